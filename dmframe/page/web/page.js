// Live page: a slider changes a parameter, the loop is simulated again, and plots, scene and verdict are updated.

const find = (id) => document.getElementById(id);
const content = JSON.parse(find("data").textContent);
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
const QUICK = 20; // longest computation while a slider moves; a longer run is cut [ms]

find("graph").textContent = content.name;
find("text").textContent = content.verdict.text;
find("yaml").textContent = content.text;
find("detail").textContent = find("detail").className = "";

const loop = await loaded(content).catch((error) => {
  find("headline").textContent = "This browser cannot run the page";
  find("detail").textContent = `The page needs WebAssembly and DecompressionStream: ${error.message}`;
  throw error;
});
const rivals = await Promise.all(content.rivals.map(async (rival) => ({ ...rival, solver: await loaded(rival.loop) })));
const ghosts = rivals.filter(({ ghost }) => ghost);
if (content.robot) content.robot.meshes = await Promise.all(content.robot.meshes.map(decodedMesh));
const plots = [], texts = new Map(); // text by element id
// `perMs`: solver work per millisecond, measured in the last run
let run = null, perMs = Infinity, scene = null, inks = {}, frames = null;
let inView = true, time = 0, hover = null, playing = !still, pace = 1, before = 0, lastRead = 0, waiting = false;
let requested = null, factor = content.enlarge; // of the deviation that the scene draws

// ---- simulation

function request(quick) {
  requested = requested === false ? false : quick;
  wake();
}

function simulate(quick) {
  const p = sliders.numbers, started = performance.now();
  run = loop.simulate({ p, shift: sliders.shift, tick: sliders.tick, dense: !quick, most: quick ? Math.max(2000, QUICK * perMs) : MOST_WORK });
  const took = performance.now() - started;
  if (run.work > 2000) perMs = run.work / Math.max(took, 1);
  if (run.short) run.notices.push(quick ? `while the slider moves, only the first ${plain(run.short, "s")} are simulated` : `the integrator's steps are so short that only the first ${plain(run.short, "s")} are simulated`);
  run.judged = loop.judged(p, run.start, run.tick);
  run.spread = loop.spread(p, run.start, run.tick);
  run.climb = climb(p);
  for (const rival of quick ? ghosts : rivals) compete(rival, p, quick);
  const all = performance.now() - started;
  time = Math.min(time, run.times.at(-1));
  showVerdict(p);
  lines();
  curves(quick);
  if (!quick) score();
  if (!quick) find("foot").textContent = `${plain(run.times.at(-1), "s")} of simulated time took ${plain(took / 1000, "s")}: ${run.substeps} step${run.substeps > 1 ? "s" : ""} of rk4 in each tick of ${plain(run.tick, "s")}${rivals.length ? `; with the verdict and ${rivals.length} other controller${rivals.length > 1 ? "s" : ""}, ${plain(all / 1000, "s")}` : ""}. dmframe ${content.dmframe}, model ${content.fingerprint.slice(0, 16)}.`;
}

// Simulates a rival from the same pose, with the parameters that it shares.
function compete(rival, p, quick) {
  const { solver, error } = rival, shared = sharedValues(rival, p), last = run.short || content.horizon;
  const most = quick ? Math.max(2000, QUICK * perMs) : MOST_WORK;
  const found = solver.simulate({ p: shared, pose: run.start, tick: run.tick, horizon: last, most });
  rival.run = { ...found, tick: run.tick, norm: normOf(found, error, rival.loop.sizes.shown) };
}

// Largest increase of V in the run; null without V. The rounding error is evaluated at nine instants.
function climb(p) {
  const group = content.groups.find(({ kind }) => kind === "storage"), last = run.kept - 1;
  if (!group || last < 1) return null;
  const rows = Array.from({ length: group.size }, (_, k) => column(group.of, group.at + k));
  const V = run.V?.values ?? run.times.map((_, k) => rows.reduce((sum, values) => sum + values[k], 0)), end = V.length - 1;
  const sampled = [0, 1, 2, 3, 4, 5, 6, 7, 8].map((k) => loop.roundingError(run, Math.round((k * last) / 8), p, run.tick, group));
  const rounding = V.map((_, k) => Math.max(sampled[Math.floor((8 * k) / end)], sampled[Math.ceil((8 * k) / end)]));
  return climbOf(V, rounding, run.V?.restarts ?? stepsAt());
}

// Recorded instants at which a source has stepped since the one before.
function stepsAt() {
  const rows = content.groups.filter(({ kind }) => kind === "steps").flatMap(({ of, at, size }) => Array.from({ length: size }, (_, k) => column(of, at + k)));
  return run.times.reduce((found, _, k) => (k && rows.some((values) => values[k] !== values[k - 1]) ? [...found, k] : found), []);
}

