// Modes of a record: the stabilization diagram, poles taken and left by a click, saved as a record of modes.
import {post, view} from "../api.js";
import {besideCard} from "../beside.js";
import {chart, colours} from "../charts.js";
import {
  bandIn,
  field,
  fill,
  h,
  marked,
  number,
  numberIn,
  options,
  table,
  unpacked,
  warningList,
  writing,
} from "../dom.js";
import {mergeCard} from "../merge.js";
import {besideStudy, givenOptions, readingFields, recordEdits, records} from "../recorded.js";

const KINDS = [
  ["outside the criteria", "circle", 3],
  ["not in a cluster", "x-thin-open", 6],
  ["in the cluster of a mode", "circle-open", 7],
  ["the mode itself", "diamond", 10],
];

let kept = null; // what was found last, with the poles taken and what was asked, so that it is there again

export async function show(box, app) {
  const files = app.folder.records.map((one) => one.path),
    measured = app.folder.records.filter((one) => !one.modes).map((one) => one.path);
  if (!files.length) {
    fill(
      box,
      h("h1", {}, "Modes of a record"),
      h("p", {}, "This folder holds no record yet: drop one on the start page."),
    );
    return;
  }
  const record = records(app)[app.record],
    own = record ? besideStudy(app) + record.path : "";
  const choice = h("select", {id: "record"}, options(measured, measured.includes(own) ? own : measured[0]));
  const low = h("input", {inputmode: "decimal", placeholder: "all"}),
    high = h("input", {inputmode: "decimal", placeholder: "all"});
  const details = h("div");
  let fields = null;
  const say = (given = givenOptions(app, choice.value)) => {
    fields = readingFields(app, choice.value, given);
    fill(details, fields.box);
  };
  choice.addEventListener("change", () => say());
  if (measured.length) {
    say();
  }
  const result = h("div", {id: "survey"}),
    stored = h("div", {id: "saved"}),
    page = h("div");
  const options_ = () => (fields ? fields.options() : {});
  const band = () => bandIn(low, high, true);
  const button = h("button", {class: "main", type: "submit"}, "Find modes");
  const form = h(
    "form",
    {
      class: "card",
      onsubmit: (event) => {
        event.preventDefault();
        app.doing(button, () => find());
      },
    },
    h(
      "div",
      {class: "row end"},
      field("Record", choice),
      field("band from, Hz", low, "short"),
      field("to, Hz", high, "short"),
      button,
    ),
    h("details", {}, h("summary", {}, "What the file does not say about itself"), details),
  );
  let taken = null;
  const model = besideCard(app, () => taken),
    merging = mergeCard(app, options_, band, (found, folder) => keep(found, folder));
  const keep = (found, folder) => {
    merging.draw();
    savedModes(stored, page, app, found, folder);
    if (app.study) {
      model.compare(found.path).catch(app.fail);
    } else {
      model.draw(found.path);
    }
  };
  fill(
    box,
    h("h1", {}, "Modes of a record"),
    measured.length ? form : null,
    result,
    stored,
    model.box,
    merging.box,
    page,
  );
  const find = async () => {
    const asked = {record: choice.value, options: options_(), band: band()},
      study = app.study;
    fill(result, h("p", {class: "muted"}, "Looking at all orders… this takes from a second to some minutes."));
    try {
      drawn({study, asked, found: await post("survey", asked)});
    } catch (error) {
      fill(result, h("div", {class: "card bad"}, marked(error.message)));
    }
  };
  const drawn = (one) => {
    kept = one;
    picture(
      result,
      app,
      one,
      (modes) => {
        taken = modes;
        model.draw();
      },
      keep,
    );
  };
  if (kept && kept.study === app.study && measured.includes(kept.asked.record)) {
    choice.value = kept.asked.record;
    [low.value, high.value] = kept.asked.band || ["", ""];
    say(kept.asked.options);
    drawn(kept);
  }
}

