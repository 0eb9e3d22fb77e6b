// Sliders in groups, the parameters of the loop at their values, and the command line that sets these values.

const SLOWEST = 32; // largest factor on the sampling period
const FASTEST = 0.00025; // shortest sampling period [s]

class Sliders {
  // `request` is called with whether the slider is still held; `about` with the description of a slider.
  constructor(content, holder, request, about) {
    Object.assign(this, { content, request, about });
    this.moved = new Map(); // factor or shift by slider label
    this.edited = null; // parameters of an edited graph with the same loop, instead of those of the page's file
    this.fixed = new Map(); // values by parameter label, set by a button
    this.pressed = false;
    this.rows = [];
    this.notices = [];
    const proved = content.verdict.outcome === "proved", groups = {
      controller: ["Controller", ""],
      hidden: ["Servo and robot", "True parameters. The controller uses only the parameters in the list of assumptions."],
      clock: ["Clock", content.clock === null ? "This loop runs in continuous time, with the steps of the integrator."
        : proved && !content.verdict.sampled ? "The proof is in continuous time; the page samples at this period. A long period shows where the proof no longer applies."
          : "Sampling period of the controller."],
      path: ["Path", ""],
      start: ["Start", content.pose?.sought ? "Offset of each joint from the pose on the path." : "Offset of each joint from the start in the file."],
    };
    const all = this.definitions();
    for (const [group, [title, hint]] of Object.entries(groups)) {
      const mine = all.filter((slider) => slider.group === group);
      if (!mine.length && group !== "clock") continue;
      const box = make("details", {}, make("summary", {}, title));
      box.open = group === "controller" || (innerWidth > 760 && (group === "hidden" || group === "clock"));
      if (hint) box.append(make("p", { class: "hint" }, hint));
      for (const slider of mine) box.append(this.row(slider));
      holder.append(box);
    }
    // a slider that is released at its old value fires no change event
    const release = () => { if (this.pressed) { this.pressed = false; this.commit(); } };
    addEventListener("pointerup", release);
    addEventListener("pointercancel", release);
    addEventListener("hashchange", () => this.restore());
  }

  definitions() {
    const { clock, pose } = this.content, all = this.content.sliders.map((slider) => ({ ...slider, least: -1 }));
    if (clock !== null) {
      const least = -Math.min(1, Math.max(0, Math.log(clock / FASTEST) / Math.log(SLOWEST)));
      const description = "Sampling period of the controller; the servo gets a new command at each sample.";
      all.push({ label: "clock", group: "clock", block: "", name: "period", description, unit: "s", kind: "factor", most: SLOWEST, least });
    }
    pose?.names.forEach((name, joint) => {
      const unit = pose.units[joint], description = "Initial offset of this joint.";
      all.push({ label: `start[${joint}]`, group: "start", block: "", name, description, unit, kind: "shift", most: unit === "m" ? 0.1 : 0.5, least: -1, joint });
    });
    return all;
  }

  row(slider) {
    const id = `move-${slider.label}`, description = `${slider.block ? `${slider.block}.` : ""}${slider.name}: ${slider.description}`;
    const input = make("input", { type: "range", id, min: slider.least, max: 1, step: 0.005, value: 0, title: slider.description, "aria-label": `${slider.name} ${slider.block}`.trim() });
    const output = make("output", { for: id, "aria-live": "off" });
    const reset = make("button", { type: "button", "aria-label": `Reset ${slider.block} ${slider.name}`, title: "Back to the file's value" }, "↺");
    const label = make("label", { for: id }, ...nice(slider.name.replace(/([a-z]{3})_/g, "$1 ")), " ", make("small", {}, slider.block));
    const element = make("div", { class: "slider" }, label, output, reset, input);
    input.onpointerdown = () => (this.pressed = true);
    input.onfocus = input.onmouseenter = () => this.about(description);
    input.oninput = () => this.move(slider, valueAt(slider, Number(input.value)));
    input.onchange = () => { this.pressed = false; this.commit(); };
    input.ondblclick = reset.onclick = () => { this.move(slider, neutral(slider)); this.commit(); };
    this.rows.push({ ...slider, input, output, element });
    return element;
  }

