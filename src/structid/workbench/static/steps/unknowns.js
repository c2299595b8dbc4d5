// What is sought: properties of element sets, priors and bounds, with the accuracy that is predicted beside each.
import {get} from "../api.js";
import {field, fill, h, options, percent, quantity, refusal, table, toml, typed, unitText} from "../dom.js";
import {refuseTyped} from "../typed.js";

export async function show(box, app) {
  const told = await get("scene", {study: app.study}),
    list = h("section", {class: "card", id: "unknowns"}),
    predicted = h("section", {class: "card", id: "predicted"}),
    plan = h("section", {class: "card"});
  fill(
    box,
    h("h1", {}, "Unknowns and plan"),
    list,
    fresh(app, told, () => refresh()),
    predicted,
    plan,
  );
  const refresh = async () => {
    draw(list, app, told, () => refresh());
    await predict(predicted, app, list);
  };
  planning(plan, app);
  await refresh();
}

const shown = (value) =>
  value === undefined
    ? ""
    : Array.isArray(value)
      ? value.map(shown).join(", ")
      : typeof value === "number"
        ? String(value)
        : String(value);
const literal = (text) => {
  const value = text.trim();
  return /^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$/.test(value)
    ? value.startsWith(".")
      ? "0" + value
      : value.endsWith(".")
        ? value + "0"
        : value
    : null;
};

export function boundsWritten(text) {
  const ends = text.split(",").map(numeric);
  if (ends.length !== 2 || !(Number(ends[0]) < Number(ends[1]))) {
    throw new Error("Bounds are written low, high, as in 20.5, 30");
  }
  return `[${ends.join(", ")}]`;
}

const numeric = (text) => {
  const found = literal(text);
  if (found === null) {
    throw new Error(`${text.trim() || "nothing"} is no number; write it as in 20.5 or 2.1e11`);
  }
  return found;
};

// A prior as it is shown, and as the study has it: mean ± std, in the unit or in per cent.
export const priorWords = (prior) =>
  prior
    ? `${shown(prior.mean)} ± ${prior.std !== undefined ? shown(prior.std) : typed(100 * prior.relative_std) + " %"}`
    : "";

export function priorWritten(text) {
  const found = /^\s*([^\s±]+?)\s*(?:±|\+-|\s)\s*([^\s±%]+)\s*(%?)$/.exec(text);
  if (!found) {
    throw new Error("A prior is written mean ± std, as in 6.5 ± 0.5 or 6.5 ± 10 %");
  }
  const spread = numeric(found[2]);
  if (!(Number(spread) > 0)) {
    throw new Error("The std of a prior must be greater than 0");
  }
  return `{ mean = ${numeric(found[1])}, ${found[3] ? `relative_std = ${Number(spread) / 100}` : `std = ${spread}`} }`;
}

// The property of an entry as the structure has it, for its unit and nominal value.
function nominal(told, entry) {
  const names = [entry.elements ?? []].flat().map((one) => String(one).split(":")[0]);
  return told.sets
    .filter((one) => names.includes(one.name))
    .flatMap((one) => one.properties)
    .find((one) => one.name === entry.property);
}

// The table of [[unknown]], each cell written into the study where it is changed; `changed` is called after each edit.
function draw(place, app, told, changed) {
  const entries = app.now.table.unknown || [];
  fill(
    place,
    h("h2", {}, `Unknowns (${entries.length} entries)`),
    entries.length
      ? table(
          ["property", "elements", "predicted std", "each", "start", "bounds", "prior", "fixed", ""],
          entries.map((entry, k) => entryRow(app, entry, k, nominal(told, entry), changed)),
        )
      : h("p", {class: "muted"}, "None yet."),
    h(
      "p",
      {class: "note"},
      "A prior is written mean ± std, as in 6.5 ± 0.5 or 6.5 ± 10 %; bounds as low, high. Fields, ties and what varies from record to record are written in the study file.",
    ),
  );
}

