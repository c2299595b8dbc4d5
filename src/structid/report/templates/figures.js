const LIGHT = "#E3E3E3",
  FRAME = {
    gridcolor: LIGHT,
    linecolor: "#6B6B6B",
    showline: true,
    ticks: "outside",
    zeroline: false,
    automargin: true,
    title: {font: {size: 13}, standoff: 8},
  };
const TEMPLATE = {
  layout: {
    font: {family: "Segoe UI, Helvetica Neue, DejaVu Sans, Arial, sans-serif", size: 13, color: "#222222"},
    showlegend: false,
    paper_bgcolor: "white",
    plot_bgcolor: "white",
    hovermode: "closest",
    xaxis: FRAME,
    yaxis: FRAME,
    scene: Object.fromEntries(
      ["xaxis", "yaxis", "zaxis"].map((name) => [name, {backgroundcolor: "white", gridcolor: LIGHT}]),
    ),
  },
};
const CONFIG = {
  responsive: true,
  displaylogo: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "sendChartToCloud"],
};
const N_FRAMES = 24,
  LIBRARIES = {},
  redrawn = []; // functions that draw figures of equal scales anew in the present width
const hasEqualScales = ({layout}) => Boolean(layout?.yaxis?.scaleanchor);

// Draw in `plot` by the part of the library that can. The library writes the domains of equal scales into its layout and begins
// with them when it resizes: such a drawing would shrink each time, so it gets a layout of its own and is drawn anew instead.
function react(plot, panel, data, layout, config) {
  plot.library = LIBRARIES[panel.layout.scene ? "library-space" : "library-plane"];
  const own = {...structuredClone(layout), template: TEMPLATE};
  plot.library.react(plot, data, own, {...config, responsive: !hasEqualScales(panel)});
}

