// The picture of a structure that is being built: nodes by a click, elements from node to node, nodes dragged on a grid.
import {field, h} from "./dom.js";
import {Scene} from "./scene.js";
import {DIRECTIONS, LINES, pairsOf, parseDofs, springEnds} from "./study_structure.js";

const TYPES = {beam: "Beam", bar: "Bar", space_beam: "SpaceBeam", point_mass: "PointMass", spring: "Spring"};

const TOOLS = [
  [
    "choose",
    "Choose and move",
    "Click a node to choose it, drag it to move it; drag elsewhere to turn, Shift and drag to move the picture",
  ],
  ["node", "Add nodes", "Click where the node goes"],
  ["element", "Add elements", "Click one node after the other; Escape ends the chain"],
];

const tools = new Map(); // the one in use, by study, also after the step is drawn anew

export class StructurePicture {
  // `acts` are chosen(label), add(at), move(label, at), join(label, label): each writes the study, or refuses by an error.
  constructor(stage, model, acts, writable, study) {
    Object.assign(this, {stage, acts, model, study, from: null, draft: []});
    this.scene = new Scene(stage, (label) => {
      if (label !== null && label !== undefined) {
        acts.chosen(label);
      }
    });
    this.scene.tool = {grab: (point) => this.grab(point), click: (point, row) => this.click(point, row)};
    this.scene.drawn = (c, colour) => this.drawGrid(c, colour);
    this.hint = stage.querySelector(".hint");
    this.told = h("div", {class: "say", "aria-live": "polite"});
    this.step = h("input", {
      value: "0.5",
      inputmode: "decimal",
      onchange: () => {
        if (!(Number(this.step.value) > 0)) {
          this.step.value = "0.5";
        }
        this.show(this.model, this.scene.findings);
      },
    });
    this.buttons = TOOLS.map(([kind, words]) =>
      h("button", {class: "small", type: "button", "aria-pressed": "false", onclick: () => this.use(kind)}, words),
    );
    this.tools = h(
      "div",
      {hidden: !writable},
      writable
        ? h(
            "div",
            {class: "row end"},
            h("div", {class: "row", role: "group", "aria-label": "What a click does"}, this.buttons),
            field("grid, m", this.step, "short"),
          )
        : null,
    );
    stage.append(this.told);
    stage
      .querySelector(".bar")
      .append(h("button", {class: "small", type: "button", onclick: () => this.scene.home()}, "Show all"));
    stage.addEventListener("keydown", (event) => {
      if (event.key === "Escape") {
        this.from = null;
        this.scene.ask();
      }
    });
    this.use(tools.get(study) ?? "choose");
  }

  get grid() {
    return Number(this.step.value) || 0.5;
  }

  use(kind) {
    this.kind = kind;
    tools.set(this.study, kind);
    this.from = null;
    this.buttons.forEach((button, k) => button.setAttribute("aria-pressed", String(TOOLS[k][0] === kind)));
    this.hint.textContent = TOOLS.find(([name]) => name === kind)[2];
    this.scene.ask();
  }

  choose(label) {
    const row = label === null ? -1 : (this.scene.row?.get(label) ?? -1);
    if (row !== this.scene.chosen) {
      this.scene.chosen = row;
      this.scene.ask();
    }
  }

  show(model, doubts) {
    const {scene} = this,
      chosen = scene.chosen >= 0 ? scene.labels[scene.chosen] : null;
    this.model = model;
    scene.least = (model.nodes.size < 3 ? 60 : 20) * this.grid; // room to begin with
    if (this.dimension !== model.dimension) {
      // a plane is seen face to face
      this.dimension = model.dimension;
      scene.first = model.dimension === 3 ? [-55, 22] : [-90, 90];
      scene.home();
    }
    scene.still = scene.view && this.isSeen(model) ? scene.unit / scene.zoom : 0;
    scene.set(drawing(model, this.draft), true);
    scene.findings = doubts.map((one) => ({...one, shown: one.nodes.length > 0}));
    scene.sensors = channels(model);
    this.choose(model.nodes.has(chosen) ? chosen : null);
  }

