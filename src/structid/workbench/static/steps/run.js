// Runs: processes of their own that go on without this page; stages, sum of squares and values as they move.
import {get, post} from "../api.js";
import {chart, colours} from "../charts.js";
import {bytes, clock, field, fill, h, numberIn, quantity, table, writing} from "../dom.js";
import {resultsName} from "../recorded.js";

export const STATES = {
  queued: ["waits for its turn", "doubt"],
  running: ["running", "live"],
  paused: ["paused", "doubt"],
  stopping: ["stopping", "doubt"],
  done: ["done", "good"],
  undetermined: ["no certain answer", "doubt"],
  unusable: ["input cannot be used", "bad"],
  wrong_model: ["the model does not explain the record", "bad"],
  stopped: ["stopped", "doubt"],
  disk_full: ["the disk is full", "bad"],
  killed: ["ended from outside", "bad"],
};
const LIVE = ["queued", "running", "paused", "stopping"];

export async function show(box, app) {
  const list = h("div", {id: "runs"}),
    cards = new Map();
  fill(
    box,
    h("h1", {}, "Run"),
    app.study ? start(app) : h("p", {class: "muted"}, "Choose a study above to start a run."),
    list,
  );
  const draw = (runs) => {
    const shown = runs.filter((one) => !app.study || one.study === app.study);
    for (const one of shown) {
      if (!cards.has(one.id)) {
        const card = new Card(app, one);
        cards.set(one.id, card);
      }
      cards.get(one.id).tell(one);
    }
    const wanted = shown.map((one) => cards.get(one.id).box);
    if (wanted.some((card, k) => list.children[k] !== card) || !shown.length) {
      fill(list, wanted.length ? wanted : h("p", {class: "muted"}, "No run of this study yet."));
    }
    shown.slice(0, 3).forEach((one) => cards.get(one.id).open());
  };
  app.heard.add(({runs}) => {
    if (runs) {
      draw(runs);
    }
  });
  await app.reload();
  draw(app.runs);
}

// A results folder that neither exists nor is written by a run.
function freeResults(app) {
  const base = resultsName(app.study),
    taken = new Set([...app.folder.results.map((one) => one.path), ...app.runs.map((one) => one.results)]);
  let name = `${base}_results`;
  for (let k = 2; taken.has(name); k += 1) {
    name = `${base}_results_${k}`;
  }
  return name;
}

// The button that asks what a run will take, and writes the answer into `place`.
function needsButton(app, place) {
  const ask = h(
    "button",
    {
      type: "button",
      onclick: () =>
        app.doing(ask, async () => {
          fill(place, "Timing a few lines, and trying the search for some seconds…");
          try {
            const needs = await get("needs", {study: app.study});
            fill(
              place,
              `About ${clock(needs.seconds)}${duration(needs)}. One iteration takes about ${clock(needs.iteration_seconds)}. About ${bytes(needs.bytes)} of memory (${bytes(needs.free)} free).`,
            );
          } catch (error) {
            fill(place, "");
            throw error;
          }
        }),
    },
    "What will it take?",
  );
  return ask;
}

// The card that starts a run.
function start(app) {
  const results = h("input", {value: freeResults(app), spellcheck: "false", id: "results-folder"}),
    needs = h("p", {class: "note", "aria-live": "polite"}, "");
  const limit = h("input", {inputmode: "decimal", placeholder: "by itself", id: "causes-seconds"}),
    always = h("input", {type: "checkbox", "data-kept": true});
  const box = h("div"),
    off = !app.folder.writable || !app.now.table.record;
  const buttons = writing(
    app,
    "Identify",
    results,
    (replace) =>
      begin(
        app,
        box,
        {
          study: app.study,
          results: results.value,
          replace,
          seconds: numberIn(limit, {least: 0, empty: true}),
          explain: always.checked,
        },
        () => {
          results.value = freeResults(app);
        },
      ),
    {class: "main", disabled: off},
  );
  return h(
    "section",
    {class: "card"},
    h("div", {class: "row end"}, field("Results go to", results), buttons, needsButton(app, needs)),
    h(
      "details",
      {"data-kept": true},
      h("summary", {}, "Causes of a misfit"),
      h(
        "div",
        {class: "row end"},
        field("look for them for so many seconds", limit, "short"),
        h("label", {class: "check"}, always, "even if the answer is sound"),
      ),
      h(
        "p",
        {class: "note"},
        "Processor time. By itself the search takes as long as three identifications and about eight seconds. What it finds stands in the results, each cause as a study to open.",
      ),
    ),
    needs,
    box,
    app.now.table.record ? null : h("p", {class: "note"}, "The study has no record yet."),
  );
}

