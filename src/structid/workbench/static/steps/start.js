// The folder: its studies, new ones from templates, and files that are dropped.
import {get, post, put, view} from "../api.js";
import {bytes, field, fill, h, marked, number, numberIn, options, table, unitText, withUnit} from "../dom.js";
import {besideStudy, givenOptions, readingFields, recordEdits, records} from "../recorded.js";
import {forgetTyped} from "../typed.js";

export async function show(box, app) {
  await app.reload();
  document.getElementById("study").value = app.study;
  const {writable} = app.folder,
    made = await fresh(app),
    list = h("section", {class: "card"});
  const draw = ({studies}) => fill(list, h("h2", {}, "Studies in this folder"), studyList(studies));
  draw(app.folder);
  app.heard.add(({folder}) => {
    if (folder) {
      draw(folder);
    }
  });
  fill(
    box,
    h("h1", {}, "Start"),
    writable
      ? null
      : h("div", {class: "card doubt"}, "This folder cannot be written: studies can be looked at, not changed or run."),
    app.folder.most
      ? h(
          "div",
          {class: "card doubt"},
          `This folder holds more files than the first ${app.folder.most}, which are looked at: open a folder further in, below.`,
        )
      : null,
    h("div", {class: "columns"}, h("div", {}, list, another(app)), made.box),
    drop(app),
    files(app, made.from),
  );
}

// Links to the studies of the folder.
const studyList = (studies) =>
  studies.length
    ? h(
        "ul",
        {class: "plain"},
        studies.map((one) =>
          h(
            "li",
            {},
            h("a", {href: `#${one.broken ? "text" : "structure"}/${encodeURIComponent(one.path)}`}, one.title),
            " ",
            h("span", {class: "muted"}, one.path),
            one.broken ? h("div", {class: "state bad"}, "broken: shown at its line") : null,
          ),
        ),
      )
    : h("p", {class: "muted"}, "None yet: make one from a template, or copy one into the folder.");

// Records and models of the folder; `from` begins a study on a model.
function files(app, from) {
  const {records, models, writable} = app.folder;
  const modelButton = ({path}) =>
    h(
      "button",
      {
        class: "small",
        type: "button",
        disabled: !writable,
        "aria-label": `New study from it: ${path}`,
        onclick: () => from(path),
      },
      "New study from it",
    );
  return h(
    "section",
    {class: "card"},
    h("h2", {}, "Records and models"),
    records.length + models.length
      ? h(
          "ul",
          {class: "plain"},
          records.map((one) => row(one, lookButton(app, one))),
          models.map((one) => row(one, modelButton(one))),
        )
      : h("p", {class: "muted"}, "None yet."),
    unusable(app.folder.unusable),
  );
}

// Files that are there and cannot be used, each with the reason.
function unusable(files) {
  return files.length
    ? h(
        "details",
        {id: "unusable"},
        h("summary", {}, `${files.length} ${files.length === 1 ? "file" : "files"} that cannot be used`),
        h(
          "ul",
          {class: "plain"},
          files.map((one) => h("li", {}, h("strong", {}, one.path), " ", h("span", {class: "muted"}, one.words))),
        ),
      )
    : null;
}

function row(one, button) {
  return h(
    "li",
    {"data-record": one.path},
    h("div", {class: "row"}, h("strong", {}, one.path), h("span", {class: "muted"}, bytes(one.bytes)), button),
    h("div"),
  );
}

function lookButton(app, one) {
  const button = h(
    "button",
    {
      class: "small",
      type: "button",
      "aria-label": `What is it? ${one.path}`,
      onclick: () => app.doing(button, () => understood(app, one.path, button.closest("li").lastChild)),
    },
    "What is it?",
  );
  return button;
}

// Another folder of this machine: one that was open before, or a path that is typed. It has an address of its own; this page stays as it is where it was.
function another(app) {
  const path = h("input", {id: "folder-path", spellcheck: "false", autocomplete: "off", placeholder: "~/measurements"});
  const open = (button, folder) =>
    app.doing(button, async () => {
      location.assign(view((await post("open", {folder})).address));
    });
  const go = h("button", {type: "submit"}, "Open");
  const {recent} = app.folder;
  return h(
    "section",
    {class: "card", id: "another"},
    h("h2", {}, "Another folder"),
    h(
      "form",
      {
        onsubmit: (event) => {
          event.preventDefault();
          open(go, path.value);
        },
      },
      h("div", {class: "row end"}, field("Path of a folder on this machine", path, "wide-field"), go),
    ),
    recent.length
      ? h(
          "details",
          {id: "recent"},
          h("summary", {}, `Recent folders (${recent.length})`),
          h(
            "ul",
            {class: "plain"},
            recent.map((folder) => {
              const button = h(
                "button",
                {class: "link", type: "button", "aria-label": `Open ${folder}`, onclick: () => open(button, folder)},
                folder.split(/[\\/]/).at(-1),
              );
              return h("li", {}, button, h("div", {class: "muted"}, folder));
            }),
          ),
        )
      : null,
  );
}

