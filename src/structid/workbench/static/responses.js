// The FRFs of a record in step *Records*: magnitude, phase, coherence and error over frequency, and the band by dragging.
import {get, post} from "./api.js";
import {channelList, chart, colours} from "./charts.js";
import {bandIn, field, fill, h, options, refusal, typed, unpacked, withUnit} from "./dom.js";
import {forgetTyped} from "./typed.js";

const STEP = 0.19; // height of a small panel, parts of the chart
const SMALL = {size: 11};

export async function responses(box, app) {
  fill(box, h("h2", {}, "Responses"), h("p", {class: "muted"}, "Computing…"));
  let told = null;
  try {
    told = await post("responses", {study: app.study, outputs: [], number: app.record});
  } catch (error) {
    fill(box, h("h2", {}, "Responses"), refusal(error.message));
    return;
  }
  const place = h("div", {class: "plot tall", id: "responses"}),
    bandPlace = h("div"),
    shown = new Set([0]),
    frequency = unpacked(told.frequency, "f64"),
    drag = dragChoice(() => draw());
  let model = null; // of the study at its start values, once it is asked for
  const over = modelChoice(app, async (isOn) => {
    model = isOn ? await modelled(app) : null;
    await draw();
  });
  const set = async (edit, words) => {
    await app.edit([edit], words);
    forgetTyped(place);
    const method = app.now.table.method || {};
    told.band = method.band ?? null;
    told.exclude = method.exclude ?? [];
    fill(bandPlace, bandRow(app, told, frequency, set));
    await draw();
  };
  const draw = async () => {
    const drawn = over.checked ? model : null,
      traces = [...shown].sort((a, b) => a - b).flatMap((k, row) => pairTraces(told, frequency, k, row, drawn));
    place.style.height = "620px";
    await chart(place, traces, {...layoutOf(told, frequency, drag.value), again: () => draw()});
    listenToDragging(place, app, told, drag, set);
  };
  fill(
    box,
    h("h2", {}, `Responses: ${withUnit(told.kind, told.unit)}`),
    channelList(told.pairs.map(pairName), shown, () => draw()),
    h(
      "div",
      {class: "row end"},
      field("Dragging", drag),
      bandPlace,
      h("label", {class: "check"}, over, "model at its start values"),
    ),
    place,
    h(
      "p",
      {class: "note"},
      `Noise: ${told.noise}. ${told.thinned > 1 ? `Every ${told.thinned}th line is drawn.` : ""}`,
    ),
  );
  fill(bandPlace, bandRow(app, told, frequency, set));
  await draw();
}

const pairName = (pair) => `${pair.output} / ${pair.input}`;

function dragChoice(changed) {
  const ways = [
    ["zoom", "zooms"],
    ["band", "sets the band"],
    ["exclude", "leaves lines out"],
  ];
  return h("select", {id: "drag", onchange: changed}, options(ways));
}

// A checkbox; where `changed` fails it is as before.
function modelChoice(app, changed) {
  const over = h("input", {
    type: "checkbox",
    id: "model-over",
    onchange: () =>
      app.doing(over, async () => {
        try {
          await changed(over.checked);
        } catch (error) {
          over.checked = false;
          throw error;
        }
      }),
  });
  return over;
}

async function modelled(app) {
  const model = await get("modelled", {study: app.study, number: app.record});
  if (!model.channels.length) {
    throw new Error("this record has no FRFs of a model to show");
  }
  return model;
}

// Fields of the band, and a button that takes back what is left out.
function bandRow(app, told, frequency, set) {
  const low = h("input", {value: typed(told.band?.[0] ?? frequency[0], 5), inputmode: "decimal"}),
    high = h("input", {value: typed(told.band?.[1] ?? frequency.at(-1), 5), inputmode: "decimal"});
  const button = (words, edit, done) => {
    const made = h("button", {type: "button", onclick: () => app.doing(made, () => set(edit(), done))}, words);
    return made;
  };
  const toBand = () => ({set: ["method", "band"], to: written(bandIn(low, high))});
  const left = (told.exclude || []).length;
  return h(
    "div",
    {class: "row end"},
    field("band from, Hz", low, "short"),
    field("to, Hz", high, "short"),
    button("Set band", toBand, "The band is set"),
    left
      ? button(
          `Take the ${left === 1 ? "stretch" : `${left} stretches`} left out back in`,
          () => ({remove: ["method", "exclude"]}),
          "No line is left out",
        )
      : null,
  );
}

