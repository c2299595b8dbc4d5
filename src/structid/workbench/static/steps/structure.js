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
  drawSets();
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
      if (told.has_record) {
        state.channels = (await get("channels", {study: app.study, number: app.record})).channels;
      } else {
        state.channels = planned(app);
      }
    } catch (error) {
      state.failed = error.message;
    }
    scene.sensors = state.channels.map((one) => ({...one, chosen: one.name === state.chosen}));
    scene.ask();
    drawSensors();
    drawNode();
    showCheck(checked, app, mark);
  }

  function drawSets() {
    fill(
      sets,
      h("h2", {}, "Element sets"),
      h("p", {class: "muted"}, `${scene.labels.length} nodes, ${told.n_dofs} free degrees of freedom`),
      h(
        "ul",
        {class: "plain sets", tabindex: 0, "aria-label": "Element sets"},
        scene.sets.map((one) =>
          h(
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
                one.properties.map((p) => [
                  p.name,
                  p.low === p.high
                    ? quantity(p.low, p.unit)
                    : `${quantity(p.low, p.unit)} to ${quantity(p.high, p.unit)}`,
                ]),
              ),
            ),
          ),
        ),
      ),
    );
  }

  const mark = (findings) => {
    markFindings(places, scene, findings);
  };
  mark(told.findings);
  await refresh();
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
  const {app, scene} = state,
    label = state.node,
    row = label === null ? -1 : scene.row.get(label);
  const chosen = state.channels.find((one) => one.name === state.chosen),
    there = state.channels.filter((one) => one.node === label && label !== null);
  const input = h("input", {
    type: "number",
    value: label ?? "",
    "aria-label": "Number of a node",
    onchange: (event) => {
      const found = scene.row.get(Number(event.target.value));
      if (found === undefined) {
        app.say(`There is no node ${event.target.value}`, true);
      } else {
        forgetTyped(event.target);
        scene.choose(found);
      }
    },
  });
  const parts = [
    h("h2", {}, "Node"),
    h(
      "div",
      {class: "row end"},
      field("Number", input, "short"),
      label === null
        ? h("span", {class: "muted"}, "none chosen")
        : h(
            "span",
            {class: "muted"},
            `at (${[0, 1, 2].map((k) => number(scene.places[3 * row + k], 4)).join(", ")}) m`,
          ),
    ),
  ];
  if (label !== null) {
    const held = told.supports.find((one) => one.node === row);
    const ways = WAYS.filter((_, k) => scene.moves[row] & (1 << Math.floor(k / 2))),
      way = h("select", {id: "way"}, options(ways.map(([name]) => name)));
    const custom = h("input", {
      id: "vector",
      placeholder: "or a vector: 0.3, 0.95, 0",
      "aria-label": "Direction as a vector",
    });
    if (held) {
      parts.push(h("p", {class: "muted"}, `support: ${held.directions.join(" ")}`));
    }
    if (there.length) {
      parts.push(h("p", {}, `here: ${there.map((one) => one.name).join(", ")}`));
    }
    if (!app.folder.writable) {
      parts.push(h("p", {class: "note"}, "The folder is read only."));
    } else if (!ways.length) {
      parts.push(h("p", {class: "note"}, "This node does not move along any axis."));
    } else if (told.has_record) {
      if (!chosen) {
        parts.push(h("p", {class: "note"}, "Choose a channel in the list below to place it here."));
      } else {
        const button = h(
          "button",
          {
            class: "main",
            type: "button",
            onclick: () =>
              app.doing(button, async () => {
                const vector = custom.value.trim()
                  ? custom.value.split(",").map((part) => (part.trim() ? Number(part) : NaN))
                  : WAYS.find(([name]) => name === way.value)[1];
                const key =
                  (chosen.role === "load" &&
                  !state.channels.some((one) => one.role === "sensor" && one.name === chosen.name)
                    ? ""
                    : chosen.role === "load"
                      ? "load "
                      : "") + chosen.name.replace(/[+-]$/, "");
                if (vector.length !== 3 || vector.some((x) => !Number.isFinite(x))) {
                  throw new Error("A direction is three numbers, as in 0.3, 0.95, 0");
                }
                const sign = chosen.name.endsWith("-") ? -1 : 1;
                await app.edit(
                  [
                    {
                      set: [...recordPath(app), "sensors", key],
                      to: `{ node = ${label}, direction = ${toml(vector.map((x) => (x === 0 ? 0 : sign * x)))} }`,
                    },
                  ],
                  `${chosen.name} reads node ${label} now`,
                );
                await refresh();
              }),
          },
          chosen.node === label ? `Turn ${chosen.name}` : `Place ${chosen.name} here`,
        );
        const taken = declaredKey(app, chosen);
        const remove = h(
          "button",
          {
            type: "button",
            onclick: () =>
              app.doing(remove, async () => {
                await app.edit(
                  [
                    {
                      remove: [
                        ...recordPath(app),
                        "sensors",
                        ...(Object.keys(sensorsOf(app)).length > 1 ? [taken] : []),
                      ],
                    },
                  ],
                  `${chosen.name} is where its name says again`,
                );
                await refresh();
              }),
          },
          "As its name says",
        );
        parts.push(
          h("div", {class: "row end"}, field("Direction", way), custom),
          h("div", {class: "row"}, button, taken ? remove : null),
        );
      }
    } else {
      const role = h(
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
                old = app.now.table.plan?.[role.value] || [];
              if (old.includes(name)) {
                throw new Error(`${name} is there already`);
              }
              await app.edit([{set: ["plan", role.value], to: toml([...old, name])}], `${name} is planned`);
              await refresh();
            }),
        },
        "Place here",
      );
      parts.push(h("div", {class: "row end"}, field("What", role), field("Direction", way), add));
      for (const one of there) {
        const key = one.role === "load" ? "installed_loads" : "installed_sensors";
        const turn = h(
          "button",
          {
            class: "small",
            type: "button",
            onclick: () =>
              change(turn, (list) =>
                list.map((name) =>
                  name === one.name ? (name.endsWith("-") ? name.slice(0, -1) : name.replace(/\+$/, "") + "-") : name,
                ),
              ),
          },
          `Turn ${one.name} round`,
        );
        const remove = h(
          "button",
          {
            class: "small",
            type: "button",
            onclick: () => change(remove, (list) => list.filter((name) => name !== one.name)),
          },
          `Remove ${one.name}`,
        );
        const change = (button, next) =>
          app.doing(button, async () => {
            const list = next(app.now.table.plan[key]);
            await app.edit([list.length ? {set: ["plan", key], to: toml(list)} : {remove: ["plan", key]}]);
            await refresh();
          });
        parts.push(h("div", {class: "row"}, turn, remove));
      }
    }
  }
  fill(place, parts);
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
        "The histories are fitted themselves now, which has no leakage",
      ),
    ),
    h(
      "p",
      {class: "note"},
      "Histories that are fitted themselves leak nothing; they need the noise of the channels. Averaged FRFs then only illustrate the fit.",
    ),
  );
}

