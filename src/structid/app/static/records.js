// Records: time histories by least and greatest of stretches, responses with coherence, and the band by dragging.
import {get, post} from "./api.js";
import {chart, colours} from "./charts.js";
import {field, fill, h, options, typed, unitText, unpacked} from "./dom.js";
import {facts, givenOptions} from "./start.js";
import {recordPath} from "./structure.js";

export async function show(box, app) {
  const files = app.folder.records.map((one) => one.path), folder = app.study.includes("/") ? app.study.slice(0, app.study.lastIndexOf("/") + 1) : "";
  const record = [app.now?.table?.record].flat()[0], own = record ? folder + [record.path, ...(record.repeats || [])].filter(Boolean)[0] : "";
  if (!files.length) { fill(box, h("h1", {}, "Records"), h("p", {}, "This folder holds no record yet: drop one on the start page.")); return; }
  const choice = h("select", {id: "record", onchange: () => look()}, options(files, files.includes(own) ? own : files[0]));
  const what = h("section", {class: "card"}), histories = h("section", {class: "card", hidden: true}), responses = h("section", {class: "card", hidden: true});
  fill(box, h("h1", {}, "Records"), h("div", {class: "row"}, field("Record", choice)), what, histories, responses);
  const look = async () => {
    const path = choice.value, given = givenOptions(app, path);
    fill(what, h("p", {class: "muted"}, "Reading…"));
    histories.hidden = responses.hidden = true;
    try {
      const found = await post("facts", {record: path, options: given});
      if (choice.value !== path) { return; }
      fill(what, facts(found));
      const jobs = [];
      if (found.kind === "time histories") { histories.hidden = false; jobs.push(time(histories, app, path, given, found)); }
      if (app.study && path === own && found.kind !== "modes") { responses.hidden = false; jobs.push(lines(responses, app)); }
      await Promise.all(jobs);
    } catch (error) { fill(what, h("p", {class: "state bad", style: {"white-space": "normal"}}, error.message), h("p", {class: "note"}, "On the start page, say what the file does not say about itself.")); }
  };
  await look();
}

async function time(box, app, record, given, found) {
  const shown = new Set(found.channels.slice(0, 4).map((one, k) => k)), place = h("div", {class: "plot", id: "histories"}), words = h("p", {class: "note", "aria-live": "polite"});
  const from = h("input", {inputmode: "decimal", value: "0"}), to = h("input", {inputmode: "decimal", value: typed(found.seconds)});
  const button = h("button", {type: "button", onclick: () => app.doing(button, () => draw(Number(from.value), Number(to.value)))}, "Show");
  const all = h("button", {type: "button", onclick: () => app.doing(all, () => draw(0, null))}, "All");
  fill(box, h("h2", {}, "Time histories"), channelList(found.channels.map((one) => one.name + (one.quantity ? " " + one.quantity : "")), shown, () => draw(...range)),
    h("div", {class: "row end"}, field("from, s", from, "short"), field("to, s", to, "short"), button, all), place, words);
  let range = [0, null], turn = 0;
  const draw = async (first, last) => {
    range = [first, last];
    const now = ++turn, told = await post("histories", {record, options: given, first, last, points: Math.max(200, Math.min(1600, place.clientWidth))});
    if (now !== turn) { return; }
    const wanted = [...shown].sort((a, b) => a - b), at = unpacked(told.time, "f64"), traces = [], layout = {uirevision: "kept", dragmode: "zoom", again: () => draw(first, last).catch(app.fail)};
    wanted.forEach((k, row) => {
      const low = unpacked(told.low[k], "f32"), high = unpacked(told.high[k], "f32"), x = new Float64Array(2 * at.length), y = new Float32Array(2 * at.length);
      at.forEach((t, i) => { x[2 * i] = x[2 * i + 1] = t; y[2 * i] = low[i]; y[2 * i + 1] = high[i]; });
      const tag = row ? String(row + 1) : "";
      traces.push({x, y, name: told.names[k], mode: "lines", line: {width: 1, color: colours()[row % 7]}, yaxis: "y" + tag, hovertemplate: "%{x:.6g} s: %{y:.4g}<extra></extra>", showlegend: false});
      layout["yaxis" + tag] = {domain: [1 - (row + 1) / wanted.length + 0.02, 1 - row / wanted.length - 0.02], title: {text: `${told.names[k].replace(/ (\w+)$/, "<br>$1")}, ${unitText(told.units[k])}`, font: {size: 11}}, nticks: 4, fixedrange: true};
    });
    layout.xaxis = {title: {text: "time, s"}, anchor: "y" + (wanted.length > 1 ? wanted.length : ""), range: [first, last ?? told.seconds]};
    place.style.height = `${Math.max(220, 60 + 120 * wanted.length)}px`;
    const Plotly = await chart(place, traces, layout);
    fill(words, told.sampled ? "Some samples of a long record; all of it is being read, once." : `${at.length} stretches, each with its least and greatest value. Drag to zoom, double-click for all.`);
    if (told.sampled) { setTimeout(() => { if (now === turn && place.isConnected) { draw(first, last).catch(app.fail); } }, 2000); }
    if (!place.listening) {
      place.listening = true;
      place.on("plotly_relayout", (change) => {
        if (change["xaxis.range[0]"] !== undefined) { from.value = typed(change["xaxis.range[0]"]); to.value = typed(change["xaxis.range[1]"]); draw(Math.max(0, change["xaxis.range[0]"]), change["xaxis.range[1]"]).catch(app.fail); }
        else if (change["xaxis.autorange"]) { draw(0, null).catch(app.fail); }
      });
    }
    return Plotly;
  };
  await draw(0, null);
}

