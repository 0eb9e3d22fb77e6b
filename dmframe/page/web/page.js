// The page: what its reader moves, what is simulated then, and what is shown of it.

const find = (id) => document.getElementById(id);
const content = JSON.parse(find("data").textContent);
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
const QUICK = 20; // a run that would take longer is shortened while a slider is being moved [ms]
const SLOWEST = 32; // a clock may be moved by this factor
const FASTEST = 0.00025; // and to this period [s]

const loop = await loaded(content).catch((error) => {
  find("headline").textContent = "This browser cannot run the page";
  find("says").textContent = `WebAssembly and DecompressionStream are needed: ${error.message}`;
  throw error;
});
if (content.robot) content.robot.meshes = await Promise.all(content.robot.meshes.map(unfolded));
const moved = new Map(); // by a slider's label: its factor, or its shift
const plots = [], sliders = [], said = new Map(); // by an element's id: its text
// `perMs`: how much work of the solver a millisecond takes, as last seen
let run = null, perMs = Infinity, scene = null, inks = {}, frames = null;
let time = 0, hover = null, playing = !still, pace = 1, before = 0, told = 0, waiting = false;
let asked = null, held = false;

// ---- what is moved

const GROUPS = {
  controller: ["Controller", "Its gains. Adaptation starts from the file's values."],
  hidden: ["Servo and robot", "The truth, hidden from the controller."],
  clock: ["Clock", content.clock === null
    ? "Continuous time: what is proved is what runs here, but for the integrator's rounding."
    : "The proof is in continuous time; the page runs at this clock. A slow clock shows where the proof ends."],
  path: ["Path", ""],
  start: ["Start", content.pose?.sought ? "Each joint beside the pose that lies on the path." : "Each joint beside the file's start."],
};

function known() {
  const all = content.sliders.map((slider) => ({ ...slider, least: -1 }));
  if (content.clock !== null) {
    const least = -Math.min(1, Math.max(0, Math.log(content.clock / FASTEST) / Math.log(SLOWEST)));
    const says = "How often the controller samples, and the servo gets a new command.";
    all.push({ label: "clock", group: "clock", block: "", name: "period", says, unit: "s", kind: "factor", most: SLOWEST, least });
  }
  const { names = [], units = [] } = content.pose ?? {};
  names.forEach((name, k) => {
    const unit = units[k], says = "Where this joint is at the start, beside the rest.";
    all.push({ label: `start[${k}]`, group: "start", block: "", name, says, unit, kind: "shift", most: unit === "m" ? 0.1 : 0.5, least: -1, joint: k });
  });
  return all;
}

function plainly(slider) { return slider.kind === "factor" ? 1 : 0; }
function placeOf(slider, value) { return slider.kind === "factor" ? Math.log(value) / Math.log(slider.most) : value / slider.most; }
function valueAt(slider, place) {
  const value = slider.kind === "factor" ? slider.most ** place : slider.most * place;
  return Math.abs(place) < 1e-9 ? plainly(slider) : Number(value.toPrecision(3));
}

// The numbers of the loop where the sliders stand; rounded, so that a command can say them in full.
function numbers() {
  const p = content.p.slice();
  for (const slider of content.sliders) {
    if (!moved.has(slider.label)) continue;
    const value = moved.get(slider.label);
    for (let k = slider.at; k < slider.at + slider.size; k++) p[k] = Number((slider.kind === "factor" ? p[k] * value : p[k] + value).toPrecision(6));
  }
  return p;
}

function tickNow() { return Number((content.tick * (moved.get("clock") ?? 1)).toPrecision(6)); }
function shifts() { return content.pose ? content.pose.names.map((_, k) => moved.get(`start[${k}]`) ?? 0) : null; }
function changed(kind) {
  const labels = [...moved.keys()], run = (label) => label === "clock" || label.startsWith("start[");
  return labels.some((label) => run(label) === (kind === "run"));
}

