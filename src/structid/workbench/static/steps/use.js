// Use: what the identified model says of other places and of changes, beside what was measured; and files for other programs.
import {get, link, post} from "../api.js";
import {chart, colours, ink} from "../charts.js";
import {bandIn, field, fill, h, marked, number, numberIn, options, table, unpacked, withUnit} from "../dom.js";
import {resultPaths} from "../recorded.js";

const KINDS = ["accelerance", "mobility", "receptance"],
  MOTIONS = ["acceleration", "velocity", "displacement"];
// Changes that can be asked about: what each is called, and the fields that it has.
const CHANGES = {
  mass: [
    "a mass is added",
    [
      ["node", "Node", "node"],
      ["mass", "kg", "number"],
    ],
  ],
  scale: [
    "a property is scaled",
    [
      ["label", "Property", "properties"],
      ["factor", "Factor", "number"],
    ],
  ],
  support: ["a support is added", [["dof", "Degree of freedom", "dofs"]]],
  damper: [
    "a tuned mass damper is added",
    [
      ["dof", "Where", "dofs"],
      ["mass", "kg", "number"],
      ["frequency", "Hz", "number"],
      ["damping_ratio", "Damping ratio", "number"],
    ],
  ],
  tune: [
    "a tuned mass damper is added and tuned",
    [
      ["dof", "Where", "dofs"],
      ["mass", "kg", "number"],
    ],
  ],
  remove: ["an element set is taken out", [["name", "Element set", "sets"]]],
};
const kept = new Map(); // changes and places asked about, by results, so that they are there again

export async function show(box, app) {
  await app.reload();
  const {all, first} = resultPaths(app);
  if (!all.length) {
    fill(box, h("h1", {}, "Use"), h("p", {}, "No results in this folder yet: run a study first."));
    return;
  }
  const choice = h("select", {id: "used", onchange: () => draw()}, options(all, first)),
    place = h("div");
  fill(box, h("h1", {}, "Use"), h("div", {class: "row end"}, field("Results", choice)), place);
  const draw = async () => {
    const results = choice.value;
    fill(place, h("p", {class: "muted"}, "Reading the identified model…"));
    try {
      const facts = await get("use", {results}),
        fits = await get("fits", {results}).catch(() => ({channels: []}));
      if (results === choice.value) {
        fill(place, asked(app, results, facts, fits), exported(app, results, facts));
      }
    } catch (error) {
      fill(place, h("div", {class: "card bad"}, h("p", {}, marked(error.message))));
    }
  };
  await draw();
}

const unsigned = (dof) => dof.replace(/[+-]$/, "").toUpperCase();
let lists = 0;

// A text field that offers names, since a mesh has thousands.
function named(label, names, value = "") {
  const id = `names-${++lists}`,
    input = h("input", {value, list: id, autocomplete: "off", spellcheck: "false"});
  const place = field(label, input, "short");
  place.append(
    h(
      "datalist",
      {id},
      names.map((name) => h("option", {value: String(name)})),
    ),
  );
  return [input, place];
}

