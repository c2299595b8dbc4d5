// Results: the verdict first, then values, the report, everything to take away, and two results side by side.
import {answerPicture} from "../answer_picture.js";
import {get, link, post, view} from "../api.js";
import {chart, colours, ink} from "../charts.js";
import {
  bytes,
  field,
  fill,
  h,
  marked,
  number,
  numberIn,
  options,
  percent,
  quantity,
  table,
  unpacked,
  warningList,
  withUnit,
} from "../dom.js";
import {resultPaths, resultsName} from "../recorded.js";

const MARKS = {sound: "good", approximate: "doubt", wrong_model: "bad", undetermined: "bad"};

export async function show(box, app) {
  await app.reload();
  const {all, first} = resultPaths(app);
  if (!all.length) {
    fill(box, h("h1", {}, "Results"), h("p", {}, "No results in this folder yet: run a study, in step Run."));
    return;
  }
  const choice = h("select", {id: "results", onchange: () => draw()}, options(all, first)),
    other = h("select", {id: "other", onchange: () => draw()}, options([["", "none"], ...all]));
  const place = h("div");
  fill(
    box,
    h("h1", {}, "Results"),
    h("div", {class: "row end"}, field("Results", choice), field("Beside", other)),
    place,
  );
  let turn = 0;
  const draw = async () => {
    const own = ++turn,
      name = choice.value;
    try {
      const found = await get("results", {results: name}),
        beside = other.value ? await get("results", {results: other.value}) : null,
        fit = h("div"),
        picture = h("div");
      if (own !== turn) {
        return; // other results were chosen meanwhile
      }
      fill(
        place,
        verdict(found.results, name, found.files),
        changes(found.results, name, found.files),
        further(app, found.results, name),
        values(found.results, beside?.results, name, other.value),
        fit,
        picture,
        exported(name, found.files),
        report(found.report, name),
      );
      const put = async (part, card) =>
        fill(part, await card.catch((error) => h("p", {class: "note"}, marked(error.message))));
      await Promise.all([put(fit, fits(name)), put(picture, get("identified", {results: name}).then(answerPicture))]);
    } catch (error) {
      if (own === turn) {
        fill(place, h("div", {class: "card bad"}, marked(error.message)));
      }
    }
  };
  await draw();
}

// All else that the results tell, on the page of the report; it is loaded when it is opened.
function report(page, folder) {
  if (!page) {
    return h("p", {class: "note"}, "These results hold no report page.");
  }
  const place = h("div"),
    details = h(
      "details",
      {
        class: "card",
        id: "report",
        ontoggle: () => {
          if (details.open && !place.firstChild) {
            fill(
              place,
              h("iframe", {class: "report", sandbox: "allow-scripts", src: view(page), title: `Report in ${folder}`}),
            );
          }
        },
      },
      h("summary", {}, "The whole report: residuals, statistics, sensitivity, convergence, provenance"),
      place,
    );
  return details;
}

// A longer search for causes of a misfit: the same run once more, into the same folder.
function further(app, found, folder) {
  if (
    !app.study ||
    !["approximate", "wrong_model"].includes(found.verdict) ||
    !folder.startsWith(resultsName(app.study))
  ) {
    return null;
  }
  const seconds = h("input", {value: "300", inputmode: "decimal"});
  const go = h(
    "button",
    {
      type: "button",
      disabled: !app.folder.writable,
      onclick: () =>
        app.doing(go, async () => {
          await post("runs", {
            study: app.study,
            results: folder,
            replace: true,
            explain: true,
            seconds: numberIn(seconds, {least: 1}),
          });
          app.go("run");
        }),
    },
    "Search further",
  );
  return h(
    "section",
    {class: "card", id: "further"},
    h("h2", {}, "Causes of the misfit"),
    h(
      "p",
      {class: "note"},
      "The search for causes has a time limit. A longer one tries more causes, and more of them together.",
    ),
    h("div", {class: "row end"}, field("seconds of processor time", seconds, "short"), go),
  );
}