function channelList(names, shown, changed) {
  return h("details", {open: names.length <= 8}, h("summary", {}, `Channels (${names.length})`), h("div", {class: "row"}, names.slice(0, 200).map((name, k) => h("label", {class: "check"},
    h("input", {type: "checkbox", checked: shown.has(k), onchange: (event) => { if (event.target.checked) { shown.add(k); } else { shown.delete(k); } if (shown.size) { changed(); } }}), name))));
}

async function lines(box, app) {
  const place = h("div", {class: "plot tall", id: "responses"}), shown = new Set([0]), bandPlace = h("div");
  fill(box, h("h2", {}, "Responses"), h("p", {class: "muted"}, "Computing…"));
  let told = null;
  try { told = await post("responses", {study: app.study, outputs: []}); } catch (error) { fill(box, h("h2", {}, "Responses"), h("p", {class: "state bad", style: {"white-space": "normal"}}, error.message)); return; }
  const mode = h("select", {id: "drag"}, options([["zoom", "zooms"], ["band", "sets the band"], ["exclude", "leaves lines out"]]));
  mode.addEventListener("change", () => draw());
  fill(box, h("h2", {}, `Responses: ${told.kind}, ${unitText(told.unit)}`), channelList(told.pairs.map((one) => `${one.output} / ${one.input}`), shown, () => draw()),
    h("div", {class: "row end"}, field("Dragging", mode), bandPlace), place, h("p", {class: "note"}, `Noise: ${told.noise}. ${told.thinned > 1 ? `Every ${told.thinned}th line is drawn.` : ""}`));
  const f = unpacked(told.frequency, "f64");
  const set = async (edit, words) => { if (await app.edit([edit], words)) { const method = app.now.table.method || {}; told.band = method.band ?? null; told.exclude = method.exclude ?? []; bands(); await draw(); } };
  const bands = () => {
    const low = h("input", {value: typed(told.band?.[0] ?? f[0], 5), inputmode: "decimal"}), high = h("input", {value: typed(told.band?.[1] ?? f.at(-1), 5), inputmode: "decimal"});
    const button = h("button", {type: "button", onclick: () => app.doing(button, () => set({set: ["method", "band"], to: written([Number(low.value), Number(high.value)])}, "The band is set"))}, "Set band");
    const out = (told.exclude || []).length ? h("button", {type: "button", onclick: (event) => app.doing(event.target, () => set({remove: ["method", "exclude"]}, "No line is left out"))}, `Take the ${told.exclude.length} stretches left out back in`) : null;
    fill(bandPlace, h("div", {class: "row end"}, field("band from, Hz", low, "short"), field("to, Hz", high, "short"), button, out));
  };
  const draw = async () => {
    const traces = [], hasCoherence = told.pairs.some((one) => one.coherence), pair = [...shown].sort((a, b) => a - b);
    pair.forEach((k, row) => {
      const one = told.pairs[k], colour = colours()[row % 7], name = `${one.output} / ${one.input}`;
      const common = {x: f, mode: "lines", line: {width: 1.3, color: colour}, name, legendgroup: name};
      traces.push({...common, y: unpacked(one.magnitude, "f32"), hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra>" + "</extra>"}, {...common, y: unpacked(one.phase, "f32"), yaxis: "y2", showlegend: false, hovertemplate: "%{x:.5g} Hz: %{y:.0f}°<extra></extra>"});
      if (one.coherence) { traces.push({...common, y: unpacked(one.coherence, "f32"), yaxis: "y3", showlegend: false}); }
      if (one.error) { traces.push({...common, y: unpacked(one.error, "f32").map((x) => 100 * x), yaxis: hasCoherence ? "y4" : "y3", showlegend: false, hovertemplate: "%{x:.5g} Hz: %{y:.2g} %<extra></extra>"}); }
    });
    const hasError = told.pairs.some((one) => one.error), below = Number(hasCoherence) + Number(hasError), step = 0.19, at = (k) => [k * step, k * step + step - 0.04];
    const layout = {again: () => draw(), uirevision: "kept" + mode.value, dragmode: mode.value === "zoom" ? "zoom" : "select", selectdirection: "h", xaxis: {title: {text: "frequency, Hz"}, anchor: below ? `y${2 + below}` : "y2"},
      yaxis: {type: "log", exponentformat: "power", title: {text: `magnitude, ${unitText(told.unit)}`}, domain: [(below + 1) * step, 1]}, yaxis2: {title: {text: "phase, °", font: {size: 11}}, range: [-185, 185], tickvals: [-180, 0, 180], domain: at(below)}};
    if (hasCoherence) { layout.yaxis3 = {title: {text: "coherence", font: {size: 11}}, range: [0, 1.03], domain: at(Number(hasError)), nticks: 3}; }
    if (hasError) { layout[hasCoherence ? "yaxis4" : "yaxis3"] = {title: {text: "error, %", font: {size: 11}}, domain: at(0), type: "log", nticks: 3, exponentformat: "power"}; }
    layout.shapes = [];
    const veil = (x0, x1) => layout.shapes.push({type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: "rgba(128,128,128,0.22)", line: {width: 0}});
    if (told.band) { veil(f[0], told.band[0]); veil(told.band[1], f.at(-1)); }
    for (const [low, high] of told.exclude || []) { veil(low, high); }
    place.style.height = "620px";
    await chart(place, traces, layout);
    if (!place.listening) {
      place.listening = true;
      place.on("plotly_selected", (event) => {
        const range = event?.range?.x;
        if (!range || mode.value === "zoom") { return; }
        const [low, high] = [Math.max(range[0], 0), range[1]], told_ = written([low, high]);
        if (told_ === place.last) { return; } // drawing anew tells the same range again
        place.last = told_;
        if (mode.value === "band") { set({set: ["method", "band"], to: written([low, high])}, "The band is set"); }
        else { set({set: ["method", "exclude"], to: `[${[...(told.exclude || []), [low, high]].map(written).join(", ")}]`}, "These lines are left out"); }
      });
    }
  };
  bands();
  await draw();
}

const written = (ends) => `[${ends.map((x) => { const text = String(Number(x.toPrecision(5))); return /[.e]/.test(text) ? text : text + ".0"; }).join(", ")}]`;