async function unpacked(id) {
  const packed = atob(document.getElementById(id).textContent),
    bytes = Uint8Array.from(packed, (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
}

// The length of an axis with limits, in its own unit.
const span = ({range}) => Math.abs(range[1] - range[0]);
// A drawing on a telephone: the bar of colours below it, and no labels, which would cover each other; a tap names an element.
const isBare = (panel) => panel.layout.xaxis?.visible === false;
function slim(plot, panel, data) {
  const axis = panel.layout.coloraxis,
    bar = {orientation: "h", thickness: 10, y: 0, yanchor: "top", xanchor: "center", x: 0.5};
  const coloraxis = axis && {
    ...axis,
    colorbar: {...axis.colorbar, ...bar, title: {...axis.colorbar.title, side: "top"}},
  };
  const {xaxis, yaxis} = panel.layout,
    below = axis ? 64 : 4;
  const height = Math.min(panel.layout.height, ((plot.clientWidth - 8) * span(yaxis)) / span(xaxis) + below);
  const layout = {...panel.layout, height, margin: {l: 4, r: 4, t: 4, b: below}, ...(axis ? {coloraxis} : {})};
  plot.style.height = `${height}px`;
  return [data.filter((trace) => trace.mode !== "markers+text"), layout];
}

// The height in which a drawing with equal scales along both axes fills the width: a slender structure is no strip in a blank square.
function filled(plot, panel) {
  const {xaxis, yaxis, height} = panel.layout;
  if (!hasEqualScales(panel) || !xaxis.range || !yaxis.range) {
    return panel.layout;
  }
  const tall = ((plot.clientWidth - 70) * span(yaxis)) / span(xaxis) + 90;
  return {...panel.layout, height: Math.min(height, Math.max(200, tall))};
}

function startFigure(box, panels, arrays) {
  const list = box.querySelector(".chooser select"),
    plots = [...box.querySelectorAll(".plot")];
  const headings = [...box.querySelectorAll(".heading")],
    hidden = new Set(),
    size = box.querySelector("input");
  let phase = 0,
    timer = null;
  const panelOf = (i) => panels[list ? Number(list.value) : i];
  const look = (place) => (Array.isArray(place) ? place.map((i) => arrays[i]) : arrays[place]);
  const moved = (trace) => {
    const {real, imaginary, ...places} = trace.arrays,
      angle = (2 * Math.PI * phase) / N_FRAMES,
      factor = size ? Number(size.value) : 1;
    return Object.fromEntries(
      Object.entries(places).map(([key, place], axis) => {
        if (!real) {
          return [key, look(place)];
        }
        const re = arrays[real[axis]],
          im = arrays[imaginary[axis]],
          c = factor * Math.cos(angle),
          s = factor * Math.sin(angle);
        return [key, arrays[place].map((x, i) => (x === null ? null : x + re[i] * c - im[i] * s))];
      }),
    );
  };
  const traceOf = (trace) => {
    const found = trace.arrays ? {...trace, ...moved(trace)} : {...trace};
    if (trace.rows && trace.rows.length) {
      const columns = trace.columns.length ? trace.columns.map((name) => " / " + name) : found.x.slice(1).map(() => "");
      found.text = trace.rows.map((row) => columns.map((column) => row + column));
    }
    return hidden.has(trace.name) ? {...found, visible: false} : found;
  };
  const draw = () =>
    plots.forEach((plot, i) => {
      const panel = panelOf(i);
      headings[i].textContent = panel.title;
      const config = {...CONFIG, displayModeBar: plot.clientWidth < 340 ? false : "hover"};
      const data = panel.data.map(traceOf),
        isNarrow = plot.clientWidth < 520 && isBare(panel);
      const layout = isBare(panel) ? panel.layout : filled(plot, panel);
      if (!isNarrow) {
        plot.style.height = `${layout.height}px`;
      }
      react(plot, panel, ...(isNarrow ? slim(plot, panel, data) : [data, layout]), config);
    });
  const drawChosen = () => {
    phase = timer ? phase : 0;
    draw();
  };
  const step = (by) => {
    list.value = String((Number(list.value) + by + list.options.length) % list.options.length);
    drawChosen();
  };
  const animate = () => {
    phase = (phase + 1) % N_FRAMES;
    const data = panelOf(0).data,
      which = data.flatMap((trace, i) => (trace.arrays && trace.arrays.real ? [i] : []));
    const places = which.map((i) => moved(data[i]));
    plots[0].library.restyle(
      plots[0],
      Object.fromEntries(Object.keys(places[0]).map((key) => [key, places.map((p) => p[key])])),
      which,
    );
  };
  // All panels at once, small, in place of one at a time.
  const grid = box.querySelector(".grid"),
    all = box.querySelector(".all");
  const drawAll = () =>
    panels.forEach((panel, i) => {
      if (!grid.children[i]) {
        const heading = document.createElement("p"),
          plot = document.createElement("div");
        heading.className = "heading";
        heading.textContent = panel.title;
        plot.className = "plot";
        grid.append(document.createElement("div"));
        grid.children[i].append(heading, plot);
      }
      const place = grid.children[i].lastChild,
        bare = ([name, axis]) => [name, name.includes("axis") ? {...axis, title: {text: ""}, nticks: 5} : axis];
      place.style.height = "300px";
      react(
        place,
        panel,
        panel.data.map(traceOf),
        {...Object.fromEntries(Object.entries(panel.layout).map(bare)), height: 300, margin: {l: 4, r: 4, t: 6, b: 24}},
        {...CONFIG, displayModeBar: false},
      );
    });
  const drawAgain = () => (all && !grid.hidden ? drawAll() : draw());
  if (panels.some(hasEqualScales)) {
    redrawn.push(() => box.clientWidth && drawAgain());
  }
  if (all) {
    all.addEventListener("click", () => {
      const open = grid.hidden;
      grid.hidden = !open;
      plots[0].parentNode.parentNode.hidden = open;
      all.setAttribute("aria-expanded", String(open));
      if (open) {
        drawAll();
      } else {
        draw();
      }
    });
  }
  const on = (selector, event, action) =>
    box.querySelectorAll(selector).forEach((part) => part.addEventListener(event, action));
  on(".chooser select", "change", drawChosen);
  on(".chooser input", "change", draw);
  matchMedia("(max-width: 600px)").addEventListener("change", draw);
  on(".previous", "click", () => step(-1));
  on(".next", "click", () => step(1));
  on(".play", "click", () => {
    timer = timer || setInterval(animate, 60);
  });
  on(".pause", "click", () => {
    clearInterval(timer);
    timer = null;
  });
  on(".legend button", "click", (event) => {
    const name = event.currentTarget.dataset.name;
    event.currentTarget.setAttribute("aria-pressed", String(hidden.has(name)));
    if (!hidden.delete(name)) {
      hidden.add(name);
    }
    drawAgain();
  });
  draw();
}

// Call `draw` once no fold hides `box`: a figure has no width before.
function whenOpen(box, draw) {
  const fold = box.closest("details:not([open])");
  if (fold) {
    fold.addEventListener("toggle", () => whenOpen(box, draw), {once: true});
  } else {
    draw();
  }
}

async function start() {
  if (!("DecompressionStream" in window)) {
    document.getElementById("too-old").hidden = false;
    return;
  }
  for (const part of document.querySelectorAll("script.library")) {
    const library = document.createElement("script");
    library.textContent = await unpacked(part.id);
    document.head.append(library);
    LIBRARIES[part.id] = window.Plotly;
  }
  const {figures, arrays} = JSON.parse(await unpacked("figures"));
  for (const [name, panels] of Object.entries(figures)) {
    const box = document.getElementById("figure-" + name);
    if (box) {
      whenOpen(box, () => startFigure(box, panels, arrays));
    }
  }
}
// On paper the page is narrower than on the screen.
const redraw = () => redrawn.forEach((draw) => draw());
const fitted = () => {
  document.querySelectorAll(".plot").forEach((plot) => {
    if (plot.clientWidth && !hasEqualScales(plot)) {
      plot.library?.Plots.resize(plot);
    }
  });
  redraw();
};
let redrawing = 0,
  width = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === width) {
    return; // a telephone shows or hides the bar of its address
  }
  width = window.innerWidth;
  clearTimeout(redrawing);
  redrawing = setTimeout(redraw, 100);
});
matchMedia("print").addEventListener("change", fitted);
// Paper shows what is folded too.
const folds = () => document.querySelectorAll("details:not([open])");
let opened = [];
window.addEventListener("beforeprint", () => {
  opened = [...folds()];
  opened.forEach((fold) => {
    fold.open = true;
    fold.dispatchEvent(new Event("toggle"));
  });
  fitted();
});
window.addEventListener("afterprint", () => {
  opened.forEach((fold) => {
    fold.open = false;
  });
  fitted();
});
start();
