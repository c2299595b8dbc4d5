// The page as a whole: which study is open, which step is shown, and what has changed behind it.
import {events, get, post} from "./api.js";
import {keepClicks, pointerUp} from "./clicks.js";
import {fill, h, marked, options} from "./dom.js";
import {forgetTyped, isTyped, keepFocus, keepTyped} from "./typed.js";

const STEPS = [
  ["start", "Start"],
  ["build", "Build"],
  ["structure", "Structure"],
  ["records", "Records"],
  ["modes", "Modes"],
  ["unknowns", "Unknowns"],
  ["run", "Run"],
  ["results", "Results"],
  ["use", "Use"],
  ["text", "Study file"],
];
const WITHOUT_STUDY = ["start", "records", "modes", "results", "run", "use"];
const refusals = new WeakMap(); // of controls: the note on what they were last refused
const main = document.getElementById("main"),
  select = document.getElementById("study");

export const app = {
  folder: null,
  study: "",
  now: null,
  step: "start",
  record: 0,
  runs: [],
  heard: new Set(),
  shown: 0,
  drafts: new Map(),
  acting: new Set(), // controls whose action goes on
  answered: null, // settles once all answers about the open study are there; a new one for each of them
};
keepClicks();
keepTyped(main, () => `${app.step} ${app.study} ${app.record}`);

app.say = (words, bad = false) => {
  const place = document.getElementById("told");
  for (const one of [...place.children]) {
    if (one.firstChild.textContent === words.replaceAll("`", "")) {
      one.remove();
    }
  }
  const note = h(
    "div",
    {class: bad ? "bad" : ""},
    h("span", {}, marked(words)),
    h("button", {class: "small", type: "button", onclick: () => note.remove()}, "Close"),
  );
  place.append(note);
  while (place.children.length > 3) {
    place.firstChild.remove();
  }
  if (!bad) {
    setTimeout(() => note.remove(), 6000);
  }
  return note;
};
app.fail = (error) => {
  console.warn(error);
  return app.say(error.message, true);
};

// Run `action` with `button` out of use; what goes wrong is told until it is tried again.
app.doing = async (button, action) => {
  button.disabled = true;
  button.setAttribute("aria-busy", "true");
  app.acting.add(button);
  refusals.get(button)?.remove();
  try {
    return await action();
  } catch (error) {
    refusals.set(button, app.fail(error));
    return null;
  } finally {
    app.acting.delete(button);
    button.disabled = false;
    button.removeAttribute("aria-busy");
  }
};

app.go = (step, study = app.study) => {
  const target = `#${step}${study ? "/" + encodeURIComponent(study) : ""}`;
  if (location.hash === target) {
    show();
  } else {
    location.hash = target;
  }
};

app.reload = async () => {
  app.folder = await get("folder");
  app.runs = app.folder.runs;
  fill(
    select,
    h("option", {value: ""}, app.folder.studies.length ? "choose a study" : "no study yet"),
    options(
      app.folder.studies.map((one) => [one.path, `${one.title} (${one.path})`]),
      app.study,
    ),
  );
  fill(document.getElementById("folder"), app.folder.folder, app.folder.writable ? "" : " (read only)");
};

app.read = async () => {
  app.now = await app.answer(app.study ? get("study", {study: app.study}) : null);
  app.record = Math.max(0, Math.min(app.record, [app.now?.table?.record ?? []].flat().length - 1)); // the one of several that is shown
  return app.now;
};

// The answer of the server to a reading or a writing of the open study; changes that are heard meanwhile wait for it.
app.answer = (asked) => {
  const answer = Promise.resolve(asked);
  app.answered = Promise.allSettled([app.answered, answer]).then(() => null); // no answer is kept
  return answer;
};

// Change keys of the open study; comments and order of all else stay. `edits` as in structid.study.schema.edits. What is refused is an error.
app.edit = async (edits, words) => {
  try {
    app.now = await app.answer(post("edit", {study: app.study, digest: app.now.digest, edits}));
  } catch (error) {
    if (error.status === 409) {
      await app.read();
      show();
    }
    throw error;
  }
  [...app.acting].filter((control) => control.matches("button") || isTyped(control)).forEach(forgetTyped);
  if (words) {
    app.say(words);
  }
  await pointerUp(); // a click that was begun reaches its control before this is drawn anew
};

function place() {
  const [step, study] = location.hash.slice(1).split("/", 2);
  return [STEPS.some(([name]) => name === step) ? step : "start", study ? decodeURIComponent(study) : ""];
}

