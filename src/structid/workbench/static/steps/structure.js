// The structure in space, its sensors, and what `check` says of it.
import {get} from "../api.js";
import {
  checkbox,
  field,
  fill,
  h,
  marked,
  number,
  numberIn,
  options,
  percent,
  quantity,
  refusal,
  table,
  toml,
  unitText,
  warningList,
} from "../dom.js";
import {recordPath, recordPicker, records} from "../recorded.js";
import {Scene, sceneStage} from "../scene.js";
import {forgetTyped} from "../typed.js";

const WAYS = [
  ["+X", [1, 0, 0]],
  ["−X", [-1, 0, 0]],
  ["+Y", [0, 1, 0]],
  ["−Y", [0, -1, 0]],
  ["+Z", [0, 0, 1]],
  ["−Z", [0, 0, -1]],
];

export async function show(box, app) {
  const stage = sceneStage(
    [h("button", {class: "small", type: "button", onclick: () => scene.home()}, "Show all")],
    "Drag to turn, Shift and drag to move, wheel to zoom, click a node",
  );
  const sets = h("section", {class: "card"}),
    node = h("section", {class: "card", id: "node"}),
    sensors = h("section", {class: "card", id: "sensors"});
  const places = h("section", {class: "card doubt", id: "marked", hidden: true});
  const checked = h("section", {class: "card", id: "checked"});
  fill(
    box,
    h("h1", {}, app.now.table?.title || app.study),
    recordPicker(app),
    h(
      "div",
      {class: "beside"},
      h("div", {class: "main-part"}, stage, places, checked),
      h("div", {class: "side-part"}, node, sensors, sets),
    ),
  );
  const state = {app, channels: [], chosen: null, node: null, failed: ""};
  const scene = new Scene(stage, (label) => {
    state.node = label;
    drawNode();
  });
  state.scene = scene;
  const told = await get("scene", {study: app.study, number: app.record});
  scene.set(told);
  if (!scene.gl) {
    app.say("This browser has no WebGL 2; the structure is drawn by lines only.", true);
  }
  setsPanel(sets, scene, told);
  const drawNode = () => nodePanel(node, state, told, refresh);
  const drawSensors = () =>
    sensorPanel(sensors, state, told, (name) => {
      state.chosen = name;
      drawSensors();
      drawNode();
    });
  drawNode();

  async function refresh() {
    try {
      state.failed = "";
      state.channels = told.has_record
        ? (await get("channels", {study: app.study, number: app.record})).channels
        : planned(app);
    } catch (error) {
      state.failed = error.message;
    }
    scene.sensors = state.channels.map((one) => ({...one, chosen: one.name === state.chosen}));
    scene.ask();
    drawSensors();
    drawNode();
    showCheck(checked, app, mark);
  }

  const mark = (findings) => {
    markFindings(places, scene, findings);
  };
  mark(told.findings);
  await refresh();
}

// The element sets, each with a box that shows it in the picture, and their properties.
function setsPanel(place, scene, told) {
  fill(
    place,
    h("h2", {}, "Element sets"),
    h("p", {class: "muted"}, `${scene.labels.length} nodes, ${told.n_dofs} free degrees of freedom`),
    h(
      "ul",
      {class: "plain sets", tabindex: 0, "aria-label": "Element sets"},
      scene.sets.map((one) => elementSet(scene, one)),
    ),
  );
}

function elementSet(scene, one) {
  const span = ({low, high, unit}) =>
    low === high ? quantity(low, unit) : `${quantity(low, unit)} to ${quantity(high, unit)}`;
  return h(
    "li",
    {},
    checkbox(
      true,
      (isOn) => {
        scene.hidden[isOn ? "delete" : "add"](one.name);
        scene.ask();
      },
      h(
        "span",
        {},
        h("span", {class: "swatch", style: {background: one.colour}}),
        one.name,
        " ",
        h("span", {class: "muted"}, `${one.count} × ${one.type}`),
      ),
    ),
    h(
      "details",
      {},
      h("summary", {}, "properties"),
      table(
        ["property", "nominal"],
        one.properties.map((property) => [property.name, span(property)]),
      ),
    ),
  );
}