// The title with the sampling period that is simulated.
function updateTitle() {
  const file = content.clock === null ? "" : plain(content.clock, "s"), now = plain(run.tick, "s");
  const title = content.title || content.name, parts = file ? title.split(new RegExp(`(?<![\\d.])${file.replace(".", "\\.")}(?![\\w])`)) : [title];
  const moved = sliders.state.clock, text = moved ? (parts.length > 1 ? parts.join(now) : `${title}, sampled at ${now}`) : title;
  if (document.title !== text) document.title = document.querySelector("h1").textContent = text;
}

// Verdict at the values of the sliders, notices of the run, and the command that repeats it.
function showVerdict(p) {
  const verdict = judgement(content, run.judged, sliders.state, run.spread, run);
  updateTitle();
  find("verdict").className = verdict.state + (content.verdict.headline === "proved" ? "" : " partly");
  set("headline", verdict.headline);
  set("detail", verdict.sentences.join(" "));
  const notices = [...run.notices, ...sliders.notices].map((notice) => `${notice.charAt(0).toUpperCase()}${notice.slice(1)}.`), { divergence } = run;
  if (divergence) {
    notices.unshift(`${divergence.message}; the run ends there.`);
    if (verdict.state === "clock") notices.push(content.verdict.sampled ? "The proof covers the estimates, not the distance of the robot from its path." : `The proof is in continuous time, and ${content.clock === null ? "the integrator's steps are too long for these numbers" : `this controller samples every ${plain(run.tick, "s")}`}.`);
  }
  set("notice", notices.join(" "));
  find("notice").hidden = !notices.length;
  if (find("notice").classList.toggle("diverged", Boolean(divergence)) === (find("detail").nextElementSibling === find("notice")))
    find("detail")[divergence ? "before" : "after"](find("notice")); // on a small screen the reader scrolls to the rest
  sliders.show(p, run.start);
  find("reset").disabled = !sliders.changed;
  guided();
  set("command", sliders.command(p, run.start));
  find("conditions").replaceChildren(...verdict.rows.map(({ name, how, margin, holds }) =>
    make("tr", { class: holds ? "yes" : holds === null ? "open" : "no" },
      ...[name, margin === null ? "" : figure(margin), holds ? (how === "sampled" ? "sampled, not proved" : "holds") : holds === null ? "not decided here" : "fails"].map((text) => make("td", {}, text)))));
  run.proved = verdict.proved;
  if (parent !== window) parent.postMessage({ state: verdict.state, headline: verdict.headline, edit: sliders.edit }, "*");
}

// Buttons of the graph: those whose values are set, and what they say.
function guided() {
  const pressed = content.buttons.filter((button) => sliders.active(button));
  for (const button of content.buttons) find(`button-${button.name}`).setAttribute("aria-pressed", pressed.includes(button));
  set("says", pressed.map(({ says }) => says).filter(Boolean).join(" "));
}

// Errors of all controllers over the last fifth of the run.
function score() {
  const group = content.groups.find(({ kind }) => kind === "error"), { horizon } = content;
  if (!rivals.length) return;
  const mine = { title: "This controller", note: "", run: { ...run, norm: normOf(run, group, content.sizes.shown) }, colour: 0 };
  const all = [mine, ...rivals].map(({ run: { times, norm } }) => lastRms(times, norm, horizon)), { power, prefix } = prefixed(Math.max(...all), group.unit);
  const rows = [mine, ...rivals.map((rival) => ({ ...rival, colour: rival.ghost ? 1 + ghosts.indexOf(rival) : null }))].map(({ title, note, run: { times, norm, divergence }, colour }) => {
    const rms = lastRms(times, norm, horizon), key = make("i", {});
    if (colour !== null) key.style.setProperty("--key", `var(--c${colour})`);
    const text = divergence ? `diverges at ${plain(divergence.time, "s")}` : rms === null ? "" : `${figure(rms / 10 ** power)} ${prefix}${group.unit}`;
    return make("tr", {}, make("td", {}, key), make("td", {}, title, note && make("small", {}, note)), make("td", {}, text));
  });
  find("scores").replaceChildren(make("caption", {}, `Error, RMS from ${plain(horizon * 0.8, "s")} to ${plain(horizon, "s")}`), ...rows);
}

// A text is replaced only if it changed: a screen reader repeats a replaced text.
function set(id, text) {
  if (texts.get(id) === text) return;
  texts.set(id, text);
  find(id).replaceChildren(...(id === "command" ? [text] : nice(text)));
}

// ---- display

