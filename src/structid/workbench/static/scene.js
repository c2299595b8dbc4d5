// A structure in space, drawn by WebGL 2: faces and beams of whole element sets at once, signs of supports and sensors above.
import {h, unpacked} from "./dom.js";

const SET_COLOURS = ["#5b9bd0", "#d9a441", "#5fb08c", "#c27ba0", "#8f8fd8", "#d0785a", "#9aa55a", "#6ab3c4"];
const FACES = `#version 300 es
in vec3 at; uniform mat3 turn; uniform vec3 centre; uniform vec2 scale; uniform vec2 shift; uniform float depth; out vec3 seen;
void main() { vec3 p = turn * (at - centre); seen = p; gl_Position = vec4(p.xy * scale + shift, -p.z * depth, 1.0); }`;
const SHADE = `#version 300 es
precision highp float; in vec3 seen; uniform vec4 colour; uniform float lit; out vec4 made;
void main() { vec3 n = normalize(cross(dFdx(seen), dFdy(seen))); float l = mix(1.0, 0.62 + 0.38 * abs(n.z), lit); made = vec4(colour.rgb * l, colour.a); }`;
// Beams as instances of one quad, as wide as wanted on the screen.
const BEAMS = `#version 300 es
in vec2 corner; in vec3 a; in vec3 b; uniform mat3 turn; uniform vec3 centre; uniform vec2 scale; uniform vec2 shift; uniform float depth; uniform vec2 pixel; uniform float width;
void main() { vec3 p = turn * (a - centre), q = turn * (b - centre); vec2 s = p.xy * scale + shift, e = q.xy * scale + shift; vec2 d = (e - s) / pixel; float l = length(d);
  d = l > 0.0 ? d / l : vec2(1.0, 0.0); vec2 side = vec2(-d.y, d.x) * corner.y * width * 0.5 * pixel; gl_Position = vec4(mix(s, e, corner.x) + side, -mix(p.z, q.z, corner.x) * depth - 0.0005, 1.0); }`;
const PLAIN = `#version 300 es
precision highp float; uniform vec4 colour; out vec4 made; void main() { made = colour; }`;
const POINTS = `#version 300 es
in vec3 at; in float size; uniform mat3 turn; uniform vec3 centre; uniform vec2 scale; uniform vec2 shift; uniform float depth;
void main() { vec3 p = turn * (at - centre); gl_Position = vec4(p.xy * scale + shift, -p.z * depth - 0.001, 1.0); gl_PointSize = size; }`;
const DISC = `#version 300 es
precision highp float; uniform vec4 colour; out vec4 made; void main() { float r = length(gl_PointCoord - 0.5); if (r > 0.5) { discard; } made = vec4(colour.rgb * (r > 0.4 ? 0.6 : 1.0), 1.0); }`;

const numbers = (given, kind) => (typeof given === "string" ? unpacked(given, kind) : given);
// An element set as the server sends it, with its packed arrays as numbers.
export function unpackedSet(one) {
  const made = {...one};
  for (const key of ["triangles", "edges", "owners", "lines", "marks"]) {
    if (one[key]) {
      made[key] = numbers(one[key], "u32");
    }
  }
  if (one.weights) {
    made.weights = numbers(one.weights, "f32");
  }
  return made;
}
const rgb = (text) => {
  const n = parseInt(text.slice(1), 16);
  return [(n >> 16) / 255, ((n >> 8) & 255) / 255, (n & 255) / 255];
};

// The place of a picture in space: its two canvases, a bar of buttons above and a hint below.
export function sceneStage(buttons, hint) {
  return h(
    "div",
    {class: "stage"},
    h("canvas", {
      class: "under",
      tabindex: 0,
      role: "img",
      "aria-label": "The structure; arrow keys turn it, plus and minus change its size, Home shows all of it",
    }),
    h("canvas", {class: "over", "aria-hidden": "true"}),
    h("div", {class: "bar"}, ...buttons),
    h("div", {class: "hint"}, hint),
  );
}

export class Scene {
  constructor(stage, picked) {
    this.stage = stage;
    this.canvas = stage.querySelector("canvas.under");
    this.over = stage.querySelector("canvas.over");
    this.picked = picked;
    this.azimuth = -55;
    this.elevation = 22;
    this.zoom = 1;
    this.moved = [0, 0];
    this.sensors = [];
    this.findings = [];
    this.chosen = -1;
    this.hovered = -1;
    this.hidden = new Set();
    this.wanted = 0;
    this.gl = null;
    this.made = [];
    this.tool = null; // {grab(point), click(point, row)}: takes a drag or a click for itself
    this.still = 0; // pixels a metre at zoom 1, where the view is to stay as it is whatever is drawn
    this.least = 0; // metres that are seen at least
    this.isOutlined = false; // beams have an edge
    this.canvas.scene = this;
    this.listen();
    new ResizeObserver(() => this.ask()).observe(stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.ask());
  }

