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
            all.map((one, k) => studyRecord(app, one, k, k === number, look)),
          )
        : h("p", {class: "muted"}, "None yet."),
      h("p", {class: "note"}, "To add one, choose its file below."),
    );
  draw(-1);
  return {box, draw};
}

// The k-th record of the study, with buttons that show it and take it out.
function studyRecord(app, record, k, isShown, look) {
  const name = recordName(record, k),
    path = fileOf(app, record),
    isAway = !app.folder.records.some((file) => file.path === path);
  const show = h(
    "button",
    {
      class: "small",
      type: "button",
      disabled: isAway,
      "aria-pressed": isShown ? "true" : "false",
      "aria-label": `${isShown ? "Shown" : "Show"} record ${name}`,
      onclick: () => {
        app.record = k;
        look(path);
      },
    },
    isShown ? "Shown" : "Show",
  );
  const remove = h(
    "button",
    {
      class: "small",
      type: "button",
      disabled: !app.folder.writable,
      "aria-label": `Take out record ${name}`,
      onclick: () =>
        app.doing(remove, async () => {
          await app.edit(
            [{remove: Array.isArray(app.now.table.record) ? ["record", k] : ["record"]}],
            `Record ${name} is taken out of the study; its file stays`,
          );
          app.go("records");
        }),
    },
    "Take out",
  );
  return h(
    "li",
    {},
    h(
      "div",
      {class: "row"},
      show,
      h("span", {}, name, record.modes ? h("span", {class: "muted"}, " modes") : null),
      isAway ? h("span", {class: "state bad"}, "its file is not in this folder") : null,
      remove,
    ),
  );
}

const PROPERTIES = [
  ["gain", "gain (1)"],
  ["delay", "delay, s"],
  ["polarity", "polarity, + or −"],
];

// Sensors and load cells that may be wrong: [[record.channel_error]] of the shown record, whose facts are `found`.
function channelErrors(box, app, found) {
  const errors = records(app)[app.record].channel_error || [];
  const edit = async (edits, words) => {
    await app.edit(edits, words);
    channelErrors(box, app, found);
  };
  fill(
    box,
    h("h2", {}, "Channels that may be wrong"),
    h(
      "p",
      {class: "note"},
      "A reading is polarity × gain × the truth, late by the delay. What is listed here is identified together with the structure and reported with its interval.",
    ),
    errors.length
      ? table(
          ["error", "channels", "", "start", "prior", ""],
          errors.map((one, k) => errorRow(app, one, k, edit)),
        )
      : h("p", {class: "muted"}, "All channels are assumed to be right."),
    newError(app, channelChoices(app, found), edit),
  );
}

// The channels of a channel error in words.
const channelWords = (error) =>
  ["outputs", "inputs"]
    .filter((end) => error[end] !== undefined)
    .map((end) =>
      [error[end]]
        .flat()
        .map((name) => (name === "all" ? `all ${end === "outputs" ? "sensors" : "loads"}` : name))
        .join(", "),
    )
    .join(", ");

// The cells of the k-th channel error, with a button that removes it.
function errorRow(app, error, k, edit) {
  const channels = channelWords(error);
  const remove = h(
    "button",
    {
      class: "small",
      type: "button",
      disabled: !app.folder.writable,
      "aria-label": `Remove the ${error.property} of ${channels}`,
      onclick: () =>
        app.doing(remove, () =>
          edit(
            [{remove: [...recordPath(app), "channel_error", k]}],
            `The ${error.property} of ${channels} counts as known`,
          ),
        ),
    },
    "Remove",
  );
  return [
    error.property,
    channels || "all channels",
    error.each || error.property === "polarity" ? "one each" : "in common",
    error.start ?? "",
    priorWords(error.prior),
    remove,
  ];
}

// Channels to choose from, as the study calls them: "outputs 5X" or "inputs all", and the words for it. Modes have no loads.
function channelChoices(app, found) {
  const {relabel = {}} = records(app)[app.record],
    isModes = found.kind === "modes";
  const called = (name) => relabel[name.replace(/[+-]$/, "")] ?? name;
  return [
    ["outputs all", "all sensors"],
    ...(isModes ? [] : [["inputs all", "all loads"]]),
    ...found.channels
      .filter((one) => !isModes || one.role !== "load")
      .slice(0, 300)
      .map(({role, name}) =>
        role === "load"
          ? [`inputs ${called(name)}`, `load ${called(name)}`]
          : [`outputs ${called(name)}`, called(name)],
      ),
  ];
}