// One element over the recorded instants, of the plotted outputs or of the state.
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
    if (group.kind === "error") add("first", group, { title: `Error ${group.name} − ${content.goal.name}`, switch: true, zero: true, log: ghosts.length > 0 });
    if (group.kind === "turn") add("first", group, { title: "Tool's turn from its orientation", switch: true, zero: true });
    if (group.kind === "storage") {
      add("first", group, { title: "V", switch: true, whole: true });
      add("more", group, { title: "Terms of V", log: true, switch: true });
    }
    if (group.kind === "estimate") add("more", group, { title: `Estimate ${group.name}` });
    if (group.kind === "command") add(content.groups.some(({ kind }) => kind === "storage") ? "more" : "first", group, { title: `Command ${group.name}${measured(group) ? ` and measured ${measured(group).name}` : ""}` });
  }
}

// The plant state that a command sets: dq for dq_c.
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
      if (ghosts.length) shown = [...ghosts.map(({ title, run: { times, norm } }, k) => ({ name: title, colour: k + 1, times, values: norm })), { ...norm, name: "this controller" }];
    } else if (group.kind === "error" || group.kind === "turn") rows[0].wide = true;
    if (group.kind === "turn") rows[0].name = "turn";
    if (group.kind === "storage") {
      const total = run.times.map((_, k) => rows.reduce((sum, { values }) => sum + values[k], 0));
      shown = plot.whole ? [{ name: "V", colour: 0, wide: true, values: total }] : rows.filter(({ values }) => values.some((value) => value > 0));
      const left = plot.whole && shown[0].values.at(-1) / shown[0].values[0];
      plot.say(!run.proved ? "no proof at these values" : plot.whole ? `the sum of all storage functions, at the end ${figure(100 * left)} % of its start${run.climb?.rises ? `; it rose at ${run.climb.rises} of ${run.climb.steps} ${run.V ? "samples" : "instants"}` : ""}` : "");
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

// Of many estimates the eight with the largest range, each with its true value.
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

// The traces of the tool, those of ghosts and the desired path, as lines in space.
function lines() {
  const { sizes, robot, axes } = content, { scene: places, shown } = sizes;
  if (!robot) return;
  const own = tracesOf(run, content, axes, factor);
  run.path = own.path;
  run.trace = own.trace;
  if (!scene) {
    const low = [0, 0, 0], high = [0, 0, 0];
    const widen = (points) => points.forEach((value, i) => { low[i % 3] = Math.min(low[i % 3], value); high[i % 3] = Math.max(high[i % 3], value); });
    for (let k = 0; k < run.kept; k++) for (let j = 0; j < robot.joints; j++) widen(run.drawn.subarray(k * shown + 12 * j + 9, k * shown + 12 * j + 12));
    widen(tracesOf(run, content, axes, 1).trace);
    if (run.path) widen(run.path);
    scene = new Scene(find("robot"), robot, { low, high }, wake);
    find("nearer").onclick = () => scene.zoom(0.85);
    find("farther").onclick = () => scene.zoom(1.18);
    find("home").onclick = () => scene.back();
  }
  scene.line("trace", run.trace);
  scene.line("path", run.path ?? new Float32Array(0));
  ghosts.forEach((ghost, k) => {
    ghost.run.trace = tracesOf(ghost.run, ghost.loop, axes, factor).trace;
    scene.line(`ghost ${k}`, ghost.run.trace);
  });
}

// Draws the scene at a time, interpolated between two recorded instants. Enlarged traces are drawn over the last fifth of
// the horizon only: an enlarged start would hide the rest.
function drawScene(at) {
  const { shown, scene: places } = content.sizes, step = run.every * run.tick;
  const k = Math.max(0, Math.min(run.kept - 1, Math.floor(at / step))), then = Math.min(run.kept - 1, k + 1), part = Math.min(1, at / step - k);
  frames ??= new Float64Array(places);
  for (let i = 0; i < places; i++) frames[i] = run.drawn[k * shown + i] * (1 - part) + run.drawn[then * shown + i] * part;
  const drawn = (name, of, ink) => {
    const { past, point } = pointAt(of.trace, of, at), window = factor > 1 ? Math.ceil(content.horizon / 5 / (of.every * of.tick)) : Infinity;
    return { name, ink, end: point, past, from: Math.max(0, past - window) };
  };
  const aim = run.path && pointAt(run.path, run, at).point;
  const traces = [...ghosts.map((ghost, n) => drawn(`ghost ${n}`, ghost.run, inks.ghosts[n])), drawn("trace", run, inks.accent)];
  if (frames.every(Number.isFinite)) scene.draw({ frames, aim, traces, inks });
}

// Names of the lines in the scene.
function key() {
  const entry = (kind, text, colour) => {
    const line = make("i", { class: kind });
    if (colour) line.style.setProperty("--key", `var(--c${colour})`);
    return make("span", {}, line, text);
  };
  find("key").replaceChildren(entry("trace", "tool"), ...ghosts.map(({ title }, k) => entry("ghost", title, k + 1)), entry("path", "desired"));
  find("enlarge").textContent = `deviation × ${factor}`;
  find("enlarge").setAttribute("aria-pressed", factor > 1);
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  const ink = (name, alpha = 1) => [...[1, 3, 5].map((k) => parseInt(style.getPropertyValue(name).trim().slice(k, k + 2), 16) / 255), alpha];
  inks = { body: ink("--body"), joint: ink("--joint"), accent: ink("--accent"), path: ink("--path"), grid: ink("--floor"), ghosts: ghosts.map((_, k) => ink(`--c${k + 1}`)) };
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
  if (requested !== null) {
    const quick = requested;
    requested = null;
    try {
      simulate(quick);
    } catch (error) {
      set("headline", "The run failed");
      set("detail", error.message);
      throw error;
    }
  }
  const last = run.times.at(-1);
  if (playing && hover === null) time = time >= last + pace ? 0 : time + passed * pace; // a pause of one second at the end
  const at = Math.min(hover ?? time, last);
  if (scene && inView) drawScene(at);
  const read = !playing || hover !== null || now - lastRead > 120;
  if (read) lastRead = now;
  for (const plot of plots) {
    plot.draw();
    plot.point(at, read);
  }
  find("scrub").max = last;
  find("scrub").value = at;
  find("scrub").style.setProperty("--part", `${last ? (100 * at) / last : 0}%`);
  set("clock", `${at.toFixed(last < 1 ? 3 : 1)} / ${plain(last, "s")}`);
  find("scrub").setAttribute("aria-valuetext", texts.get("clock").replace("/", "of"));
  if (playing && (inView || plots.some(({ seen }) => seen))) wake(); // idle where nothing is in sight
}

function play(on) {
  playing = on;
  find("play").textContent = on ? "❚❚" : "▶";
  find("play").setAttribute("aria-label", on ? "Pause" : "Play");
  wake();
}

find("about").textContent = "Point at a parameter to read its description; a double click on its slider resets it.";
find("conditions").closest("details").hidden = !content.verdict.conditions.length;
find("assumptions").closest("details").hidden = !content.verdict.assumptions.length;
find("assumptions").append(...content.verdict.assumptions.map((text) => make("li", {}, text)));
find("origin").hidden = !content.origin;
find("from").textContent = content.origin ? `${content.origin.robot}: ${content.origin.text}` : "";
find("licences").textContent = (content.origin?.licences ?? []).map(({ name, text }) => `${name}\n\n${text}`).join("\n\n");
find("view").hidden = find("transport").hidden = !content.robot;
find("guided").hidden = !content.buttons.length;
find("guided").prepend(...content.buttons.map(({ name, title }) => make("button", { type: "button", id: `button-${name}`, "aria-pressed": false }, title)));
for (const button of content.buttons) find(`button-${button.name}`).onclick = () => sliders.press(button, Math.min(hover ?? time, content.horizon));
new IntersectionObserver(([entry]) => { inView = entry.isIntersecting; wake(); }).observe(find("view"));
find("enlarge").hidden = content.enlarge === 1;
find("enlarge").onclick = () => { factor = factor > 1 ? 1 : content.enlarge; key(); lines(); wake(); };
find("play").onclick = () => play(!playing);
find("scrub").oninput = () => { time = Number(find("scrub").value); play(false); };
find("pace").onchange = () => (pace = Number(find("pace").value));
find("reset").onclick = () => sliders.reset();
find("copy").onclick = async () => {
  try {
    await navigator.clipboard.writeText(texts.get("command"));
    find("copy").textContent = "Copied";
  } catch { // not allowed inside another page: select the text instead
    getSelection().selectAllChildren(find("command"));
  }
};
// An editor that embeds this page sends the parameters of an edited graph with the same loop, and the edit's number.
addEventListener("message", ({ source, data }) => {
  if (parent === window || source !== parent || !Array.isArray(data?.p) || data.p.length !== content.p.length) return;
  Object.assign(sliders, { edited: data.p.map(Number), edit: data.edit });
  request(false);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", colours);
const sliders = new Sliders(content, find("sliders"), request, (text) => (find("about").textContent = text));
key();
arrange();
if (!plots.length && !content.robot) find("first").append(make("p", { class: "quiet" }, "This graph has no robot, no error, no command and no estimate: there is nothing to draw."));
sliders.restore();
const moment = Number(new URLSearchParams(location.hash.slice(1)).get("at") ?? NaN); // instant that a link names: #at=3.5
if (moment >= 0) { time = moment; playing = false; }
play(playing);
colours();
