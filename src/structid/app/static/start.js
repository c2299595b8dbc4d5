// The folder: its studies, new ones from templates, and files that are dropped.
import {get, post, put} from "./api.js";
import {bytes, field, fill, h, number, options, table} from "./dom.js";
import {besideStudy, givenOptions, LISTS, MAPPING, recordEdits, records} from "./recorded.js";

export async function show(box, app) {
  await app.reload();
  document.getElementById("study").value = app.study;
  const {studies, records, models, writable} = app.folder;
  fill(box, h("h1", {}, "Start"),
    writable ? null : h("div", {class: "card doubt"}, "This folder cannot be written: studies can be looked at, not changed or run."),
    h("div", {class: "columns"},
      h("section", {class: "card"}, h("h2", {}, "Studies in this folder"),
        studies.length ? h("ul", {class: "plain"}, studies.map((one) => h("li", {},
          h("a", {href: `#${one.broken ? "text" : "structure"}/${encodeURIComponent(one.path)}`}, one.title), " ",
          h("span", {class: "muted"}, one.path), one.broken ? h("div", {class: "state bad"}, "broken: shown at its line") : null)))
          : h("p", {class: "muted"}, "None yet: make one from a template, or copy one into the folder.")),
      await fresh(app)),
    drop(app),
    h("section", {class: "card"}, h("h2", {}, "Records and models"),
      records.length + models.length ? h("ul", {class: "plain"}, [...records, ...models].map((one) => row(app, one, records.includes(one))))
        : h("p", {class: "muted"}, "None yet.")));
}

function row(app, one, isRecord) {
  const place = h("div");
  const button = h("button", {class: "small", type: "button", onclick: () => app.doing(button, () => understood(app, one.path, place))}, "What is it?");
  return h("li", {"data-record": one.path}, h("div", {class: "row"}, h("strong", {}, one.path), h("span", {class: "muted"}, bytes(one.bytes)), isRecord ? button : null), place);
}

async function fresh(app) {
  const templates = await get("templates"), inputs = h("div", {class: "fields"}), words = h("p", {class: "note"});
  const name = h("input", {name: "path", required: true, spellcheck: "false"});
  const kind = h("select", {name: "template", onchange: () => draw()}, options(templates.map((one) => one.name)));
  const draw = () => {
    const one = templates.find((each) => each.name === kind.value);
    fill(words, one.words);
    fill(inputs, one.asks.map((ask) => field(`${ask.words}${ask.unit ? ", " + ask.unit.replace("^2", "²").replace("^3", "³") : ""}`, h("input", {name: ask.name, value: String(ask.default), inputmode: typeof ask.default === "number" ? "decimal" : null}))));
    const taken = app.folder.studies.map((each) => each.path);
    let count = 1, wanted = `${one.name}.toml`;
    while (taken.includes(wanted)) { count += 1; wanted = `${one.name}_${count}.toml`; }
    name.value = wanted;
  };
  draw();
  const button = h("button", {class: "main", type: "submit", disabled: !app.folder.writable}, "Make the study");
  const form = h("form", {onsubmit: (event) => {
    event.preventDefault();
    const numbers = Object.fromEntries([...inputs.querySelectorAll("input")].map((input) => [input.name, input.value]));
    app.doing(button, async () => {
      const {path} = await post("init", {template: kind.value, path: name.value, numbers});
      await app.reload();
      app.go("structure", path);
    });
  }}, h("div", {class: "row"}, field("Template", kind), field("File", name)), words, inputs, button);
  return h("section", {class: "card"}, h("h2", {}, "New study"), form);
}

function drop(app) {
  const input = h("input", {type: "file", multiple: true, id: "files", onchange: () => take(input.files)});
  const place = h("div", {class: "drop card", ondragover: (event) => { event.preventDefault(); place.classList.add("over"); },
    ondragleave: () => place.classList.remove("over"),
    ondrop: (event) => { event.preventDefault(); place.classList.remove("over"); take(event.dataTransfer.files); }},
  h("p", {}, "Drop records, meshes, matrices or studies here, or ", h("label", {for: "files"}, "choose files: "), input),
  h("p", {class: "note"}, "They are copied into the folder. NPZ, NPY, HDF5, CSV, MAT, UFF; meshes and matrices as docs/meshes.md and docs/import-models.md name them."));
  const take = async (files) => {
    for (const file of files) {
      try {
        const {path} = await put(file.name, file);
        app.say(`${path}: copied into the folder`);
        await app.reload();
        if (app.step === "start") {
          await show(document.querySelector("[data-step=start]"), app);
          const line = document.querySelector(`[data-record="${CSS.escape(path)}"]`);
          if (line) { line.querySelector("button")?.click(); line.scrollIntoView({block: "nearest"}); }
        }
      } catch (error) { app.fail(error); }
    }
  };
  return place;
}

