// Records: time histories by least and greatest of stretches, responses with coherence, and the band by dragging.
import {get, post} from "../api.js";
import {chart, colours} from "../charts.js";
import {bandIn, checkbox, field, fill, h, options, refusal, table, toml, typed, unpacked, withUnit} from "../dom.js";
import {fileOf, givenOptions, recordName, recordPath, records} from "../recorded.js";
import {forgetTyped} from "../typed.js";
import {facts, use} from "./start.js";
import {priorWords, priorWritten} from "./unknowns.js";

export async function show(box, app) {
  const files = app.folder.records.map((one) => one.path),
    all = records(app),
    own = all.length ? fileOf(app, all[app.record]) : "";
  if (!files.length) {
    fill(box, h("h1", {}, "Records"), h("p", {}, "This folder holds no record yet: drop one on the start page."));
    return;
  }
  const choice = h(
    "select",
    {id: "record", onchange: () => look()},
    options(files, files.includes(own) ? own : files[0]),
  );
  const what = h("section", {class: "card"}, h("p", {class: "muted"}, "Reading…")),
    errors = h("section", {class: "card", id: "channel-errors", hidden: true});
  const histories = h("section", {class: "card", hidden: true}),
    responses = h("section", {class: "card", hidden: true});
  const ofStudy = app.study
    ? studyRecords(app, (path) => {
        choice.value = path;
        look();
      })
    : null;
  fill(
    box,
    h("h1", {}, "Records"),
    ofStudy && ofStudy.box,
    h("div", {class: "row"}, field("File", choice)),
    what,
    histories,
    responses,
    errors,
  );
  const look = async () => {
    const path = choice.value,
      given = givenOptions(app, path);
    const number_ = all.findIndex(
      (one, k) => fileOf(app, one) === path && (k === app.record || fileOf(app, all[app.record]) !== path),
    );
    if (number_ >= 0) {
      app.record = number_;
    }
    if (ofStudy) {
      ofStudy.draw(number_);
    }
    fill(what, h("p", {class: "muted"}, "Reading…"));
    histories.hidden = responses.hidden = errors.hidden = true;
    try {
      const found = await post("facts", {record: path, options: given});
      if (choice.value !== path) {
        return;
      }
      fill(what, facts(found), app.study && number_ < 0 ? use(app, path, found, given) : null);
      const jobs = [];
      if (number_ >= 0) {
        errors.hidden = false;
        channelErrors(errors, app, found);
      }
      if (found.kind === "time histories") {
        histories.hidden = false;
        jobs.push(time(histories, app, path, given, found));
      }
      if (number_ >= 0 && found.kind !== "modes") {
        responses.hidden = false;
        jobs.push(lines(responses, app));
      }
      await Promise.all(jobs);
    } catch (error) {
      fill(
        what,
        refusal(error.message),
        h("p", {class: "note"}, "On the start page, say what the file does not say about itself."),
      );
    }
  };
  await look();
}

// The records that the study has: each shown by a click, or taken out.
function studyRecords(app, look) {
  const box = h("section", {class: "card", id: "study-records"}),
    all = records(app);
  const draw = (number) =>
    fill(
      box,
      h("h2", {}, all.length === 1 ? "Record of the study" : "Records of the study"),
      all.length
        ? h(
            "ul",
            {class: "plain"},
            all.map((one, k) => {
              const name = recordName(one, k),
                out = h(
                  "button",
                  {
                    class: "small",
                    type: "button",
                    disabled: !app.folder.writable,
                    "aria-label": `Take out record ${name}`,
                    onclick: () =>
                      app.doing(out, async () => {
                        await app.edit(
                          [{remove: Array.isArray(app.now.table.record) ? ["record", k] : ["record"]}],
                          `Record ${name} is taken out of the study; its file stays`,
                        );
                        app.go("records");
                      }),
                  },
                  "Take out",
                );
              const away = !app.folder.records.some(({path}) => path === fileOf(app, one));
              return h(
                "li",
                {},
                h(
                  "div",
                  {class: "row"},
                  h(
                    "button",
                    {
                      class: "small",
                      type: "button",
                      disabled: away,
                      "aria-pressed": k === number ? "true" : "false",
                      "aria-label": `${k === number ? "Shown" : "Show"} record ${name}`,
                      onclick: () => {
                        app.record = k;
                        look(fileOf(app, one));
                      },
                    },
                    k === number ? "Shown" : "Show",
                  ),
                  h("span", {}, name, one.modes ? h("span", {class: "muted"}, " modes") : null),
                  away ? h("span", {class: "state bad"}, "its file is not in this folder") : null,
                  out,
                ),
              );
            }),
          )
        : h("p", {class: "muted"}, "None yet."),
      h("p", {class: "note"}, "To add one, choose its file below."),
    );
  draw(-1);
  return {box, draw};
}