async function show() {
  const [step, study] = place(),
    turn = ++app.shown;
  main.setAttribute("aria-busy", "true");
  app.heard.clear();
  if (app.step === "text" && app.drafts.has(app.study) && (step !== "text" || study !== app.study)) {
    app.say(`What you typed into ${app.study} is not saved yet; it is kept on its page, Study file.`, true);
  }
  app.step = step;
  if (study !== app.study) {
    app.record = 0;
  }
  app.study = study;
  select.value = study;
  drawSteps(step, study);
  document.title = `${STEPS.find(([name]) => name === step)[1]}${study ? " · " + study : ""} · structid workbench`;
  try {
    if (!app.folder) {
      await app.reload();
      select.value = study;
    }
    if (study) {
      await app.read();
    } else {
      app.now = null;
    }
    const view = await import(`./steps/${step}.js`);
    if (turn !== app.shown) {
      return;
    }
    const box = h("div", {"data-step": step});
    keepFocus();
    fill(main, box);
    if (!study && !WITHOUT_STUDY.includes(step)) {
      fill(box, h("p", {}, "Choose a study above, or make one on the start page."));
      return;
    }
    if (app.now && app.now.broken && !["text", "start"].includes(step)) {
      fill(box, broken());
      return;
    }
    await view.show(box, app);
  } catch (error) {
    if (turn !== app.shown) {
      return;
    }
    fill(main, failure(error, step, study));
  } finally {
    if (turn === app.shown) {
      main.dataset.drawn = app.now?.digest ?? ""; // of the study as it is shown
      main.removeAttribute("aria-busy");
    }
  }
}

// Links to the steps, the present one in view; those that need a study lead nowhere without one.
function drawSteps(step, study) {
  fill(
    document.getElementById("steps"),
    STEPS.map(([name, words], k) => {
      const off = !study && !WITHOUT_STUDY.includes(name);
      return h(
        "li",
        {},
        h(
          "a",
          {
            href: off ? "#start" : `#${name}${study ? "/" + encodeURIComponent(study) : ""}`,
            "aria-current": name === step ? "page" : null,
            "aria-disabled": off ? "true" : null,
            title: off ? "choose or make a study first" : null,
          },
          h("span", {"aria-hidden": "true"}, String(k + 1)),
          words,
        ),
      );
    }),
  );
  const nav = document.querySelector("nav"),
    current = nav.querySelector("[aria-current]");
  nav.scrollLeft = current.offsetLeft - (nav.clientWidth - current.offsetWidth) / 2;
}

// Why a step cannot be shown, and where to go from there.
const failure = (error, step, study) =>
  h(
    "div",
    {class: "card bad"},
    h("p", {}, marked(error.message)),
    h(
      "div",
      {class: "row"},
      h("button", {type: "button", onclick: show}, "Try again"),
      study && step === "structure"
        ? h("a", {class: "button", href: `#build/${encodeURIComponent(study)}`}, "Go on building")
        : null,
      study ? h("a", {class: "button", href: `#text/${encodeURIComponent(study)}`}, "Open the study file") : null,
    ),
  );

function broken() {
  return h(
    "div",
    {class: "card bad"},
    h("h2", {}, "This study is not valid TOML"),
    h("p", {}, `Line ${app.now.broken.line}: ${app.now.broken.words}`),
    h("a", {class: "button", href: `#text/${encodeURIComponent(app.study)}`}, "Show it at its line"),
  );
}

select.addEventListener("change", () =>
  app.go(select.value && app.step === "start" ? "structure" : app.step, select.value),
);
window.addEventListener("hashchange", show);
window.addEventListener("beforeunload", (event) => {
  if (app.drafts.size) {
    event.preventDefault();
  }
});

// Changes made by hand, by another page or by a run are heard here.
async function noticeChange(study) {
  let found = null,
    answered = null;
  do {
    answered = app.answered;
    await answered;
    found = await get("study", {study});
  } while (answered !== app.answered); // else it may be older than what the page itself has read or written meanwhile
  if (!app.now || app.study !== study || found.digest === app.now.digest) {
    return;
  }
  for (const heard of app.heard) {
    heard({changed: found});
  }
  if (app.step !== "text") {
    await pointerUp();
    app.say("The study was changed outside this page; it is shown as it is now.");
    show();
  }
}

let stamps = null,
  away = {words: "", note: null};
events(
  (now) => {
    app.runs = now.runs;
    const before = stamps,
      study = app.study;
    stamps = now.studies;
    if (before && JSON.stringify(before) !== JSON.stringify(stamps)) {
      app
        .reload()
        .then(() => {
          select.value = app.study;
          for (const heard of app.heard) {
            heard({folder: app.folder});
          }
        })
        .catch(app.fail);
    }
    if (study && stamps[study] && (!before || before[study] !== stamps[study])) {
      noticeChange(study).catch(app.fail);
    }
    for (const heard of app.heard) {
      heard({runs: now.runs});
    }
  },
  async (lost) => {
    let words = "";
    if (lost) {
      try {
        await get("folder");
      } catch (error) {
        words = error.message;
      }
    }
    if (words === away.words) {
      return;
    }
    away.note?.remove();
    away = {words, note: words ? app.say(words, true) : null};
  },
);
await show();