// Axes of the panels from the bottom: error and coherence where there are any, then phase and magnitude.
function axesOf(told) {
  const hasCoherence = told.pairs.some((one) => one.coherence),
    hasError = told.pairs.some((one) => one.error);
  return {
    coherence: hasCoherence ? "y3" : null,
    error: hasError ? (hasCoherence ? "y4" : "y3") : null,
    below: Number(hasCoherence) + Number(hasError),
  };
}

// Traces of the pair number `k`, drawn as the `row`-th: measured, of the `model` where there is one, coherence and error.
function pairTraces(told, frequency, k, row, model) {
  const pair = told.pairs[k],
    name = pairName(pair),
    axes = axesOf(told),
    color = colours()[row % 7],
    common = {x: frequency, mode: "lines", line: {width: 1.3, color}, name, legendgroup: name},
    quiet = {...common, showlegend: false};
  const traces = [
    {...common, y: unpacked(pair.magnitude, "f32"), hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra></extra>"},
    {...quiet, y: unpacked(pair.phase, "f32"), yaxis: "y2", hovertemplate: "%{x:.5g} Hz: %{y:.0f}°<extra></extra>"},
  ];
  const ofModel = model?.channels.find((each) => each.name === name);
  if (ofModel) {
    traces.push({
      x: unpacked(model.frequency, "f64"),
      y: unpacked(ofModel.magnitude, "f32"),
      mode: "lines",
      line: {width: 1.6, color, dash: "dash"},
      name: `${name}, model`,
      legendgroup: name,
      hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra>model</extra>",
    });
  }
  if (pair.coherence) {
    traces.push({...quiet, y: unpacked(pair.coherence, "f32"), yaxis: axes.coherence});
  }
  if (pair.error) {
    const percent = unpacked(pair.error, "f32").map((x) => 100 * x);
    traces.push({...quiet, y: percent, yaxis: axes.error, hovertemplate: "%{x:.5g} Hz: %{y:.2g} %<extra></extra>"});
  }
  return traces;
}

function layoutOf(told, frequency, way) {
  const {coherence, error, below} = axesOf(told),
    panel = (k) => [k * STEP, k * STEP + STEP - 0.04];
  const layout = {
    uirevision: "kept" + way,
    dragmode: way === "zoom" ? "zoom" : "select",
    selectdirection: "h",
    xaxis: {title: {text: "frequency, Hz"}, anchor: below ? `y${2 + below}` : "y2"},
    yaxis: {
      type: "log",
      exponentformat: "power",
      title: {text: withUnit("magnitude", told.unit)},
      domain: [(below + 1) * STEP, 1],
    },
    yaxis2: {
      title: {text: "phase, °", font: SMALL},
      range: [-185, 185],
      tickvals: [-180, 0, 180],
      domain: panel(below),
    },
    shapes: veils(told, frequency),
  };
  if (coherence) {
    const title = {text: "coherence", font: SMALL};
    layout.yaxis3 = {title, range: [0, 1.03], domain: panel(Number(Boolean(error))), nticks: 3};
  }
  if (error) {
    const title = {text: "error, %", font: SMALL};
    layout[error.replace("y", "yaxis")] = {title, domain: panel(0), type: "log", nticks: 3, exponentformat: "power"};
  }
  return layout;
}

// Grey over the lines outside the band and those that are left out.
function veils(told, frequency) {
  const outside = told.band
    ? [
        [frequency[0], told.band[0]],
        [told.band[1], frequency.at(-1)],
      ]
    : [];
  return [...outside, ...(told.exclude || [])].map(([x0, x1]) => ({
    type: "rect",
    xref: "x",
    yref: "paper",
    x0,
    x1,
    y0: 0,
    y1: 1,
    fillcolor: "rgba(128,128,128,0.22)",
    line: {width: 0},
  }));
}

function listenToDragging(place, app, told, drag, set) {
  if (place.listening) {
    return;
  }
  place.listening = true;
  place.on("plotly_selected", (event) => {
    const range = event?.range?.x;
    if (!range || drag.value === "zoom") {
      return;
    }
    const ends = [Math.max(range[0], 0), range[1]],
      text = written(ends);
    if (text === place.last) {
      return;
    } // drawing anew tells the same range again
    place.last = text;
    const left = [...(told.exclude || []), ends].map(written).join(", ");
    const done =
      drag.value === "band"
        ? set({set: ["method", "band"], to: text}, "The band is set")
        : set({set: ["method", "exclude"], to: `[${left}]`}, "These lines are left out");
    done.catch(app.fail);
  });
}

const written = (ends) =>
  `[${ends
    .map((x) => {
      const text = String(Number(x.toPrecision(5)));
      return /[.e]/.test(text) ? text : text + ".0";
    })
    .join(", ")}]`;