function build() {
  const all = known();
  for (const [group, [title, hint]] of Object.entries(GROUPS)) {
    const mine = all.filter((slider) => slider.group === group);
    if (!mine.length && group !== "clock") continue;
    const box = make("details", {}, make("summary", {}, title));
    box.open = group === "controller" || (innerWidth > 760 && (group === "hidden" || group === "clock"));
    if (hint) box.append(make("p", { class: "hint" }, hint));
    for (const slider of mine) box.append(row(slider));
    find("sliders").append(box);
  }
}

function row(slider) {
  const id = `move-${slider.label}`, says = `${slider.block ? `${slider.block}.` : ""}${slider.name}: ${slider.says}`;
  const input = make("input", { type: "range", id, min: slider.least, max: 1, step: 0.005, value: 0, title: slider.says });
  const output = make("output", { for: id });
  const reset = make("button", { type: "button", "aria-label": `Reset ${slider.block} ${slider.name}`, title: "Back to the file's value" }, "↺");
  const label = make("label", { for: id }, ...nice(slider.name.replace(/([a-z]{3})_/g, "$1 ")), " ", make("small", {}, slider.block));
  const element = make("div", { class: "slider" }, label, output, reset, input);
  input.onpointerdown = () => (held = true);
  input.onfocus = input.onmouseenter = () => (find("about").textContent = says);
  input.oninput = () => move(slider, valueAt(slider, Number(input.value)));
  input.onchange = () => { held = false; settle(); };
  input.ondblclick = reset.onclick = () => { move(slider, plainly(slider)); settle(); };
  sliders.push({ ...slider, input, output, element });
  return element;
}

function move(slider, value) {
  if (value === plainly(slider)) moved.delete(slider.label); else moved.set(slider.label, value);
  ask(held);
}

function settle() {
  try {
    history.replaceState(null, "", moved.size ? `#${[...moved].map((pair) => pair.map(encodeURIComponent).join("=")).join("&")}` : location.pathname + location.search);
  } catch { /* a page inside another has no address of its own */ }
  ask(false);
}

// What the address says was moved.
function recall() {
  moved.clear();
  const found = new URLSearchParams(location.hash.slice(1));
  for (const slider of sliders) {
    const value = Number(found.get(slider.label) ?? NaN), place = placeOf(slider, value);
    if (Number.isFinite(place) && place >= slider.least - 1e-6 && place <= 1 + 1e-6 && value !== plainly(slider)) moved.set(slider.label, value);
  }
  ask(false);
}

function showSliders(p) {
  for (const slider of sliders) {
    const value = moved.get(slider.label) ?? plainly(slider), place = placeOf(slider, value), { input, least } = slider;
    if (document.activeElement !== input || Math.abs(Number(input.value) - place) > 0.01) input.value = place;
    const zero = -least / (1 - least), now = (place - least) / (1 - least), part = Math.abs(now - zero);
    input.style.setProperty("--zero", `${100 * zero}%`);
    input.style.setProperty("--part", `${100 * part}%`);
    input.style.setProperty("--from", `${part < 1 ? (100 * Math.min(now, zero)) / (1 - part) : 0}%`);
    slider.element.classList.toggle("moved", moved.has(slider.label));
    slider.output.textContent = valueText(slider, value, p);
    input.setAttribute("aria-valuetext", slider.output.textContent);
  }
  find("reset").disabled = !moved.size;
}

function valueText({ label, at, size, unit, joint }, factor, p) {
  if (label === "clock") return plain(tickNow(), "s");
  const values = joint === undefined ? p.slice(at, at + size) : [run.start[joint]];
  if (values.some((value) => value !== values[0])) return `× ${figure(factor)}`;
  return superscript(`${String(Number(values[0].toPrecision(4))).replace("-", "−")} ${unit}`).trim();
}

// ---- what is simulated

function ask(quick) {
  asked = asked === false ? false : quick;
  wake();
}