function verdict(found, folder, files) {
  const advice = found.advice || (found.verdict_reasons || []).slice(1),
    headline = found.headline || found.verdict_text || found.status_text || found.status || "";
  return h(
    "section",
    {class: "card " + (MARKS[found.verdict] || "doubt"), id: "verdict"},
    h("h2", {}, found.title || "Verdict"),
    h("p", {}, h("strong", {}, marked(headline))),
    cause(found, folder, files),
    found.next_step ? h("p", {}, h("strong", {}, "Next: "), marked(byButtons(found.next_step))) : null,
    advice.length ? warningList(advice.slice(0, 5)) : null,
    found.warnings?.length
      ? h("details", {}, h("summary", {}, warningCount(found.warnings.length)), warningList(found.warnings))
      : null,
  );
}

// What to do next, by the buttons of this page where the console names commands.
const byButtons = (words) =>
  words
    .replace(/Run `structid identify [^`]+`, which has this change\./, "Open the study with this change, and run it.")
    .replace(/, and run `structid identify [^`]+`\./, "; the study above has this change.")
    .replace(/: `structid explain` tries .*$/, ": search for causes of the misfit below.");

// The change of model or record that explains the misfit, with its study to open.
function cause(found, folder, files) {
  const [first, next] = found.causes || [];
  return first?.share >= 0.01
    ? h(
        "div",
        {id: "cause"},
        h("h3", {}, next?.is_alike ? "Cause, or one that looks the same" : "Cause"),
        h("p", {}, marked(`${changeWords(first)}. This removes ${percent(first.share)} of the misfit.`)),
        opened(first, folder, files),
      )
    : null;
}

const capital = (words) => words.charAt(0).toUpperCase() + words.slice(1);

// The words of a change at the beginning of a sentence, without a capital where they begin with a name.
function changeWords({words, where, is_second: isSecond}) {
  if (isSecond) {
    return `Beside the first, ${words}`;
  }
  const first = words.split(/[ ,]/, 1)[0];
  return /^\p{L}+$/u.test(first) && ![where ?? []].flat().includes(first) ? capital(words) : words;
}

// A link to the study of a change, where it was written.
function opened(one, folder, files) {
  const href = `#structure/${encodeURIComponent(`${folder}/${one.study}`)}`;
  return isWritten(one, folder, files) ? h("a", {class: "button", href}, `Open ${one.study.split("/").at(-1)}`) : null;
}

const isWritten = (one, folder, files) =>
  Boolean(one.study) && files.some((file) => file.path === `${folder}/${one.study}`);

// The fit of the worst and of the best channel, and of others by choice: measured, initial and fitted magnitude.
async function fits(folder) {
  const found = await get("fits", {results: folder}),
    {length} = found.channels;
  if (!length) {
    return null;
  }
  const x = unpacked(found.frequency, "f64");
  return h(
    "section",
    {class: "card"},
    h("h2", {}, "Fit"),
    h("p", {class: "note"}, "Points: measured. Line: fitted model. Dashed: model at its initial values."),
    h(
      "div",
      {class: "columns"},
      fitOf(found, x, 0, length > 1 ? "Worst channel, and its median relative error" : "Channel", "fit"),
      length > 1 ? fitOf(found, x, length - 1, "Best channel, or another one", "fit-best") : null,
    ),
  );
}

function fitOf(found, x, first, label, id) {
  const plot = h("div", {class: "plot", id});
  const choice = h(
    "select",
    {onchange: () => draw()},
    found.channels.map((one, k) =>
      h("option", {value: k, selected: k === first}, `${one.name}: ${percent(one.error)}`),
    ),
  );
  const draw = () => {
    const one = found.channels[Number(choice.value)],
      [blue, orange] = colours();
    const lines = [
      {name: "measured", x, y: unpacked(one.measured, "f32"), mode: "markers", marker: {size: 3, color: ink()}},
      {
        name: "initial model",
        x,
        y: unpacked(one.initial, "f32"),
        mode: "lines",
        line: {color: blue, dash: "dash", width: 1.2},
      },
      {name: "fitted model", x, y: unpacked(one.fitted, "f32"), mode: "lines", line: {color: orange, width: 2}},
    ];
    const {y} = lines[0],
      least = y.reduce((low, value) => Math.min(low, value)),
      most = y.reduce((high, value) => Math.max(high, value));
    return chart(plot, lines, {
      again: draw,
      showlegend: false,
      xaxis: {title: {text: "frequency, Hz"}},
      yaxis: {
        type: "log",
        exponentformat: "power",
        dtick: most < 1000 * least ? "D2" : null, // ticks at 1, 2 and 5
        title: {text: withUnit(one.quantity, one.unit)},
      },
    });
  };
  setTimeout(draw); // it has no width before it is on the page
  return h("div", {}, field(label, choice), plot);
}

