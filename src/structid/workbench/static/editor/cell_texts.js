// Texts of cells in the tables of *Build*, both ways: what a cell shows of a structure, and what a typed text means.
import {unitText} from "../dom.js";
import {
  elementsText,
  LINES,
  parseElements,
  parseNodes,
  parseNumber,
  shownNumber,
  springEnds,
} from "../study_structure.js";

export const TITLES = {beam: "Beams", space_beam: "Beams", bar: "Bars", point_mass: "Masses", spring: "Springs"};
// Columns that stand there without being asked for, and short names of some.
const USUAL = ["axial_stiffness", "torsional_stiffness", "polar_inertia", "loss_factor", "orientation"];
const SHORT = {
  mass: "mass",
  bending_stiffness: "EI",
  bending_stiffness_y: "EI about y",
  bending_stiffness_z: "EI about z",
  axial_stiffness: "EA",
  torsional_stiffness: "GJ",
  loss_factor: "loss factor",
};
const LEFT_OUT = ["tolerance", "directions"];
const TEXTS = ["name", "nodes", "first", "second"];

// The keys that have a column: needed or usual ones, and those that one of the element sets `sets` states.
export function shownKeys(keys, sets) {
  return keys.filter(
    (one) =>
      !LEFT_OUT.includes(one.name) &&
      (one.required ||
        TEXTS.includes(one.name) ||
        USUAL.includes(one.name) ||
        sets.some((set) => one.name in set.entry)),
  );
}

// The name of a set that is given none.
export function defaultName(type, taken) {
  const base = TITLES[type].toLowerCase();
  for (let k = 1; ; k += 1) {
    const name = k === 1 ? base : `${base} ${k}`;
    if (!taken.includes(name)) {
      return name;
    }
  }
}

export const inColumn = (column, words) => Object.assign(new Error(words), {column});

// What `read()` makes of a cell of the new row; what is wrong with it is told at its `column`.
export function readCell(column, read) {
  try {
    return read();
  } catch (error) {
    throw inColumn(column, error.message);
  }
}

export function column(type, one, name) {
  const unit = one.unit && one.unit !== "1" ? `, ${unitText(one.unit)}` : "";
  const titles = {name: "name", nodes: LINES.includes(type) ? "elements" : "nodes", first: "from", second: "to"};
  const placeholder =
    {name, nodes: LINES.includes(type) ? "1-2, 3-4" : "2, 3", first: "2X", second: "ground", orientation: "default"}[
      one.name
    ] ?? (one.required ? "" : "–");
  return {
    key: one.name,
    title: titles[one.name] ?? `${SHORT[one.name] ?? one.name.replaceAll("_", " ")}${unit}`,
    label: titles[one.name] ?? SHORT[one.name] ?? one.name.replaceAll("_", " "),
    placeholder,
    wide: ["nodes", "name"].includes(one.name),
  };
}

export function shownValue(set, key) {
  const value = set.entry[key];
  if (key === "nodes") {
    return LINES.includes(set.type) ? elementsText(value ?? []) : (value ?? []).join(", ");
  }
  if (key === "first" || key === "second") {
    return springEnds(set)
      .map((pair) => pair[key === "first" ? 0 : 1])
      .filter((text) => text !== null)
      .join(", ");
  }
  return value === undefined
    ? ""
    : [value]
        .flat()
        .map((one) => (typeof one === "number" ? shownNumber(one) : String(one)))
        .join(", ");
}

// The value of a cell; undefined where it may be left out, and is.
export function parsed(keys, key, text) {
  const own = keys.find((one) => one.name === key);
  if (key === "name") {
    return text;
  }
  if (key === "nodes") {
    return keys.some((one) => one.unit === "kg/m") ? parseElements(text) : parseNodes(text);
  }
  if (key === "first" || key === "second") {
    const list = text
      .split(/[,;]+/)
      .map((part) => part.trim())
      .filter(Boolean);
    return list.length ? list : undefined;
  }
  if (!text && !own.required) {
    return undefined;
  }
  const values = text.split(/,\s+|;|\s+/).filter(Boolean);
  const numbers = values.length
    ? values.map((part) => parseNumber(part))
    : [parseNumber(text, own.unit && own.unit !== "1" ? `, in ${unitText(own.unit)}` : "")];
  return numbers.length === 1 ? numbers[0] : numbers;
}

const translations = (model) => model.active.filter((one) => !one.startsWith("R"));

export function heldText(model, label) {
  const directions = model.active.filter((one) =>
    model.fixed.some((held) => held.node === label && held.directions.includes(one)),
  );
  return !directions.length
    ? ""
    : directions.length === model.active.length
      ? "clamped"
      : directions.join() === translations(model).join()
        ? "pinned"
        : directions.join(" ");
}

export function heldDirections(model, text) {
  const word = text.trim().toLowerCase();
  if (!word || word === "free") {
    return [];
  }
  if (word === "clamped" || word === "fixed") {
    return [...model.active];
  }
  if (word === "pinned") {
    return translations(model);
  }
  const directions = text
    .toUpperCase()
    .split(/[,;\s]+/)
    .filter(Boolean);
  for (const one of directions) {
    if (!model.active.includes(one)) {
      throw new Error(
        `${one} is no direction of this structure; write free, pinned, clamped, or some of ${model.active.join(" ")}`,
      );
    }
  }
  return model.active.filter((one) => directions.includes(one));
}