// What is doubtful in places: a number in the picture, the words beside it.
function markFindings(place, scene, findings) {
  scene.findings = findings.map((one) => ({...one, shown: true}));
  scene.ask();
  place.hidden = !findings.length;
  fill(
    place,
    h("h2", {}, "Marked in the picture"),
    h(
      "ul",
      {class: "plain marked"},
      scene.findings.map((one, k) =>
        h(
          "li",
          {},
          checkbox(
            true,
            (isOn) => {
              one.shown = isOn;
              scene.ask();
            },
            h("b", {class: "tag"}, String(k + 1)),
            h("span", {}, marked(one.words)),
          ),
        ),
      ),
    ),
  );
}

// Sensors and loads of a test that is still to come.
function planned(app) {
  const plan = app.now.table?.plan || {};
  const found = (key, role) =>
    (plan[key] || []).map((name) => {
      const parts = /^(\d+)\s*[:_ ]?\s*([+-]?)(R?[XYZ])([+-]?)$/i.exec(name);
      const axis = parts ? "XYZ".indexOf(parts[3].slice(-1).toUpperCase()) : 0,
        sign = parts && (parts[2] + parts[4]).includes("-") ? -1 : 1;
      return {
        name,
        role,
        node: parts ? Number(parts[1]) : null,
        direction: [0, 1, 2].map((k) => (k === axis ? sign : 0)),
        rotation: Boolean(parts && parts[3].length > 1),
        declared: true,
        planned: true,
      };
    });
  return [...found("installed_sensors", "sensor"), ...found("installed_loads", "load")];
}

function sensorPanel(place, state, told, choose) {
  const listed = state.channels;
  fill(
    place,
    h("h2", {}, told.has_record ? "Sensors and loads of the record" : "Planned sensors and loads"),
    state.failed ? refusal(state.failed) : null,
    listed.length > 400
      ? h("p", {}, `${listed.length} channels`)
      : listed.length
        ? h(
            "ul",
            {class: "plain"},
            listed.map((one) =>
              h(
                "li",
                {},
                h(
                  "label",
                  {class: "check"},
                  h("input", {
                    type: "radio",
                    name: "channel",
                    value: one.name,
                    checked: one.name === state.chosen,
                    onchange: () => choose(one.name),
                  }),
                  h(
                    "span",
                    {},
                    (one.role === "load" ? "load " : "") + one.name,
                    " ",
                    h(
                      "span",
                      {class: "muted"},
                      one.node === null ? "on no node yet" : `at node ${one.node}, ${words(one)}`,
                    ),
                  ),
                ),
              ),
            ),
          )
        : h(
            "p",
            {class: "muted"},
            told.has_record ? "" : "None yet. Choose a node and place one, or let the plan choose (step Unknowns).",
          ),
  );
}

function words(one) {
  if (one.rotation) {
    return "rotation";
  }
  const found = WAYS.find(([, way]) => way.every((x, k) => Math.abs(x - one.direction[k]) < 1e-6));
  return found ? found[0] : `along (${one.direction.map((x) => number(x, 3)).join(", ")})`;
}

// The chosen node: place, turn or remove a sensor there; the same by keyboard through its number.
function nodePanel(place, state, told, refresh) {
  fill(place, h("h2", {}, "Node"), nodeNumber(state), state.node === null ? null : sensorsAtNode(state, told, refresh));
}

// The number of the chosen node, which may be typed, and its coordinates.
function nodeNumber({app, scene, node: label}) {
  const input = h("input", {
    type: "number",
    value: label ?? "",
    "aria-label": "Number of a node",
    onchange: (event) => {
      const row = scene.row.get(Number(event.target.value));
      if (row === undefined) {
        app.say(`There is no node ${event.target.value}`, true);
      } else {
        forgetTyped(event.target);
        scene.choose(row);
      }
    },
  });
  const coordinate = (k) => number(scene.places[3 * scene.row.get(label) + k], 4);
  return h(
    "div",
    {class: "row end"},
    field("Number", input, "short"),
    h("span", {class: "muted"}, label === null ? "none chosen" : `at (${[0, 1, 2].map(coordinate).join(", ")}) m`),
  );
}

