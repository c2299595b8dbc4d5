// The study file itself, with what is wrong at its line; nothing typed is lost when it changes elsewhere.
import {get, post} from "./api.js";
import {fill, h} from "./dom.js";

export async function show(box, app) {
  const numbers = h("pre", {"aria-hidden": "true"}), told = h("div", {"aria-live": "polite"});
  const area = h("textarea", {spellcheck: "false", autocapitalize: "off", wrap: "off", "aria-label": "Text of the study", oninput: () => { save.disabled = false; draw(); }, onscroll: () => { numbers.scrollTop = area.scrollTop; }});
  let wrong = 0;
  const draw = () => {
    const count = area.value.split("\n").length;
    fill(numbers, Array.from({length: Math.min(count, 20000)}, (_, k) => (k + 1 === wrong ? h("b", {}, String(k + 1)) : `${k + 1}\n`)));
    numbers.scrollTop = area.scrollTop;
  };
  const jump = (line, words) => {
    wrong = line;
    draw();
    fill(told, h("div", {class: "card bad"}, `Line ${line}: ${words}`));
    area.scrollTop = Math.max(0, (line - 6) * 20);
    const start = area.value.split("\n").slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    area.setSelectionRange(start, start + (area.value.split("\n")[line - 1] || "").length);
  };
  const judge = async () => {
    wrong = 0;
    fill(told);
    if (app.now.broken) { jump(app.now.broken.line, app.now.broken.words); return; }
    try { await get("line", {study: app.study}); fill(told, h("p", {class: "muted"}, "The study can be read.")); } catch (error) {
      const found = /line (\d+)(?:, column \d+)?: ([\s\S]*)/.exec(error.message);
      if (found) { jump(Number(found[1]), found[2]); } else { fill(told, h("div", {class: "card bad"}, error.message)); }
    }
    draw();
  };
  const save = h("button", {class: "main", type: "button", disabled: true, onclick: () => app.doing(save, async () => {
    try {
      app.now = await post("study", {study: app.study, text: area.value, digest: app.now.digest});
      app.say(`${app.study}: saved`);
      queueMicrotask(() => { save.disabled = true; });
      await judge();
    } catch (error) {
      if (error.status !== 409) { throw error; }
      conflict(await get("study", {study: app.study}));
    }
  })}, "Save");
  const conflict = (found) => {
    const keep = h("button", {type: "button", onclick: () => { app.now = found; fill(told); save.disabled = false; app.say("Saving now replaces what the other wrote."); }}, "Keep mine");
    const take = h("button", {type: "button", onclick: () => { app.now = found; area.value = found.text; save.disabled = true; judge(); }}, "Take what is in the file");
    fill(told, h("div", {class: "card doubt"}, h("p", {}, "The file was changed by another page or program since it was read. What you typed is still here."), h("div", {class: "row"}, keep, take)));
  };
  app.heard.add(({changed}) => { if (changed && changed.digest !== app.now.digest) { if (save.disabled) { app.now = changed; area.value = changed.text; judge(); } else { conflict(changed); } } });
  fill(box, h("h1", {}, app.study), h("div", {class: "row"}, save, h("span", {class: "note"}, "The file is the one truth: every step of this page reads and writes it. Ctrl-S saves.")), told, h("div", {class: "editor"}, numbers, area));
  area.value = app.now.text;
  box.addEventListener("keydown", (event) => { if ((event.ctrlKey || event.metaKey) && event.key === "s") { event.preventDefault(); save.click(); } });
  draw();
  await judge();
}