const written = (value) => (Array.isArray(value) ? `[${value.map(written).join(", ")}]` : JSON.stringify(value));

export async function understood(app, path, place, own = null) {
  const given = own || givenOptions(app, path);
  let found = null, failed = "";
  try { found = await post("facts", {record: path, options: given}); } catch (error) { failed = error.message; }
  const inputs = MAPPING.map(([name, words]) => field(words, h("input", {name, value: [given[name] ?? ""].flat().join(", "), spellcheck: "false"})));
  const again = h("button", {type: "submit"}, "Read it so");
  const mapping = h("form", {onsubmit: (event) => {
    event.preventDefault();
    const next = Object.fromEntries([...new FormData(event.target)].filter(([, value]) => value.trim()).map(([key, value]) =>
      [key, LISTS.includes(key) ? value.split(",").map((part) => part.trim()) : key === "sampling_rate" ? Number(value) : value.trim()]));
    app.doing(again, () => understood(app, path, place, next));
  }}, h("div", {class: "fields"}, inputs), again);
  fill(place, failed ? h("div", {class: "card doubt"}, h("p", {}, failed)) : facts(found),
    h("details", {open: Boolean(failed)}, h("summary", {}, "What the file does not say about itself"), mapping),
    found && app.study ? use(app, path, found, given) : found ? h("p", {class: "note"}, "Open a study above to use this record in it.") : null);
}

export function facts(found) {
  const size = found.kind === "time histories" ? `time histories: ${found.samples} samples at ${number(found.rate)} Hz, ${number(found.seconds)} s`
    : found.kind === "modes" ? `${found.modes.length} modes, ${number(found.modes[0][0])} to ${number(found.modes.at(-1)[0])} Hz`
      : `${found.kind}s in ${found.unit}: ${found.lines} lines, ${number(found.band[0])} to ${number(found.band[1])} Hz, ${found.coherence ? "with" : "without"} coherence`;
  const many = found.channels.length > 12;
  return h("div", {}, h("p", {}, size), found.channels.length <= 60 ? h("details", {open: !many}, h("summary", {}, `${found.channels.length} channels`),
    table(["channel", "", "quantity", "unit"], found.channels.map((one) => [one.name, one.role, one.quantity || found.kind, one.unit || found.unit || ""]))) : h("p", {}, `${found.channels.length} channels`),
  found.findings.length ? h("ul", {class: "warnings"}, found.findings.map((one) => h("li", {}, one.words))) : found.kind === "time histories" ? h("p", {class: "note"}, "No fault of the signals was found.") : null);
}

export function use(app, path, found, given) {
  const folder = besideStudy(app);
  if (!path.startsWith(folder)) { return h("p", {class: "note"}, "The study lies in another folder than this record."); }
  const name = path.slice(folder.length);
  const segment = h("input", {value: String(found.segment || 1024), name: "segment_length", inputmode: "numeric"});
  const isTime = found.kind === "time histories";
  const edits = () => {
    const keys = {path: JSON.stringify(name), ...Object.fromEntries(Object.entries(given).filter(([key]) => key !== "csv").map(([key, value]) => [key, written(value)]))}, tables = {};
    if (given.csv) { tables.csv = Object.fromEntries(Object.entries(given.csv).map(([key, value]) => [key, written(value)])); }
    if (isTime) { tables.frf = {segment_length: String(Math.round(Number(segment.value)))}; }
    if (found.kind === "modes") { tables.modes = {form: '"output"'}; }
    return recordEdits(app, keys, tables);
  };
  const made = (which, words, told) => { const button = h("button", {class: which === "instead" ? "main" : "", type: "button", disabled: !app.folder.writable, onclick: () => app.doing(button, async () => {
    if (await app.edit(edits()[which], told)) { app.record = Infinity; app.go("structure"); }
  })}, words); return button; };
  const n = records(app).length;
  return h("div", {class: "row end"}, isTime ? field("FRFs are averaged over segments of so many samples", segment) : null,
    made("instead", n > 1 ? `Use in ${app.study} in place of record ${app.record + 1}` : n ? `Use in ${app.study} in place of its record` : `Use in ${app.study}`, n > 1 ? `${name} is a record of ${app.study} now` : `${name} is now the record of ${app.study}`),
    n ? made("beside", n > 1 ? `Use beside its ${n} records` : "Use beside its record", `${name} is another record of ${app.study} now`) : null);
}