const PROPERTIES = [
  ["gain", "gain (1)"],
  ["delay", "delay, s"],
  ["polarity", "polarity, + or −"],
];

// Sensors and load cells that may be wrong: [[record.channel_error]] of the shown record.
function channelErrors(box, app, found) {
  const record = records(app)[app.record],
    list = record.channel_error || [],
    isModes = found.kind === "modes",
    away = !app.folder.writable;
  const say = async (edits, words) => {
    await app.edit(edits, words);
    channelErrors(box, app, found);
  };
  const rows = list.map((one, k) => {
    const channels = ["outputs", "inputs"]
      .flatMap((end) =>
        one[end] === undefined
          ? []
          : [
              [one[end]]
                .flat()
                .map((name) => (name === "all" ? `all ${end === "outputs" ? "sensors" : "loads"}` : name))
                .join(", "),
            ],
      )
      .join(", ");
    const out = h(
      "button",
      {
        class: "small",
        type: "button",
        disabled: away,
        "aria-label": `Remove the ${one.property} of ${channels}`,
        onclick: () =>
          app.doing(out, () =>
            say(
              [{remove: [...recordPath(app), "channel_error", k]}],
              `The ${one.property} of ${channels} counts as known`,
            ),
          ),
      },
      "Remove",
    );
    return [
      one.property,
      channels || "all channels",
      one.each || one.property === "polarity" ? "one each" : "in common",
      one.start ?? "",
      priorWords(one.prior),
      out,
    ];
  });
  const called = (name) => {
    const bare = name.replace(/[+-]$/, "");
    return (record.relabel || {})[bare] ?? name;
  };
  const ends = found.channels
    .filter((one) => !isModes || one.role !== "load")
    .slice(0, 300)
    .map((one) => [
      `${one.role === "load" ? "inputs" : "outputs"} ${called(one.name)}`,
      `${one.role === "load" ? "load " : ""}${called(one.name)}`,
    ]);
  const all = [["outputs all", "all sensors"], ...(isModes ? [] : [["inputs all", "all loads"]])];
  const property = h(
      "select",
      {id: "error-property", "data-kept": true},
      options(isModes ? PROPERTIES.slice(0, 1) : PROPERTIES),
    ),
    channels = h(
      "select",
      {id: "error-channels", "data-kept": true, multiple: true, size: Math.min(6, ends.length + all.length)},
      options([...all, ...ends], "outputs all"),
    );
  const each = h("input", {type: "checkbox", id: "error-each", "data-kept": true, checked: true}),
    prior = h("input", {id: "error-prior", spellcheck: "false", placeholder: "as in 1 ± 2.5 %"});
  const add = h(
    "button",
    {
      class: "main",
      type: "button",
      disabled: away,
      onclick: () =>
        app.doing(add, async () => {
          const chosen = [...channels.selectedOptions].map((one) => one.value.split(" ")),
            entry = {property: JSON.stringify(property.value)};
          if (!chosen.length) {
            throw new Error("Choose the channels that may be wrong");
          }
          for (const end of ["outputs", "inputs"]) {
            const names = chosen.filter(([which]) => which === end).map(([, name]) => name);
            if (names.length) {
              entry[end] = names.includes("all") ? '"all"' : toml(names);
            }
          }
          if (property.value !== "polarity") {
            if (each.checked) {
              entry.each = "true";
            }
            if (prior.value.trim()) {
              entry.prior = priorWritten(prior.value);
            }
          }
          await say(
            [{add: [...recordPath(app), "channel_error"], table: entry}],
            `The ${property.value} of these channels is sought`,
          );
        }),
    },
    "Add",
  );
  property.addEventListener("change", () => {
    prior.disabled = each.disabled = property.value === "polarity";
  });
  fill(
    box,
    h("h2", {}, "Channels that may be wrong"),
    h(
      "p",
      {class: "note"},
      "A reading is polarity × gain × the truth, late by the delay. What is listed here is identified together with the structure and reported with its interval.",
    ),
    rows.length
      ? table(["error", "channels", "", "start", "prior", ""], rows)
      : h("p", {class: "muted"}, "All channels are taken to be right."),
    h(
      "div",
      {class: "row end"},
      field("Error", property),
      field("Channels", channels),
      field("Prior, mean ± std", prior),
      h("label", {class: "check"}, each, "one for each channel"),
      add,
    ),
  );
}