// Responses and modes, with the changes that are asked about.
function asked(app, results, facts, fits) {
  const state = kept.get(results) || {
    sensor: facts.outputs[0] || facts.dofs[0] || "",
    load: facts.inputs[0] || facts.dofs[0] || "",
    kind: KINDS.includes(facts.kind) ? facts.kind : KINDS[0],
    band: facts.band || ["", ""],
    history: "",
    motion: MOTIONS[0],
    filtered: false,
    changes: [],
  };
  kept.set(results, state);
  const places = [...new Set([...facts.outputs, ...facts.dofs, ...facts.element_outputs])];
  const [sensor, sensorField] = named("Sensor, force or strain", places, state.sensor),
    [load, loadField] = named(
      "Force, or support that moves, at",
      [...new Set([...facts.inputs, ...facts.dofs, ...facts.supports])],
      state.load,
    );
  const kind = h("select", {}, options(KINDS, state.kind)),
    low = h("input", {inputmode: "decimal", value: state.band[0]}),
    high = h("input", {inputmode: "decimal", value: state.band[1]}),
    files = app.folder.records.map((one) => one.path),
    file = h("select", {id: "loads"}, options([["", "none"], ...files.map((path) => [path, path])], state.history)),
    motion = h("select", {id: "motion"}, options(MOTIONS, state.motion)),
    filtered = h("input", {type: "checkbox", id: "filtered", checked: state.filtered});
  const answer = h("div", {id: "predicted", "aria-live": "polite"}),
    list = h("ul", {class: "plain", id: "changes"});
  const button = h("button", {class: "main", type: "submit"}, "Predict");
  const predict = async () => {
    const given = {
      sensor: sensor.value.trim(),
      load: load.value.trim(),
      kind: kind.value,
      band: bandIn(low, high),
      history: file.value,
      motion: motion.value,
      filtered: filtered.checked,
    };
    Object.assign(state, given);
    fill(answer, h("p", {class: "muted"}, "Computing 200 models within the uncertainty…"));
    try {
      const told = await post("predict", {results, options: given, changes: state.changes});
      fill(
        answer,
        shownModes(told),
        ...response(told, state, facts, fits),
        ...history(told, state),
        told.bands
          ? h("p", {class: "note"}, `Bands hold the true value with a probability of 95 %: ${told.bands}.`)
          : null,
      );
    } catch (error) {
      fill(answer, h("div", {class: "card bad"}, h("p", {}, marked(error.message))));
    }
  };
  const listed = () =>
    fill(
      list,
      state.changes.map((one, k) =>
        h(
          "li",
          {class: "row"},
          h("span", {}, changeWords(one)),
          h(
            "button",
            {
              class: "small",
              type: "button",
              "aria-label": `Take back: ${changeWords(one)}`,
              onclick: () => {
                state.changes.splice(k, 1);
                listed();
              },
            },
            "Take back",
          ),
        ),
      ),
    );
  listed();
  return h(
    "form",
    {
      class: "card",
      onsubmit: (event) => {
        event.preventDefault();
        app.doing(button, predict);
      },
    },
    h("h2", {}, "Predict"),
    h(
      "p",
      {class: "note"},
      "The response at any place to a force or a moving support at any place, and what a change of the structure would do to it. Elements have forces, strains and stresses: M[deck:3@12], strain[deck:3@12 y=0.05], stress[deck:3@12 y=0.05 E=2.1e11].",
    ),
    h(
      "div",
      {class: "row end"},
      sensorField,
      loadField,
      field("Kind, to a force", kind),
      field("band from, Hz", low, "short"),
      field("to, Hz", high, "short"),
    ),
    h("h3", {}, "Under loads over time"),
    h(
      "p",
      {class: "note"},
      "A file of forces, or of accelerations or displacements of supports, from rest. Measured loads have passed a filter against aliasing; designed pulses and steps have not.",
    ),
    h(
      "div",
      {class: "row end"},
      field("Loads of the file", file),
      field("Motion", motion),
      h("label", {class: "row"}, filtered, "measured behind a filter against aliasing"),
    ),
    h("h3", {}, "What if"),
    list,
    newChange(app, facts, (change) => {
      state.changes.push(change);
      listed();
    }),
    h("div", {class: "row end"}, button),
    answer,
  );
}

function changeWords(one) {
  const [words, fields] = CHANGES[one.kind];
  return `${words}: ${fields.map(([key, label]) => `${label} ${one[key]}`).join(", ")}`;
}