// Start a run; where its study runs a program, what that is is shown first, and the run starts when it is confirmed.
async function begin(app, box, given, started = () => {}) {
  fill(box);
  try {
    app.runs = [...app.runs, await post("runs", given)];
    started();
    app.say("Started; it goes on when this page is closed.");
  } catch (error) {
    if (error.status !== 428) {
      throw error;
    }
    fill(
      box,
      confirming(
        app,
        error.found.solver,
        (confirmed) => begin(app, box, {...given, confirmed}, started),
        () => fill(box),
      ),
    );
    box.querySelector("h2").focus(); // not the button: whoever presses a key twice has not read it
  }
}

function confirming(app, solver, run, cancel) {
  const go = h(
    "button",
    {class: "main", type: "button", onclick: () => app.doing(go, () => run(solver.confirmation))},
    "Run this program",
  );
  return h(
    "section",
    {class: "card doubt", id: "confirm", role: "group", "aria-labelledby": "confirm-title"},
    h("h2", {id: "confirm-title", tabindex: -1}, "This study runs a program of this machine"),
    h(
      "p",
      {},
      "It can do all that you can do. Run it only where you know where the study comes from, and what the program does.",
    ),
    h("pre", {class: "log command", tabindex: 0, "aria-label": "The command"}, visible(solver.command)),
    h(
      "p",
      {class: "note"},
      `Word by word: ${solver.words.map((word) => JSON.stringify(visible(word))).join(" ")}. It works in a folder of its own with ${solver.inputs.map(visible).join(", ")} of the study.`,
    ),
    h("p", {class: "note"}, "You are asked again when command, deck or files change."),
    h("div", {class: "row"}, go, h("button", {type: "button", onclick: cancel}, "Do not run it")),
  );
}

// Signs that are not seen, or that turn the text around, by their numbers.
const visible = (text) => text.replace(/[\p{C}\p{Zl}\p{Zp}]/gu, (sign) => `\\u{${sign.codePointAt(0).toString(16)}}`);

function duration(found) {
  if (found.is_tried) {
    return found.causes_seconds
      ? `, of which ${clock(found.causes_seconds)} to look for causes: the search was tried, and its fit misses the noise`
      : ": the search was tried, and came to its end";
  }
  return `${found.causes_seconds ? `, ${clock(found.most_seconds)} where causes of a misfit are sought` : ""}: the search takes too long to be tried, and how many iterations it takes the record decides`;
}

class Card {
  constructor(app, one) {
    this.app = app;
    this.id = one.id;
    this.at = 0;
    this.lines = [];
    this.isOpen = false;
    this.busy = false;
    this.again = false;
    this.state = h("span", {class: "state"});
    this.words = h("p", {"aria-live": "polite"});
    this.buttons = h("div", {class: "row"});
    this.confirm = h("div");
    this.bar = h("progress", {max: 1, "aria-label": `Progress of the run into ${one.results}`});
    this.plot = h("div", {class: "plot low"});
    this.values = h("div");
    this.log = h("pre", {class: "log", tabindex: 0, role: "log", "aria-label": "Log of the run"});
    this.more = h("div", {}, this.plot, this.values, h("details", {}, h("summary", {}, "Log"), this.log));
    this.toggle = h(
      "button",
      {class: "small", type: "button", onclick: () => (this.isOpen ? this.close() : this.open())},
      "Show",
    );
    this.box = h(
      "section",
      {class: "card", "data-run": one.id},
      h(
        "div",
        {class: "row"},
        h("strong", {}, one.results),
        h("span", {class: "muted"}, `${one.study}, ${new Date(1000 * one.started).toLocaleString()}`),
        this.state,
        this.toggle,
      ),
      this.words,
      this.bar,
      this.buttons,
      this.confirm,
    );
  }

  open() {
    if (!this.isOpen && !this.closed) {
      this.isOpen = true;
      this.box.append(this.more);
      this.toggle.textContent = "Hide";
      this.read();
    }
  }
  close() {
    this.isOpen = false;
    this.closed = true;
    this.more.remove();
    this.toggle.textContent = "Show";
    this.toggle.onclick = () => {
      this.closed = false;
      this.open();
    };
  }