// The cells of the k-th entry; `property` is that of the structure, for unit and nominal value.
function entryRow(app, entry, k, property, changed) {
  const name = `${entry.property} of ${shown(entry.elements)}`,
    unit = unitText(property?.unit);
  const change = (key, value) =>
    app.edit([value === "" ? {remove: ["unknown", k, key]} : {set: ["unknown", k, key], to: value}]);
  // an empty cell of a key that the entry has not is no change
  const cell = (key, words, toToml, placeholder = "") =>
    textCell(app, words, `${key}: ${name}`, placeholder, async (text) => {
      if (text || entry[key] !== undefined) {
        await change(key, text === "" ? "" : toToml(text));
        changed();
      }
    });
  const flag = (key, label) =>
    h("input", {
      type: "checkbox",
      checked: Boolean(entry[key]),
      disabled: !app.folder.writable,
      "aria-label": `${label}: ${name}`,
      onchange: (event) =>
        app.doing(event.target, async () => {
          await change(key, event.target.checked ? "true" : "");
          changed();
        }),
    });
  return [
    [entry.property + (entry.field ? " (field)" : ""), unit ? h("span", {class: "muted"}, `, ${unit}`) : null],
    shown(entry.elements),
    h("span", {"data-predicted": String(k)}, "…"),
    flag("each", "one for each element"),
    cell("start", shown(entry.start), numeric, property && property.low === property.high ? typed(property.low) : ""),
    cell("bounds", shown(entry.bounds), boundsWritten),
    cell("prior", priorWords(entry.prior), priorWritten),
    flag("fixed", "kept at its start"),
    h(
      "button",
      {
        class: "small",
        type: "button",
        disabled: !app.folder.writable,
        "aria-label": `Remove ${name}`,
        onclick: (event) =>
          app.doing(event.target, async () => {
            await app.edit([{remove: ["unknown", k]}], `${name} is no unknown any more`);
            changed();
          }),
      },
      "Remove",
    ),
  ];
}

// A field of a table whose text is saved when it is left; what `save` refuses is said beside it.
function textCell(app, words, label, placeholder, save) {
  const input = h("input", {
    value: words,
    placeholder,
    "aria-label": label,
    spellcheck: "false",
    disabled: !app.folder.writable,
    size: Math.max(7, Math.min(16, words.length + 1)),
    onchange: () =>
      app.doing(input, async () => {
        try {
          await save(input.value.trim());
        } catch (error) {
          refuseTyped(input, error.message);
          throw error;
        }
      }),
  });
  return input;
}

// The card that adds an unknown: a property that all chosen element sets have.
function fresh(app, told, changed) {
  const sets = told.sets.filter((one) => one.properties.length);
  const names = h(
    "select",
    {
      id: "set",
      "data-kept": true,
      multiple: true,
      size: Math.min(6, Math.max(2, sets.length)),
      onchange: () => offerProperties(),
    },
    options(
      sets.map((one) => [one.name, `${one.name} (${one.count} × ${one.type})`]),
      sets[0]?.name,
    ),
  );
  const property = h("select", {id: "property", "data-kept": true}),
    each = h("input", {type: "checkbox", id: "each", "data-kept": true});
  const chosenNames = () => [...names.selectedOptions].map((one) => one.value);
  const offerProperties = () => {
    const chosen = chosenNames().map((name) => sets.find((set) => set.name === name));
    fill(property, options(commonProperties(chosen), property.value));
  };
  offerProperties();
  const add = h(
    "button",
    {
      class: "main",
      type: "button",
      disabled: !app.folder.writable,
      onclick: () =>
        app.doing(add, async () => {
          const chosen = chosenNames();
          if (!chosen.length || !property.value) {
            throw new Error("Choose an element set and a property");
          }
          const entry = {
            property: JSON.stringify(property.value),
            elements: chosen.length === 1 ? JSON.stringify(chosen[0]) : toml(chosen),
            ...(each.checked ? {each: "true"} : {}),
          };
          await app.edit([{add: ["unknown"], table: entry}], `${property.value} of ${chosen.join(", ")} is sought`);
          changed();
        }),
    },
    "Add",
  );
  return h(
    "section",
    {class: "card"},
    h("h2", {}, "Add an unknown"),
    h(
      "div",
      {class: "row end"},
      field("Element sets", names),
      field("Property", property),
      h("label", {class: "check"}, each, "one for each element"),
      add,
    ),
  );
}

// Names of the properties that all of some element sets have, with the nominal value of the first set.
const commonProperties = (sets) =>
  (sets[0]?.properties || [])
    .filter(({name}) => sets.every((set) => set.properties.some((one) => one.name === name)))
    .map(({name, low, high, unit}) => [
      name,
      `${name}, nominal ${low === high ? quantity(low, unit) : "from " + quantity(low, unit)}`,
    ]);