// Support and sensors of the chosen node, and the fields that place a sensor there.
function sensorsAtNode(state, told, refresh) {
  const {app, scene, node: label} = state,
    row = scene.row.get(label);
  const support = told.supports.find((one) => one.node === row),
    there = state.channels.filter((one) => one.node === label),
    ways = WAYS.filter((_, k) => scene.moves[row] & (1 << Math.floor(k / 2)));
  const facts = [
    support ? h("p", {class: "muted"}, `support: ${support.directions.join(" ")}`) : null,
    there.length ? h("p", {}, `here: ${there.map((one) => one.name).join(", ")}`) : null,
  ];
  if (!app.folder.writable) {
    return [facts, h("p", {class: "note"}, "The folder is read only.")];
  }
  if (!ways.length) {
    return [facts, h("p", {class: "note"}, "This node does not move along any axis.")];
  }
  return [
    facts,
    told.has_record
      ? placeChannel(state, ways, refresh)
      : [planChannel(state, ways, refresh), there.map((one) => changePlanned(app, one, refresh))],
  ];
}

const directionChoice = (ways) => h("select", {id: "way"}, options(ways.map(([name]) => name)));

// A channel of the record at the chosen node: placed there, turned, or read by its name again.
function placeChannel(state, ways, refresh) {
  const {app, node: label} = state,
    chosen = state.channels.find((one) => one.name === state.chosen);
  if (!chosen) {
    return h("p", {class: "note"}, "Choose a channel in the list below to place it here.");
  }
  const way = directionChoice(ways);
  const vector = h("input", {
    id: "vector",
    placeholder: "or a vector: 0.3, 0.95, 0",
    "aria-label": "Direction as a vector",
  });
  const put = h(
    "button",
    {
      class: "main",
      type: "button",
      onclick: () =>
        app.doing(put, async () => {
          const direction = directionOf(chosen, way.value, vector.value);
          await app.edit(
            [
              {
                set: [...recordPath(app), "sensors", sensorKey(state.channels, chosen)],
                to: `{ node = ${label}, direction = ${toml(direction)} }`,
              },
            ],
            `${chosen.name} reads node ${label} now`,
          );
          await refresh();
        }),
    },
    chosen.node === label ? `Turn ${chosen.name}` : `Place ${chosen.name} here`,
  );
  return [
    h("div", {class: "row end"}, field("Direction", way), vector),
    h("div", {class: "row"}, put, declaredKey(app, chosen) ? readByName(app, chosen, refresh) : null),
  ];
}

// The button that removes what the study says of a channel's position.
function readByName(app, chosen, refresh) {
  const key = declaredKey(app, chosen);
  const remove = h(
    "button",
    {
      type: "button",
      onclick: () =>
        app.doing(remove, async () => {
          const isLast = Object.keys(sensorsOf(app)).length <= 1;
          await app.edit(
            [{remove: [...recordPath(app), "sensors", ...(isLast ? [] : [key])]}],
            `${chosen.name} is where its name says again`,
          );
          await refresh();
        }),
    },
    "As its name says",
  );
  return remove;
}

// Components of a channel's direction: those typed, or else those of the way chosen; against it if its name ends with "-".
function directionOf(channel, way, text) {
  const vector = text.trim()
    ? text.split(",").map((part) => (part.trim() ? Number(part) : NaN))
    : WAYS.find(([name]) => name === way)[1];
  if (vector.length !== 3 || vector.some((x) => !Number.isFinite(x))) {
    throw new Error("A direction is three numbers, as in 0.3, 0.95, 0");
  }
  const sign = channel.name.endsWith("-") ? -1 : 1;
  return vector.map((x) => (x === 0 ? 0 : sign * x));
}

// The key of a channel in [record.sensors]: its name without sign, behind "load " where a sensor has that name too.
function sensorKey(channels, chosen) {
  const isShared = channels.some((one) => one.role === "sensor" && one.name === chosen.name);
  return (chosen.role === "load" && isShared ? "load " : "") + chosen.name.replace(/[+-]$/, "");
}

const planKey = (role) => (role === "load" ? "installed_loads" : "installed_sensors");

// A sensor or load of a planned test, placed at the chosen node.
function planChannel({app, node: label}, ways, refresh) {
  const way = directionChoice(ways);
  const key = h(
    "select",
    {id: "role"},
    options([
      ["installed_sensors", "sensor"],
      ["installed_loads", "load"],
    ]),
  );
  const add = h(
    "button",
    {
      class: "main",
      type: "button",
      onclick: () =>
        app.doing(add, async () => {
          const name = `${label}${way.value.slice(1)}${way.value.startsWith("−") ? "-" : ""}`,
            installed = app.now.table.plan?.[key.value] || [];
          if (installed.includes(name)) {
            throw new Error(`${name} is there already`);
          }
          await app.edit([{set: ["plan", key.value], to: toml([...installed, name])}], `${name} is planned`);
          await refresh();
        }),
    },
    "Place here",
  );
  return h("div", {class: "row end"}, field("What", key), field("Direction", way), add);
}

