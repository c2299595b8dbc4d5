const LIGHT = "#E3E3E3", FRAME = {
  gridcolor: LIGHT, linecolor: "#6B6B6B", showline: true, ticks: "outside", zeroline: false, automargin: true,
  title: {font: {size: 13}, standoff: 8},
};
const TEMPLATE = {layout: {
  font: {family: "Segoe UI, Helvetica Neue, DejaVu Sans, Arial, sans-serif", size: 13, color: "#222222"},
  showlegend: false, paper_bgcolor: "white", plot_bgcolor: "white", hovermode: "closest", xaxis: FRAME, yaxis: FRAME,
  scene: Object.fromEntries(["xaxis", "yaxis", "zaxis"].map((name) => [name, {backgroundcolor: "white", gridcolor: LIGHT}])),
}};
const CONFIG = {responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "sendChartToCloud"]};
const N_FRAMES = 24;

async function unpacked(id) {
  const packed = atob(document.getElementById(id).textContent), bytes = Uint8Array.from(packed, (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
}

function startFigure(box, panels, arrays) {
  const list = box.querySelector(".chooser select"), plots = [...box.querySelectorAll(".plot")];
  const headings = [...box.querySelectorAll(".heading")], hidden = new Set(), size = box.querySelector("input");
  let phase = 0, timer = null;
  const panelOf = (i) => panels[list ? Number(list.value) : i];
  const look = (place) => (Array.isArray(place) ? place.map((i) => arrays[i]) : arrays[place]);
  const moved = (trace) => {
    const {real, imaginary, ...places} = trace.arrays, angle = 2 * Math.PI * phase / N_FRAMES, factor = size ? Number(size.value) : 1;
    return Object.fromEntries(Object.entries(places).map(([key, place], axis) => {
      if (!real) { return [key, look(place)]; }
      const re = arrays[real[axis]], im = arrays[imaginary[axis]], c = factor * Math.cos(angle), s = factor * Math.sin(angle);
      return [key, arrays[place].map((x, i) => (x === null ? null : x + re[i] * c - im[i] * s))];
    }));
  };
  const traceOf = (trace) => {
    const found = trace.arrays ? {...trace, ...moved(trace)} : {...trace};
    if (trace.rows && trace.rows.length) {
      const columns = trace.columns.length ? trace.columns.map((name) => " / " + name) : found.x.slice(1).map(() => "");
      found.text = trace.rows.map((row) => columns.map((column) => row + column));
    }
    return hidden.has(trace.name) ? {...found, visible: false} : found;
  };
  const draw = () => plots.forEach((plot, i) => {
    const panel = panelOf(i);
    phase = timer ? phase : 0;
    headings[i].textContent = panel.title;
    const config = {...CONFIG, displayModeBar: plot.clientWidth < 340 ? false : "hover"};
    Plotly.react(plot, panel.data.map(traceOf), {...panel.layout, template: TEMPLATE}, config);
  });
  const step = (by) => {
    list.value = String((Number(list.value) + by + list.options.length) % list.options.length);
    draw();
  };
  const animate = () => {
    phase = (phase + 1) % N_FRAMES;
    const data = panelOf(0).data, which = data.flatMap((trace, i) => (trace.arrays && trace.arrays.real ? [i] : []));
    const places = which.map((i) => moved(data[i]));
    Plotly.restyle(plots[0], Object.fromEntries(Object.keys(places[0]).map((key) => [key, places.map((p) => p[key])])), which);
  };
  const on = (selector, event, action) => box.querySelectorAll(selector).forEach((part) => part.addEventListener(event, action));
  on(".chooser select, .chooser input", "change", draw);
  on(".previous", "click", () => step(-1));
  on(".next", "click", () => step(1));
  on(".play", "click", () => { timer = timer || setInterval(animate, 60); });
  on(".pause", "click", () => { clearInterval(timer); timer = null; });
  on(".legend button", "click", (event) => {
    const name = event.currentTarget.dataset.name;
    event.currentTarget.setAttribute("aria-pressed", String(hidden.has(name)));
    if (!hidden.delete(name)) { hidden.add(name); }
    draw();
  });
  draw();
}

async function start() {
  if (!("DecompressionStream" in window)) { document.getElementById("too-old").hidden = false; return; }
  const library = document.createElement("script");
  library.textContent = await unpacked("library");
  document.head.append(library);
  const {figures, arrays} = JSON.parse(await unpacked("figures"));
  for (const [name, panels] of Object.entries(figures)) {
    const box = document.getElementById("figure-" + name);
    if (box) { startFigure(box, panels, arrays); }
  }
}
start();