  tell(one) {
    const told = JSON.stringify(one);
    if (told === this.told) {
      return;
    }
    this.told = told;
    const [words, kind] = STATES[one.state] || [one.state, ""],
      live = LIVE.includes(one.state),
      app = this.app;
    this.state.textContent = words;
    this.state.className = "state " + kind;
    this.bar.hidden = !live || one.state === "queued";
    if (one.last?.total) {
      this.bar.value = one.last.done / one.last.total;
    } else {
      this.bar.removeAttribute("value");
    }
    this.words.textContent =
      one.state === "queued"
        ? "Two runs compute at a time; this one begins when one of them has ended."
        : live
          ? one.last?.words || "reading and checking"
          : one.state === "disk_full"
            ? `Free some space${one.can_resume ? ", then resume it where it was" : ", then start it again"}: nothing is half written, and what stood in ${one.results} before is untouched.`
            : "";
    const act = (label, action, main = false) => {
      const button = h(
        "button",
        {class: main ? "main" : "", type: "button", onclick: () => app.doing(button, action)},
        label,
      );
      return button;
    };
    fill(
      this.buttons,
      live && !["paused", "queued"].includes(one.state) ? act("Pause", () => post(`runs/${one.id}/pause`, {})) : null,
      one.state === "paused" ? act("Go on", () => post(`runs/${one.id}/continue`, {}), true) : null,
      live ? act("Stop", () => post(`runs/${one.id}/stop`, {})) : null,
      one.can_resume
        ? act(
            "Resume where it was",
            () => begin(app, this.confirm, {study: one.study, results: one.results, resume: true}),
            true,
          )
        : null,
      one.has_results && !live
        ? h("a", {class: "button", href: `#results/${encodeURIComponent(one.study)}`}, "Results")
        : null,
    );
    if (this.isOpen) {
      this.read();
    }
  }

  async read() {
    if (this.busy) {
      this.again = true;
      return;
    }
    this.busy = true;
    try {
      const found = await get(`runs/${this.id}`, {after: this.at});
      this.at = found.at;
      this.lines.push(...found.lines);
      this.log.textContent = found.log || "nothing yet";
      this.log.scrollTop = this.log.scrollHeight;
      if (["unusable", "killed"].includes(found.state) && found.log) {
        this.words.textContent = found.log.trim().split("\n").at(-1);
      }
      await this.draw();
    } catch (error) {
      this.app.fail(error);
    } finally {
      this.busy = false;
      if (this.again) {
        this.again = false;
        this.read();
      }
    }
  }

  async draw() {
    const costs = this.lines.filter((one) => one.sum_of_squares !== undefined && one.name !== "");
    this.plot.hidden = costs.length < 2;
    if (costs.length > 1) {
      const begun = costs[0].time,
        stages = [...new Set(costs.map((one) => one.name))];
      await chart(
        this.plot,
        stages.map((name, k) => {
          const own = costs.filter((one) => one.name === name);
          return {
            x: own.map((one) => one.time - begun),
            y: own.map((one) => one.sum_of_squares),
            name,
            mode: "lines+markers",
            marker: {size: 4},
            line: {width: 1.5, color: colours()[k % 7]},
            hovertemplate: "%{fullData.name}<br>%{x:.1f} s: %{y:.5g}<extra></extra>",
          };
        }),
        {
          again: () => this.draw().catch(this.app.fail),
          xaxis: {title: {text: "time, s"}},
          yaxis: {type: "log", exponentformat: "power", title: {text: "sum of squares"}, nticks: 4},
          margin: {l: 76, r: 14, t: 30, b: 46},
          showlegend: stages.length > 1 && stages.length <= 6 && this.plot.clientWidth > 500,
        },
      );
    }
    const rows = costs.filter((one) => one.parameters?.length).map((one) => one.parameters),
      last = rows.at(-1);
    if (last) {
      const first = rows[0];
      fill(
        this.values,
        h(
          "details",
          {open: last.length <= 12},
          h("summary", {}, `${last.length} parameters as they move`),
          table(
            ["parameter", "first", "now"],
            last.map((one) => [
              one.name,
              quantity(first.find((other) => other.name === one.name)?.value ?? NaN, one.unit),
              quantity(one.value, one.unit),
            ]),
            [1, 2],
          ),
        ),
      );
    }
  }
}