function simulate(quick) {
  const p = numbers(), begun = performance.now();
  run = loop.simulate({ p, shift: shifts(), tick: tickNow(), most: quick ? Math.max(2000, QUICK * perMs) : MOST_WORK });
  const took = performance.now() - begun;
  if (run.work > 2000) perMs = run.work / Math.max(took, 1);
  if (run.short) run.notices.push(quick ? `while it is moved, the first ${plain(run.short, "s")} are run` : `so short are the steps that only ${plain(run.short, "s")} are run`);
  run.judged = loop.judged(p);
  time = Math.min(time, run.times.at(-1));
  tell(p);
  lines();
  curves(quick);
  if (!quick) find("foot").textContent = `${plain(run.horizon, "s")} of simulated time took ${plain(took / 1000, "s")}: ${run.substeps} steps of rk4 in each tick of ${plain(run.tick, "s")}. dmframe ${content.dmframe}.`;
}

// What is proved where the sliders stand, and what became of the run.
function tell(p) {
  const verdict = judgement(content, run.judged, { p: changed("p"), run: changed("run") });
  find("verdict").className = verdict.state;
  set("headline", verdict.headline);
  set("says", verdict.says.join(" "));
  const notices = run.notices.map((notice) => `${notice}.`), wild = run.divergence;
  if (wild) {
    notices.unshift(`${wild.says}; the run ends there.`);
    if (verdict.state === "proved" && content.clock !== null) notices.push(`The proof is in continuous time, and this clock ticks every ${plain(run.tick, "s")}.`);
  }
  set("notice", notices.join(" "));
  find("notice").hidden = !notices.length;
  find("notice").classList.toggle("wild", Boolean(wild));
  showSliders(p);
  set("command", command(p));
  find("conditions").replaceChildren(...verdict.rows.map(({ name, how, margin, holds }) =>
    make("tr", { class: holds ? "yes" : holds === null ? "open" : "no" },
      ...[name, margin === null ? "" : figure(margin), holds ? (how === "sampled" ? "sampled, not proved" : "holds") : holds === null ? "not decided here" : "fails"].map((text) => make("td", {}, text)))));
  run.proved = verdict.state === "proved";
}

// A text is only set anew when it is another: who listens to the page would hear it again.
function set(id, text) {
  if (said.get(id) === text) return;
  said.set(id, text);
  find(id).replaceChildren(...(id === "command" ? [text] : nice(text)));
}

// The same run from a command line.
function command(p) {
  const words = [`dmframe run ${content.name}`, `--set duration=${content.horizon}`], lacking = [];
  const say = (label, values) => words.push(`--set '${label}=${values.length > 1 ? `[${values.join(", ")}]` : values[0]}'`);
  const bases = new Set();
  for (const { label } of content.sliders) if (moved.has(label)) bases.add(label.replace(/\[\d\]$/, ""));
  for (const base of bases) {
    const whole = content.sliders.filter(({ label }) => label === base || label.startsWith(`${base}[`));
    if (base.startsWith("robot.") && base !== "robot.friction_velocity") lacking.push(base);
    else say(base, whole.flatMap(({ at, size }) => p.slice(at, at + size)));
  }
  const pathMoved = content.sliders.some(({ label, group }) => group === "path" && moved.has(label));
  if (content.pose && (shifts().some(Boolean) || (content.pose.sought && pathMoved))) say("start.q", run.start.map((angle) => Number(angle.toPrecision(12))));
  if (moved.has("clock")) say("clock", [tickNow()]);
  return words.join(" ") + (lacking.length ? `   # and ${lacking.join(" and ")}, which the robot's file says` : "");
}

// ---- what is shown

// A column of numbers, one an instant, from what is drawn or from the state.
function column(of, at) {
  const width = of === "shown" ? content.sizes.shown : loop.states, from = of === "shown" ? run.drawn : run.log;
  return Float64Array.from({ length: run.kept }, (_, k) => from[k * width + at]);
}

function arrange() {
  const point = (at, fixed) => {
    hover = at;
    if (fixed) time = Math.min(at, run.times.at(-1));
    wake();
  };
  const add = (place, group, spec) => {
    const plot = new Plot(find(place), { unit: group.unit, ...spec }, point);
    Object.assign(plot, { group, kind: group.kind, redrawn: wake });
    plots.push(plot);
  };
  for (const group of content.groups) {
    if (group.kind === "error") add("first", group, { title: `Error ${group.name} − ${content.goal.name}`, switch: true, zero: true });
    if (group.kind === "storage") {
      add("first", group, { title: "V", switch: true, whole: true });
      add("more", group, { title: "Terms of V", log: true, switch: true });
    }
    if (group.kind === "estimate") add("more", group, { title: `Estimate ${group.name}` });
    if (group.kind === "command") add("more", group, { title: `Command ${group.name}${measured(group) ? ` and measured ${measured(group).name}` : ""}` });
  }
}

