const CONFIG = {responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "sendChartToCloud"]};
for (const [name, figure] of Object.entries(FIGURES)) {
  const place = document.getElementById("figure-" + name);
  if (place) { Plotly.newPlot(place, figure.data, figure.layout, CONFIG); }
}
function showChannel(name, chooser) {
  const figure = FIGURES[name], chosen = figure.channels[Number(chooser.value)];
  figure.data.forEach((trace, i) => { trace.y = chosen.y[i]; });
  figure.layout.yaxis.title.text = chosen.title;
  figure.layout.yaxis.range = chosen.range;
  figure.layout.title.text = chosen.heading;
  Plotly.react(document.getElementById("figure-" + name), figure.data, figure.layout, CONFIG);
}
for (const box of document.querySelectorAll(".chooser[data-figure]")) {
  const name = box.dataset.figure, chooser = box.querySelector("select"), [previous, next] = box.querySelectorAll("button");
  const step = (by) => {
    const count = chooser.options.length;
    chooser.value = String((Number(chooser.value) + by + count) % count);
    showChannel(name, chooser);
  };
  chooser.addEventListener("change", () => showChannel(name, chooser));
  previous.addEventListener("click", () => step(-1));
  next.addEventListener("click", () => step(1));
}