async function time(box, app, record, given, found) {
  const shown = new Set(found.channels.slice(0, 4).keys()),
    place = h("div", {class: "plot", id: "histories"}),
    words = h("p", {class: "note", "aria-live": "polite"});
  const from = h("input", {inputmode: "decimal", value: "0"}),
    to = h("input", {inputmode: "decimal", value: typed(found.seconds)});
  const button = h(
    "button",
    {type: "button", onclick: () => app.doing(button, () => draw(...bandIn(from, to)))},
    "Show",
  );
  const all = h("button", {type: "button", onclick: () => app.doing(all, () => draw(0, null))}, "All");
  fill(
    box,
    h("h2", {}, "Time histories"),
    channelList(
      found.channels.map((one) => one.name + (one.quantity ? " " + one.quantity : "")),
      shown,
      () => draw(...range),
    ),
    h("div", {class: "row end"}, field("from, s", from, "short"), field("to, s", to, "short"), button, all),
    place,
    words,
  );
  let range = [0, null],
    turn = 0;
  const draw = async (first, last) => {
    range = [first, last];
    const now = ++turn,
      told = await post("histories", {
        record,
        options: given,
        first,
        last,
        points: Math.max(200, Math.min(1600, place.clientWidth)),
      });
    if (now !== turn) {
      return;
    }
    const wanted = [...shown].sort((a, b) => a - b),
      at = unpacked(told.time, "f64"),
      traces = [],
      layout = {uirevision: "kept", dragmode: "zoom", again: () => draw(first, last).catch(app.fail)};
    wanted.forEach((k, row) => {
      const low = unpacked(told.low[k], "f32"),
        high = unpacked(told.high[k], "f32"),
        x = new Float64Array(2 * at.length),
        y = new Float32Array(2 * at.length);
      at.forEach((t, i) => {
        x[2 * i] = x[2 * i + 1] = t;
        y[2 * i] = low[i];
        y[2 * i + 1] = high[i];
      });
      const tag = row ? String(row + 1) : "";
      traces.push({
        x,
        y,
        name: told.names[k],
        mode: "lines",
        line: {width: 1, color: colours()[row % 7]},
        yaxis: "y" + tag,
        hovertemplate: "%{x:.6g} s: %{y:.4g}<extra></extra>",
        showlegend: false,
      });
      layout["yaxis" + tag] = {
        domain: [1 - (row + 1) / wanted.length + 0.02, 1 - row / wanted.length - 0.02],
        title: {text: withUnit(told.names[k].replace(/ (\w+)$/, "<br>$1"), told.units[k]), font: {size: 11}},
        nticks: 4,
        fixedrange: true,
      };
    });
    layout.xaxis = {
      title: {text: "time, s"},
      anchor: "y" + (wanted.length > 1 ? wanted.length : ""),
      range: [first, last ?? told.seconds],
    };
    place.style.height = `${Math.max(220, 60 + 120 * wanted.length)}px`;
    const Plotly = await chart(place, traces, layout);
    fill(
      words,
      told.sampled
        ? "Some samples of a long record; all of it is being read, once."
        : `${at.length} stretches, each with its least and greatest value. Drag to zoom, double-click for all.`,
    );
    if (told.sampled) {
      setTimeout(() => {
        if (now === turn && place.isConnected) {
          draw(first, last).catch(app.fail);
        }
      }, 2000);
    }
    if (!place.listening) {
      place.listening = true;
      place.on("plotly_relayout", (change) => {
        if (change["xaxis.range[0]"] !== undefined) {
          from.value = typed(change["xaxis.range[0]"]);
          to.value = typed(change["xaxis.range[1]"]);
          draw(Math.max(0, change["xaxis.range[0]"]), change["xaxis.range[1]"]).catch(app.fail);
        } else if (change["xaxis.autorange"]) {
          draw(0, null).catch(app.fail);
        }
      });
    }
    return Plotly;
  };
  await draw(0, null);
}