// What a study begins with that is built node by node, by the directions in which it moves.
const BUILT = {
  name: "build",
  words: "Nodes, beams, bars and masses of your own, in tables beside a picture",
  asks: [
    {
      name: "moves",
      words: "it lies and moves",
      unit: "",
      default: "in a plane (X, Y)",
      choices: ["in a plane (X, Y)", "in space (X, Y, Z)", "on a line (X), bending in Y"],
    },
  ],
};
const ACTIVE = [
  ["X", "Y", "RZ"],
  ["X", "Y", "Z", "RX", "RY", "RZ"],
  ["Y", "RZ"],
];
const titleOf = (path) => {
  const words = path
    .split("/")
    .at(-1)
    .replace(/\.toml$/i, "")
    .replace(/[_-]+/g, " ")
    .trim();
  return words.charAt(0).toUpperCase() + words.slice(1);
};
const builtText = (path, moves) =>
  `title = ${JSON.stringify(titleOf(path))}\n\n[structure]\nactive = [${ACTIVE[BUILT.asks[0].choices.indexOf(moves)].map((one) => `"${one}"`).join(", ")}]\n\n[structure.nodes]  # m\n`;

const MESH = /\.(msh|bdf|nas|fem|dat|inp|vtu|vtk)$/i;

// New studies by a template; `from` begins one on a mesh or a matrix of the folder.
async function fresh(app) {
  const templates = [...(await get("templates")), BUILT];
  const form = {
    app,
    templates,
    inputs: h("div", {class: "fields"}),
    words: h("p", {class: "note"}),
    meshWords: h("p", {class: "note", "aria-live": "polite"}),
    name: h("input", {name: "path", required: true, spellcheck: "false"}),
    files: h("datalist", {id: "input-files"}),
    groups: h("datalist", {id: "mesh-groups"}),
    kind: h(
      "select",
      {name: "template", onchange: () => drawTemplate(form)},
      options(templates.map((one) => (one === BUILT ? [one.name, "build it yourself"] : one.name))),
    ),
  };
  drawTemplate(form);
  const make = h("button", {class: "main", type: "submit", disabled: !app.folder.writable}, "Make the study");
  const box = h(
    "section",
    {class: "card", id: "new-study"},
    h("h2", {}, "New study"),
    h(
      "form",
      {
        onsubmit: (event) => {
          event.preventDefault();
          makeStudy(form, make);
        },
      },
      h("div", {class: "row"}, field("Template", form.kind), field("File", form.name)),
      form.words,
      form.inputs,
      form.meshWords,
      form.files,
      form.groups,
      make,
    ),
  );
  return {box, from: (path) => beginFrom(form, box, path)};
}

const inputOf = (form, name) => form.inputs.querySelector(`[name=${name}]`);

// Fields of the chosen template, with their defaults or the values `given` by name; `given.name` is that of the file without suffix.
function drawTemplate(form, given = {}) {
  const {app} = form,
    template = form.templates.find((one) => one.name === form.kind.value),
    isMesh = template.name === "mesh";
  fill(form.words, template.words);
  fill(form.meshWords);
  form.inputs.dataset.typed = template.name;
  fill(
    form.files,
    [...app.folder.models, ...app.folder.records.filter((one) => /\.(npz|mat)$/i.test(one.path))]
      .filter((one) => MESH.test(one.path) === isMesh)
      .map((one) => h("option", {value: one.path})),
  );
  fill(form.groups);
  fill(
    form.inputs,
    template.asks.map((ask) =>
      templateField(ask, given[ask.name] ?? ask.default, isMesh ? () => lookAtMesh(form) : null),
    ),
  );
  const stem = given.name || (template === BUILT ? "structure" : template.name);
  form.name.value = freeName(
    stem,
    app.folder.studies.map((one) => one.path),
  );
}