  // Sets the values of a button, or resets them if they are set; `now` is the time that the page shows.
  press(button, now) {
    const on = this.active(button);
    for (const set of button.set) {
      for (const label of [...this.moved.keys()]) if (baseOf(label) === set.label) this.moved.delete(label);
      if (on) this.fixed.delete(set.label);
      else this.fixed.set(set.label, { ...set, values: set.values.map((value) => (value === "now" ? Number(now.toFixed(2)) : value)) });
    }
    if (button.clock !== null && on) this.moved.delete("clock");
    else if (button.clock !== null) this.moved.set("clock", button.clock / this.content.tick);
    this.commit();
  }

  // Whether all values of a button are set.
  active({ set, clock }) {
    const held = ({ label, values }) => this.fixed.get(label)?.values.every((value, k) => values[k] === "now" || values[k] === value);
    return set.every(held) && (clock === null || Math.abs(this.tick / clock - 1) < 1e-5);
  }

  get changed() { return this.moved.size > 0 || this.fixed.size > 0; }

  move(slider, value) {
    this.fixed.delete(baseOf(slider.label));
    if (value === neutral(slider)) this.moved.delete(slider.label); else this.moved.set(slider.label, value);
    this.request(this.pressed);
  }

  // Ends a change: the address of the page lists the moved sliders, so that a link shows the same run.
  commit() {
    this.notices = [];
    try {
      const fixed = [...this.fixed].map(([label, { values }]) => [label, `[${values}]`]);
      const fragment = [...this.moved, ...fixed].map((pair) => pair.map(encodeURIComponent).join("=")).join("&");
      history.replaceState(null, "", fragment ? `#${fragment}` : location.pathname + location.search);
    } catch { /* an embedded page has no address of its own */ }
    this.request(false);
  }

  // Sets the sliders from the address of the page.
  restore() {
    this.moved.clear();
    this.fixed.clear();
    const found = new Map(new URLSearchParams(location.hash.slice(1))); // an entry without a value is an anchor
    for (const slider of this.rows) {
      const text = found.get(slider.label), value = Number(text || NaN), place = placeOf(slider, value);
      const within = Number.isFinite(place) && place >= slider.least - 1e-6 && place <= 1 + 1e-6;
      if (within && value !== neutral(slider)) this.moved.set(slider.label, value);
      if (within) found.delete(slider.label);
    }
    for (const set of this.content.buttons.flatMap((button) => button.set)) {
      const text = found.get(set.label), values = /^\[.*\]$/.test(text ?? "") ? text.slice(1, -1).split(",").map(Number) : [];
      const allowed = (value, k) => (set.values[k] === "now" ? value >= 0 && value <= this.content.horizon : value === set.values[k]);
      if (values.length !== set.values.length || !values.every(allowed)) continue;
      this.fixed.set(set.label, { ...set, values });
      found.delete(set.label);
    }
    if (Number(found.get("at") || NaN) >= 0) found.delete("at"); // an instant, read in page.js
    const lost = [...found].filter(([, text]) => text).map((pair) => pair.join("=")), more = lost.length > 3 ? `, and ${lost.length - 3} more` : "";
    this.notices = lost.length ? [`the address of the page sets unknown or invalid values: ${lost.slice(0, 3).join(", ").slice(0, 200)}${more}`] : [];
    this.request(false);
  }

  reset() {
    this.moved.clear();
    this.fixed.clear();
    this.commit();
  }

  // Parameters of the loop; changed ones are rounded to 6 digits, so that the command line gives the same values.
  get numbers() {
    const p = (this.edited ?? this.content.p).slice();
    for (const { label, kind, at, size } of this.content.sliders) {
      if (!this.moved.has(label)) continue;
      const value = this.moved.get(label);
      for (let k = at; k < at + size; k++) p[k] = Number((kind === "factor" ? p[k] * value : p[k] + value).toPrecision(6));
    }
    for (const { at, values } of this.fixed.values()) values.forEach((value, k) => (p[at + k] = value));
    return p;
  }

  get tick() { return Number((this.content.tick * (this.moved.get("clock") ?? 1)).toPrecision(6)); }
  get shift() { return this.content.pose && this.content.pose.names.map((_, k) => this.moved.get(`start[${k}]`) ?? 0); }

