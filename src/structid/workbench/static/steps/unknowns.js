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

function draw(place, app, told, changed) {
  const list = app.now.table.unknown || [];
  const cell = (words, label, save, placeholder = "") => {
    const input = h("input", {
      value: words,
      placeholder,
      "aria-label": label,
      spellcheck: "false",
      disabled: !app.folder.writable,
      size: Math.max(7, Math.min(16, words.length + 1)),
    });
    input.addEventListener("change", () =>
      app.doing(input, async () => {
        try {
          if (await save(input.value.trim())) {
            changed();
          }
        } catch (error) {
          refuseTyped(input, error.message);
          throw error;
        }
      }),
    );
    return input;
  };
  const change = async (k, key, value, remove = value === "") => {
    await app.edit([remove ? {remove: ["unknown", k, key]} : {set: ["unknown", k, key], to: value}]);
    return true;
  };
  fill(
    place,
    h("h2", {}, `Unknowns (${list.length} entries)`),
    list.length
      ? table(
          ["property", "elements", "predicted std", "each", "start", "bounds", "prior", "fixed", ""],
          list.map((one, k) => {
            const name = `${one.property} of ${shown(one.elements)}`;
            const has = (key) => one[key] !== undefined,
              own = nominal(told, one),
              unit = unitText(own?.unit);
            const flag = (key) =>
              h("input", {
                type: "checkbox",
                checked: Boolean(one[key]),
                disabled: !app.folder.writable,
                "aria-label": `${key === "each" ? "one for each element" : "kept at its start"}: ${name}`,
                onchange: (event) =>
                  app.doing(event.target, async () => {
                    await change(k, key, "true", !event.target.checked);
                    changed();
                  }),
              });
            const prior = priorWords(one.prior);
            return [
              [one.property + (one.field ? " (field)" : ""), unit ? h("span", {class: "muted"}, `, ${unit}`) : null],
              shown(one.elements),
              h("span", {"data-predicted": String(k)}, "…"),
              flag("each"),
              cell(
                shown(one.start),
                `start: ${name}`,
                (text) => (text || has("start") ? change(k, "start", text === "" ? "" : numeric(text)) : false),
                own && own.low === own.high ? typed(own.low) : "",
              ),
              cell(shown(one.bounds), `bounds: ${name}`, (text) =>
                text || has("bounds") ? change(k, "bounds", text === "" ? "" : boundsWritten(text)) : false,
              ),
              cell(prior, `prior: ${name}`, (text) => {
                if (!text) {
                  return has("prior") ? change(k, "prior", "") : false;
                }
                return change(k, "prior", priorWritten(text));
              }),
              flag("fixed"),
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
          }),
        )
      : h("p", {class: "muted"}, "None yet."),
    h(
      "p",
      {class: "note"},
      "A prior is written mean ± std, as in 6.5 ± 0.5 or 6.5 ± 10 %; bounds as low, high. Fields, ties and what varies from record to record are written in the study file.",
    ),
  );
}

function fresh(app, told, changed) {
  const sets = told.sets.filter((one) => one.properties.length),
    names = h(
      "select",
      {
        id: "set",
        "data-kept": true,
        multiple: true,
        size: Math.min(6, Math.max(2, sets.length)),
        onchange: () => draw_(),
      },
      options(
        sets.map((one) => [one.name, `${one.name} (${one.count} × ${one.type})`]),
        sets[0]?.name,
      ),
    );
  const property = h("select", {id: "property", "data-kept": true}),
    each = h("input", {type: "checkbox", id: "each", "data-kept": true});
  const draw_ = () => {
    const chosen = [...names.selectedOptions].map((one) => sets.find((set) => set.name === one.value)),
      common = (chosen[0]?.properties || []).filter((p) =>
        chosen.every((set) => set.properties.some((other) => other.name === p.name)),
      ),
      before = property.value;
    fill(
      property,
      options(
        common.map((p) => [
          p.name,
          `${p.name}, nominal ${p.low === p.high ? quantity(p.low, p.unit) : "from " + quantity(p.low, p.unit)}`,
        ]),
        before,
      ),
    );
  };
  draw_();
  const button = h(
    "button",
    {
      class: "main",
      type: "button",
      disabled: !app.folder.writable,
      onclick: () =>
        app.doing(button, async () => {
          const chosen = [...names.selectedOptions].map((one) => one.value);
          if (!chosen.length || !property.value) {
            throw new Error("Choose an element set and a property");
          }
          const entry = {
            property: JSON.stringify(property.value),
            elements: chosen.length === 1 ? JSON.stringify(chosen[0]) : toml(chosen),
          };
          if (each.checked) {
            entry.each = "true";
          }
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
      button,
    ),
  );
}

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
    h("p", {class: "note"}, "Which places tell most of these unknowns, before any test (docs/plan.md)."),
    h("div", {class: "row end"}, field("Sensors", count, "short"), button),
    result,
  );
}