// The field of one question of a template; `look` is called when path or unit of a mesh change, and null for other templates.
function templateField(ask, value, look) {
  const label = withUnit(ask.words, ask.unit);
  if (ask.choices.length) {
    return field(label, h("select", {name: ask.name, onchange: look}, options(ask.choices, value)));
  }
  const list = ask.words.startsWith("file of") ? "input-files" : look && ask.name === "held" ? "mesh-groups" : null;
  return field(
    label,
    h("input", {
      name: ask.name,
      value: String(value),
      inputmode: typeof ask.default === "number" ? "decimal" : null,
      list,
      onchange: ask.name === "path" ? look : null,
    }),
  );
}

// A name of a study file that is not taken: the stem, or the stem with a number.
function freeName(stem, taken) {
  let name = `${stem}.toml`;
  for (let count = 2; taken.includes(name); count++) {
    name = `${stem}_${count}.toml`;
  }
  return name;
}

// Says what the mesh holds, in the unit that is chosen, and offers its groups.
async function lookAtMesh(form) {
  try {
    const folder = form.name.value.slice(0, form.name.value.lastIndexOf("/") + 1),
      mesh = await post("mesh", {
        path: folder + inputOf(form, "path").value,
        length_unit: inputOf(form, "length_unit").value,
      });
    fill(
      form.groups,
      ["none", ...mesh.groups].map((group) => h("option", {value: group})),
    );
    fill(
      form.meshWords,
      `${mesh.nodes} nodes; ${mesh.cells.map(([cell, count]) => `${count} × ${cell}`).join(", ")}. It measures ${mesh.size.map((x) => number(x, 3)).join(" × ")} m with this unit. Groups: ${mesh.groups.join(", ") || "none"}.`,
    );
  } catch (error) {
    fill(form.meshWords, error.message);
  }
}

// A new study on the mesh or matrix at `path`, in the folder of that file.
function beginFrom(form, box, path) {
  const isMesh = MESH.test(path),
    folder = path.slice(0, path.lastIndexOf("/") + 1),
    stem = path.slice(folder.length).replace(/\.[^.]*$/, "");
  form.kind.value = isMesh ? "mesh" : "own-matrices";
  drawTemplate(form, {name: folder + stem, ...(isMesh ? {path} : {mass: path, stiffness: path})});
  if (folder) {
    form.app.say("The new study lies beside the file; its inputs are named from there.");
    for (const input of form.inputs.querySelectorAll("[list=input-files]")) {
      input.value = input.value.startsWith(folder) ? input.value.slice(folder.length) : input.value;
    }
  }
  if (isMesh) {
    lookAtMesh(form);
  }
  box.scrollIntoView({block: "nearest"});
  (inputOf(form, "held") || inputOf(form, "mass")).focus();
}

// Writes the study and opens it: in the step Build if it is built by hand, in the step Structure otherwise.
function makeStudy(form, button) {
  const {app, kind, name} = form;
  const values = Object.fromEntries(
    [...form.inputs.querySelectorAll("input, select")].map((input) => [input.name, input.value]),
  );
  app.doing(button, async () => {
    const isBuilt = kind.value === BUILT.name;
    let path;
    if (isBuilt) {
      path = /\.toml$/i.test(name.value) ? name.value : `${name.value}.toml`;
      await post("study", {study: path, text: builtText(path, values.moves), digest: ""});
    } else {
      ({path} = await post("init", {template: kind.value, path: name.value, numbers: values}));
    }
    forgetTyped(button);
    await app.reload();
    app.go(isBuilt ? "build" : "structure", path);
  });
}

function drop(app) {
  const input = h("input", {type: "file", multiple: true, id: "files", onchange: () => take(input.files)});
  const place = h(
    "div",
    {
      class: "drop card",
      ondragover: (event) => {
        event.preventDefault();
        place.classList.add("over");
      },
      ondragleave: () => place.classList.remove("over"),
      ondrop: (event) => {
        event.preventDefault();
        place.classList.remove("over");
        take(event.dataTransfer.files);
      },
    },
    h(
      "p",
      {},
      "Drop records, meshes, matrices or studies here, or ",
      h("label", {for: "files"}, "choose files: "),
      input,
    ),
    h(
      "p",
      {class: "note"},
      "They are copied into the folder. Records and modes: CSV, UFF, MAT, HDF5, NPZ and files of loggers. Models: meshes of Gmsh, Nastran, Abaqus or VTK, and matrices.",
    ),
  );
  const take = async (files) => {
    for (const file of files) {
      try {
        const {path} = await put(file.name, file);
        app.say(`${path}: copied into the folder`);
        await app.reload();
        if (app.step === "start") {
          await show(document.querySelector("[data-step=start]"), app);
          const line = document.querySelector(`[data-record="${CSS.escape(path)}"]`);
          if (line) {
            line.querySelector("button")?.click();
            line.scrollIntoView({block: "nearest"});
          }
        }
      } catch (error) {
        app.fail(error);
      }
    }
  };
  return place;
}

