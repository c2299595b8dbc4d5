const MOTION = FIGURES.shapes.motion, STAGE = document.getElementById("figure-shapes"), N_FRAMES = 24;
const chosenMode = document.getElementById("mode"), chosenSize = document.getElementById("size");
function pathsAt(phase) {
  const mode = Number(chosenMode.value), size = Number(chosenSize.value), c = Math.cos(phase), s = Math.sin(phase);
  const re = MOTION.real[mode], im = MOTION.imaginary[mode];
  const place = (i, axis) => MOTION.rest[i][axis] + size * (re[i][axis] * c - im[i][axis] * s);
  return MOTION.paths.map((path) => {
    const trace = {};
    ["x", "y", "z"].slice(0, MOTION.rest[0].length).forEach((name, axis) => {
      trace[name] = path.map((i) => (i < 0 ? null : place(i, axis)));
    });
    return trace;
  });
}
const moving = MOTION.paths.map((_, i) => MOTION.first + i);
const AT_ONCE = {mode: "immediate", frame: {duration: 0, redraw: true}, transition: {duration: 0}};
let timer = null, phase = 0;
function showPhase() { return Plotly.animate(STAGE, ["phase" + phase], AT_ONCE).catch(() => {}); }  // a later one came first
async function showMode() {
  const frames = [];
  for (let k = 0; k < N_FRAMES; k += 1) {
    frames.push({name: "phase" + k, data: pathsAt(2 * Math.PI * k / N_FRAMES), traces: moving});
  }
  await Plotly.addFrames(STAGE, frames);  // those of the same names are replaced
  if (timer === null) { phase = 0; }
  await showPhase();
}
function play() {
  if (timer === null) { timer = setInterval(() => { phase = (phase + 1) % N_FRAMES; showPhase(); }, 60); }
}
function pause() {
  clearInterval(timer);
  timer = null;
}
function stepMode(by) {
  const count = chosenMode.options.length;
  chosenMode.value = String((Number(chosenMode.value) + by + count) % count);
  showMode();
}
const [earlier, later] = document.querySelectorAll("#motion button");
earlier.addEventListener("click", () => stepMode(-1));
later.addEventListener("click", () => stepMode(1));
chosenMode.addEventListener("change", showMode);
chosenSize.addEventListener("change", showMode);
document.getElementById("play").addEventListener("click", play);
document.getElementById("pause").addEventListener("click", pause);
showMode();