// Buttons that turn or remove a planned sensor or load.
function changePlanned(app, channel, refresh) {
  const key = planKey(channel.role);
  const change = (words, changed) => {
    const button = h(
      "button",
      {
        class: "small",
        type: "button",
        onclick: () =>
          app.doing(button, async () => {
            const names = changed(app.now.table.plan[key]);
            await app.edit([names.length ? {set: ["plan", key], to: toml(names)} : {remove: ["plan", key]}]);
            await refresh();
          }),
      },
      words,
    );
    return button;
  };
  const turned = (name) => (name.endsWith("-") ? name.slice(0, -1) : name.replace(/\+$/, "") + "-");
  return h(
    "div",
    {class: "row"},
    change(`Turn ${channel.name} round`, (names) => names.map((name) => (name === channel.name ? turned(name) : name))),
    change(`Remove ${channel.name}`, (names) => names.filter((name) => name !== channel.name)),
  );
}

const sensorsOf = (app) => records(app)[app.record].sensors || {};

function declaredKey(app, chosen) {
  const bare = chosen.name.replace(/[+-]$/, "");
  return Object.keys(sensorsOf(app)).find((key) => key.replace(/^load /, "").replace(/[+-]$/, "") === bare);
}

// A button that edits the study and shows this step anew.
function editButton(app, text, edits, told) {
  const button = h(
    "button",
    {
      type: "button",
      onclick: () =>
        app.doing(button, async () => {
          await app.edit(edits(), told);
          app.go("structure");
        }),
    },
    text,
  );
  return button;
}

// Where segments leak: longer ones, or the histories fitted themselves, each by a click. Of one record only.
function leaking(app, warnings) {
  const words = warnings.find((one) => /^leakage: /.test(one)),
    all = records(app);
  if (!words || all.length !== 1 || !app.folder.writable) {
    return null;
  }
  const needed = /take segments of (\d+) samples/.exec(words)?.[1],
    path = recordPath(app);
  const noise = h("input", {value: "1", inputmode: "decimal"});
  return h(
    "div",
    {id: "leaking"},
    h(
      "div",
      {class: "row end"},
      needed
        ? editButton(
            app,
            `Take segments of ${needed} samples`,
            () => [{set: [...path, "frf", "segment_length"], to: needed}],
            "The segments are longer",
          )
        : null,
      field("noise of the channels, % of their rms", noise, "short"),
      editButton(
        app,
        "Fit the histories themselves",
        () => [
          {set: [...path, "time", "fit"], to: '"spectra"'},
          {set: [...path, "time", "relative_noise"], to: String(numberIn(noise, {least: 1e-6}) / 100)},
        ],
        "The histories themselves are fitted now, without leakage",
      ),
    ),
    h(
      "p",
      {class: "note"},
      "A fit of the histories themselves has no leakage, and needs the noise of the channels. Averaged FRFs then only illustrate the fit.",
    ),
  );
}

// Where the mesh is too coarse: beams in as many pieces as the warning says, by a click.
function coarse(app, warnings) {
  const pieces = warnings
    .map((one) => one.match(/(?:too coarse|smaller elements).*`subdivide = (\d+)`/)?.[1])
    .find(Boolean);
  return app.folder.writable && pieces
    ? h(
        "div",
        {class: "row", id: "coarse"},
        editButton(
          app,
          "Cut the beams finely enough",
          () => [{set: ["structure", "subdivide"], to: pieces}],
          `Each beam has ${pieces} pieces now`,
        ),
      )
    : null;
}

// Where coherence tells the noise once the number of averages is said. Of one record only.
function unaveraged(app, warnings) {
  if (
    !app.folder.writable ||
    records(app).length !== 1 ||
    !warnings.some((one) => /give `averages` in \[record\]/.test(one))
  ) {
    return null;
  }
  const averages = h("input", {value: "", inputmode: "numeric", placeholder: "10"});
  return h(
    "div",
    {class: "row end", id: "averages"},
    field("averages of each FRF", averages, "short"),
    editButton(
      app,
      "Take the noise from coherence",
      () => [{set: [...recordPath(app), "averages"], to: String(Math.round(numberIn(averages, {least: 2})))}],
      "Coherence tells the noise now",
    ),
  );
}