const written = (value) => (Array.isArray(value) ? `[${value.map(written).join(", ")}]` : JSON.stringify(value));

// Words of an error on a file, where fields below ask for what the study or the command line would say.
const saidHere = (words) =>
  words
    .replaceAll(" in [record.csv]", "")
    .replace(/ in the study, beside `path`, or in ReadOptions \(--.*? on the command line\)/g, " below");

// What the reader has said of files, by path, as long as no study says it: a file is often looked at before there is one.
const saidOf = new Map();

export async function understood(app, path, place, own = null) {
  if (own) {
    saidOf.set(path, own);
  }
  const ofStudy = givenOptions(app, path),
    given = own || (Object.keys(ofStudy).length ? ofStudy : saidOf.get(path) || {});
  let found = null,
    failed = "";
  try {
    found = await post("facts", {record: path, options: given});
  } catch (error) {
    failed = error.message;
  }
  const fields = readingFields(app, path, given, failed);
  const again = h("button", {type: "submit"}, "Read it so");
  const mapping = h(
    "form",
    {
      onsubmit: (event) => {
        event.preventDefault();
        app.doing(again, async () => {
          const said = fields.options();
          forgetTyped(again); // it stands in the fields again, where the file does not contradict it
          await understood(app, path, place, said);
        });
      },
    },
    fields.box,
    again,
  );
  const seen = /\.(csv|txt|tsv)$/i.test(path) ? preview(path, mapping, given.csv ?? {}) : null;
  fill(
    place,
    failed ? h("div", {class: "card doubt"}, h("p", {}, marked(saidHere(failed)))) : facts(found),
    h("details", {open: Boolean(failed)}, h("summary", {}, "What the file does not say about itself"), seen, mapping),
    found && app.study
      ? use(app, path, found, given)
      : found
        ? h("p", {class: "note"}, "Open a study above to use this record in it.")
        : null,
  );
  if (failed) {
    fields.asked?.focus();
  }
}

const SEPARATORS = {comma: ",", semicolon: ";", tab: "\t", space: /\s+/};

// The first lines of a table as the layout in `form` takes them apart: lines left out are struck through, headers are bold.
function preview(path, form, given) {
  const place = h("div", {class: "preview", "aria-live": "polite"});
  let lines = [],
    encoding = null;
  const said = (name) => form.querySelector(`[name=${name}]`)?.value.trim() ?? given[name] ?? "";
  const read = async () => {
    const wanted = said("encoding");
    if (wanted !== encoding) {
      encoding = wanted;
      lines = [];
      try {
        const answer = await post("lines", {record: path, encoding: wanted});
        if (wanted !== encoding) {
          return;
        }
        ({lines} = answer);
      } catch (error) {
        if (wanted === encoding) {
          fill(place, h("p", {class: "wrong"}, error.message));
        }
        return;
      }
    }
    if (lines.length) {
      fill(place, linesTable(path, lines, said));
    }
  };
  for (const kind of ["input", "change"]) {
    form.addEventListener(kind, read);
  }
  read();
  return place;
}

// Lines in their columns, eight at most; `said` gives what a field of the layout says, by its name.
function linesTable(path, lines, said) {
  const separator =
    SEPARATORS[said("separator")] ?? ["\t", ";", ","].find((sign) => lines.at(-1)?.includes(sign)) ?? /\s+/;
  const skip = Number(said("skip_rows")) || 0,
    headers = said("header_rows") === "" ? 1 : Number(said("header_rows")) || 0;
  const rows = lines.map((line, k) => {
    const parts = line.split(separator),
      kind = k < skip ? "skipped" : k < skip + headers ? "header" : null,
      words = kind === "skipped" ? " left out" : kind === "header" ? " header" : "";
    return h(
      "tr",
      {class: kind},
      h("th", {scope: "row"}, `${k + 1}${words}`),
      parts.slice(0, 8).map((part) => h("td", {}, part)),
      parts.length > 8 ? h("td", {}, "…") : null,
    );
  });
  return h(
    "div",
    {class: "wide", tabindex: 0, role: "group", "aria-label": `First lines of ${path}`},
    h(
      "table",
      {},
      h("caption", {class: "note"}, "Its first lines, as this layout takes them apart"),
      h("tbody", {}, rows),
    ),
  );
}

