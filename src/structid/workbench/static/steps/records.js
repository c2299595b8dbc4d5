// Records: time histories by least and greatest of stretches, responses with coherence, and the band by dragging.
import {post} from "../api.js";
import {channelList, chart, colours} from "../charts.js";
import {bandIn, field, fill, h, options, refusal, table, toml, typed, unpacked, withUnit} from "../dom.js";
import {fileOf, givenOptions, recordName, recordPath, records} from "../recorded.js";
import {responses} from "../responses.js";
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
    responseBox = h("section", {class: "card", hidden: true});
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
    responseBox,
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
    histories.hidden = responseBox.hidden = errors.hidden = true;
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
        responseBox.hidden = false;
        jobs.push(responses(responseBox, app));
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
