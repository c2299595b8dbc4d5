// The editor of a structure: nodes, beams, bars, masses and springs in tables beside the picture; each edit is written to the study.
import {get} from "../api.js";
import {arrange} from "../cells.js";
import {field, fill, h, options} from "../dom.js";
import {TITLES} from "../editor/cell_texts.js";
import {nodesTable} from "../editor/nodes_table.js";
import {planPlaces} from "../editor/plan_places.js";
import {readableLine} from "../editor/readable.js";
import {setsTables} from "../editor/sets_tables.js";
import {Editor} from "../editor.js";
import {sceneStage} from "../scene.js";
import {StructurePicture} from "../structure_picture.js";
import {actions, elementsText, findings, LINES} from "../study_structure.js";

const MOST_NODES = 1500;

export async function show(box, app) {
  const elsewhere = editedElsewhere(app.now.table?.structure);
  if (elsewhere) {
    fill(box, h("h1", {}, "Build"), h("p", {}, elsewhere));
    return;
  }
  const [kinds, sections] = await Promise.all([get("kinds"), get("sections")]);
  const editor = new Editor(app, () => draw()),
    {writable} = app.folder,
    into = h("select", {id: "drawn-into", "data-kept": true}),
    asked = h("div", {"aria-live": "assertive"}),
    run = (action) => editor.do(action);
  const bench = {app, editor, run, kinds, sections, writable, into};
  const nodes = nodesTable(bench, (label) => picture.choose(label), asked),
    sets = setsTables(bench),
    plan = planPlaces(bench);
  const stage = sceneStage([], ""),
    picture = new StructurePicture(
      stage,
      editor.model,
      {
        chosen: (label) => nodes.focus(label),
        add: (at) => nodes.place(at)[1],
        place: (at) => nodes.place(at),
        move: (label, at) => run((model) => actions.moveNode(model, label, at)),
        join: (a, b) => join(bench, sets, a, b, () => draw()),
      },
      writable,
      app.study,
    );
  picture.tools.firstChild?.append(field("elements go into", into));
  const page = pageParts(app, editor, picture.tools, stage, asked),
    tellReadable = readableLine(bench, page.state);
  const draw = () => {
    const {model} = editor,
      doubts = findings(model),
      types = sets.shownTypes();
    nodes.draw(new Set(doubts.flatMap((one) => one.nodes)));
    types.forEach(sets.draw);
    arrange(page.tables, [nodes.section, ...types.map((type) => sets.tableOf(type).section), plan.section]);
    plan.draw();
    fill(page.told, doubtsCard(doubts));
    page.drawHistory();
    const lines = types.filter((type) => LINES.includes(type));
    offerSets(into, lines, model.sets);
    picture.draft = lines.flatMap(sets.draftOf);
    picture.show(model, doubts);
    tellReadable();
  };
  fill(box, page.parts);
  listenToUndo(box, page.step);
  draw();
  if (writable && !editor.model.nodes.size) {
    nodes.cells.focus("new", "X");
  }
}

// Words on where a structure is edited that has no tables here; "" where it has.
function editedElsewhere(structure) {
  if (structure && ["mesh", "matrices", "matrix_group", "solver"].some((key) => key in structure)) {
    return "The nodes of this study come from a mesh, from matrices or from a solver: they are edited in the program that made them. Supports, masses and springs beside them are written in the last step, Study file.";
  }
  return Object.keys(structure?.nodes ?? {}).length > MOST_NODES
    ? `The tables are for structures of up to ${MOST_NODES} nodes; larger ones are edited in the last step, Study file.`
    : "";
}

// An element from node `a` to node `b`: into the set that is chosen, or into the new row of a type.
function join({editor, run, into}, sets, a, b, draw) {
  const {model} = editor,
    [type, k] = into.value.split(" "),
    set = model.sets.find((one) => one.type === type && String(one.k) === k);
  const pair = model.dimension === 1 && model.nodes.get(a)[0] > model.nodes.get(b)[0] ? [b, a] : [a, b];
  if (set) {
    return run((now) => actions.addElement(now, set, pair));
  }
  const drafted = sets.draftOf(type);
  if (drafted.some((one) => pair.every((label) => one.includes(label)))) {
    throw new Error(`element ${pair.join("-")} is there already`);
  }
  sets.tableOf(type).cells.fill({nodes: elementsText([...drafted, pair])});
  draw();
  return null;
}

// What stands around the tables: undo and redo, one line on the study, the picture with what is doubtful in it.
function pageParts(app, editor, tools, stage, asked) {
  const step = (way) => editor[way]().catch(app.fail);
  const undo = h("button", {type: "button", onclick: () => step("undo")}, "Undo"),
    redo = h("button", {type: "button", onclick: () => step("redo")}, "Redo");
  const told = h("div", {id: "doubts", "aria-live": "polite"}),
    state = h("p", {class: "note", id: "readable", "aria-live": "polite"}),
    tables = h("div", {id: "tables"}),
    next = h("a", {class: "button", href: `#structure/${encodeURIComponent(app.study)}`}, "To the structure");
  const parts = [
    h("h1", {}, app.now.table?.title || app.study),
    h("div", {class: "row"}, undo, redo, next),
    state,
    h(
      "div",
      {class: "build"},
      h("div", {class: "picture"}, tools, stage, told),
      h("div", {class: "main-part"}, asked, tables),
    ),
  ];
  const drawHistory = () => {
    const {undo: back, redo: again} = editor.history;
    for (const [button, list, word] of [
      [undo, back, "Undo"],
      [redo, again, "Redo"],
    ]) {
      button.disabled = !list.length;
      button.textContent = list.length ? `${word}: ${list.at(-1).words}` : word;
    }
  };
  return {parts, step, told, state, tables, drawHistory};
}

function doubtsCard(doubts) {
  const rows = doubts.map((one, k) =>
    h("li", {}, h("div", {class: "check"}, h("b", {class: "tag"}, String(k + 1)), h("span", {}, one.words))),
  );
  return rows.length
    ? h("section", {class: "card doubt"}, h("h2", {}, "To be looked at"), h("ul", {class: "plain marked"}, rows))
    : null;
}

// The element sets that a drawn element may go into; the choice stays where it is still offered.
function offerSets(into, types, sets) {
  const targets = types.flatMap((type) => [
    [`${type} new`, `new ${TITLES[type].toLowerCase()}`],
    ...sets.filter((one) => one.type === type).map((one) => [`${type} ${one.k}`, one.name]),
  ]);
  fill(into, options(targets, into.value));
}

function listenToUndo(box, step) {
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
}
