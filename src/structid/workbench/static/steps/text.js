// The study file itself, with what is wrong at its line; nothing typed is lost when it changes elsewhere.
import {get, post} from "../api.js";
import {fill, h} from "../dom.js";

export async function show(box, app) {
  const study = app.study,
    draft = app.drafts.get(study);
  let base = draft?.digest ?? app.now.digest; // of the file that what is typed began from
  const numbers = h("pre", {"aria-hidden": "true"}),
    told = h("div", {"aria-live": "polite"});
  const area = h("textarea", {
    spellcheck: "false",
    autocapitalize: "off",
    wrap: "off",
    "aria-label": "Text of the study",
    oninput: () => {
      app.drafts.set(study, {text: area.value, digest: base});
      save.disabled = false;
      draw();
    },
    onscroll: () => {
      numbers.scrollTop = area.scrollTop;
    },
  });
  let wrong = 0;
  const draw = () => {
    const count = area.value.split("\n").length;
    fill(
      numbers,
      Array.from({length: Math.min(count, 20000)}, (_, k) =>
        k + 1 === wrong ? h("b", {}, String(k + 1)) : `${k + 1}\n`,
      ),
    );
    numbers.scrollTop = area.scrollTop;
  };
  const jump = (line, words) => {
    wrong = line;
    draw();
    fill(told, h("div", {class: "card bad"}, `Line ${line}: ${words}`));
    area.scrollTop = Math.max(0, (line - 6) * 20);
    const start =
      area.value
        .split("\n")
        .slice(0, line - 1)
        .join("\n").length + (line > 1 ? 1 : 0);
    area.setSelectionRange(start, start + (area.value.split("\n")[line - 1] || "").length);
  };
  const judge = async () => {
    wrong = 0;
    fill(told);
    if (app.now.broken) {
      jump(app.now.broken.line, app.now.broken.words);
      return;
    }
    try {
      await get("line", {study});
      fill(told, h("p", {class: "muted"}, "The study can be read."));
    } catch (error) {
      const found = /line (\d+)(?:, column \d+)?: ([\s\S]*)/.exec(error.message);
      if (found) {
        jump(Number(found[1]), found[2]);
      } else {
        fill(told, h("div", {class: "card bad"}, error.message));
      }
    }
    draw();
  };
  const save = h(
    "button",
    {
      class: "main",
      type: "button",
      disabled: true,
      onclick: () =>
        app
          .doing(save, async () => {
            const text = area.value;
            try {
              const saved = await post("study", {study, text, digest: base});
              base = saved.digest;
              if (app.study === study) {
                app.now = saved;
              }
              if (area.value === text) {
                app.drafts.delete(study);
              } else {
                app.drafts.set(study, {text: area.value, digest: base});
              }
              app.say(`${study}: saved`);
              await judge();
            } catch (error) {
              if (error.status !== 409) {
                throw error;
              }
              conflict(await get("study", {study}));
            }
          })
          .then(() => {
            save.disabled = !app.drafts.has(study);
          }),
    },
    "Save",
  );
  const take = (found) => {
    app.now = found;
    base = found.digest;
    app.drafts.delete(study);
    area.value = found.text;
    save.disabled = true;
    judge();
  };
  const choice = (words, found, ...others) =>
    fill(
      told,
      h(
        "div",
        {class: "card doubt"},
        h("p", {}, words),
        h(
          "div",
          {class: "row"},
          others,
          h("button", {type: "button", onclick: () => take(found)}, "Take what is in the file"),
        ),
      ),
    );
  const conflict = (found) =>
    choice(
      "The file was changed since this was typed, by another step, page or program. What you typed is still here.",
      found,
      h(
        "button",
        {
          type: "button",
          onclick: () => {
            app.now = found;
            base = found.digest;
            app.drafts.set(study, {text: area.value, digest: base});
            fill(told);
            save.disabled = false;
            app.say("Saving now replaces what the other wrote.");
          },
        },
        "Keep mine",
      ),
    );
  app.heard.add(({changed}) => {
    if (changed && changed.digest !== base) {
      if (app.drafts.has(study)) {
        conflict(changed);
      } else {
        take(changed);
      }
    }
  });
  fill(
    box,
    h("h1", {}, study),
    h(
      "div",
      {class: "row"},
      save,
      h(
        "span",
        {class: "note"},
        "The file is the one truth: every step of this page reads and writes it. Ctrl-S saves.",
      ),
    ),
    told,
    h("div", {class: "editor"}, numbers, area),
  );
  area.value = draft ? draft.text : app.now.text;
  box.addEventListener("keydown", (event) => {
    if ((event.ctrlKey || event.metaKey) && event.key === "s") {
      event.preventDefault();
      save.click();
    }
  });
  draw();
  if (!draft) {
    await judge();
    return;
  }
  save.disabled = false;
  if (draft.digest === app.now.digest) {
    choice("What you typed is still here, and not saved yet.", app.now);
  } else {
    conflict(app.now);
  }
}