function picture(box, app, one, now, keep) {
  const {
    found,
    asked: {record, options: given, band},
  } = one;
  const place = h("div", {class: "plot tall", id: "stabilization"}),
    list = h("section", {class: "card"});
  const f = unpacked(found.poles.frequency, "f64"),
    order = unpacked(found.poles.order, "f32"),
    kind = unpacked(found.poles.kind, "u8"),
    ratio = unpacked(found.poles.damping, "f32");
  const shape = unpacked(found.poles.shape, "f32"),
    channels = found.channels.length;
  const taken = (one.taken =
    one.taken ||
    found.frequency.map((x, k) => ({
      frequency: x,
      std: found.frequency_std[k],
      damping: found.damping[k],
      damping_std: found.damping_std[k],
      shape: found.shapes[k],
    })));
  fill(
    box,
    h(
      "section",
      {class: "card"},
      h("h2", {}, "Stabilization diagram"),
      h(
        "p",
        {class: "note"},
        `Method ${found.method}. A pole that keeps its place from order to order is a mode. Click a pole to take or leave it.`,
      ),
      place,
    ),
    list,
    found.warnings.length
      ? h("section", {class: "card doubt"}, h("h2", {}, "Warnings"), warningList(found.warnings))
      : null,
  );
  const pick = (frequency, damping, moves = null) => {
    const near = taken.findIndex((one) => Math.abs(one.frequency / frequency - 1) < 0.005);
    if (near >= 0) {
      taken.splice(near, 1);
    } else {
      taken.push({frequency, damping, shape: moves});
      taken.sort((a, b) => a.frequency - b.frequency);
    }
    draw().catch(app.fail);
  };
  const draw = async () => {
    const spectrum = unpacked(found.spectrum.value, "f32"),
      sf = unpacked(found.spectrum.frequency, "f64"),
      top = f.length ? order.reduce((a, b) => Math.max(a, b), 0) * 1.05 + 1 : 1;
    const traces = [
      {
        x: sf,
        y: spectrum,
        yaxis: "y2",
        mode: "lines",
        line: {width: 1.3, color: colours()[5]},
        name: "first singular value",
        hoverinfo: "skip",
      },
    ];
    KINDS.forEach(([name, symbol, size], number_) => {
      const which = [];
      kind.forEach((one, k) => {
        if (one === number_) {
          which.push(k);
        }
      });
      traces.push({
        x: which.map((k) => f[k]),
        y: which.map((k) => order[k]),
        customdata: which.map((k) => [ratio[k], k]),
        mode: "markers",
        type: "scatter",
        name,
        marker: {
          symbol,
          size,
          color: [colours()[6], colours()[6], colours()[0], colours()[1]][number_],
          opacity: number_ ? 1 : 0.35,
          line: {width: 1.5, color: [colours()[6], colours()[6], colours()[0], colours()[1]][number_]},
        },
        hovertemplate: "%{x:.5g} Hz, order %{y}, damping %{customdata[0]:.4f}<extra></extra>",
      });
    });
    const high = Math.min(sf.at(-1), 1.6 * Math.max(...found.frequency, 1e-9));
    await chart(place, traces, {
      again: () => draw().catch(app.fail),
      uirevision: "kept",
      xaxis: {title: {text: "frequency, Hz"}, range: band || [0, high]},
      yaxis: {title: {text: "order of the model"}, range: [0, top], overlaying: "y2", tickmode: "auto"},
      yaxis2: {type: "log", side: "right", showgrid: false, title: {text: ""}, exponentformat: "power"},
      shapes: taken.map((one) => ({
        type: "line",
        x0: one.frequency,
        x1: one.frequency,
        yref: "paper",
        y0: 0,
        y1: 1,
        line: {color: colours()[1], width: 1.5},
      })),
    });
    if (!place.listening) {
      place.listening = true;
      place.on("plotly_click", (event) => {
        const point = event.points.find((one) => one.customdata !== undefined);
        if (point) {
          const [damping, k] = point.customdata;
          pick(point.x, damping, [...shape.slice(channels * k, channels * (k + 1))]);
        }
      });
    }
    panel();
  };
  const panel = () => {
    const name = h("input", {value: `${record.replace(/\.[^./]*$/, "")}_modes`, spellcheck: "false"}),
      by = h("input", {inputmode: "decimal"});
    const add = h(
      "button",
      {type: "button", onclick: () => app.doing(add, async () => pick(numberIn(by, {least: 1e-9}), NaN))},
      "Take or leave",
    );
    const save = writing(
      app,
      `Save ${taken.length} modes`,
      name,
      async (replace) => {
        const saved = await post("pick", {
          record,
          options: given,
          frequencies: taken.map((one) => Number(one.frequency.toPrecision(8))),
          out: name.value,
          band,
          replace,
        });
        await app.reload();
        keep(saved, name.value);
      },
      {class: "main", disabled: !taken.length || !app.folder.writable},
    );
    fill(
      list,
      h("h2", {}, "Modes taken"),
      table(
        ["Hz", "std", "damping ratio", "std", ""],
        taken.map((one) => [
          number(one.frequency, 6),
          number(one.std ?? NaN, 2),
          number(one.damping, 3),
          number(one.damping_std ?? NaN, 2),
          h(
            "button",
            {
              class: "small",
              type: "button",
              "aria-label": `Leave the mode at ${number(one.frequency, 5)} Hz`,
              onclick: () => pick(one.frequency, one.damping),
            },
            "Leave",
          ),
        ]),
        [0, 1, 2, 3],
      ),
      h("div", {class: "row end"}, field("A mode by its frequency, Hz", by, "short"), add),
      h("div", {class: "row end"}, field("Folder of the modes", name), save),
    );
    const own = taken.filter((one) => one.shape); // what is taken by its frequency alone has a shape once it is saved
    now(
      own.length
        ? {
            frequency: own.map((one) => one.frequency),
            damping: own.map((one) => one.damping),
            shapes: own.map((one) => one.shape),
            channels: found.channels,
          }
        : null,
    );
  };
  draw().catch(app.fail);
}

// Modes that were written: what they can be used for, and their page.
function savedModes(place, page, app, saved, folder) {
  const here = besideStudy(app),
    edits = recordEdits(app, {path: JSON.stringify(saved.path.slice(here.length))}, {modes: {form: '"output"'}});
  const can = app.study && saved.path.startsWith(here) && app.folder.writable;
  const use = (which, words) => {
    const button = h(
      "button",
      {
        type: "button",
        onclick: () =>
          app.doing(button, async () => {
            await app.edit(
              which,
              `The modes are now ${words.toLowerCase().includes("beside") ? "another" : "the"} record of this study`,
            );
            app.go("structure");
          }),
      },
      words,
    );
    return button;
  };
  fill(
    place,
    h(
      "div",
      {class: "card good"},
      h("p", {}, `${saved.frequency.length} modes are saved in ${saved.path}.`),
      can
        ? h(
            "div",
            {class: "row"},
            use(edits.instead, `Use as the record of ${app.study}`),
            edits.beside ? use(edits.beside, `Use beside the records of ${app.study}`) : null,
          )
        : null,
      saved.page
        ? h("p", {class: "note"}, "The page at the end shows their shapes in motion, AutoMAC and complexity.")
        : null,
    ),
  );
  fill(
    page,
    saved.page
      ? h("iframe", {class: "report", sandbox: "allow-scripts", src: view(saved.page), title: `Modes in ${folder}`})
      : null,
  );
  app.say(`${saved.path}: saved`);
}
