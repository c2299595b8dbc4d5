// The table of nodes in *Build*: numbers, positions and supports.
import {Cells} from "../cells.js";
import {fill, h} from "../dom.js";
import {actions, dependentsOf, parseNodes, parseNumber, shownNumber} from "../study_structure.js";
import {heldDirections, heldText, inColumn, readCell} from "./cell_texts.js";

const COORDINATES = ["X", "Y", "Z"];

// The table of `bench`; `choose` marks a node in the picture, `asked` is the box for the question before a removal.
export function nodesTable({app, editor, run, writable}, choose, asked) {
  const nextLabel = () => Math.max(0, ...editor.model.nodes.keys()) + 1;
  const cells = new Cells("node", {
    writable,
    addWords: "Add node",
    first: "X",
    chosen: (key) => choose(key === "new" ? null : Number(key)),
    changed: async (key, column, text) => changeNode(editor.model, run, Number(key), column, text),
    added: (values) => addNode(editor.model, run, values, nextLabel()),
    removed: (key) => remove(Number(key)),
  });
  const remove = (label) => {
    const words = dependentsOf(editor.model, label);
    const go = () => {
      fill(asked);
      run((model) => actions.removeNode(model, label)).catch(app.fail);
      cells.focus("new", "X");
    };
    if (words.length) {
      askBeforeRemoval(asked, label, words, go, () => cells.focus(String(label), "X"));
    } else {
      go();
    }
  };
  return {
    cells,
    section: nodesSection(cells),
    focus: (label) => cells.focus(String(label), "X"),
    place: (at) => {
      const label = nextLabel();
      return [label, run((model) => actions.addNode(model, label, at))];
    },
    draw: (marked) => drawNodes(cells, editor.model, nextLabel(), marked),
  };
}

async function changeNode(current, run, label, column, text) {
  if (column === "label") {
    return run((model) => actions.renumber(model, label, Number(parseNodes(text)[0] ?? NaN)));
  }
  if (column === "held") {
    return run((model) => actions.holdNode(model, label, heldDirections(model, text)));
  }
  const at = [...current.nodes.get(label)];
  at[COORDINATES.indexOf(column)] = parseNumber(text);
  return run((model) => actions.moveNode(model, label, at));
}

function addNode(current, run, values, next) {
  const label = values.label === "" ? next : Number(values.label);
  if (!Number.isInteger(label) || label < 0) {
    throw inColumn("label", `${values.label} is no number of a node`);
  }
  const at = COORDINATES.slice(0, current.dimension).map((name) => readCell(name, () => parseNumber(values[name])));
  const directions = readCell("held", () => heldDirections(current, values.held));
  try {
    return run((model) => actions.addNode(model, label, at, directions));
  } catch (error) {
    throw inColumn("label", error.message);
  }
}

function askBeforeRemoval(asked, label, words, remove, keep) {
  const all = h("button", {class: "main", type: "button", onclick: remove}, `Remove node ${label} and all of that`);
  const stay = () => {
    fill(asked);
    keep();
  };
  fill(
    asked,
    h(
      "div",
      {class: "card doubt", id: "removing"},
      h("p", {}, `Node ${label} carries ${words.join("; ")}.`),
      h("div", {class: "row"}, all, h("button", {type: "button", onclick: stay}, "Keep it")),
    ),
  );
  all.focus();
}

function drawNodes(cells, model, next, marked) {
  const axes = COORDINATES.slice(0, model.dimension);
  cells.show(
    [
      {key: "label", title: "number", label: "number", placeholder: String(next)},
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
}

function nodesSection(cells) {
  const ways = ["free", "pinned", "clamped"].map((one) => h("option", {value: one}));
  return h(
    "section",
    {class: "card", id: "table-nodes"},
    h("h2", {}, "Nodes"),
    cells.box,
    h("datalist", {id: "support-ways"}, ways),
    h(
      "p",
      {class: "note"},
      "Enter adds a row and goes down, arrow keys go up and down, Ctrl-Z undoes. Supports: free, pinned, clamped, or directions such as X Y.",
    ),
  );
}