  // What differs from the file: parameters (`p`; `at`: their indices), initial state, sampling period. An initial value
  // that is a function of changed parameters counts as changed; its index follows those of the parameters.
  get state() {
    const ofStart = (label) => label.startsWith("start["), labels = [...this.moved.keys()], { sliders, starts, p } = this.content;
    const at = new Set(sliders.filter(({ label }) => this.moved.has(label)).flatMap(({ at, size }) => Array.from({ length: size }, (_, k) => at + k)));
    for (const { at: first, values } of this.fixed.values()) values.forEach((_, k) => at.add(first + k));
    this.edited?.forEach((value, k) => { if (value !== p[k]) at.add(k); });
    const changed = at.size > 0;
    const start = labels.some(ofStart) || starts.reads.some((place) => at.has(place)), clock = this.moved.has("clock");
    if (start) for (const row of starts.rows) at.add(p.length + row);
    return { p: changed, at, start, clock, run: clock || labels.some(ofStart) };
  }

  // Updates all sliders from the parameters and the initial pose.
  show(p, start) {
    for (const slider of this.rows) {
      const value = this.moved.get(slider.label) ?? neutral(slider), place = placeOf(slider, value), { input, least } = slider;
      if (document.activeElement !== input || Math.abs(Number(input.value) - place) > 0.01) input.value = place;
      const zero = -least / (1 - least), now = (place - least) / (1 - least), part = Math.abs(now - zero);
      input.style.setProperty("--zero", `${100 * zero}%`);
      input.style.setProperty("--part", `${100 * part}%`);
      input.style.setProperty("--from", `${part < 1 ? (100 * Math.min(now, zero)) / (1 - part) : 0}%`);
      slider.element.classList.toggle("moved", this.moved.has(slider.label) || this.fixed.has(baseOf(slider.label)));
      slider.output.textContent = this.text(slider, value, p, start);
      input.setAttribute("aria-valuetext", slider.output.textContent);
    }
  }

  text({ label, at, size, unit, joint }, factor, p, start) {
    if (label === "clock") return plain(this.tick, "s");
    const values = joint === undefined ? p.slice(at, at + size) : [start[joint]];
    if (values.some((value) => value !== values[0])) return this.fixed.has(label) ? "set" : `× ${figure(factor)}`;
    return superscript(`${String(Number(values[0].toPrecision(4))).replace("-", "−")} ${unit}`).trim();
  }

  // Command line that repeats the run.
  command(p, start) {
    const { command, horizon, sliders, pose } = this.content, words = [command.text, `--set duration=${horizon}`];
    const lacking = command.before ? [command.before] : [];
    const assign = (label, value) => words.push(`--set '${label}=${value}'`);
    const moved = sliders.filter(({ label }) => this.moved.has(label));
    for (const { label, at, written } of this.fixed.values()) assign(label, listed(written, (place) => p[at + place]));
    for (const base of new Set(moved.map(({ label }) => baseOf(label)))) {
      const whole = sliders.filter(({ label }) => label === base || label.startsWith(`${base}[`));
      if (base.startsWith("robot.") && base !== "robot.friction_velocity") lacking.push(`${base}, which the robot file sets`);
      else assign(command.swapped.includes(base.split(".")[0]) ? `baseline.${base}` : base, listed(whole[0].written, (place) => p[whole[0].first + place]));
    }
    // on another path `run` would compute another initial pose
    const sought = pose?.sought && moved.some(({ group }) => group === "path");
    if (sought || this.shift?.some(Boolean)) assign("start.q", listed(start.map((_, k) => k), (k) => Number(start[k].toPrecision(12))));
    if (this.moved.has("clock")) assign("clock", this.tick);
    return words.join(" ") + (lacking.length ? `   # and ${lacking.join(", and ")}` : "");
  }
}

// Label of the parameter of a slider that shifts one element.
function baseOf(label) {
  return label.replace(/\[\d\]$/, "");
}

// YAML text of numbers in nested lists.
function listed(places, number) {
  if (Array.isArray(places)) return `[${places.map((inner) => listed(inner, number)).join(", ")}]`;
  return places === null ? "0" : String(number(places));
}

function neutral({ kind }) {
  return kind === "factor" ? 1 : 0;
}

function placeOf({ kind, most }, value) {
  return kind === "factor" ? Math.log(value) / Math.log(most) : value / most;
}

function valueAt(slider, place) {
  const value = slider.kind === "factor" ? slider.most ** place : slider.most * place;
  return Math.abs(place) < 1e-9 ? neutral(slider) : Number(value.toPrecision(3));
}
