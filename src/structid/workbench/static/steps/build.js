// The editor of a structure: nodes, beams, bars, masses and springs in tables beside the picture; each edit is written to the study.
import {get, post} from "../api.js";
import {Cells} from "../cells.js";
import {field, fill, h, options, unitText} from "../dom.js";
import {Editor} from "../editor.js";
import {sceneStage} from "../scene.js";
import {StructurePicture} from "../structure_picture.js";
import {
  actions,
  dependentsOf,
  elementsText,
  findings,
  LINES,
  parseElements,
  parseNodes,
  parseNumber,
  shownNumber,
  springEnds,
} from "../study_structure.js";
import {forgetTyped, refuseTyped} from "../typed.js";

const COORDINATES = ["X", "Y", "Z"];
const MOST_NODES = 1500;
const TITLES = {beam: "Beams", space_beam: "Beams", bar: "Bars", point_mass: "Masses", spring: "Springs"};
const SINGULAR = {beam: "beam", space_beam: "beam", bar: "bar", point_mass: "mass", spring: "spring"};
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

export async function show(box, app) {
  const {structure} = app.now.table ?? {};
  if (structure && ["mesh", "matrices", "matrix_group", "solver"].some((key) => key in structure)) {
    fill(
      box,
      h("h1", {}, "Build"),
      h(
        "p",
        {},
        "The nodes of this study come from a mesh, from matrices or from a solver: they are edited in the program that made them. Supports, masses and springs beside them are written in the last step, Study file.",
      ),
    );
    return;
  }
  if (Object.keys(structure?.nodes ?? {}).length > MOST_NODES) {
    fill(
      box,
      h("h1", {}, "Build"),
      h(
        "p",
        {},
        `The tables are for structures of up to ${MOST_NODES} nodes; larger ones are edited in the last step, Study file.`,
      ),
    );
    return;
  }
  const [kinds, sections] = await Promise.all([get("kinds"), get("sections")]);
  const stage = sceneStage([], "");
  const undo = h("button", {type: "button", onclick: () => step("undo")}, "Undo"),
    redo = h("button", {type: "button", onclick: () => step("redo")}, "Redo");
  const told = h("div", {id: "doubts", "aria-live": "polite"}),
    state = h("p", {class: "note", id: "readable", "aria-live": "polite"});
  const asked = h("div", {"aria-live": "assertive"}),
    parts = h("div", {id: "tables"}),
    writable = app.folder.writable;
  const editor = new Editor(app, () => draw()),
    picture = new StructurePicture(
      stage,
      editor.model,
      {
        chosen: (label) => focusNode(label),
        add: (at) => place(at)[1],
        place: (at) => place(at),
        move: (label, at) => run((model) => actions.moveNode(model, label, at)),
        join: (a, b) => join(a, b),
      },
      writable,
      app.study,
    );
  const step = (way) => editor[way]().catch(app.fail);
  const run = (action) => editor.do(action);

  const nodes = new Cells("node", {
    writable,
    addWords: "Add node",
    first: "X",
    chosen: (key) => picture.choose(key === "new" ? null : Number(key)),
    changed: async (key, column, text) => {
      const label = Number(key);
      if (column === "label") {
        return run((model) => actions.renumber(model, label, Number(parseNodes(text)[0] ?? NaN)));
      }
      if (column === "held") {
        return run((model) => actions.holdNode(model, label, heldDirections(model, text)));
      }
      const at = [...editor.model.nodes.get(label)];
      at[COORDINATES.indexOf(column)] = parseNumber(text);
      return run((model) => actions.moveNode(model, label, at));
    },
    added: (values) => {
      const label = values.label === "" ? nextLabel() : Number(values.label);
      if (!Number.isInteger(label) || label < 0) {
        throw inColumn("label", `${values.label} is no number of a node`);
      }
      const at = COORDINATES.slice(0, editor.model.dimension).map((name) =>
        readCell(name, () => parseNumber(values[name])),
      );
      const directions = readCell("held", () => heldDirections(editor.model, values.held));
      try {
        return run((model) => actions.addNode(model, label, at, directions));
      } catch (error) {
        throw inColumn("label", error.message);
      }
    },
    removed: (key) => removeNode(Number(key)),
  });
  const held = h(
    "datalist",
    {id: "support-ways"},
    ["free", "pinned", "clamped"].map((one) => h("option", {value: one})),
  );
  const tables = new Map();

  // Elements that are drawn go into a set that is chosen, or into the new row of a type.
  const into = h("select", {id: "drawn-into", "data-kept": true}),
    place = (at) => {
      const label = nextLabel();
      return [label, run((model) => actions.addNode(model, label, at))];
    };
  picture.tools.firstChild?.append(field("elements go into", into));
  function join(a, b) {
    const {model} = editor,
      [type, k] = into.value.split(" "),
      set = model.sets.find((one) => one.type === type && String(one.k) === k);
    const pair = model.dimension === 1 && model.nodes.get(a)[0] > model.nodes.get(b)[0] ? [b, a] : [a, b];
    if (set) {
      return run((now) => actions.addElement(now, set, pair));
    }
    const {cells} = setsTable(type),
      drafted = draftOf(cells);
    if (drafted.some((one) => pair.every((label) => one.includes(label)))) {
      throw new Error(`element ${pair.join("-")} is there already`);
    }
    cells.fill({nodes: elementsText([...drafted, pair])});
    draw();
    return null;
  }
  const draftOf = (cells) => {
    try {
      return parseElements(cells.values().nodes ?? "");
    } catch {
      return [];
    }
  };

  const nextLabel = () => Math.max(0, ...editor.model.nodes.keys()) + 1;
  const focusNode = (label) => nodes.focus(String(label), "X");

  function removeNode(label) {
    const words = dependentsOf(editor.model, label);
    const go = () => {
      fill(asked);
      run((model) => actions.removeNode(model, label)).catch(app.fail);
      nodes.focus("new", "X");
    };
    if (!words.length) {
      go();
      return;
    }
    const all = h("button", {class: "main", type: "button", onclick: go}, `Remove node ${label} and all of that`);
    fill(
      asked,
      h(
        "div",
        {class: "card doubt", id: "removing"},
        h("p", {}, `Node ${label} carries ${words.join("; ")}.`),
        h(
          "div",
          {class: "row"},
          all,
          h(
            "button",
            {
              type: "button",
              onclick: () => {
                fill(asked);
                focusNode(label);
              },
            },
            "Keep it",
          ),
        ),
      ),
    );
    all.focus();
  }

  // A table of element sets of one type.
  function setsTable(type) {
    if (tables.has(type)) {
      return tables.get(type);
    }
    const values = (row) => ({
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
      changed: async (row, column, text) => {
        const value = parsed(kinds[type], column, text);
        return run((model) => actions.setValue(model, values(row), column, value));
      },
      added: (texts) => {
        const entry = {},
          taken = editor.model.sets.map((one) => one.name);
        texts = {...texts, name: texts.name || defaultName(type, taken)};
        for (const {name} of kinds[type]) {
          if (texts[name] === undefined) {
            continue;
          }
          const value = readCell(name, () => parsed(kinds[type], name, texts[name]));
          if (value !== undefined) {
            entry[name] = value;
          }
        }
        try {
          return run((model) => actions.addSet(model, type, entry));
        } catch (error) {
          throw inColumn(
            /no length|no node|elements|at the same|backwards|twice/.test(error.message) ? "nodes" : "name",
            error.message,
          );
        }
      },
      removed: (row) => {
        run((model) => actions.removeSet(model, values(row))).catch(app.fail);
      },
    });
    const made = {
      cells,
      section: h("section", {class: "card", id: `table-${type}`}, h("h2", {}, TITLES[type]), cells.box),
    };
    if (LINES.includes(type)) {
      made.section.append(
        preset(type, cells, (row, found) =>
          Promise.all(
            Object.entries(found).map(([key, value]) =>
              run((model) => actions.setValue(model, values(row), key, value)),
            ),
          ),
        ),
      );
    }
    if (type === "spring") {
      made.section.append(
        h(
          "p",
          {class: "note"},
          "From and to are a node and a direction, as in 2X; without an end the spring goes to the ground.",
        ),
      );
    }
    tables.set(type, made);
    return made;
  }

  const shownTypes = () => {
    const beam = editor.model.dimension === 3 ? "space_beam" : "beam";
    return [...new Set([beam, "bar", "point_mass", "spring", ...editor.model.sets.map((one) => one.type)])];
  };

  function preset(type, cells, write) {
    const material = h("select", {"data-kept": true}, options(sections.materials)),
      shape = h(
        "select",
        {"data-kept": true, onchange: () => sizes()},
        options(sections.shapes.map((one) => one.name)),
      );
    const inputs = h("div", {class: "row end"}),
      turned = h("input", {type: "checkbox", "data-kept": true}),
      into = h("select", {"data-kept": true});
    const sizes = () =>
      fill(
        inputs,
        Object.entries(sections.shapes.find((one) => one.name === shape.value).sizes).map(([name, size]) =>
          field(`${name}, mm`, h("input", {name, value: String(size), inputmode: "decimal"}), "short"),
        ),
      );
    const take = h(
      "button",
      {
        type: "button",
        disabled: !writable,
        onclick: () =>
          app.doing(take, async () => {
            const given = Object.fromEntries(
              [...inputs.querySelectorAll("input")].map((one) => [one.name, one.value.trim()]),
            );
            const found = await post("sections", {
              element: type,
              material: material.value,
              shape: shape.value,
              sizes: given,
              is_turned: turned.checked,
            });
            if (into.value === "new") {
              cells.fill(Object.fromEntries(Object.entries(found).map(([key, value]) => [key, shownNumber(value)])));
              cells.focus("new", "name");
            } else {
              await write(into.value, found);
            }
          }),
      },
      "Take its values",
    );
    sizes();
    const details = h(
      "details",
      {class: "preset", "data-kept": true},
      h("summary", {}, "Values from material and cross-section"),
      h(
        "div",
        {class: "row end"},
        field("Material", material),
        field("Cross-section", shape),
        inputs,
        type === "bar"
          ? null
          : h("label", {class: "check"}, turned, type === "beam" ? "lying on its side" : "width along local y"),
        field("for", into),
        take,
      ),
    );
    cells.sets = (sets) => {
      const before = into.value;
      fill(into, options([["new", "the new row"], ...sets.map((one) => [String(one.k), one.name])]));
      if ([...into.options].some((one) => one.value === before)) {
        into.value = before;
      }
    };
    return details;
  }

  function draw() {
    const {model} = editor,
      doubts = findings(model),
      marked = new Set(doubts.flatMap((one) => one.nodes));
    const axes = COORDINATES.slice(0, model.dimension);
    nodes.show(
      [
        {key: "label", title: "number", label: "number", placeholder: String(nextLabel())},
        ...axes.map((name) => ({key: name, title: `${name}, m`, label: name})),
        {key: "held", title: "support", label: "support", list: "support-ways", placeholder: "free"},
      ],
      [...model.nodes].map(([label, at]) => ({
        key: String(label),
        head: `node ${label}`,
        cells: {
          label: String(label),
          ...Object.fromEntries(axes.map((name, k) => [name, shownNumber(at[k])])),
          held: heldText(model, label),
        },
        mark: marked.has(label) ? "doubtful" : null,
      })),
      {},
    );
    const types = shownTypes();
    for (const type of types) {
      const own = model.sets.filter((one) => one.type === type),
        {cells} = setsTable(type);
      const keys = kinds[type].filter(
        (one) =>
          !LEFT_OUT.includes(one.name) &&
          (one.required ||
            TEXTS.includes(one.name) ||
            USUAL.includes(one.name) ||
            own.some((set) => one.name in set.entry)),
      );
      cells.show(
        keys.map((one) =>
          column(
            type,
            one,
            defaultName(
              type,
              model.sets.map((set) => set.name),
            ),
          ),
        ),
        own.map((set) => ({
          key: String(set.k),
          head: set.name,
          cells: Object.fromEntries(keys.map((one) => [one.name, shownValue(set, one.name)])),
        })),
        {},
      );
      cells.sets?.(own);
    }
    const order = [nodesPart, ...types.map((type) => setsTable(type).section), planPart];
    if (order.some((one, k) => parts.children[k] !== one) || parts.children.length !== order.length) {
      fill(parts, order);
    }
    drawPlan();
    fill(
      told,
      doubts.length
        ? h(
            "section",
            {class: "card doubt"},
            h("h2", {}, "To be looked at"),
            h(
              "ul",
              {class: "plain marked"},
              doubts.map((one, k) =>
                h(
                  "li",
                  {},
                  h("div", {class: "check"}, h("b", {class: "tag"}, String(k + 1)), h("span", {}, one.words)),
                ),
              ),
            ),
          )
        : null,
    );
    const {undo: back, redo: again} = editor.history;
    for (const [button, list, word] of [
      [undo, back, "Undo"],
      [redo, again, "Redo"],
    ]) {
      button.disabled = !list.length;
      button.textContent = list.length ? `${word}: ${list.at(-1).words}` : word;
    }
    const lines = types.filter((type) => LINES.includes(type)),
      targets = lines.flatMap((type) => [
        [`${type} new`, `new ${TITLES[type].toLowerCase()}`],
        ...model.sets.filter((one) => one.type === type).map((one) => [`${type} ${one.k}`, one.name]),
      ]);
    fill(into, options(targets, targets.some(([value]) => value === into.value) ? into.value : targets[0][0]));
    picture.draft = lines.flatMap((type) => draftOf(setsTable(type).cells));
    picture.show(model, doubts);
    read();
  }

  // What comes next is told at once; whether the study can be read as it stands, a moment after the last edit.
  let timer = 0;
  function read() {
    clearTimeout(timer);
    const {model} = editor;
    if (editor.count) {
      fill(state, "Saving…");
      return;
    }
    if (!model.nodes.size) {
      fill(state, "Begin with the nodes: type a coordinate, Tab, and Enter at the end of the row.");
      return;
    }
    if (!model.sets.length && !model.others.length) {
      fill(state, "Saved. Now join the nodes: name some beams, write their elements as in 1-2, and give their values.");
      return;
    }
    timer = setTimeout(async () => {
      const digest = app.now.digest;
      let words = "Saved. The study can be read; step Structure shows what it can determine.";
      try {
        await get("line", {study: app.study});
      } catch (error) {
        words = model.unknown.length
          ? `Saved. It cannot be used yet: ${error.message}`
          : "Saved. The next thing to say is what you look for: step Unknowns.";
      }
      if (app.now?.digest === digest) {
        fill(state, words);
      }
    }, 500);
  }

  const plan = new Map([
    ["installed_sensors", ["Sensors", "sensors"]],
    ["installed_loads", ["Loads", "loads"]],
  ]);
  const planInputs = new Map(
    [...plan].map(([key, [words]]) => [
      key,
      h("input", {spellcheck: "false", readonly: !writable, placeholder: "such as 3X, 5Y", "data-label": words}),
    ]),
  );
  const planNote = h("p", {class: "note"}),
    planPart = h(
      "section",
      {class: "card", id: "plan-places"},
      h("h2", {}, "Sensors and loads"),
      h(
        "div",
        {class: "row end"},
        [...planInputs].map(([key, input]) => field(plan.get(key)[0], input, "wide-field")),
      ),
      planNote,
    );
  for (const [key, input] of planInputs) {
    input.addEventListener("change", () => {
      const list = input.value.split(/[,;\s]+/).filter(Boolean);
      planWords();
      try {
        run((model) => actions.setPlan(model, key, list)).then(
          () => forgetTyped(input),
          (error) => refuseTyped(input, error.message),
        );
      } catch (error) {
        refuseTyped(input, error.message);
      }
    });
    input.addEventListener("refused", ({detail}) => planWords(detail));
  }
  const planWords = (words = "") => {
    fill(
      planNote,
      words
        ? h("span", {class: "wrong"}, words)
        : editor.model.hasRecord
          ? "Those of the record are placed in step Structure; these are for a plan."
          : "Where the test is to measure and to push: node and direction, as in 3X. A click on a node in step Structure does the same.",
    );
  };
  function drawPlan() {
    for (const [key, input] of planInputs) {
      const text = editor.model[plan.get(key)[1]].join(", ");
      if (!input.hasAttribute("aria-invalid") && document.activeElement !== input) {
        input.value = text;
      }
    }
    if (!planPart.querySelector("[aria-invalid]")) {
      planWords();
    }
  }

  const nodesPart = h(
    "section",
    {class: "card", id: "table-nodes"},
    h("h2", {}, "Nodes"),
    nodes.box,
    held,
    h(
      "p",
      {class: "note"},
      "Enter adds a row and goes down, arrow keys go up and down, Ctrl-Z undoes. Supports: free, pinned, clamped, or directions such as X Y.",
    ),
  );
  fill(
    box,
    h("h1", {}, app.now.table?.title || app.study),
    h(
      "div",
      {class: "row"},
      undo,
      redo,
      h("a", {class: "button", href: `#structure/${encodeURIComponent(app.study)}`}, "To the structure"),
    ),
    state,
    h(
      "div",
      {class: "build"},
      h("div", {class: "picture"}, picture.tools, stage, told),
      h("div", {class: "main-part"}, asked, parts),
    ),
  );
  box.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || !["z", "y"].includes(event.key.toLowerCase())) {
      return;
    }
    if (event.target.cell && event.target.value !== event.target.cell.saved) {
      return;
    } // what is being typed is undone by the browser
    event.preventDefault();
    step(event.key.toLowerCase() === "y" || event.shiftKey ? "redo" : "undo");
  });
  draw();
  if (writable && !editor.model.nodes.size) {
    nodes.focus("new", "X");
  }
}

// The name of a set that is given none.
function defaultName(type, taken) {
  const base = TITLES[type].toLowerCase();
  for (let k = 1; ; k += 1) {
    const name = k === 1 ? base : `${base} ${k}`;
    if (!taken.includes(name)) {
      return name;
    }
  }
}

const inColumn = (column, words) => Object.assign(new Error(words), {column});

// What `read()` makes of a cell of the new row; what is wrong with it is told at its `column`.
function readCell(column, read) {
  try {
    return read();
  } catch (error) {
    throw inColumn(column, error.message);
  }
}

function column(type, one, name) {
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

function shownValue(set, key) {
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
function parsed(keys, key, text) {
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

function heldText(model, label) {
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

function heldDirections(model, text) {
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