function newChange(app, facts, add) {
  const kind = h(
      "select",
      {id: "change", onchange: () => draw()},
      options(Object.entries(CHANGES).map(([name, [words]]) => [name, words])),
    ),
    place = h("div", {class: "row end"});
  let inputs = {};
  const draw = () => {
    inputs = {};
    fill(
      place,
      CHANGES[kind.value][1].map(([key, label, holds]) => {
        if (holds === "number") {
          inputs[key] = [h("input", {inputmode: "decimal"}), true];
          return field(label, inputs[key][0], "short");
        }
        if (holds === "properties" || holds === "sets") {
          inputs[key] = [h("select", {}, options(facts[holds])), false];
          return field(label, inputs[key][0]);
        }
        const [input, wrapped] = named(label, holds === "node" ? facts.nodes : facts.dofs);
        inputs[key] = [input, holds === "node"];
        return wrapped;
      }),
    );
  };
  draw();
  const button = h(
    "button",
    {
      type: "button",
      onclick: () =>
        app.doing(button, async () => {
          const change = {kind: kind.value};
          for (const [key, [input, isNumber]] of Object.entries(inputs)) {
            if (isNumber) {
              change[key] = numberIn(input);
              continue;
            }
            change[key] = input.value.trim();
            if (!change[key]) {
              input.focus();
              throw new Error(`${input.labels[0].textContent}: name one`);
            }
          }
          add(change);
          draw();
        }),
    },
    "Add the change",
  );
  return h("div", {class: "row end"}, field("A change", kind), place, button);
}

function shownModes(told) {
  const isChange = told.changes.length > 0,
    rows = told.modes.map(({frequency_hz: hertz, damping_ratio: ratio}, k) =>
      isChange
        ? [
            `${k + 1}`,
            number(hertz.before.value, 5),
            number(hertz.after.value, 5),
            `${hertz.difference.value > 0 ? "+" : ""}${number(hertz.difference.value, 3)}`,
            hertz.difference.interval_text,
            number(ratio.before.value, 3),
            number(ratio.after.value, 3),
          ]
        : [
            `${k + 1}`,
            number(hertz.value.value, 5),
            hertz.value.interval_text,
            number(ratio.value.value, 3),
            ratio.value.interval_text,
          ],
    );
  const header = isChange
    ? ["mode", "before, Hz", "after, Hz", "change, Hz", "95 % of the change", "damping before", "damping after"]
    : ["mode", "Hz", "95 % interval", "damping ratio", "95 % interval"];
  return h(
    "section",
    {id: "predicted-modes"},
    h("h3", {}, isChange ? `Modes before and after: ${told.changes.join(", ")}` : "Modes"),
    table(header, rows, header.map((_, k) => k).slice(1)),
    isChange
      ? h(
          "p",
          {class: "note"},
          "A row is one shape, before and after. Errors that both models share cancel in the change; a damper splits the mode that it is tuned to in two, of which one is listed.",
        )
      : null,
  );
}

// Curves of a quantity over x with their 95 % bands, before and after changes where there are any.
function banded(x, parts) {
  const colour = colours();
  return Object.entries(parts).flatMap(([name, part], k) => {
    const [low, high, value] = [part.low, part.high, part.value].map((one) => unpacked(one, "f32")),
      label = name === "value" ? "predicted" : name,
      shade = colour[k === 0 ? 1 : 0];
    return [
      {x, y: high, mode: "lines", line: {width: 0}, hoverinfo: "skip", showlegend: false},
      {
        x,
        y: low,
        mode: "lines",
        line: {width: 0},
        fill: "tonexty",
        fillcolor: `${shade}40`,
        name: `${label}, 95 %`,
        hoverinfo: "skip",
      },
      {
        x,
        y: value,
        mode: "lines",
        line: {color: shade, width: 1.8, dash: name === "after" ? "dash" : "solid"},
        name: label,
      },
    ];
  });
}

// The motion under the loads of a file, and its largest value.
function history(told, state) {
  if (!told.history) {
    return [];
  }
  const place = h("div", {class: "plot", id: "predicted-history"}),
    x = unpacked(told.history.time, "f64"),
    {output} = told.history,
    what = output.includes("[") ? output : state.motion;
  const draw = () =>
    chart(place, banded(x, told.history.parts), {
      again: draw,
      xaxis: {title: {text: "time, s"}},
      yaxis: {title: {text: withUnit(what, told.history.unit)}},
    });
  setTimeout(draw); // it has no width before it is on the page
  return [
    h("h3", {}, `Motion at ${output} over time`),
    h(
      "p",
      {class: "note"},
      `Under ${told.history.words}.${told.history.thinned ? " Samples are drawn by minimum and maximum of short bins." : ""}`,
    ),
    place,
    table(
      ["", withUnit("largest", told.history.unit), "95 % interval"],
      Object.entries(told.history.largest).map(([name, [value, low, high]]) => [
        {value: "predicted", difference: "change"}[name] || name,
        number(value, 4),
        `${number(low, 4)} to ${number(high, 4)}`,
      ]),
      [1, 2],
    ),
  ];
}