// The state of the plant that a command is for: dq for dq_c.
function measured({ label, size }) {
  const wanted = label.split(".").pop().replace(/_c$/, "");
  return content.states.findLast((state) => state.label.endsWith(`.${wanted}`) && state.size === size);
}

function curves(quick) {
  for (const plot of plots) {
    const { group } = plot, rows = Array.from({ length: group.size }, (_, k) => ({
      name: group.size === 1 && !group.names[0] ? group.name : (group.size === content.pose?.size && content.pose.names[k] && group.kind !== "storage" && group.unit !== "m" ? content.pose.names[k] : group.names[k] ?? `${k + 1}`),
      values: column(group.of, group.at + k), colour: k % 8,
    }));
    let shown = rows;
    if (group.kind === "error" && rows.length > 1) {
      const norm = { name: "norm", colour: 0, wide: true, values: run.times.map((_, k) => Math.hypot(...rows.map(({ values }) => values[k]))) };
      shown = [...rows.map((one, k) => ({ ...one, colour: k + 1, faint: true })), norm];
    } else if (group.kind === "error") rows[0].wide = true;
    if (group.kind === "storage") {
      const total = run.times.map((_, k) => rows.reduce((sum, { values }) => sum + values[k], 0));
      shown = plot.whole ? [{ name: "V", colour: 0, wide: true, values: total }] : rows.filter(({ values }) => values.some((value) => value > 0));
      plot.say(!run.proved ? "proves nothing at these values" : plot.whole ? "the sum of what all blocks store" : "");
    }
    if (group.kind === "command" && measured(group)) {
      const { label } = measured(group);
      let first = 0;
      for (const state of content.states) { if (state.label === label) break; first += state.size; }
      shown = [...rows, ...rows.map((one, k) => ({ ...one, values: column("state", first + k), dash: true, silent: true }))];
    }
    if (group.kind === "estimate") shown = estimates(plot, rows, quick);
    plot.show(run.times, content.horizon, run.divergence ? run.divergence.time : null, shown);
  }
}

// Of many the eight that move most, each with its true value.
function estimates(plot, rows, quick) {
  const { group } = plot;
  if (!quick || !plot.chosen) {
    const spans = rows.map(({ values }, k) => [Math.max(...values) - Math.min(...values), k]).sort((a, b) => b[0] - a[0]);
    plot.chosen = spans.slice(0, 8).map(([, k]) => k).sort((a, b) => a - b);
    if (rows.length > 8) plot.say(`the 8 of ${rows.length} that move most`);
  }
  return plot.chosen.flatMap((k, colour) => {
    const truth = group.true === null ? [] : [{ name: "true", colour, dash: true, silent: true, constant: run.judged[group.true + k] }];
    return [{ ...rows[k], colour }, ...truth];
  });
}

// The tool's trace and the desired path, as lines in space.
function lines() {
  const { scene: places, shown } = content.sizes, { goal, axes } = content;
  if (!content.robot) return;
  const trace = new Float32Array(3 * run.kept), path = new Float32Array(3 * run.kept);
  for (let k = 0; k < run.kept; k++) {
    const tool = run.drawn.subarray(k * shown + places - 3, k * shown + places);
    trace.set(tool, 3 * k);
    path.set(run.aims ? run.aims.subarray(3 * k, 3 * k + 3) : tool, 3 * k);
    if (!run.aims && goal?.unit === "m") [...axes].forEach((axis, i) => (path[3 * k + "xyz".indexOf(axis)] = run.drawn[k * shown + goal.at + i]));
  }
  run.path = goal && (run.aims || goal.unit === "m") ? path : null;
  if (!scene) {
    const low = [0, 0, 0], high = [0, 0, 0];
    const widen = (points) => points.forEach((value, i) => { low[i % 3] = Math.min(low[i % 3], value); high[i % 3] = Math.max(high[i % 3], value); });
    for (let k = 0; k < run.kept; k++) for (let j = 0; j < content.robot.joints; j++) widen(run.drawn.subarray(k * shown + 12 * j + 9, k * shown + 12 * j + 12));
    widen(trace);
    if (run.path) widen(path);
    scene = new Scene(find("robot"), content.robot, { low, high }, wake);
    find("nearer").onclick = () => scene.zoom(0.85);
    find("farther").onclick = () => scene.zoom(1.18);
    find("home").onclick = () => scene.back();
  }
  scene.line("trace", trace);
  scene.line("path", run.path ?? new Float32Array(0));
}