// Fields that add a channel error; where no loads can be chosen, the record holds modes, which have gains alone.
function newError(app, choices, edit) {
  const hasLoads = choices.some(([value]) => value === "inputs all");
  const property = h(
    "select",
    {
      id: "error-property",
      "data-kept": true,
      onchange: () => {
        prior.disabled = each.disabled = property.value === "polarity";
      },
    },
    options(hasLoads ? PROPERTIES : PROPERTIES.slice(0, 1)),
  );
  const channels = h(
    "select",
    {id: "error-channels", "data-kept": true, multiple: true, size: Math.min(6, choices.length)},
    options(choices, "outputs all"),
  );
  const each = h("input", {type: "checkbox", id: "error-each", "data-kept": true, checked: true}),
    prior = h("input", {id: "error-prior", spellcheck: "false", placeholder: "as in 1 ± 2.5 %"});
  const add = h(
    "button",
    {
      class: "main",
      type: "button",
      disabled: !app.folder.writable,
      onclick: () =>
        app.doing(add, async () => {
          const chosen = [...channels.selectedOptions].map((one) => one.value.split(" "));
          await edit(
            [
              {
                add: [...recordPath(app), "channel_error"],
                table: errorEntry(property.value, chosen, each.checked, prior.value),
              },
            ],
            `The ${property.value} of these channels is sought`,
          );
        }),
    },
    "Add",
  );
  return h(
    "div",
    {class: "row end"},
    field("Error", property),
    field("Channels", channels),
    field("Prior, mean ± std", prior),
    h("label", {class: "check"}, each, "one for each channel"),
    add,
  );
}

// A table [[record.channel_error]] as texts of TOML by key; `chosen` are pairs of "outputs" or "inputs" and a name.
function errorEntry(property, chosen, isEach, prior) {
  if (!chosen.length) {
    throw new Error("Choose the channels that may be wrong");
  }
  const entry = {property: JSON.stringify(property)};
  for (const end of ["outputs", "inputs"]) {
    const names = chosen.filter(([which]) => which === end).map(([, name]) => name);
    if (names.length) {
      entry[end] = names.includes("all") ? '"all"' : toml(names);
    }
  }
  if (property !== "polarity") {
    if (isEach) {
      entry.each = "true";
    }
    if (prior.trim()) {
      entry.prior = priorWritten(prior);
    }
  }
  return entry;
}

// Time histories of a file, with channels to choose and a span of time that is typed or dragged.
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
    const rows = [...shown].sort((a, b) => a - b);
    const {traces, layout, count} = envelopes(told, rows, [first, last ?? told.seconds]);
    layout.again = () => draw(first, last).catch(app.fail);
    place.style.height = `${Math.max(220, 60 + 120 * rows.length)}px`;
    await chart(place, traces, layout);
    fill(
      words,
      told.sampled
        ? "Some samples of a long record; all of it is being read, once."
        : `${count} stretches, each with its least and greatest value. Drag to zoom, double-click for all.`,
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
  };
  await draw(0, null);
}

// Traces and layout of histories below each other, each drawn from the least to the greatest value of each stretch; `rows` are
// indices of channels, `span` first and last time, s. `count` is the number of stretches.
function envelopes(told, rows, span) {
  const times = unpacked(told.time, "f64"),
    x = Float64Array.from({length: 2 * times.length}, (_, i) => times[i >> 1]);
  const layout = {
    uirevision: "kept",
    dragmode: "zoom",
    xaxis: {title: {text: "time, s"}, anchor: "y" + (rows.length > 1 ? rows.length : ""), range: span},
  };
  const traces = rows.map((channel, row) => {
    const low = unpacked(told.low[channel], "f32"),
      high = unpacked(told.high[channel], "f32"),
      name = told.names[channel],
      tag = row ? String(row + 1) : "";
    layout["yaxis" + tag] = {
      domain: [1 - (row + 1) / rows.length + 0.02, 1 - row / rows.length - 0.02],
      title: {text: withUnit(name.replace(/ (\w+)$/, "<br>$1"), told.units[channel]), font: {size: 11}},
      nticks: 4,
      fixedrange: true,
    };
    return {
      x,
      y: Float32Array.from({length: x.length}, (_, i) => (i % 2 ? high : low)[i >> 1]),
      name,
      mode: "lines",
      line: {width: 1, color: colours()[row % 7]},
      yaxis: "y" + tag,
      hovertemplate: "%{x:.6g} s: %{y:.4g}<extra></extra>",
      showlegend: false,
    };
  });
  return {traces, layout, count: times.length};
}