const counted = (channels) => (channels.length === 1 ? "1 channel" : `${channels.length} channels`);

export function facts(found) {
  if (found.kind === "modes") {
    return h(
      "div",
      {},
      h(
        "p",
        {},
        `a table of ${found.modes.length} modes, ${number(found.modes[0][0])} to ${number(found.modes.at(-1)[0])} Hz: a study reads it with [record.modes]`,
      ),
      h(
        "details",
        {},
        h("summary", {}, counted(found.channels)),
        h("p", {}, found.channels.map((one) => one.name).join(", ")),
      ),
    );
  }
  const size =
    found.kind === "time histories"
      ? `time histories: ${found.samples} samples at ${number(found.rate)} Hz, ${number(found.seconds)} s`
      : `${found.kind}s in ${unitText(found.unit)}: ${found.lines} lines, ${number(found.band[0])} to ${number(found.band[1])} Hz, ${found.coherence ? "with" : "without"} coherence`;
  const many = found.channels.length > 12;
  return h(
    "div",
    {},
    h("p", {}, size),
    found.read ? h("p", {class: "note"}, `Read as: ${found.read}`) : null,
    found.channels.length <= 60
      ? h(
          "details",
          {open: !many},
          h("summary", {}, counted(found.channels)),
          found.kind === "time histories"
            ? table(
                ["channel", "", "quantity", "unit"],
                found.channels.map((one) => [one.name, one.role, one.quantity, unitText(one.unit)]),
              )
            : table(
                ["channel", ""],
                found.channels.map((one) => [one.name, one.role]),
              ),
        )
      : h("p", {}, `${found.channels.length} channels`),
    found.findings.length
      ? h(
          "ul",
          {class: "warnings"},
          found.findings.map((one) => h("li", {}, one.words)),
        )
      : found.kind === "time histories"
        ? h("p", {class: "note"}, "No fault of the signals was found.")
        : null,
  );
}

// Values as texts of TOML, by key.
const writtenKeys = (values) => Object.fromEntries(Object.entries(values).map(([key, value]) => [key, written(value)]));

// Buttons that make a file the record of the open study, or one more of its records; `found` are its facts, `given` how it is read.
export function use(app, path, found, given) {
  const folder = besideStudy(app);
  if (!path.startsWith(folder)) {
    return h("p", {class: "note"}, "The study lies in another folder than this record.");
  }
  const name = path.slice(folder.length);
  const segment = h("input", {value: String(found.segment || 1024), name: "segment_length", inputmode: "numeric"});
  const averages = h("input", {value: "", name: "averages", inputmode: "numeric", placeholder: "10"});
  const isTime = found.kind === "time histories",
    asksAverages = Boolean(found.coherence) && !found.averages;
  const {csv, ...plain} = given;
  const edits = () =>
    recordEdits(
      app,
      {
        path: JSON.stringify(name),
        ...writtenKeys(plain),
        ...(asksAverages && averages.value.trim()
          ? {averages: String(Math.round(numberIn(averages, {least: 2})))}
          : {}),
      },
      {
        ...(csv ? {csv: writtenKeys(csv)} : {}),
        ...(isTime ? {frf: {segment_length: String(Math.round(numberIn(segment, {least: 2})))}} : {}),
        ...(found.kind === "modes" ? {modes: {form: '"output"'}} : {}),
      },
    );
  const made = (which, words, told) => {
    const button = h(
      "button",
      {
        class: which === "instead" ? "main" : "",
        type: "button",
        disabled: !app.folder.writable,
        onclick: () =>
          app.doing(button, async () => {
            await app.edit(edits()[which], told);
            app.record = Infinity;
            app.go("structure");
          }),
      },
      words,
    );
    return button;
  };
  const n = records(app).length;
  return h(
    "div",
    {class: "row end"},
    isTime ? field("FRFs are averaged over segments of so many samples", segment) : null,
    asksAverages ? field("averages of each FRF, which with the coherence say the noise", averages) : null,
    made(
      "instead",
      n > 1
        ? `Use in ${app.study} in place of record ${app.record + 1}`
        : n
          ? `Use in ${app.study} in place of its record`
          : `Use in ${app.study}`,
      n > 1 ? `${name} is a record of ${app.study} now` : `${name} is now the record of ${app.study}`,
    ),
    n
      ? made(
          "beside",
          n > 1 ? `Use beside its ${n} records` : "Use beside its record",
          `${name} is another record of ${app.study} now`,
        )
      : null,
  );
}