  // All nodes lie within the stage as it is seen now, and do not crowd in a corner of it; whoever draws keeps the view.
  isSeen(model) {
    const {width, height} = this.scene.view,
      points = [...model.nodes.values()].map((at) => this.scene.project([at[0] ?? 0, at[1] ?? 0, at[2] ?? 0]));
    const inside = points.every(([x, y]) => x > 12 && y > 12 && x < width - 12 && y < height - 30),
      wide = (k) => Math.max(...points.map((point) => point[k])) - Math.min(...points.map((point) => point[k]));
    return (
      inside &&
      (points.length < 2 ||
        this.kind !== "choose" ||
        this.scene.dragging ||
        Math.max(wide(0) / width, wide(1) / height) > 0.3)
    );
  }

  // The place on the grid under a point, in the plane of the structure, or of `through` and the two axes that are seen best.
  place(point, through = [0, 0, 0]) {
    const {dimension} = this.model,
      eye = this.scene.view.turn[2].map(Math.abs),
      normal = dimension < 3 ? 2 : eye.indexOf(Math.max(...eye));
    const at = this.scene.under(
      point,
      [0, 1, 2].map((k) => through[k] ?? 0),
      normal,
    );
    if (!at) {
      throw new Error("the plane of the structure is seen edge-on; Show all turns it back");
    }
    return at
      .slice(0, dimension)
      .map((x, k) =>
        dimension === 3 && k === normal
          ? through[k]
          : Number((Math.round(x / this.grid) * this.grid).toPrecision(9)) + 0,
      );
  }

  // The answer of `action`; what it refuses, at once or when it is written, is told in the picture.
  attempt(action) {
    const refused = (error) => {
      this.told.textContent = error.message;
      return null;
    };
    this.told.textContent = "";
    try {
      const answer = action();
      answer?.catch?.(refused);
      return answer;
    } catch (error) {
      return refused(error);
    }
  }

  click(point, row) {
    const label = row < 0 ? null : this.scene.labels[row];
    if (this.kind === "choose" || !this.buttons[0].isConnected) {
      return false;
    }
    const before = this.scene.chosen < 0 ? undefined : this.model.nodes.get(this.scene.labels[this.scene.chosen]);
    if (this.kind === "node") {
      if (label === null) {
        this.attempt(() => this.acts.add(this.place(point, before)));
      } else {
        this.told.textContent = `there is node ${label}`;
      }
      return true;
    }
    this.attempt(() => {
      let to = label,
        done = null;
      if (to === null) {
        [to, done] = this.acts.place(this.place(point, before));
      }
      const from = this.from;
      this.from = to === from ? null : to;
      this.choose(this.from);
      return from === null || from === to ? done : this.acts.join(from, to);
    });
    this.scene.ask();
    return true;
  }

  // A node that is dragged; the picture follows, the study when it is let go.
  grab(point) {
    const row =
      this.kind === "choose" && this.buttons[0].isConnected && this.scene.view ? this.scene.nearest(...point) : -1;
    if (row < 0) {
      return null;
    }
    const label = this.scene.labels[row],
      start = this.model.nodes.get(label),
      {model} = this;
    const to = (now) => this.place(now, start),
      moved = (at) => this.show({...model, nodes: new Map(model.nodes).set(label, at)}, []);
    const back = () => this.show(model, []);
    return {
      move: (now) =>
        this.attempt(() => {
          moved(to(now));
          this.told.textContent = `node ${label}: ${to(now).join(", ")} m`;
        }),
      drop: (now) => {
        back();
        this.choose(label);
        const at = this.attempt(() => to(now));
        if (at && at.some((x, k) => x !== start[k])) {
          this.attempt(() => this.acts.move(label, at));
        }
      },
      cancel: back,
    };
  }

