const CONFIG = {responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "sendChartToCloud"]};
for (const [name, figure] of Object.entries(FIGURES)) {
  const place = document.getElementById("figure-" + name);
  if (place) { Plotly.newPlot(place, figure.data, figure.layout, CONFIG); }
}
const chooser = document.getElementById("channel");
function showChannel() {
  const figure = FIGURES["responses"], chosen = figure.channels[Number(chooser.value)];
  figure.data.forEach((trace, i) => { trace.y = chosen.y[i]; });
  figure.layout.yaxis.title.text = chosen.title;
  figure.layout.yaxis.range = chosen.range;
  figure.layout.title.text = chosen.heading;
  Plotly.react(document.getElementById("figure-responses"), figure.data, figure.layout, CONFIG);
}
function step(by) {
  const count = chooser.options.length;
  chooser.value = String((Number(chooser.value) + by + count) % count);
  showChannel();
}
chooser.addEventListener("change", showChannel);
document.getElementById("previous").addEventListener("click", () => step(-1));
document.getElementById("next").addEventListener("click", () => step(1));
