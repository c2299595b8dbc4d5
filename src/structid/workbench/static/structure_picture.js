// The picture of a structure that is being built.
import {h} from "./dom.js";
import {Scene} from "./scene.js";
import {DIRECTIONS, LINES, pairsOf, parseDofs, springEnds} from "./study_structure.js";

const TYPES = {beam: "Beam", bar: "Bar", space_beam: "SpaceBeam", point_mass: "PointMass", spring: "Spring"};

export class StructurePicture {
  constructor(stage, editor, {writable, chosen}) {
    Object.assign(this, {stage, editor, writable});
    this.tools = h("div", {class: "row"});
    this.target = null;
    this.scene = new Scene(stage, (label) => { if (label !== null && label !== undefined) { chosen(label); } });
    stage.querySelector(".hint").textContent = "Drag to turn, Shift and drag to move, wheel to zoom, click a node";
    stage.querySelector(".bar").append(h("button", {class: "small", type: "button", onclick: () => this.scene.home()}, "Show all"));
  }

  // Elements that are drawn go into this set from now on; null is the new row of its type.
  into(type, k) { this.target = {type, k}; }

  choose(label) { const row = label === null ? -1 : this.scene.row?.get(label) ?? -1; if (row !== this.scene.chosen) { this.scene.chosen = row; this.scene.ask(); } }

  show(model, doubts) {
    const chosen = this.scene.chosen >= 0 ? this.scene.labels[this.scene.chosen] : null;
    if (this.dimension !== model.dimension) { // a plane is seen face to face
      this.dimension = model.dimension;
      this.scene.first = model.dimension === 3 ? [-55, 22] : [-90, 90];
      this.scene.home();
    }
    this.scene.set(drawing(model), true);
    this.scene.findings = doubts.map((one) => ({...one, shown: one.nodes.length > 0}));
    this.scene.sensors = channels(model);
    this.choose(model.nodes.has(chosen) ? chosen : null);
  }
}

// The structure as the scene draws it; see `scene` of structid.workbench.work.scene.
function drawing(model) {
  const labels = Int32Array.from(model.nodes.keys()), row = new Map([...labels].map((label, k) => [label, k])), places = new Float32Array(3 * labels.length);
  [...model.nodes.values()].forEach((at, k) => places.set(at.map(Number).filter(Number.isFinite).slice(0, 3), 3 * k));
  const sets = model.sets.map((set) => {
    const one = {name: set.name, type: TYPES[set.type], count: 0, properties: []};
    if (LINES.includes(set.type)) { one.lines = Uint32Array.from(pairsOf(set).filter((pair) => pair.every((label) => row.has(label))).flat().map((label) => row.get(label))); }
    else if (set.type === "point_mass") {
      const nodes = (set.entry.nodes ?? []).filter((label) => row.has(label));
      one.marks = Uint32Array.from(nodes.map((label) => row.get(label)));
      one.weights = Float32Array.from(nodes.map((_, k) => [set.entry.mass].flat()[k] ?? [set.entry.mass].flat()[0] ?? 1));
    } else {
      one.connectors = springEnds(set).map((pair) => pair.map((text) => (text === null ? null : parseDofs(text)))).filter(([a, b]) => a && row.has(a.node) && (b === null || row.has(b.node)))
        .map(([a, b]) => ({from: row.get(a.node), to: b === null ? null : row.get(b.node), direction: a.directions[0]}));
    }
    return one;
  });
  const held = new Map();
  for (const one of model.fixed) { if (row.has(one.node)) { held.set(one.node, [...(held.get(one.node) ?? []), ...one.directions]); } }
  const moves = new Uint8Array(labels.length).fill(DIRECTIONS.slice(0, 3).reduce((sum, one, k) => sum + (model.active.includes(one) ? 1 << k : 0), 0));
  return {labels, places, moves, sets, links: [], supports: [...held].map(([label, directions]) => ({node: row.get(label), directions}))};
}

function channels(model) {
  const of = (list, role) => list.map((name) => ({name, dof: parseDofs(name)})).filter(({dof}) => dof).map(({name, dof}) => {
    const axis = "XYZ".indexOf(dof.directions[0].at(-1)), sign = name.includes("-") ? -1 : 1;
    return {name, role, node: dof.node, direction: [0, 1, 2].map((k) => (k === axis ? sign : 0))};
  });
  return [...of(model.sensors, "sensor"), ...of(model.loads, "load")];
}