  prepare() {
    const gl = this.gl,
      made = (kind, text) => {
        const s = gl.createShader(kind);
        gl.shaderSource(s, text);
        gl.compileShader(s);
        if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) {
          throw new Error(gl.getShaderInfoLog(s));
        }
        return s;
      };
    const program = (above, below) => {
      const p = gl.createProgram();
      gl.attachShader(p, made(gl.VERTEX_SHADER, above));
      gl.attachShader(p, made(gl.FRAGMENT_SHADER, below));
      gl.linkProgram(p);
      const found = {program: p};
      for (let k = 0; k < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); k += 1) {
        const {name} = gl.getActiveUniform(p, k);
        found[name] = gl.getUniformLocation(p, name);
      }
      for (let k = 0; k < gl.getProgramParameter(p, gl.ACTIVE_ATTRIBUTES); k += 1) {
        const {name} = gl.getActiveAttrib(p, k);
        found["in_" + name] = gl.getAttribLocation(p, name);
      }
      return found;
    };
    this.faces = program(FACES, SHADE);
    this.beams = program(BEAMS, PLAIN);
    this.discs = program(POINTS, DISC);
    this.quad = this.buffer(new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]));
    this.made = []; // the quad stays
  }

  buffer(data, target = this.gl.ARRAY_BUFFER) {
    const b = this.gl.createBuffer();
    this.gl.bindBuffer(target, b);
    this.gl.bufferData(target, data, this.gl.STATIC_DRAW);
    this.made.push(b);
    return b;
  }

  // A structure as the server tells it, or with plain arrays; another one may follow it.
  // With `keeps` it is seen from where the last one was.
  set(told, keeps = false) {
    const large = told.sets.some((one) => one.triangles && one.count > 20000); // smooth edges would cost most of its time
    const gl = this.canvas.getContext("webgl2", {antialias: !large});
    if (gl && !this.gl) {
      this.gl = gl;
      this.prepare();
    }
    for (const buffer of this.made.splice(0)) {
      gl.deleteBuffer(buffer);
    }
    this.dots = null;
    this.told = told;
    this.labels = numbers(told.labels, "i32");
    this.places = this.rest = numbers(told.places, "f32");
    this.moves = numbers(told.moves, "u8");
    const extent = this.measure();
    if (!keeps) {
      this.lookFrom(extent);
    }
    this.row = new Map();
    this.labels.forEach((label, k) => this.row.set(label, k));
    this.sets = told.sets.map((one, k) => ({
      ...unpackedSet(one),
      colour: one.colour ?? SET_COLOURS[k % SET_COLOURS.length],
    }));
    this.used = this.usedNodes();
    this.few = this.labels.length <= 3000 ? [...this.labels.keys()] : [];
    if (gl) {
      this.upload();
    }
    this.ask();
  }

  // Centre and size of the structure, unless the view stands still; returns its extent along X, Y and Z, m.
  measure() {
    const hasNodes = this.labels.length > 0,
      low = Array(3).fill(hasNodes ? 1e300 : 0),
      high = Array(3).fill(hasNodes ? -1e300 : 0);
    for (let k = 0; k < 3 * this.labels.length; k += 1) {
      low[k % 3] = Math.min(low[k % 3], this.places[k]);
      high[k % 3] = Math.max(high[k % 3], this.places[k]);
    }
    const extent = high.map((x, k) => x - low[k]);
    if (!this.still) {
      this.centre = low.map((x, k) => (x + high[k]) / 2);
      this.size = Math.max(Math.hypot(...extent), this.least) || 1;
    }
    return extent;
  }

  // The first view: from above what lies and moves in its plane, from the side along a line.
  lookFrom(extent) {
    const isFlat = extent.map((x) => x < 1e-6 * this.size),
      bends = isFlat[2] && this.moves.some((ways) => ways & 4);
    if (isFlat[2] && !bends) {
      this.azimuth = -90;
      this.elevation = 90;
    } else if (isFlat[1] && isFlat[0]) {
      this.azimuth = -90;
      this.elevation = 8;
    } else if (bends) {
      this.elevation = 38;
    }
    this.first = [this.azimuth, this.elevation];
  }

  // For each node 1 if an element has it, else 0.
  usedNodes() {
    const used = new Uint8Array(this.labels.length);
    for (const set of this.sets) {
      for (const key of ["triangles", "lines", "marks"]) {
        for (const row of set[key] || []) {
          used[row] = 1;
        }
      }
      for (const link of set.connectors || []) {
        used[link.from] = 1;
        if (link.to !== null) {
          used[link.to] = 1;
        }
      }
    }
    return used;
  }

  // Buffers of nodes, faces, edges, lines and marks on the graphics card.
  upload() {
    const gl = this.gl;
    this.at = this.buffer(this.places);
    const heaviest = Math.max(
      1e-300,
      ...this.sets.flatMap((one) => (one.weights ? [one.weights.reduce((a, b) => Math.max(a, b), 0)] : [])),
    );
    for (const one of this.sets) {
      if (one.triangles) {
        one.faceBuffer = this.buffer(one.triangles, gl.ELEMENT_ARRAY_BUFFER);
        one.edgeBuffer = this.buffer(one.edges, gl.ELEMENT_ARRAY_BUFFER);
      }
      if (one.triangles?.length > 90000) {
        one.coarse = this.coarse(one.triangles);
        one.coarseBuffer = this.buffer(one.coarse, gl.ELEMENT_ARRAY_BUFFER);
      }
      if (one.lines) {
        one.ends = this.buffer(this.ends(one.lines));
      }
      if (one.marks) {
        const size = new Float32Array(one.marks.length);
        one.marks.forEach((_, k) => {
          size[k] = one.type === "PointMass" ? 7 + 15 * Math.sqrt(one.weights[k] / heaviest) : 10;
        });
        one.markBuffer = this.buffer(this.ends(one.marks));
        one.sizeBuffer = this.buffer(size);
      }
    }
    if (this.few.length) {
      this.dots = this.buffer(new Float32Array(this.labels.length).fill(5));
    }
  }

  // The faces of a large mesh while it turns: nodes of one cell of a grid count as one, and what is left of the triangles.
  coarse(triangles) {
    const step = this.size / 110,
      cells = new Map(),
      first = new Int32Array(this.labels.length).fill(-1),
      found = [],
      known = new Set();
    const of = (row) => {
      if (first[row] < 0) {
        const key = [0, 1, 2]
          .map((i) => Math.floor((this.places[3 * row + i] - this.centre[i]) / step + 512))
          .reduce((a, b) => 1024 * a + b, 0);
        if (!cells.has(key)) {
          cells.set(key, row);
        }
        first[row] = cells.get(key);
      }
      return first[row];
    };
    for (let k = 0; k < triangles.length; k += 3) {
      const a = of(triangles[k]),
        b = of(triangles[k + 1]),
        c = of(triangles[k + 2]);
      if (a === b || b === c || a === c) {
        continue;
      }
      const key = [a, b, c].sort((x, y) => x - y).join();
      if (!known.has(key)) {
        known.add(key);
        found.push(a, b, c);
      }
    }
    return new Uint32Array(found);
  }

  ends(lines) {
    const found = new Float32Array(3 * lines.length);
    lines.forEach((row, k) => found.set(this.places.subarray(3 * row, 3 * row + 3), 3 * k));
    return found;
  }

  // The same structure with its nodes at other places; it is seen from where it was.
  displace(places) {
    this.places = places;
    const {gl} = this,
      write = (buffer, data) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
      };
    if (gl) {
      write(this.at, places);
      for (const one of this.sets) {
        if (one.lines) {
          write(one.ends, this.ends(one.lines));
        }
        if (one.marks) {
          write(one.markBuffer, this.ends(one.marks));
        }
      }
    }
    this.ask();
  }

  ask() {
    if (!this.wanted) {
      this.wanted = requestAnimationFrame(() => {
        this.wanted = 0;
        this.draw();
      });
    }
  }

  // Axes of the screen in space: right, up, towards the eye.
  turn() {
    const a = (this.azimuth * Math.PI) / 180,
      e = (this.elevation * Math.PI) / 180;
    const eye = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)],
      right = [-Math.sin(a), Math.cos(a), 0];
    return [
      right,
      [
        eye[1] * right[2] - eye[2] * right[1],
        eye[2] * right[0] - eye[0] * right[2],
        eye[0] * right[1] - eye[1] * right[0],
      ],
      eye,
    ];
  }

  fit(width, height) {
    const t = this.turn();
    let w = 0,
      h = 0;
    const step = Math.max(1, Math.floor(this.labels.length / 4000));
    for (let k = 0; k < this.labels.length; k += step) {
      const d = [0, 1, 2].map((i) => this.rest[3 * k + i] - this.centre[i]);
      w = Math.max(w, Math.abs(t[0][0] * d[0] + t[0][1] * d[1] + t[0][2] * d[2]));
      h = Math.max(h, Math.abs(t[1][0] * d[0] + t[1][1] * d[1] + t[1][2] * d[2]));
    }
    const most = this.size / 2;
    return (
      this.zoom *
      Math.min(
        (width / 2 - Math.min(70, width * 0.14)) / Math.max(w, 0.35 * most),
        (height / 2 - 60) / Math.max(h, 0.35 * most),
      )
    );
  }

  draw() {
    if (!this.told) {
      return;
    }
    const dense = devicePixelRatio || 1,
      width = this.stage.clientWidth,
      height = this.stage.clientHeight;
    for (const canvas of [this.canvas, this.over]) {
      if (canvas.width !== Math.round(width * dense) || canvas.height !== Math.round(height * dense)) {
        canvas.width = Math.round(width * dense);
        canvas.height = Math.round(height * dense);
      }
    }
    const style = getComputedStyle(this.stage),
      colour = (name) => style.getPropertyValue(name).trim();
    this.unit = this.dragging && this.unit ? this.unit : this.still ? this.still * this.zoom : this.fit(width, height);
    this.view = {width, height, turn: this.turn(), unit: this.unit};
    if (this.gl) {
      this.paint(width, height, colour);
    }
    this.overlay(width, height, dense, colour);
  }

  // Faces, beams and points by WebGL; `width` and `height` of the picture in px, `colour` gives a colour of the style sheet.
  paint(width, height, colour) {
    const gl = this.gl;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...rgb(colour("--paper")), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const shown = this.sets.filter((one) => !this.hidden.has(one.name));
    this.usePainter(this.faces, width, height);
    this.paintFaces(shown.filter((one) => one.triangles));
    this.unlink();
    this.usePainter(this.beams, width, height);
    gl.uniform2f(this.beams.pixel, 2 / width, 2 / height);
    this.paintBeams(
      shown.filter((one) => one.lines),
      colour("--ink"),
    );
    this.unlink();
    this.usePainter(this.discs, width, height);
    this.paintPoints(
      shown.filter((one) => one.marks),
      colour("--ink"),
    );
    this.unlink();
  }

  // A program of the graphics card, with the view.
  usePainter(p, width, height) {
    const gl = this.gl,
      [right, up, eye] = this.view.turn;
    gl.useProgram(p.program);
    gl.uniformMatrix3fv(p.turn, false, [right[0], up[0], eye[0], right[1], up[1], eye[1], right[2], up[2], eye[2]]);
    gl.uniform3fv(p.centre, this.centre);
    gl.uniform2f(p.scale, (2 * this.view.unit) / width, (2 * this.view.unit) / height);
    gl.uniform2f(p.shift, (2 * this.moved[0]) / width, (-2 * this.moved[1]) / height);
    gl.uniform1f(p.depth, 0.9 / this.size);
  }

  // A buffer as the input `name` of a program.
  link(p, name, buffer, size, divisor = 0, stride = 0, offset = 0) {
    const gl = this.gl,
      place = p["in_" + name];
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
    gl.vertexAttribDivisor(place, divisor);
  }

  unlink() {
    for (let k = 0; k < 4; k += 1) {
      this.gl.disableVertexAttribArray(k);
      this.gl.vertexAttribDivisor(k, 0);
    }
  }

  paintFaces(sets) {
    const gl = this.gl,
      many = this.labels.length > 20000;
    this.link(this.faces, "at", this.at, 3);
    gl.uniform1f(this.faces.lit, 1);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    for (const one of sets) {
      gl.uniform4f(this.faces.colour, ...rgb(one.colour), 1);
      const quick = this.dragging && one.coarse?.length;
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, quick ? one.coarseBuffer : one.faceBuffer);
      gl.drawElements(gl.TRIANGLES, quick ? one.coarse.length : one.triangles.length, gl.UNSIGNED_INT, 0);
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.uniform1f(this.faces.lit, 0);
    if (many && this.dragging) {
      return; // sides would cost most of the time of a large mesh that moves
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    for (const one of sets) {
      gl.uniform4f(this.faces.colour, 0, 0, 0, many ? 0.12 : 0.45);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, one.edgeBuffer);
      gl.drawElements(gl.LINES, one.edges.length, gl.UNSIGNED_INT, 0);
    }
    gl.disable(gl.BLEND);
  }

  paintBeams(sets, ink) {
    const gl = this.gl;
    for (const one of sets) {
      gl.uniform4f(this.beams.colour, ...rgb(one.colour), 1);
      gl.uniform1f(this.beams.width, one.lines.length > 20000 ? 1.5 : 5);
      this.link(this.beams, "corner", this.quad, 2);
      this.link(this.beams, "a", one.ends, 3, 1, 24, 0);
      this.link(this.beams, "b", one.ends, 3, 1, 24, 12);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, one.lines.length / 2);
      if (this.isOutlined) {
        // behind it, and wider: a colour near that of the paper is seen too
        gl.uniform4f(this.beams.colour, ...rgb(ink), 1);
        gl.uniform1f(this.beams.width, 7);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, one.lines.length / 2);
      }
    }
  }

  // Masses and springs at points, and the nodes where they are few.
  paintPoints(sets, ink) {
    const gl = this.gl;
    for (const one of sets) {
      gl.uniform4f(this.discs.colour, ...rgb(one.colour), 1);
      this.link(this.discs, "at", one.markBuffer, 3);
      this.link(this.discs, "size", one.sizeBuffer, 1);
      gl.drawArrays(gl.POINTS, 0, one.marks.length);
    }
    if (this.dots) {
      gl.uniform4f(this.discs.colour, ...rgb(ink), 1);
      this.link(this.discs, "at", this.at, 3);
      this.link(this.discs, "size", this.dots, 1);
      gl.drawArrays(gl.POINTS, 0, this.labels.length);
    }
  }

  // Where a node is on the screen, with its depth.
  seen(row) {
    return this.project([this.places[3 * row], this.places[3 * row + 1], this.places[3 * row + 2]]);
  }

  project(place) {
    const {width, height, turn, unit} = this.view,
      d = place.map((x, k) => x - this.centre[k]);
    const on = turn.map((axis) => axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2]);
    return [width / 2 + this.moved[0] + unit * on[0], height / 2 + this.moved[1] - unit * on[1], on[2]];
  }

  // The place under a point of the screen, in the plane through `through` across the axis `normal`; null where it is seen edge-on.
  under(point, through, normal) {
    const {
      width,
      height,
      turn: [right, up, eye],
      unit,
    } = this.view;
    const a = (point[0] - width / 2 - this.moved[0]) / unit,
      b = (height / 2 + this.moved[1] - point[1]) / unit;
    if (Math.abs(eye[normal]) < 0.05) {
      return null;
    }
    const c = (through[normal] - this.centre[normal] - right[normal] * a - up[normal] * b) / eye[normal];
    return this.centre.map((x, k) => x + right[k] * a + up[k] * b + eye[k] * c);
  }

  // The direction of a vector on the screen, of length 1 at most.
  along(vector) {
    const [right, up] = this.view.turn,
      dot = (a) => a[0] * vector[0] + a[1] * vector[1] + a[2] * vector[2];
    return [dot(right), -dot(up)];
  }

  // Links, supports, findings, sensors and names above the picture; `dense` pixels of the screen stand for one of the page.
  overlay(width, height, dense, colour) {
    const c = this.over.getContext("2d");
    c.setTransform(dense, 0, 0, dense, 0, 0);
    c.clearRect(0, 0, width, height);
    c.lineCap = c.lineJoin = "round";
    c.font = '12.5px "Segoe UI", "DejaVu Sans", sans-serif';
    const ink = colour("--ink"),
      muted = colour("--muted"),
      boxes = [];
    if (!this.gl) {
      this.plainLines(c, ink);
    }
    this.drawLinks(c, muted);
    this.drawSupports(c, muted);
    this.findings.forEach((one, k) => {
      if (one.shown) {
        this.finding(c, one, k, colour, boxes);
      }
    });
    const names = this.sensors.filter((one) => this.row.has(one.node)).map((one) => this.drawSensor(c, one, colour));
    for (const [text, x, y, fill] of names) {
      this.word(c, text, x, y, fill, boxes, width);
    }
    if (this.labels.length <= 200) {
      for (const k of this.few) {
        const [x, y] = this.seen(k);
        this.word(c, String(this.labels[k]), x + 7, y - 6, muted, boxes, width, true);
      }
    }
    this.drawRing(c, this.hovered, muted, width);
    this.drawRing(c, this.chosen, colour("--accent"), width);
    this.drawn?.(c, colour);
    this.axes(c, height, ink);
  }

  // Ties by dashed lines, and connectors by their signs.
  drawLinks(c, muted) {
    c.strokeStyle = muted;
    c.lineWidth = 1.2;
    c.setLineDash([4, 3]);
    for (const link of this.told.links) {
      const a = this.seen(link[0]);
      for (const other of link.slice(1, 300)) {
        const b = this.seen(other);
        c.beginPath();
        c.moveTo(a[0], a[1]);
        c.lineTo(b[0], b[1]);
        c.stroke();
      }
    }
    c.setLineDash([]);
    for (const one of this.sets) {
      if (one.connectors && !this.hidden.has(one.name)) {
        for (const part of one.connectors) {
          this.connector(c, part, one, muted);
        }
      }
    }
  }

  drawSupports(c, muted) {
    c.fillStyle = muted;
    const size = this.told.supports.length > 60 ? 3 : 7;
    for (const support of this.told.supports) {
      const [x, y] = this.seen(support.node);
      c.beginPath();
      c.moveTo(x, y + 2);
      c.lineTo(x - size, y + 2 + 1.7 * size);
      c.lineTo(x + size, y + 2 + 1.7 * size);
      c.closePath();
      c.fill();
    }
  }

  // The arrow of a sensor or load, or a ring where it points at the eye; returns its name with place and colour.
  drawSensor(c, one, colour) {
    const [x, y] = this.seen(this.row.get(one.node)),
      load = one.role === "load",
      [dx, dy] = this.along(one.direction),
      length = Math.hypot(dx, dy);
    c.strokeStyle = c.fillStyle = colour(load ? "--load" : "--sensor");
    c.lineWidth = one.chosen ? 4 : load ? 3 : 2.2;
    if (length < 0.15) {
      c.beginPath();
      c.arc(x, y, 9, 0, 7);
      c.stroke();
      c.beginPath();
      c.arc(x, y, 2.5, 0, 7);
      c.fill();
      return [one.name, x + 11, y - 8, c.fillStyle];
    }
    const u = [dx / length, dy / length],
      reach = 26 + 16 * length,
      from = load ? [x - u[0] * reach, y - u[1] * reach] : [x + 4 * u[0], y + 4 * u[1]],
      to = load ? [x - 5 * u[0], y - 5 * u[1]] : [x + u[0] * reach, y + u[1] * reach];
    this.arrow(c, from, to, u);
    const tip = load ? from : to,
      above = Math.abs(u[1]) < 0.35 ? -7 : 4 + 9 * u[1]; // beside an arrow that lies, not on the line that it may lie on
    return [(load ? "load " : "") + one.name, tip[0] + 5 + 5 * u[0], tip[1] + above, c.fillStyle];
  }

  // A ring around a node with its number; nothing for row -1.
  drawRing(c, row, colour, width) {
    if (row < 0) {
      return;
    }
    const [x, y] = this.seen(row);
    c.strokeStyle = colour;
    c.lineWidth = 3;
    c.beginPath();
    c.arc(x, y, 9, 0, 7);
    c.stroke();
    this.word(c, "node " + this.labels[row], x + 12, y - 12, colour, [], width);
  }

  // Elements and nodes of a finding, with its number at the first of them.
  finding(c, one, number, colour, boxes) {
    c.strokeStyle = colour("--bad");
    c.lineWidth = 4;
    c.globalAlpha = 0.75;
    let first = null;
    for (const nodes of one.outlines) {
      const ends = nodes
        .map((label) => this.row.get(label))
        .filter((row) => row !== undefined)
        .map((row) => this.seen(row));
      if (!ends.length) {
        continue;
      }
      first ??= [0, 1].map((k) => ends.reduce((sum, end) => sum + end[k], 0) / ends.length);
      c.beginPath();
      ends.forEach(([x, y]) => c.lineTo(x, y));
      if (ends.length > 2) {
        c.closePath();
      }
      c.stroke();
    }
    c.globalAlpha = 1;
    c.lineWidth = 3;
    for (const label of one.nodes) {
      const row = this.row.get(label);
      if (row === undefined) {
        continue;
      }
      const [x, y] = this.seen(row);
      first ??= [x, y];
      c.beginPath();
      c.moveTo(x - 6, y - 6);
      c.lineTo(x + 6, y + 6);
      c.moveTo(x + 6, y - 6);
      c.lineTo(x - 6, y + 6);
      c.stroke();
    }
    if (!first) {
      return;
    }
    const [x, y] = [first[0], first[1] + 22];
    boxes.push([x - 12, y - 12, x + 12, y + 12]);
    c.fillStyle = colour("--bad");
    c.beginPath();
    c.arc(x, y, 10, 0, 7);
    c.fill();
    c.fillStyle = colour("--paper");
    c.textAlign = "center";
    c.fillText(String(number + 1), x, y + 4);
    c.textAlign = "start";
  }

  word(c, text, x, y, fill, boxes, width, dropped = false) {
    const w = c.measureText(text).width;
    x = Math.max(2, x + w > width - 2 ? x - w - 12 : x); // at the other side where there is no room
    for (let k = 0; k < 4; k += 1) {
      // moved away from what is there, or left out
      const box = [x - 2, y - 11, x + w + 2, y + 4];
      if (!boxes.some((b) => b[0] < box[2] && box[0] < b[2] && b[1] < box[3] && box[1] < b[3])) {
        boxes.push(box);
        c.fillStyle = fill;
        c.fillText(text, x, y);
        return;
      }
      if (dropped) {
        return;
      }
      y += 14;
    }
  }

  arrow(c, from, to, u) {
    c.beginPath();
    c.moveTo(from[0], from[1]);
    c.lineTo(to[0] - 5 * u[0], to[1] - 5 * u[1]);
    c.stroke();
    c.beginPath();
    c.moveTo(to[0], to[1]);
    c.lineTo(to[0] - 10 * u[0] - 5 * u[1], to[1] - 10 * u[1] + 5 * u[0]);
    c.lineTo(to[0] - 10 * u[0] + 5 * u[1], to[1] - 10 * u[1] - 5 * u[0]);
    c.closePath();
    c.fill();
  }

  connector(c, part, set, muted) {
    const [x, y] = this.seen(part.from);
    c.strokeStyle = set.colour;
    c.lineWidth = 2;
    if (part.direction.startsWith("R")) {
      c.beginPath();
      for (let k = 0; k <= 40; k += 1) {
        const a = (k / 40) * 4 * Math.PI,
          r = 4 + (9 * k) / 40;
        c.lineTo(x + r * Math.cos(a), y + r * Math.sin(a));
      }
      c.stroke();
      return;
    }
    let u, length, end;
    if (part.to !== null) {
      end = this.seen(part.to);
      length = Math.hypot(end[0] - x, end[1] - y);
      u = length ? [(end[0] - x) / length, (end[1] - y) / length] : [1, 0];
    }
    if (part.to === null || length < 2) {
      const axis = "XYZ".indexOf(part.direction),
        d = this.along([0, 1, 2].map((k) => (k === axis ? -1 : 0))),
        l = Math.hypot(...d);
      u = l > 0.15 ? [d[0] / l, d[1] / l] : [-0.7, 0.7];
      length = 44;
      end = [x + u[0] * length, y + u[1] * length];
    }
    const side = [-u[1], u[0]],
      inner = Math.min(0.7 * length, 110),
      start = (length - inner) / 2;
    c.beginPath();
    c.moveTo(x, y);
    if (set.type === "Spring") {
      for (let k = 0; k <= 8; k += 1) {
        const t = start + (inner * k) / 8,
          s = k === 0 || k === 8 ? 0 : k % 2 ? 5 : -5;
        c.lineTo(x + u[0] * t + side[0] * s, y + u[1] * t + side[1] * s);
      }
    }
    c.lineTo(end[0], end[1]);
    c.stroke();
    if (set.type !== "Spring") {
      const m = [x + (u[0] * length) / 2, y + (u[1] * length) / 2];
      c.lineWidth = 2;
      c.beginPath();
      for (const s of [-6, 6]) {
        c.moveTo(m[0] + side[0] * s - u[0] * 6, m[1] + side[1] * s - u[1] * 6);
        c.lineTo(m[0] + side[0] * s + u[0] * 6, m[1] + side[1] * s + u[1] * 6);
      }
      c.stroke();
    }
    if (part.to === null) {
      c.strokeStyle = muted;
      c.beginPath();
      c.moveTo(end[0] + side[0] * 8, end[1] + side[1] * 8);
      c.lineTo(end[0] - side[0] * 8, end[1] - side[1] * 8);
      c.stroke();
    }
  }

  plainLines(c, ink) {
    // no WebGL: sides and beams as plain lines, some of them where they are very many
    c.strokeStyle = ink;
    c.lineWidth = 1;
    for (const one of this.sets) {
      const lines = one.lines || one.edges;
      if (!lines) {
        continue;
      }
      const step = 2 * Math.max(1, Math.ceil(lines.length / 20000));
      c.beginPath();
      for (let k = 0; k < lines.length; k += step) {
        const a = this.seen(lines[k]),
          b = this.seen(lines[k + 1]);
        c.moveTo(a[0], a[1]);
        c.lineTo(b[0], b[1]);
      }
      c.stroke();
    }
  }

  axes(c, height, ink) {
    const at = [34, height - 46];
    c.fillStyle = c.strokeStyle = ink;
    c.lineWidth = 1.5;
    ["X", "Y", "Z"].forEach((name, k) => {
      const [dx, dy] = this.along([0, 1, 2].map((i) => (i === k ? 1 : 0)));
      if (Math.hypot(dx, dy) < 0.15) {
        return;
      }
      c.beginPath();
      c.moveTo(at[0], at[1]);
      c.lineTo(at[0] + 24 * dx, at[1] + 24 * dy);
      c.stroke();
      c.fillText(name, at[0] + 32 * dx - 4, at[1] + 32 * dy + 4);
    });
  }

  nearest(x, y) {
    let best = -1,
      least = 1e300;
    for (let k = 0; k < this.labels.length; k += 1) {
      const [px, py, depth] = this.seen(k),
        away = Math.hypot(px - x, py - y);
      if (away < 16) {
        const cost = away - (6 * depth) / this.size + (this.used[k] ? 0 : 2);
        if (cost < least) {
          least = cost;
          best = k;
        }
      }
    }
    return best;
  }

  choose(row) {
    this.chosen = row;
    this.ask();
    this.picked(row < 0 ? null : this.labels[row]);
  }

  listen() {
    this.listenToPointers();
    const canvas = this.canvas;
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoomBy(Math.exp(-event.deltaY / 600));
        this.ask();
      },
      {passive: false},
    );
    canvas.addEventListener("keydown", (event) => {
      if (this.turnByKey(event.key)) {
        event.preventDefault();
        this.ask();
      }
    });
    this.stage.style.touchAction = "none";
  }

  zoomBy(factor) {
    this.zoom = Math.min(60, Math.max(0.2, this.zoom * factor));
  }

  // Turns or zooms as the key says; false if the key means nothing here.
  turnByKey(key) {
    const turns = {ArrowLeft: [-6, 0], ArrowRight: [6, 0], ArrowUp: [0, 6], ArrowDown: [0, -6]}[key];
    if (turns) {
      this.rotate(...turns);
    } else if (key === "+" || key === "=") {
      this.zoom *= 1.15;
    } else if (key === "-") {
      this.zoom /= 1.15;
    } else if (key === "Home") {
      this.home();
    } else {
      return false;
    }
    return true;
  }

  // Drags turn or move the view, or what the tool grips; two fingers zoom; a click chooses a node or goes to the tool.
  listenToPointers() {
    const canvas = this.canvas,
      pointers = new Map();
    let last = null,
      far = 0, // px that the pointer has gone since it went down
      apart = 0; // px between two fingers
    const at = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, at(event));
      last = at(event);
      far = 0;
      this.grip = pointers.size === 1 ? (this.tool?.grab?.(last) ?? null) : null;
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = at(event);
      if (!pointers.has(event.pointerId)) {
        this.hover(now);
        return;
      }
      pointers.set(event.pointerId, now);
      if (pointers.size === 2) {
        const [a, b] = [...pointers.values()],
          wide = Math.hypot(a[0] - b[0], a[1] - b[1]);
        if (apart) {
          this.zoomBy(wide / apart);
          this.unit = 0;
        }
        apart = wide;
        far = 99;
        this.ask();
        return;
      }
      const way = [now[0] - last[0], now[1] - last[1]];
      far += Math.abs(way[0]) + Math.abs(way[1]);
      last = now;
      if (far >= 5) {
        this.drag(event, now, way);
      }
    });
    const end = (event) => {
      if (!pointers.delete(event.pointerId)) {
        return;
      }
      apart = 0;
      this.release(at(event), far < 5, event.type === "pointerup");
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
  }

  // The node under a pointer that is not pressed is marked, except in a large mesh.
  hover(point) {
    if (this.view && this.labels.length < 50000) {
      const row = this.nearest(...point);
      if (row !== this.hovered) {
        this.hovered = row;
        this.ask();
      }
    }
  }

  // A pressed pointer came to `point` (px) by the way `way` (px).
  drag(event, point, way) {
    this.dragging = true;
    if (this.grip) {
      this.grip.move(point);
      return;
    }
    if (event.shiftKey || event.buttons === 4 || event.buttons === 2) {
      this.moved = [this.moved[0] + way[0], this.moved[1] + way[1]];
    } else {
      this.rotate(-0.4 * way[0], 0.4 * way[1]);
    }
    this.ask();
  }

  // A pointer went up (`isUp`) or was taken away at `point`; it is a click where it had hardly moved (`isShort`).
  release(point, isShort, isUp) {
    const row = this.view ? this.nearest(...point) : -1;
    if (isShort && isUp) {
      if (!this.tool?.click?.(point, row)) {
        this.choose(row);
      }
    } else if (this.grip) {
      if (isUp) {
        this.grip.drop(point);
      } else {
        this.grip.cancel();
      }
    }
    this.grip = null;
    this.dragging = false;
    this.ask();
  }

  rotate(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.max(-90, Math.min(90, this.elevation + elevation));
  }
  home() {
    this.still = 0;
    [this.azimuth, this.elevation] = this.first;
    this.zoom = 1;
    this.moved = [0, 0];
    this.ask();
  }
}