function response(told, state, facts, fits) {
  if (!told.frf) {
    return [];
  }
  const {moved, output, input} = told.frf,
    place = h("div", {class: "plot", id: "predicted-frf"}),
    x = unpacked(told.frf.frequency, "f64");
  const seen = fits.channels.find(
    (one) => one.name.split("/").map(unsigned).join("/") === [output, input].map(unsigned).join("/"),
  );
  const isSeen = seen && told.frf.kind === facts.kind;
  const draw = () => {
    const lines = banded(x, told.frf.parts);
    if (isSeen) {
      lines.unshift({
        x: unpacked(fits.frequency, "f64"),
        y: unpacked(seen.measured, "f32"),
        mode: "markers",
        marker: {size: 3, color: ink()},
        name: "measured",
      });
    }
    return chart(place, lines, {
      again: draw,
      xaxis: {title: {text: "frequency, Hz"}, range: state.band},
      yaxis: {type: "log", exponentformat: "power", title: {text: withUnit("magnitude", told.frf.unit)}},
    });
  };
  setTimeout(draw); // it has no width before it is on the page
  const words = isSeen
    ? "Measured in the record"
    : seen
      ? `Measured as ${facts.kind}; predict that kind to see both`
      : output.includes("[")
        ? "Read from the element, which no sensor of the record measures"
        : "No sensor of the record is there";
  return [
    h(
      "h3",
      {},
      `Response at ${output} to ${moved.length ? `motion of ${moved.length > 1 ? "supports" : "support"} ${moved.join(", ")}${moved.length > 1 ? ", together" : ""}` : `a force at ${input}`}`,
    ),
    h("p", {class: "note"}, `${words}.`),
    place,
  ];
}

// Files for other programs, written beside the results and taken away by a link.
function exported(app, results, facts) {
  const modes = h("input", {inputmode: "numeric", value: "10"});
  const rows = facts.offers.map((one) => {
    const written = h("div", {"aria-live": "polite"});
    if (one.obstacle) {
      return h("li", {}, h("strong", {}, one.content), h("p", {class: "note"}, one.obstacle));
    }
    const form = h("select", {}, options(one.suffixes)),
      button = h(
        "button",
        {
          type: "button",
          disabled: !app.folder.writable,
          onclick: () =>
            app.doing(button, async () => {
              const state = kept.get(results),
                told = await post("exports", {
                  results,
                  kind: one.kind,
                  suffix: form.value,
                  options: {
                    modes: numberIn(modes, {least: 1}),
                    sensor: state.sensor,
                    load: state.load,
                    band: state.band[0] === "" ? null : state.band,
                  },
                });
              fill(
                written,
                h(
                  "ul",
                  {class: "plain"},
                  told.paths.map((path) => h("li", {}, h("a", {href: link("download", {path}), download: ""}, path))),
                ),
                h("p", {class: "note lines"}, told.lines.slice(0, 12).join("\n").replaceAll("`", "")),
              );
            }),
        },
        `Write ${one.kind.replaceAll("_", " ")}`,
      );
    return h(
      "li",
      {"data-offer": one.kind},
      h(
        "strong",
        {},
        one.content.replace("; needs --sensors, --loads, --band", ", of the sensor, force and band above"),
      ),
      h("div", {class: "row end"}, field("Format", form), button),
      written,
    );
  });
  return h(
    "section",
    {class: "card", id: "exports"},
    h("h2", {}, "Export"),
    h("p", {class: "note"}, `Files go to the folder ${results}_exports.`),
    h("div", {class: "row"}, field("Modes in files of modes and grids", modes, "short")),
    h("ul", {class: "plain"}, rows),
  );
}
