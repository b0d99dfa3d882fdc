// ---- app: time, controls and keys ----

const SPEEDS = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1];
const ICONS = { play: "M3 1.5v13l11-6.5z", pause: "M3 2h3.6v12H3zM9.4 2H13v12H9.4z" };
const byId = (id) => document.getElementById(id);

const data = JSON.parse(byId("data").textContent);
const runs = data.runs.map(decodeAll);
const times = unionOf(runs.map((run) => run.time));
const state = { time: times[0], playing: false, speed: 1, last: 0, queued: false };

const extent = [0, 1, 2, 3].map((k) => (k < 2 ? Math.min : Math.max)(...runs.map((run) => run.extent[k])));
const view = new View(byId("stage"), extent, () => draw());
const painter = new Painter(view, runs);
const charts = new Charts(byId("charts"), runs, data.labels, seek);

function draw() {
  if (state.queued) return;
  state.queued = true;
  requestAnimationFrame(step);
}

function step(now) {
  state.queued = false;
  if (state.playing) advance(Math.min(now - state.last, 100) / 1000);
  state.last = now;
  show();
  if (state.playing) draw();
}

function advance(seconds) {
  const end = times[times.length - 1];
  state.time += state.speed * seconds;
  if (state.time < end) return;
  if (byId("loop").checked) state.time = times[0];
  else { state.time = end; setPlaying(false); }
}

function show() {
  const frame = nearest(times, state.time);
  painter.paint(state.time, { color: byId("color").value, arrows: byId("arrows").checked, names: byId("names").checked });
  charts.show(state.time);
  byId("scrub").value = frame;
  byId("time").textContent = `${state.time.toFixed(4)} s \u00b7 ${frame + 1}/${times.length}`;
}

function seek(time) {
  state.time = Math.min(Math.max(time, times[0]), times[times.length - 1]);
  draw();
}

function setPlaying(playing) {
  if (playing && state.time >= times[times.length - 1]) state.time = times[0];
  state.playing = playing;
  state.last = performance.now();
  byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  byId("play").querySelector("path").setAttribute("d", playing ? ICONS.pause : ICONS.play);
  draw();
}

function stepFrames(count) {
  setPlaying(false);
  const frame = nearest(times, state.time) + count;
  seek(times[Math.min(Math.max(frame, 0), times.length - 1)]);
}

function setSpeed(index) {
  const chosen = Math.min(Math.max(index, 0), SPEEDS.length - 1);
  byId("speed").selectedIndex = chosen;
  state.speed = SPEEDS[chosen];
}

const KEYS = {
  " ": () => setPlaying(!state.playing),
  ArrowRight: (event) => stepFrames(event.shiftKey ? 10 : 1),
  ArrowLeft: (event) => stepFrames(event.shiftKey ? -10 : -1),
  ArrowUp: () => setSpeed(byId("speed").selectedIndex + 1),
  ArrowDown: () => setSpeed(byId("speed").selectedIndex - 1),
  Home: () => seek(times[0]),
  End: () => seek(times[times.length - 1]),
  "+": () => view.zoom(1.25),
  "=": () => view.zoom(1.25),
  "-": () => view.zoom(0.8),
  0: () => view.fit(),
};

function onKey(event) {
  const act = KEYS[event.key], element = event.target.tagName;
  if (!act || event.ctrlKey || event.metaKey || event.altKey || element === "SELECT") return;
  if (event.key === " " && (element === "BUTTON" || element === "SUMMARY" || event.target.type === "checkbox")) return;
  event.preventDefault();
  act(event);
}

function fillHeader() {
  runs.forEach((run, r) => {
    if (runs.length < 2) return;
    const item = document.createElement("span"), line = document.createElement("i");
    line.style.borderColor = r ? "var(--after)" : "var(--plain)";
    item.append(line, r ? `${data.labels[r]} (curves dashed)` : data.labels[r]);
    byId("runs").append(item);
  });
  const failed = runs.flatMap((run, r) => (run.failure ? `${runs.length > 1 ? `${data.labels[r]} failed` : "Failed"} ${run.failure}` : []));
  byId("failed").hidden = failed.length === 0;
  byId("failed").textContent = failed.join("; ");
}

function connect() {
  byId("scrub").max = times.length - 1;
  byId("scrub").addEventListener("input", () => { setPlaying(false); seek(times[Number(byId("scrub").value)]); });
  byId("play").addEventListener("click", () => setPlaying(!state.playing));
  byId("zoom-in").addEventListener("click", () => view.zoom(1.25));
  byId("zoom-out").addEventListener("click", () => view.zoom(0.8));
  byId("fit").addEventListener("click", () => view.fit());
  for (const speed of SPEEDS) byId("speed").append(new Option(speed < 1 ? `1/${Math.round(1 / speed)}` : "1"));
  byId("speed").addEventListener("change", () => setSpeed(byId("speed").selectedIndex));
  for (const id of ["speed", "color"]) byId(id).addEventListener("change", () => { byId(id).blur(); draw(); });
  for (const id of ["arrows", "names", "loop"]) byId(id).addEventListener("change", draw);
  window.addEventListener("keydown", onKey);
  new ResizeObserver(() => view.resize()).observe(byId("stage"));
  new ResizeObserver(() => { charts.resize(); draw(); }).observe(byId("charts"));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { painter.readColors(); charts.build(); draw(); });
}

function begin() {
  const slow = (times[times.length - 1] - times[0]) / 8;
  fillHeader();
  connect();
  setSpeed(Math.max(0, SPEEDS.findLastIndex((speed) => speed <= slow * 1.01)));
  view.resize();
}

begin();
window.diffeed = { state, runs, times, view, charts, painter, show };