// What `check` says of the study, or what it still needs; `mark` shows the findings that have a place in the picture.
async function showCheck(place, app, mark) {
  const {study, now} = app;
  const show = (...parts) => fill(place, h("h2", {}, "What check says"), parts);
  show(h("p", {class: "muted"}, "Reading the study…"));
  try {
    const {record, unknown} = app.now.table;
    if (!record || !unknown) {
      if (!record) {
        await get("line", {study});
      }
      if (app.now === now) {
        show(incomplete(app, Boolean(record)));
      }
      return;
    }
    const result = await get("check", {study});
    if (app.now !== now) {
      return;
    }
    mark(result.findings);
    show(checkResult(app, result));
  } catch (error) {
    if (app.now === now) {
      show(refusal(error.message), h("a", {href: `#text/${encodeURIComponent(study)}`}, "Open the study file"));
    }
  }
}

// What a study needs before its data can be checked; a record of the folder, where there is one, comes before a plan.
const incomplete = (app, hasRecord) => {
  const step = (name) => h("a", {href: `#${name.toLowerCase()}/${encodeURIComponent(app.study)}`}, `step ${name}`);
  return hasRecord
    ? h("p", {}, "Say what you look for, and this page shows what the record can determine: ", step("Unknowns"), ".")
    : h(
        "p",
        {},
        "The study can be read. Next, ",
        app.folder.records.length ? ["use a record of this folder in it: ", step("Start"), ", or "] : null,
        "plan the test: ",
        step("Unknowns"),
        ".",
      );
};

// The answer of `check`: determined or not, warnings with what mends them, and tables.
function checkResult(app, {determined, records, facts, warnings, directions, resonances, modes, channels}) {
  return [
    h(
      "p",
      {},
      h(
        "span",
        {class: "state " + (determined ? "good" : "bad")},
        determined ? "data and priors determine every parameter" : "the data do not determine every parameter",
      ),
    ),
    records.map((words) => h("p", {}, unitText(words))),
    facts.map((words) => h("p", {class: "note"}, marked(words))),
    warnings.length ? [h("h3", {}, "Warnings"), warningList(warnings)] : h("p", {class: "muted"}, "No warning."),
    coarse(app, warnings),
    unaveraged(app, warnings),
    leaking(app, warnings),
    directions.length
      ? [
          h("h3", {}, "Not determined"),
          h(
            "ul",
            {class: "warnings"},
            directions.map((words) => h("li", {}, words)),
          ),
        ]
      : null,
    resonances.length ? resonanceTable(resonances) : null,
    h("div", {class: "columns"}, modeTable(modes), channelTable(channels)),
  ];
}

function resonanceTable(resonances) {
  return h(
    "details",
    {open: true, id: "resonances"},
    h("summary", {}, "Resonances of the record and of the model at its start values"),
    table(
      ["measured, Hz", "model, Hz", "model is higher by", "MAC"],
      resonances.map(([measured, model, , mac]) => [
        number(measured),
        number(model),
        measured && model ? percent((model - measured) / measured) : "–",
        mac === null ? "–" : number(mac, 2),
      ]),
      [0, 1, 2, 3],
    ),
  );
}

// Modes up to the first one above the band.
function modeTable(modes) {
  return h(
    "details",
    {open: true},
    h("summary", {}, "Modes of the initial model"),
    table(
      ["mode", "Hz", "damping ratio", "lines in its bandwidth"],
      modes
        .slice(0, modes.findLastIndex(([, , isInBand]) => isInBand) + 2)
        .map(([frequency, ratio, isInBand, lines], k) => [
          String(k + 1),
          number(frequency),
          number(ratio, 3),
          isInBand ? number(lines, 3) : "outside",
        ]),
      [1, 2, 3],
    ),
  );
}

function channelTable(channels) {
  return h(
    "details",
    {open: channels.length < 15},
    h("summary", {}, `What the ${channels.length} channels measure`),
    table(["channel", "", "measures"], channels),
  );
}