// What may be wrong with the model, each as a study that can be opened and run.
function changes(found, folder, files) {
  const written = (one) => isWritten(one, folder, files),
    causes = (found.causes || []).filter(written),
    others = (found.suggestions || []).filter(written);
  return [
    changeList("Possible causes, each as a study", causes, folder, files, "suggested"),
    changeList(
      "Changes that lower the misfit without explaining it, each as a study",
      others,
      folder,
      files,
      causes.length ? "lowering" : "suggested",
    ),
  ];
}

function changeList(title, list, folder, files, id) {
  return list.length
    ? h(
        "section",
        {class: "card", id},
        h("h2", {}, title),
        h(
          "ul",
          {class: "plain"},
          list.map((one) =>
            h(
              "li",
              {},
              h(
                "p",
                {},
                marked(
                  `${changeWords(one)}: removes ${percent(one.share)} of ${one.is_second ? "what is left" : "the misfit"}${one.leaves_noise ? "; what remains is noise" : ""}`,
                ),
              ),
              h(
                "details",
                {},
                h("summary", {}, "Lines that it changes"),
                h("pre", {class: "log", tabindex: 0}, one.lines.join("\n")),
              ),
              opened(one, folder, files),
            ),
          ),
        ),
      )
    : null;
}

function values(found, beside, name, otherName) {
  const rows = (found.parameters || []).slice(0, 400),
    of = (one) => beside?.parameters?.find((each) => each.name === one.name);
  const end = (one) =>
    one.interval_95?.[0] !== null && one.interval_95
      ? `${quantity(one.interval_95[0], one.unit)} to ${quantity(one.interval_95[1], one.unit)}`
      : "";
  const header = beside
    ? ["parameter", name, otherName, "change", "in std"]
    : ["parameter", "value ± std", "95 % interval", "initial", "state"];
  return h(
    "section",
    {class: "card"},
    h("h2", {}, "Values"),
    h("p", {}, found.total_mass?.value !== undefined ? `Total mass ${withStd(found.total_mass)} kg` : ""),
    table(
      header,
      rows.map((one) => {
        if (!beside) {
          return [
            one.name,
            one.text ?? quantity(one.value, one.unit),
            one.interval_text ?? end(one),
            quantity(one.initial, one.unit),
            one.state ?? "",
          ];
        }
        const two = of(one);
        if (!two) {
          return [one.name, quantity(one.value, one.unit), "–", "", ""];
        }
        const spread = Math.hypot(one.std ?? NaN, two.std ?? NaN);
        return [
          one.name,
          quantity(one.value, one.unit),
          quantity(two.value, one.unit),
          `${two.value > one.value ? "+" : ""}${number(100 * (two.value / one.value - 1), 3)} %`,
          number((two.value - one.value) / spread, 2),
        ];
      }),
      [1, 2, 3, 4],
      rows.map((one) => ((one.state ? one.state === "determined" : one.identified) ? null : "doubtful")),
    ),
    beside
      ? h(
          "p",
          {class: "note"},
          "In std: over the root of both variances, as if the two were independent; `structid compare` fits states together.",
        )
      : null,
  );
}

// A value to the digits that its standard deviation of two digits leaves.
function withStd({value, std}) {
  const digits = std > 0 && value ? Math.floor(Math.log10(Math.abs(value))) - Math.floor(Math.log10(std)) + 2 : 5;
  return `${number(value, Math.min(Math.max(digits, 2), 8))} ± ${number(std ?? NaN, 2)}`;
}

function exported(folder, files) {
  return h(
    "details",
    {class: "card"},
    h("summary", {}, "Take away"),
    h(
      "p",
      {},
      h("a", {class: "button", href: link("export", {results: folder}), download: ""}, "All of it as one archive"),
    ),
    h(
      "ul",
      {class: "plain"},
      files.map((one) =>
        h(
          "li",
          {},
          h("a", {href: link("download", {path: one.path}), download: ""}, one.path),
          " ",
          h("span", {class: "muted"}, bytes(one.bytes)),
        ),
      ),
    ),
  );
}

const warningCount = (count) => (count === 1 ? "1 warning" : `${count} warnings`);
