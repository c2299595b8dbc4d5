// Results: the verdict first, then values, the report, everything to take away, and two results side by side.
import {get, link, view} from "../api.js";
import {bytes, field, fill, h, number, options, percent, quantity, table} from "../dom.js";
import {resultsName} from "../recorded.js";

const MARKS = {sound: "good", approximate: "doubt", wrong_model: "bad", undetermined: "bad"};

export async function show(box, app) {
  await app.reload();
  const all = app.folder.results.sort((a, b) => b.changed - a.changed).map((one) => one.path), base = resultsName(app.study);
  if (!all.length) { fill(box, h("h1", {}, "Results"), h("p", {}, "No results in this folder yet: run a study (step 6).")); return; }
  const first = all.find((path) => base && path.startsWith(base)) || all[0];
  const choice = h("select", {id: "results", onchange: () => draw()}, options(all, first)), other = h("select", {id: "other", onchange: () => draw()}, options([["", "none"], ...all]));
  const place = h("div");
  fill(box, h("h1", {}, "Results"), h("div", {class: "row end"}, field("Results", choice), field("Beside", other)), place);
  const draw = async () => {
    try {
      const found = await get("results", {results: choice.value}), beside = other.value ? await get("results", {results: other.value}) : null;
      fill(place, verdict(found.results), changes(found.results, choice.value, found.files), values(found.results, beside?.results, choice.value, other.value), exported(choice.value, found.files),
        found.report ? h("iframe", {class: "report", sandbox: "allow-scripts", src: view(found.report), title: `Report in ${choice.value}`}) : h("p", {class: "note"}, "These results hold no report page."));
    } catch (error) { fill(place, h("div", {class: "card bad"}, error.message)); }
  };
  await draw();
}

function verdict(found) {
  const reasons = (found.verdict_reasons || []).slice(1);
  return h("section", {class: "card " + (MARKS[found.verdict] || "doubt"), id: "verdict"}, h("h2", {}, found.title || "Verdict"), h("p", {}, h("strong", {}, found.verdict_text || found.status_text || found.status || "")),
    reasons.length ? h("ul", {class: "warnings"}, reasons.map((words) => h("li", {}, words))) : null,
    (found.causes || []).length ? h("ul", {class: "warnings"}, found.causes.slice(0, 4).map((one) => h("li", {}, `${one.words}: removes ${percent(one.share)} of the misfit`))) : null,
    (found.warnings || []).length ? h("details", {}, h("summary", {}, `${found.warnings.length} warnings`), h("ul", {class: "warnings"}, found.warnings.map((words) => h("li", {}, words)))) : null);
}

// What may be wrong with the model, each as a study that can be opened and run.
function changes(found, folder, files) {
  const there = new Set(files.map((one) => one.path)), named = [...(found.causes || []), ...(found.suggestions || [])].filter((one) => one.study && there.has(`${folder}/${one.study}`));
  return named.length ? h("section", {class: "card", id: "suggested"}, h("h2", {}, "Changes of the model that were tried, each as a study"), h("ul", {class: "plain"}, named.map((one) => h("li", {},
    h("p", {}, `${one.words}: removes ${percent(one.share)} of the misfit`),
    h("details", {}, h("summary", {}, "Lines that it changes"), h("pre", {class: "log", tabindex: 0}, one.lines.join("\n"))),
    h("a", {class: "button", href: `#structure/${encodeURIComponent(`${folder}/${one.study}`)}`}, `Open ${one.study.split("/").at(-1)}`))))) : null;
}

function values(found, beside, name, otherName) {
  const rows = (found.parameters || []).slice(0, 400), of = (one) => beside?.parameters?.find((each) => each.name === one.name);
  const end = (one) => (one.interval_95?.[0] !== null && one.interval_95 ? `${quantity(one.interval_95[0], one.unit)} to ${quantity(one.interval_95[1], one.unit)}` : "");
  const header = beside ? ["parameter", name, otherName, "change", "in std"] : ["parameter", "initial", "value", "std", "95 % interval", ""];
  return h("section", {class: "card"}, h("h2", {}, "Values"), h("p", {}, found.total_mass?.value !== undefined ? `Total mass ${number(found.total_mass.value, 5)} ± ${number(found.total_mass.std ?? NaN, 2)} kg` : ""),
    table(header, rows.map((one) => {
      if (!beside) { return [one.name, quantity(one.initial, one.unit), quantity(one.value, one.unit), quantity(one.std ?? NaN, one.unit, 2), end(one), one.identified ? (one.at_bound ? "at its bound" : "") : "not identified"]; }
      const two = of(one);
      if (!two) { return [one.name, quantity(one.value, one.unit), "–", "", ""]; }
      const spread = Math.hypot(one.std ?? NaN, two.std ?? NaN);
      return [one.name, quantity(one.value, one.unit), quantity(two.value, one.unit), `${two.value > one.value ? "+" : ""}${number(100 * (two.value / one.value - 1), 3)} %`, number((two.value - one.value) / spread, 2)];
    }), [1, 2, 3, 4], rows.map((one) => (one.identified ? null : "doubtful"))), beside ? h("p", {class: "note"}, "In std: over the root of both variances, as if the two were independent; `structid compare` fits states together.") : null);
}

function exported(folder, files) {
  return h("details", {class: "card"}, h("summary", {}, "Take away"), h("p", {}, h("a", {class: "button", href: link("export", {results: folder}), download: ""}, "All of it as one archive")),
    h("ul", {class: "plain"}, files.map((one) => h("li", {}, h("a", {href: link("download", {path: one.path}), download: ""}, one.path), " ", h("span", {class: "muted"}, bytes(one.bytes))))));
}