function channelList(names, shown, changed) {
  return h(
    "details",
    {open: names.length <= 8},
    h("summary", {}, `Channels (${names.length})`),
    h(
      "div",
      {class: "row"},
      names.slice(0, 200).map((name, k) =>
        checkbox(
          shown.has(k),
          (isOn) => {
            shown[isOn ? "add" : "delete"](k);
            if (shown.size) {
              changed();
            }
          },
          name,
        ),
      ),
    ),
  );
}

async function lines(box, app) {
  const place = h("div", {class: "plot tall", id: "responses"}),
    shown = new Set([0]),
    bandPlace = h("div");
  fill(box, h("h2", {}, "Responses"), h("p", {class: "muted"}, "Computing…"));
  let told = null;
  try {
    told = await post("responses", {study: app.study, outputs: [], number: app.record});
  } catch (error) {
    fill(box, h("h2", {}, "Responses"), refusal(error.message));
    return;
  }
  const mode = h(
    "select",
    {id: "drag"},
    options([
      ["zoom", "zooms"],
      ["band", "sets the band"],
      ["exclude", "leaves lines out"],
    ]),
  );
  mode.addEventListener("change", () => draw());
  const f = unpacked(told.frequency, "f64");
  let model = null; // of the study at its start values, once it is asked for
  const over = h("input", {
    type: "checkbox",
    id: "model-over",
    onchange: () =>
      app.doing(over, async () => {
        if (over.checked) {
          model = await get("modelled", {study: app.study, number: app.record});
          if (!model.channels.length) {
            over.checked = false;
            throw new Error("this record has no FRFs of a model to show");
          }
        }
        await draw();
      }),
  });
  fill(
    box,
    h("h2", {}, `Responses: ${withUnit(told.kind, told.unit)}`),
    channelList(
      told.pairs.map((one) => `${one.output} / ${one.input}`),
      shown,
      () => draw(),
    ),
    h(
      "div",
      {class: "row end"},
      field("Dragging", mode),
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
  const set = async (edit, words) => {
    await app.edit([edit], words);
    forgetTyped(place);
    const method = app.now.table.method || {};
    told.band = method.band ?? null;
    told.exclude = method.exclude ?? [];
    bands();
    await draw();
  };
  const bands = () => {
    const low = h("input", {value: typed(told.band?.[0] ?? f[0], 5), inputmode: "decimal"}),
      high = h("input", {value: typed(told.band?.[1] ?? f.at(-1), 5), inputmode: "decimal"});
    const button = h(
      "button",
      {
        type: "button",
        onclick: () =>
          app.doing(button, () => set({set: ["method", "band"], to: written(bandIn(low, high))}, "The band is set")),
      },
      "Set band",
    );
    const out = (told.exclude || []).length
      ? h(
          "button",
          {
            type: "button",
            onclick: (event) =>
              app.doing(event.target, () => set({remove: ["method", "exclude"]}, "No line is left out")),
          },
          `Take the ${told.exclude.length} stretches left out back in`,
        )
      : null;
    fill(
      bandPlace,
      h("div", {class: "row end"}, field("band from, Hz", low, "short"), field("to, Hz", high, "short"), button, out),
    );
  };
  const draw = async () => {
    const traces = [],
      hasCoherence = told.pairs.some((one) => one.coherence),
      pair = [...shown].sort((a, b) => a - b);
    pair.forEach((k, row) => {
      const one = told.pairs[k],
        colour = colours()[row % 7],
        name = `${one.output} / ${one.input}`;
      const common = {x: f, mode: "lines", line: {width: 1.3, color: colour}, name, legendgroup: name};
      traces.push(
        {...common, y: unpacked(one.magnitude, "f32"), hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra>" + "</extra>"},
        {
          ...common,
          y: unpacked(one.phase, "f32"),
          yaxis: "y2",
          showlegend: false,
          hovertemplate: "%{x:.5g} Hz: %{y:.0f}°<extra></extra>",
        },
      );
      const own = over.checked && model?.channels.find((each) => each.name === name);
      if (own) {
        traces.push({
          x: unpacked(model.frequency, "f64"),
          y: unpacked(own.magnitude, "f32"),
          mode: "lines",
          line: {width: 1.6, color: colour, dash: "dash"},
          name: `${name}, model`,
          legendgroup: name,
          hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra>model</extra>",
        });
      }
      if (one.coherence) {
        traces.push({...common, y: unpacked(one.coherence, "f32"), yaxis: "y3", showlegend: false});
      }
      if (one.error) {
        traces.push({
          ...common,
          y: unpacked(one.error, "f32").map((x) => 100 * x),
          yaxis: hasCoherence ? "y4" : "y3",
          showlegend: false,
          hovertemplate: "%{x:.5g} Hz: %{y:.2g} %<extra></extra>",
        });
      }
    });
    const hasError = told.pairs.some((one) => one.error),
      below = Number(hasCoherence) + Number(hasError),
      step = 0.19,
      at = (k) => [k * step, k * step + step - 0.04];
    const layout = {
      again: () => draw(),
      uirevision: "kept" + mode.value,
      dragmode: mode.value === "zoom" ? "zoom" : "select",
      selectdirection: "h",
      xaxis: {title: {text: "frequency, Hz"}, anchor: below ? `y${2 + below}` : "y2"},
      yaxis: {
        type: "log",
        exponentformat: "power",
        title: {text: withUnit("magnitude", told.unit)},
        domain: [(below + 1) * step, 1],
      },
      yaxis2: {
        title: {text: "phase, °", font: {size: 11}},
        range: [-185, 185],
        tickvals: [-180, 0, 180],
        domain: at(below),
      },
    };
    if (hasCoherence) {
      layout.yaxis3 = {
        title: {text: "coherence", font: {size: 11}},
        range: [0, 1.03],
        domain: at(Number(hasError)),
        nticks: 3,
      };
    }
    if (hasError) {
      layout[hasCoherence ? "yaxis4" : "yaxis3"] = {
        title: {text: "error, %", font: {size: 11}},
        domain: at(0),
        type: "log",
        nticks: 3,
        exponentformat: "power",
      };
    }
    layout.shapes = [];
    const veil = (x0, x1) =>
      layout.shapes.push({
        type: "rect",
        xref: "x",
        yref: "paper",
        x0,
        x1,
        y0: 0,
        y1: 1,
        fillcolor: "rgba(128,128,128,0.22)",
        line: {width: 0},
      });
    if (told.band) {
      veil(f[0], told.band[0]);
      veil(told.band[1], f.at(-1));
    }
    for (const [low, high] of told.exclude || []) {
      veil(low, high);
    }
    place.style.height = "620px";
    await chart(place, traces, layout);
    if (!place.listening) {
      place.listening = true;
      place.on("plotly_selected", (event) => {
        const range = event?.range?.x;
        if (!range || mode.value === "zoom") {
          return;
        }
        const [low, high] = [Math.max(range[0], 0), range[1]],
          told_ = written([low, high]);
        if (told_ === place.last) {
          return;
        } // drawing anew tells the same range again
        place.last = told_;
        if (mode.value === "band") {
          set({set: ["method", "band"], to: written([low, high])}, "The band is set").catch(app.fail);
        } else {
          set(
            {set: ["method", "exclude"], to: `[${[...(told.exclude || []), [low, high]].map(written).join(", ")}]`},
            "These lines are left out",
          ).catch(app.fail);
        }
      });
    }
  };
  bands();
  await draw();
}

const written = (ends) =>
  `[${ends
    .map((x) => {
      const text = String(Number(x.toPrecision(5)));
      return /[.e]/.test(text) ? text : text + ".0";
    })
    .join(", ")}]`;