  drawGrid(c, colour) {
    const {scene} = this,
      step = this.grid,
      {width, height, unit} = scene.view;
    if (this.from !== null && scene.row.has(this.from)) {
      const [x, y] = scene.seen(scene.row.get(this.from));
      c.strokeStyle = colour("--accent");
      c.lineWidth = 3;
      c.beginPath();
      c.arc(x, y, 13, 0, 7);
      c.stroke();
    }
    if (this.model.dimension === 3 || unit * step < 7 || Math.abs(scene.elevation) < 89) {
      return;
    }
    const [low, high] = [scene.under([0, height], [0, 0, 0], 2), scene.under([width, 0], [0, 0, 0], 2)];
    c.fillStyle = colour("--muted");
    c.globalAlpha = 0.45;
    for (let i = Math.ceil(low[0] / step); i * step <= high[0]; i += 1) {
      for (let j = Math.ceil(low[1] / step); j * step <= high[1]; j += 1) {
        const [x, y] = scene.project([i * step, j * step, 0]);
        c.fillRect(x - 0.75, y - 0.75, 1.5, 1.5);
      }
    }
    c.globalAlpha = 1;
  }
}

// The structure as the scene draws it; see `scene` of structid.workbench.work.scene.
function drawing(model, draft) {
  const labels = Int32Array.from(model.nodes.keys()),
    row = new Map([...labels].map((label, k) => [label, k])),
    places = new Float32Array(3 * labels.length);
  [...model.nodes.values()].forEach((at, k) => places.set(at.map(Number).filter(Number.isFinite).slice(0, 3), 3 * k));
  const sets = model.sets.map((set) => {
    const one = {name: set.name, type: TYPES[set.type], count: 0, properties: []};
    if (LINES.includes(set.type)) {
      one.lines = Uint32Array.from(
        pairsOf(set)
          .filter((pair) => pair.every((label) => row.has(label)))
          .flat()
          .map((label) => row.get(label)),
      );
    } else if (set.type === "point_mass") {
      const nodes = (set.entry.nodes ?? []).filter((label) => row.has(label));
      one.marks = Uint32Array.from(nodes.map((label) => row.get(label)));
      one.weights = Float32Array.from(
        nodes.map((_, k) => [set.entry.mass].flat()[k] ?? [set.entry.mass].flat()[0] ?? 1),
      );
    } else {
      one.connectors = springEnds(set)
        .map((pair) => pair.map((text) => (text === null ? null : parseDofs(text))))
        .filter(([a, b]) => a && row.has(a.node) && (b === null || row.has(b.node)))
        .map(([a, b]) => ({
          from: row.get(a.node),
          to: b === null ? null : row.get(b.node),
          direction: a.directions[0],
        }));
    }
    return one;
  });
  const held = new Map();
  for (const one of model.fixed) {
    if (row.has(one.node)) {
      held.set(one.node, [...(held.get(one.node) ?? []), ...one.directions]);
    }
  }
  const moves = new Uint8Array(labels.length).fill(
    DIRECTIONS.slice(0, 3).reduce((sum, one, k) => sum + (model.active.includes(one) ? 1 << k : 0), 0),
  );
  const links = draft
    .filter((pair) => pair.every((label) => row.has(label)))
    .map((pair) => pair.map((label) => row.get(label)));
  return {
    labels,
    places,
    moves,
    sets,
    links,
    supports: [...held].map(([label, directions]) => ({node: row.get(label), directions})),
  };
}

function channels(model) {
  const of = (list, role) =>
    list
      .map((name) => ({name, dof: parseDofs(name)}))
      .filter(({dof}) => dof)
      .map(({name, dof}) => {
        const axis = "XYZ".indexOf(dof.directions[0].at(-1)),
          sign = name.includes("-") ? -1 : 1;
        return {name, role, node: dof.node, direction: [0, 1, 2].map((k) => (k === axis ? sign : 0))};
      });
  return [...of(model.sensors, "sensor"), ...of(model.loads, "load")];
}
