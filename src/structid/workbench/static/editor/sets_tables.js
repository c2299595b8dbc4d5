// The tables of element sets in *Build*, one for each type.
import {Cells} from "../cells.js";
import {h} from "../dom.js";
import {actions, LINES, parseElements} from "../study_structure.js";
import {column, defaultName, inColumn, parsed, readCell, shownKeys, shownValue, TITLES} from "./cell_texts.js";
import {sectionValues} from "./section_values.js";

const SINGULAR = {beam: "beam", space_beam: "beam", bar: "bar", point_mass: "mass", spring: "spring"};

// The tables of `bench`, each made when its type is first shown.
export function setsTables(bench) {
  const {editor} = bench,
    tables = new Map();
  const tableOf = (type) => {
    if (!tables.has(type)) {
      tables.set(type, setsTable(bench, type));
    }
    return tables.get(type);
  };
  return {
    tableOf,
    // The elements that are typed into the new row of a type; none where they cannot be read yet.
    draftOf: (type) => {
      try {
        return parseElements(tableOf(type).cells.values().nodes ?? "");
      } catch {
        return [];
      }
    },
    shownTypes: () => {
      const beam = editor.model.dimension === 3 ? "space_beam" : "beam";
      return [...new Set([beam, "bar", "point_mass", "spring", ...editor.model.sets.map((one) => one.type)])];
    },
    draw: (type) => drawSets(tableOf(type), editor.model, type, bench.kinds[type]),
  };
}

function setsTable({app, editor, run, kinds, sections, writable, into}, type) {
  const setOf = (row) => ({
    ...editor.model.sets.filter((one) => one.type === type).find((one) => String(one.k) === row),
  });
  const cells = new Cells(SINGULAR[type], {
    writable,
    addWords: "Add",
    chosen: (key) => {
      if (LINES.includes(type)) {
        into.value = `${type} ${key}`;
      }
    },
    changed: async (row, name, text) => {
      const value = parsed(kinds[type], name, text);
      return run((model) => actions.setValue(model, setOf(row), name, value));
    },
    added: (texts) => addSet(editor.model, run, type, kinds[type], texts),
    removed: (row) => {
      run((model) => actions.removeSet(model, setOf(row))).catch(app.fail);
    },
  });
  const section = h("section", {class: "card", id: `table-${type}`}, h("h2", {}, TITLES[type]), cells.box);
  if (LINES.includes(type)) {
    const write = (row, values) =>
      Promise.all(
        Object.entries(values).map(([key, value]) => run((model) => actions.setValue(model, setOf(row), key, value))),
      );
    section.append(sectionValues({app, sections, writable}, type, cells, write));
  }
  if (type === "spring") {
    const words = "From and to are a node and a direction, as in 2X; without an end the spring goes to the ground.";
    section.append(h("p", {class: "note"}, words));
  }
  return {cells, section};
}

function addSet(current, run, type, keys, texts) {
  const entry = {},
    taken = current.sets.map((one) => one.name),
    named = {...texts, name: texts.name || defaultName(type, taken)};
  for (const {name} of keys) {
    if (named[name] === undefined) {
      continue;
    }
    const value = readCell(name, () => parsed(keys, name, named[name]));
    if (value !== undefined) {
      entry[name] = value;
    }
  }
  try {
    return run((model) => actions.addSet(model, type, entry));
  } catch (error) {
    const ofNodes = /no length|no node|elements|at the same|backwards|twice/.test(error.message);
    throw inColumn(ofNodes ? "nodes" : "name", error.message);
  }
}

function drawSets({cells}, model, type, keys) {
  const sets = model.sets.filter((one) => one.type === type),
    shown = shownKeys(keys, sets);
  const taken = model.sets.map((set) => set.name);
  cells.show(
    shown.map((one) => column(type, one, defaultName(type, taken))),
    sets.map((set) => ({
      key: String(set.k),
      head: set.name,
      cells: Object.fromEntries(shown.map((one) => [one.name, shownValue(set, one.name)])),
    })),
    {},
  );
  cells.sets?.(sets);
}
