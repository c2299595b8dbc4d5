// Charts by Plotly, loaded when the first one is shown; colours follow light and dark.
import {checkbox, fill, h} from "./dom.js";

let library = null;

export function plotly() {
  library =
    library ||
    new Promise((done, failed) => {
      const script = document.createElement("script");
      script.src = "static/plotly.js";
      script.onload = () => done(window.Plotly);
      script.onerror = () => {
        library = null;
        failed(new Error("the part that draws did not arrive; reload the page"));
      };
      document.head.append(script);
    });
  return library;
}

const dark = matchMedia("(prefers-color-scheme: dark)");
dark.addEventListener("change", () => {
  for (const place of document.querySelectorAll(".plot")) {
    place.again?.();
  }
});
export const colours = () =>
  dark.matches
    ? ["#6cb6ff", "#ff9a5c", "#5fd3a6", "#f0c05a", "#e39ac0", "#8fd3f4", "#d0d4d8"]
    : ["#0072B2", "#D55E00", "#007a5a", "#b07800", "#a8558a", "#2f8fc4", "#333333"];
export const ink = () => getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();

// Names come from files: Plotly would make links and markup of them.
const plain = (text) => (typeof text === "string" ? text.replace(/&/g, "&amp;").replace(/</g, "&lt;") : text);

// `again` draws a chart anew where its colours were chosen by the caller; by default the same traces in the new scheme.
export async function chart(place, traces, layout, settings = {}) {
  const Plotly = await plotly();
  place.again = layout.again || (() => chart(place, traces, layout, settings));
  const style = getComputedStyle(document.documentElement),
    of = (name) => style.getPropertyValue(name).trim();
  const axis = {
    gridcolor: of("--line"),
    linecolor: of("--muted"),
    zeroline: false,
    showline: true,
    ticks: "outside",
    tickcolor: of("--muted"),
    automargin: true,
  };
  const full = {
    font: {color: of("--ink"), size: 13, family: "Segoe UI, Helvetica Neue, DejaVu Sans, Arial, sans-serif"},
    paper_bgcolor: of("--paper"),
    plot_bgcolor: of("--paper"),
    margin: {l: 60, r: 14, t: 10, b: 46},
    colorway: colours(),
    hovermode: "closest",
    showlegend: place.clientWidth > 480 && traces.filter((one) => one.name && one.showlegend !== false).length > 1,
    selections: [],
    legend: {orientation: "h", y: 1.02, yanchor: "bottom", x: 0},
    ...layout,
  };
  for (const name of new Set(["xaxis", "yaxis", ...Object.keys(full).filter((key) => /^[xy]axis\d*$/.test(key))])) {
    full[name] = {...axis, ...full[name]};
  }
  if (place.clientWidth < 520) {
    full.margin = {...full.margin, l: 44, r: 8};
  }
  delete full.again;
  await Plotly.react(
    place,
    traces.map((one) => ({...one, name: plain(one.name)})),
    full,
    {
      responsive: true,
      displaylogo: false,
      modeBarButtonsToRemove: ["lasso2d", "sendChartToCloud", "toImage"],
      displayModeBar: place.clientWidth < 500 ? false : "hover",
      ...settings,
    },
  );
  return Plotly;
}

// Checkboxes of the channels that a chart shows; `shown` is the set of their numbers.
export function channelList(names, shown, changed) {
  const summary = h("summary");
  // A chart of one channel has no legend: the words above it name the channel.
  const say = () => {
    const which = shown.size === 1 ? names[[...shown][0]] : shown.size;
    fill(summary, `Channels: ${which} of ${names.length} shown`);
  };
  say();
  return h(
    "details",
    {open: names.length <= 8},
    summary,
    h(
      "div",
      {class: "row"},
      names.slice(0, 200).map((name, k) =>
        checkbox(
          shown.has(k),
          (isOn) => {
            shown[isOn ? "add" : "delete"](k);
            say();
            if (shown.size) {
              changed();
            }
          },
          name,
        ),
      ),
    ),
  );
}