// The parameters that an entry makes, by their names.
function made(entry, all) {
  const sets = [entry.elements].flat().map((one) => one.split(":")[0]);
  return all.filter((one) => {
    const [, property, inner] = /^([^[]*)\[(.*)\]$/.exec(one.name) || [];
    return (
      property === entry.property &&
      (entry.name
        ? inner === entry.name || inner.startsWith(entry.name + ":")
        : inner === [entry.elements].flat().join(", ") ||
          [entry.elements].flat().includes(inner) ||
          sets.some((set) => inner.startsWith(set + ":")) ||
          sets.includes(inner))
    );
  });
}

function besides(list, app, parameters) {
  (app.now.table.unknown || []).forEach((entry, k) => {
    const place = list.querySelector(`[data-predicted="${k}"]`),
      own = parameters ? made(entry, parameters) : [];
    if (!place) {
      return;
    }
    const relative = own.map((one) => one.relative ?? Infinity),
      worst = Math.max(...relative),
      best = Math.min(...relative);
    place.textContent = !own.length
      ? ""
      : own.length === 1 || best === worst
        ? percent(worst)
        : `${percent(best)} to ${percent(worst)}`;
    place.className = worst > 1 ? "state bad" : "";
  });
}

async function predict(place, app, list) {
  const {record, unknown} = app.now.table;
  if (!record || !unknown) {
    besides(list, app, null);
    const words = record ? "Needs an unknown: add one above." : "Needs a record, or a plan.";
    fill(place, h("h2", {}, "Predicted accuracy"), h("p", {class: "muted"}, words));
    return;
  }
  const mark = app.now.digest;
  fill(place, h("h2", {}, "Predicted accuracy"), h("p", {class: "muted"}, "Computing…"));
  try {
    const found = await get("check", {study: app.study});
    if (app.now.digest !== mark) {
      return;
    }
    const rows = found.parameters.slice(0, 300);
    besides(list, app, found.parameters);
    fill(
      place,
      h("h2", {}, "Predicted accuracy"),
      h(
        "p",
        {},
        `Rank ${found.rank} of ${found.n_parameters} from the data alone; predicted at the initial values, for a model that is right.`,
      ),
      table(
        ["parameter", "start", "predicted std", "relative"],
        rows.map((one) => [
          one.name,
          quantity(one.start, one.unit),
          quantity(one.std ?? NaN, one.unit, 2),
          percent(one.relative),
        ]),
        [1, 2, 3],
        rows.map((one) => (one.relative === null || one.relative > 1 ? "doubtful" : null)),
      ),
      found.directions.length
        ? h(
            "div",
            {},
            h("h3", {}, "Not determined"),
            h(
              "ul",
              {class: "warnings"},
              found.directions.map((words) => h("li", {}, words)),
            ),
          )
        : null,
    );
  } catch (error) {
    besides(list, app, null);
    fill(place, h("h2", {}, "Predicted accuracy"), refusal(error.message));
  }
}

function planning(place, app) {
  const count = h("input", {type: "number", min: 1, max: 40, value: 4}),
    result = h("div", {"aria-live": "polite"});
  const button = h(
    "button",
    {
      type: "button",
      onclick: () =>
        app.doing(button, async () => {
          fill(result, h("p", {class: "muted"}, "Choosing…"));
          const found = await get("plan", {study: app.study, sensors: count.value});
          const take = h(
            "button",
            {
              class: "main",
              type: "button",
              disabled: !app.folder.writable,
              onclick: () =>
                app.doing(take, async () => {
                  const bare = (list) => toml(list.map((name) => name.replace(/\+$/, "")));
                  await app.edit(
                    [
                      {set: ["plan", "installed_sensors"], to: bare(found.sensors)},
                      {set: ["plan", "installed_loads"], to: bare(found.loads)},
                    ],
                    "The plan is in the study",
                  );
                  app.go("structure");
                }),
            },
            "Take into the plan",
          );
          fill(
            result,
            h("p", {}, `Best sensors: ${found.sensors.join(", ")}; load at ${found.loads.join(", ")}.`),
            table(
              ["parameter", "predicted relative std"],
              found.parameters.map((one) => [one.name, percent(one.relative)]),
              [1],
            ),
            take,
          );
        }),
    },
    "Choose",
  );
  fill(
    place,
    h("h2", {}, "Best sensors"),
    h("p", {class: "note"}, "The sensor positions that determine these unknowns best, chosen before any test."),
    h("div", {class: "row end"}, field("Sensors", count, "short"), button),
    result,
  );
}
