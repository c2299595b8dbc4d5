// The study file itself, with what is wrong at its line; nothing typed is lost when it changes elsewhere.
import {get, post} from "../api.js";
import {fill, h} from "../dom.js";

const LINE_HEIGHT = 20; // px, as the style sheet has it

export async function show(box, app) {
  const {study} = app,
    draft = app.drafts.get(study);
  const editor = makeEditor(app, draft?.digest ?? app.now.digest);
  const {area, numbers, messages, save} = editor;
  app.heard.add(({changed}) => {
    if (changed && changed.digest !== editor.base) {
      if (app.drafts.has(study)) {
        showConflict(editor, changed);
      } else {
        takeFile(editor, changed);
      }
    }
  });
  fill(
    box,
    h("h1", {}, study),
    h("div", {class: "row"}, save, h("span", {class: "note"}, "All steps read and write this file. Ctrl-S saves it.")),
    messages,
    h("div", {class: "editor"}, numbers, area),
  );
  area.value = draft ? draft.text : app.now.text;
  box.addEventListener("keydown", (event) => {
    if ((event.ctrlKey || event.metaKey) && event.key === "s") {
      event.preventDefault();
      save.click();
    }
  });
  drawNumbers(editor);
  if (!draft) {
    await checkStudy(editor);
    return;
  }
  save.disabled = false;
  if (draft.digest === app.now.digest) {
    offerFile(editor, "What you typed is still here, and not saved yet.", app.now);
  } else {
    showConflict(editor, app.now);
  }
}

// Elements and state of the editor: `base` is the digest of the file that the typed text began from, `wrong` the number of a wrong line.
function makeEditor(app, base) {
  const editor = {
    app,
    study: app.study,
    base,
    wrong: 0,
    numbers: h("pre", {"aria-hidden": "true"}),
    messages: h("div", {"aria-live": "polite"}),
  };
  editor.area = h("textarea", {
    spellcheck: "false",
    autocapitalize: "off",
    wrap: "off",
    "aria-label": "Text of the study",
    oninput: () => {
      keepDraft(editor);
      editor.save.disabled = false;
      drawNumbers(editor);
    },
    onscroll: () => {
      editor.numbers.scrollTop = editor.area.scrollTop;
    },
  });
  editor.save = h(
    "button",
    {
      class: "main",
      type: "button",
      disabled: true,
      onclick: () =>
        app
          .doing(editor.save, () => saveStudy(editor))
          .then(() => {
            editor.save.disabled = !app.drafts.has(editor.study);
          }),
    },
    "Save",
  );
  return editor;
}

// What is typed is kept while other steps are shown.
function keepDraft({app, study, area, base}) {
  app.drafts.set(study, {text: area.value, digest: base});
}

// Line numbers beside the text, that of a wrong line in bold.
function drawNumbers({numbers, area, wrong}) {
  const count = area.value.split("\n").length;
  fill(
    numbers,
    Array.from({length: Math.min(count, 20000)}, (_, k) =>
      k + 1 === wrong ? h("b", {}, String(k + 1)) : `${k + 1}\n`,
    ),
  );
  numbers.scrollTop = area.scrollTop;
}

// Marks, shows and selects a wrong line.
function showWrongLine(editor, line, words) {
  const {area, messages} = editor,
    lines = area.value.split("\n");
  editor.wrong = line;
  drawNumbers(editor);
  fill(messages, h("div", {class: "card bad"}, `Line ${line}: ${words}`));
  area.scrollTop = Math.max(0, (line - 6) * LINE_HEIGHT);
  const start = lines.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
  area.setSelectionRange(start, start + (lines[line - 1] || "").length);
}

// Whether the saved study can be read; where not, the line that is wrong.
async function checkStudy(editor) {
  const {app, study, messages} = editor;
  editor.wrong = 0;
  fill(messages);
  if (app.now.broken) {
    showWrongLine(editor, app.now.broken.line, app.now.broken.words);
    return;
  }
  try {
    await get("line", {study});
    fill(messages, h("p", {class: "muted"}, "The study can be read."));
  } catch (error) {
    const named = /line (\d+)(?:, column \d+)?: ([\s\S]*)/.exec(error.message);
    if (named) {
      showWrongLine(editor, Number(named[1]), named[2]);
    } else {
      fill(messages, h("div", {class: "card bad"}, error.message));
    }
  }
  drawNumbers(editor);
}

// Writes the text into the file, unless that was changed since; what is typed meanwhile stays a draft.
async function saveStudy(editor) {
  const {app, study, area} = editor,
    text = area.value;
  try {
    const saved = await post("study", {study, text, digest: editor.base});
    editor.base = saved.digest;
    if (app.study === study) {
      app.now = saved;
    }
    if (area.value === text) {
      app.drafts.delete(study);
    } else {
      keepDraft(editor);
    }
    app.say(`${study}: saved`);
    await checkStudy(editor);
  } catch (error) {
    if (error.status !== 409) {
      throw error;
    }
    showConflict(editor, await get("study", {study}));
  }
}

// The text of `file` replaces what is typed.
function takeFile(editor, file) {
  const {app, study, area, save} = editor;
  app.now = file;
  editor.base = file.digest;
  app.drafts.delete(study);
  area.value = file.text;
  save.disabled = true;
  checkStudy(editor);
}

// What is typed replaces `file` when it is saved.
function keepTyped(editor, file) {
  const {app, messages, save} = editor;
  app.now = file;
  editor.base = file.digest;
  keepDraft(editor);
  fill(messages);
  save.disabled = false;
  app.say("Saving now replaces what the other wrote.");
}

// Words beside what is typed, and buttons: `others`, and one that takes the text of `file`.
function offerFile(editor, words, file, ...others) {
  fill(
    editor.messages,
    h(
      "div",
      {class: "card doubt"},
      h("p", {}, words),
      h(
        "div",
        {class: "row"},
        others,
        h("button", {type: "button", onclick: () => takeFile(editor, file)}, "Take what is in the file"),
      ),
    ),
  );
}

function showConflict(editor, file) {
  offerFile(
    editor,
    "The file was changed since this was typed, by another step, page or program. What you typed is still here.",
    file,
    h("button", {type: "button", onclick: () => keepTyped(editor, file)}, "Keep mine"),
  );
}
