// The records of a study: where they stand in its file, and the edits that add one, take its place or take it out.
import {field, h, numberIn, options} from "./dom.js";

export const records = (app) => [app.now?.table?.record ?? []].flat();
export const recordPath = (app) => (Array.isArray(app.now.table.record) ? ["record", app.record] : ["record"]);
export const besideStudy = (app) => (app.study.includes("/") ? app.study.slice(0, app.study.lastIndexOf("/") + 1) : "");
// By slashes from the folder that is open; suggested studies name their records by "../..".
export function fileOf(app, record) {
  const parts = [];
  for (const part of (besideStudy(app) + [record.path, ...(record.repeats || [])].filter(Boolean)[0]).split("/")) {
    if (part === ".." && parts.length) {
      parts.pop();
    } else if (part !== ".") {
      parts.push(part);
    }
  }
  return parts.join("/");
}

// What the results of a study are called before a suffix: those of a suggested one lie beside the results that it came from.
export const resultsName = (study) => study.replace(/\.toml$/, "").replace(/\/suggestions\/(?=[^/]*$)/, "_");

// All results of the folder, the newest first, and those that are shown to begin with: of this study, where it has some.
export function resultPaths(app) {
  const all = app.folder.results.sort((a, b) => b.changed - a.changed).map((one) => one.path),
    own = resultsName(app.study);
  return {all, first: all.find((path) => own && path.startsWith(own)) || all[0]};
}

// What the study says of the same file.
export function givenOptions(app, path) {
  const record = records(app).find((one) => fileOf(app, one) === path);
  return Object.fromEntries(
    Object.entries(record || {}).filter(([key]) => app.folder.reading.some((one) => key === (one.within || one.name))),
  );
}

// Keys whose value the file itself determines where words propose one; all others are the reader's to answer.
const DETERMINED = ["skip_rows", "footer_rows", "longest_gap", "encoding"];

// Fields with the words on each below it.
const described = (rows) =>
  h(
    "div",
    {class: "fields reading"},
    rows.map((one) => {
      const place = field(one.name.replaceAll("_", " "), one.input),
        id = `${one.input.id}-words`;
      one.input.setAttribute("aria-describedby", id);
      place.append(h("span", {class: "note", id}, one.words));
      return place;
    }),
  );

// Options that the fields state, by name, those of a table within another in a mapping of their own; defaults are left out.
function statedOptions(rows) {
  const stated = {};
  for (const {input, name, within, ...one} of rows) {
    const text = input.value.trim();
    if (!text || text === String(one.default)) {
      continue;
    }
    const place = within ? (stated[within] = stated[within] || {}) : stated;
    place[name] = one.is_number ? numberIn(input) : one.is_list ? text.split(",").map((part) => part.trim()) : text;
  }
  return stated;
}

// Fields for what a file does not say about itself, with what is `given`; `options()` is what they say. Those that the words `failed` name come first:
// filled where the file determines the value that the words propose; `asked` is the first that the reader is to answer.
export function readingFields(app, path, given, failed = "") {
  const isTable = /\.(csv|txt|tsv)$/i.test(path);
  const all = app.folder.reading,
    layout = all.filter((one) => one.within === "csv"),
    rest = all.filter((one) => !one.within);
  const proposed = Object.fromEntries(
    [...failed.matchAll(/`([a-z_]+) = "?([^`"]+)"?`/g)]
      .map(([, name, value]) => [name, value])
      .filter(([name]) => DETERMINED.includes(name)),
  );
  // Names of a table that the words list by what they are of: their fields ask for what these are.
  const listed = Object.fromEntries(
    [...failed.matchAll(/\b(outputs|inputs): ([^;()]+)/g)].map((match) => match.slice(1)),
  );
  const rows = (isTable ? [...layout, ...rest] : rest).map((one) => {
    const stated = one.within ? given[one.within]?.[one.name] : given[one.name],
      value = [proposed[one.name] ?? stated ?? ""].flat().join(", "),
      name = one.name;
    return {
      ...one,
      words: listed[name] ? `What ${listed[name]} are, in this order, as in 12Z+.` : one.words,
      input: one.choices.length
        ? h("select", {name}, options(one.choices, value || one.default))
        : h("input", {
            name,
            value,
            placeholder: String(one.default),
            inputmode: one.is_number ? "decimal" : null,
            spellcheck: "false",
          }),
    };
  });
  const named = [...failed.matchAll(/`([a-z_]+)/g)].map((match) => match[1]);
  const first = rows
    .filter((one) => (one.input.value !== String(one.default) && one.input.value) || named.includes(one.name))
    .sort((a, b) => (named.indexOf(a.name) + 1 || 99) - (named.indexOf(b.name) + 1 || 99));
  const filled = first.filter((one) => one.name in proposed).map((one) => one.name.replaceAll("_", " "));
  const rest_ = rows.filter((one) => !first.includes(one));
  return {
    options: () => statedOptions(rows),
    asked: first.find((one) => named.includes(one.name) && !one.input.value)?.input,
    box: first.length
      ? h(
          "div",
          {},
          filled.length
            ? h(
                "p",
                {class: "note"},
                `Filled in as the message proposes: ${filled.join(", ")}. Look at the lines above, then read the file so.`,
              )
            : null,
          described(first),
          h("details", {}, h("summary", {}, `All else that may be said (${rest_.length})`), described(rest_)),
        )
      : described(rows),
  };
}

// Edits that make a record of `keys` and of `tables` in it: `instead` of the shown one, and `beside` those there are.
export function recordEdits(app, keys, tables = {}) {
  const n = records(app).length,
    several = Array.isArray(app.now?.table?.record);
  const within = (place) =>
    Object.entries(tables).flatMap(([name, own]) =>
      Object.entries(own).map(([key, to]) => ({set: [...place, name, key], to})),
    );
  const plain = [...Object.entries(keys).map(([key, to]) => ({set: ["record", key], to})), ...within(["record"])];
  const added = (count) => [{add: ["record"], table: keys}, ...within(["record", count])];
  if (!n) {
    return {instead: plain, beside: null};
  }
  if (several) {
    return {instead: [{remove: ["record", app.record]}, ...added(n - 1)], beside: added(n)};
  }
  return {instead: [{remove: ["record"]}, ...plain], beside: [{list: ["record"]}, ...added(1)]};
}

export const recordName = (record, k) =>
  `${k + 1}: ${record.name || [record.path, ...(record.repeats || [])].filter(Boolean).join(", ")}`;

// Which of several records is shown; nothing where there is one.
export function recordPicker(app) {
  const all = records(app);
  return all.length < 2
    ? null
    : h(
        "div",
        {class: "row"},
        field(
          "Record of the study",
          h(
            "select",
            {
              id: "shown-record",
              onchange: (event) => {
                app.record = Number(event.target.value);
                app.go(app.step);
              },
            },
            options(
              all.map((one, k) => [String(k), recordName(one, k)]),
              String(app.record),
            ),
          ),
        ),
      );
}