// Where the mesh is too coarse: beams cut as finely as the values need, by a click.
function coarse(app, warnings) {
  return app.folder.writable && warnings.some((one) => /(too coarse|smaller elements).*`subdivide = /.test(one))
    ? h(
        "div",
        {class: "row", id: "coarse"},
        editButton(
          app,
          "Cut the beams finely enough",
          () => [{set: ["structure", "subdivide"], to: '"auto"'}],
          "Beams are cut until the mesh moves no value",
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
  const averages = h("input", {value: "", inputmode: "numeric", placeholder: "such as 10"});
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

async function showCheck(place, app, mark) {
  const {study, now} = app;
  fill(place, h("h2", {}, "What check says"), h("p", {class: "muted"}, "Reading the study…"));
  try {
    const {record, unknown} = app.now.table;
    if (!record || !unknown) {
      if (!record) {
        await get("line", {study});
      }
      if (app.now !== now) {
        return;
      }
      fill(
        place,
        h("h2", {}, "What check says"),
        h(
          "p",
          {},
          record
            ? "What its record can determine is told once the study says what you look for: "
            : "The study can be read. What data can determine is told once there is a record, or by a plan: ",
          h("a", {href: `#unknowns/${encodeURIComponent(study)}`}, "step Unknowns"),
          ".",
        ),
      );
      return;
    }
    const found = await get("check", {study});
    if (app.now !== now) {
      return;
    }
    mark(found.findings);
    fill(
      place,
      h("h2", {}, "What check says"),
      h(
        "p",
        {},
        h(
          "span",
          {class: "state " + (found.determined ? "good" : "bad")},
          found.determined ? "data and priors determine every parameter" : "the data do not determine every parameter",
        ),
      ),
      found.records.map((words) => h("p", {}, unitText(words))),
      found.warnings.length
        ? [h("h3", {}, "Warnings"), warningList(found.warnings)]
        : h("p", {class: "muted"}, "No warning."),
      coarse(app, found.warnings),
      unaveraged(app, found.warnings),
      leaking(app, found.warnings),
      found.directions.length
        ? [
            h("h3", {}, "Not determined"),
            h(
              "ul",
              {class: "warnings"},
              found.directions.map((words) => h("li", {}, words)),
            ),
          ]
        : null,
      found.resonances.length
        ? h(
            "details",
            {open: true, id: "resonances"},
            h("summary", {}, "Resonances of the record and of the model at its start values"),
            table(
              ["measured, Hz", "model, Hz", "model is higher by", "MAC"],
              found.resonances.map(([measured, model, , mac]) => [
                number(measured),
                number(model),
                measured && model ? percent((model - measured) / measured) : "–",
                mac === null ? "–" : number(mac, 2),
              ]),
              [0, 1, 2, 3],
            ),
          )
        : null,
      h(
        "div",
        {class: "columns"},
        h(
          "details",
          {open: true},
          h("summary", {}, "Modes of the initial model"),
          table(
            ["mode", "Hz", "damping ratio", "lines in its bandwidth"],
            found.modes
              .slice(0, found.modes.findLastIndex((one) => one[2]) + 2)
              .map((one, k) => [
                String(k + 1),
                number(one[0]),
                number(one[1], 3),
                one[2] ? number(one[3], 3) : "outside",
              ]),
            [1, 2, 3],
          ),
        ),
        h(
          "details",
          {open: found.channels.length < 15},
          h("summary", {}, `What the ${found.channels.length} channels measure`),
          table(
            ["channel", "", "measures"],
            found.channels.map((one) => one),
          ),
        ),
      ),
    );
  } catch (error) {
    if (app.now !== now) {
      return;
    }
    fill(
      place,
      h("h2", {}, "What check says"),
      refusal(error.message),
      h("a", {href: `#text/${encodeURIComponent(study)}`}, "Open the study file"),
    );
  }
}