// Between two instants the robot is drawn between its places.
function drawScene(at) {
  const { shown, scene: places } = content.sizes, step = run.every * run.tick;
  const k = Math.max(0, Math.min(run.kept - 1, Math.floor(at / step))), then = Math.min(run.kept - 1, k + 1), part = Math.min(1, at / step - k);
  frames ??= new Float64Array(places);
  for (let i = 0; i < places; i++) frames[i] = run.drawn[k * shown + i] * (1 - part) + run.drawn[then * shown + i] * part;
  const aim = run.path && [0, 1, 2].map((i) => run.path[3 * k + i] * (1 - part) + run.path[3 * then + i] * part);
  if (frames.every(Number.isFinite)) scene.draw({ frames, aim, past: k, inks });
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  const ink = (name, alpha = 1) => [...[1, 3, 5].map((k) => parseInt(style.getPropertyValue(name).trim().slice(k, k + 2), 16) / 255), alpha];
  inks = { body: ink("--body"), joint: ink("--joint"), accent: ink("--accent"), path: ink("--path"), grid: ink("--floor") };
  for (const plot of plots) plot.touch();
  wake();
}

function wake() {
  if (!waiting) requestAnimationFrame(turn);
  waiting = true;
}

function turn(now) {
  waiting = false;
  const passed = Math.min(0.1, (now - before) / 1000);
  before = now;
  if (asked !== null) {
    const quick = asked;
    asked = null;
    try {
      simulate(quick);
    } catch (error) {
      set("headline", "The run failed");
      set("says", error.message);
      throw error;
    }
  }
  const last = run.times.at(-1);
  if (playing && hover === null) time = time >= last ? 0 : Math.min(last, time + passed * pace);
  const at = Math.min(hover ?? time, last);
  if (scene) drawScene(at);
  const read = !playing || hover !== null || now - told > 120;
  if (read) told = now;
  for (const plot of plots) {
    plot.draw();
    plot.point(at, read);
  }
  find("scrub").max = last;
  find("scrub").value = at;
  find("scrub").style.setProperty("--part", `${last ? (100 * at) / last : 0}%`);
  set("clock", `${at.toFixed(last < 1 ? 3 : 1)} / ${plain(last, "s")}`);
  if (playing) wake();
}

function play(on) {
  playing = on;
  find("play").textContent = on ? "❚❚" : "▶";
  find("play").setAttribute("aria-label", on ? "Pause" : "Play");
  wake();
}

find("graph").textContent = content.name;
find("text").textContent = content.verdict.text;
find("yaml").textContent = content.text;
find("assumptions").append(...content.verdict.assumptions.map((text) => make("li", {}, text)));
find("view").hidden = find("transport").hidden = !content.robot;
find("play").onclick = () => play(!playing);
find("scrub").oninput = () => { time = Number(find("scrub").value); play(false); };
find("pace").onchange = () => (pace = Number(find("pace").value));
find("reset").onclick = () => { moved.clear(); settle(); };
find("copy").onclick = async () => {
  try {
    await navigator.clipboard.writeText(said.get("command"));
    find("copy").textContent = "Copied";
  } catch { // not allowed inside another page: it is marked instead
    getSelection().selectAllChildren(find("command"));
  }
};
addEventListener("pointerup", () => (held = false));
addEventListener("hashchange", recall);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", colours);
build();
arrange();
recall();
play(playing);
colours();
