// The identified structure: its changes by colour, and the shapes of its modes in motion.
import {field, fill, h, options, unpacked} from "./dom.js";
import {Scene, sceneStage, unpackedSet} from "./scene.js";

const REACH = 0.12; // of the size of the structure: the largest motion that is drawn
const SECONDS = 2.4; // a cycle

// Element sets split by the colours of a shading, each part with the elements of one colour.
function splitByColour(sets, shading) {
  return sets.flatMap((set) => {
    const {colours, index} = shading.sets[set.name],
      of = unpacked(index, "u8");
    return colours.map((colour, c) => {
      const part = {...set, name: `${set.name} ${colour}`, colour};
      const taken = (values, each) => values.filter((_, k) => of[Math.floor(k / each)] === c);
      for (const [key, each] of [
        ["lines", 2],
        ["marks", 1],
      ]) {
        if (set[key] && set[key].length === each * of.length) {
          part[key] = taken(set[key], each);
        }
      }
      if (set.weights) {
        part.weights = taken(set.weights, 1);
      }
      if (set.connectors) {
        part.connectors = taken(set.connectors, 1);
      }
      if (set.triangles) {
        part.triangles = set.triangles.filter((_, k) => of[set.owners[Math.floor(k / 3)]] === c);
      }
      return part;
    });
  });
}

// Colours of a shading, and the words at its ticks.
const scaleOf = ({colours, ticks}) => [
  h(
    "div",
    {class: "colours"},
    colours.map((one) => h("span", {style: {background: one}})),
  ),
  h(
    "div",
    {class: "ticks"},
    ticks.map((one) => h("span", {}, one)),
  ),
];

// A mode swings about the places at rest while `goes()`; where motion is not wanted it stands at its largest.
function swing(scene, places, moves, goes) {
  const largest = moves.reduce((most, x) => Math.max(most, Math.abs(x)), 0) || 1,
    scale = (REACH * scene.size) / largest,
    isStill = matchMedia("(prefers-reduced-motion: reduce)").matches,
    begun = performance.now();
  const step = (now) => {
    if (!goes()) {
      return;
    }
    const phase = isStill ? 1 : Math.cos((2 * Math.PI * (now - begun)) / (1000 * SECONDS));
    scene.displace(places.map((x, k) => x + scale * phase * moves[k]));
    if (!isStill) {
      requestAnimationFrame(step);
    }
  };
  requestAnimationFrame(step);
}

// A card with the picture of what `told` says of an identified structure.
export function answerPicture(told) {
  const stage = sceneStage(
    [h("button", {class: "small", type: "button", onclick: () => scene.home()}, "Show all")],
    "Drag to turn, Shift and drag to move, wheel to zoom",
  );
  const scene = new Scene(stage, () => {});
  const structure = {...told, places: unpacked(told.places, "f32"), sets: told.sets.map(unpackedSet)};
  const legend = h("div", {class: "scale"}),
    words = h("ul", {class: "plain note"});
  const shown = h(
    "select",
    {
      id: "shaded",
      onchange: () => {
        colour();
        move();
      },
    },
    options([...told.shadings.map((one, k) => [String(k), one.title]), ["", "element sets"]]),
  );
  const mode = h(
    "select",
    {id: "mode-shown", onchange: () => move()},
    options([["", "at rest"], ...told.modes.map((one, k) => [String(k), one.name])]),
  );
  const colour = () => {
    const shading = told.shadings[shown.value];
    stage.classList.toggle("shaded", Boolean(shading));
    scene.isOutlined = Boolean(shading);
    scene.set(
      {...structure, sets: shading ? splitByColour(structure.sets, shading) : structure.sets},
      Boolean(scene.told),
    );
    fill(legend, shading ? scaleOf(shading.legend) : null);
    fill(
      words,
      shading ? Object.values(shading.sets).flatMap((set) => set.words.map((one) => h("li", {}, one))) : null,
    );
  };
  let turn = 0;
  const move = () => {
    const shape = told.modes[mode.value],
      own = ++turn;
    if (!shape) {
      scene.displace(structure.places);
      return;
    }
    swing(scene, structure.places, unpacked(shape.moves, "f32"), () => own === turn && stage.isConnected);
  };
  colour();
  return h(
    "section",
    {class: "card", id: "identified"},
    h("h2", {}, "Identified structure"),
    h("div", {class: "row end"}, field("Colours", shown), told.modes.length ? field("Mode shape", mode) : null),
    stage,
    legend,
    h("p", {class: "note"}, "White: no change beyond its 95 % interval. Grey: no parameter of this kind."),
    h("details", {}, h("summary", {}, "Changes in words"), words),
  );
}
