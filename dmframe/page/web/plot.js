// Plot on two canvases: curves over time, and above them the cursor, which is redrawn alone.

const LEFT = 58, RIGHT = 10, TOP = 8, BOTTOM = 22; // [pixels]

class Plot {
  // `spec`: title, unit, and whether the axis is logarithmic; `point` is called with the time under the pointer, or null.
  constructor(holder, spec, point) {
    Object.assign(this, spec);
    this.curves = [];
    this.dirty = false;
    this.seen = true;
    this.base = make("canvas", { "aria-hidden": true });
    this.over = make("canvas", { role: "img", "aria-label": `${spec.title} over time` });
    this.legend = make("ul", { class: "legend" });
    this.unitText = make("span", { class: "unit" });
    this.noteText = make("span", { class: "quiet" });
    const head = make("figcaption", {}, make("span", { class: "what" }, ...nice(spec.title)), this.unitText, this.noteText);
    if (spec.switch) {
      const button = make("button", { type: "button", class: "small", "aria-pressed": Boolean(spec.log), "aria-label": `log: ${spec.title} on a logarithmic axis` }, "log");
      button.onclick = () => {
        this.log = !this.log;
        button.setAttribute("aria-pressed", this.log);
        this.touch();
        this.redrawn?.();
      };
      head.append(button);
    }
    this.element = make("figure", { class: "plot" }, head, make("div", { class: "sheets" }, this.base, this.over), this.legend);
    holder.append(this.element);
    this.over.onpointermove = (event) => point(this.timeAt(event.offsetX));
    this.over.onpointerdown = (event) => point(this.timeAt(event.offsetX), true);
    this.over.onpointerleave = () => point(null);
    new ResizeObserver(() => { this.touch(); this.redrawn?.(); }).observe(this.over);
    new IntersectionObserver(([entry]) => { this.seen = entry.isIntersecting; if (this.seen) this.redrawn?.(); }).observe(this.over);
  }

  // Curves: name, values at `times`, colour, and whether faint, dashed or thick. `stop` is the time of divergence.
  show(times, horizon, stop, curves) {
    const names = curves.map((curve) => curve.name + curve.colour).join("\n");
    Object.assign(this, { times, stop, curves });
    this.end = stop !== null && stop < horizon / 2 ? Math.max(stop * 1.4, times[1] ?? stop) : horizon;
    if (names !== this.names) this.list();
    this.names = names;
    this.touch();
  }

  list() {
    this.legend.replaceChildren(...this.curves.map((curve) => {
      if (curve.silent) return "";
      curve.key = make("i", { class: curve.dash ? "dash" : curve.wide ? "wide" : "" });
      curve.key.style.setProperty("--key", `var(--c${curve.colour})`); // the content security policy forbids style attributes in HTML
      return make("li", { class: curve.faint ? "faint" : "" }, curve.key, make("span", {}, ...nice(curve.name)), make("b", {}));
    }));
    this.readings = [...this.legend.querySelectorAll("b")];
  }

  say(note) { if (this.noteText.textContent !== note) this.noteText.textContent = note; }
  touch() { this.dirty = true; }

  get width() { return Math.max(1, this.end === undefined ? 1 : this.over.clientWidth - LEFT - RIGHT); }
  get height() { return Math.max(1, this.over.clientHeight - TOP - BOTTOM); }
  timeAt(x) { return Math.min(this.end, Math.max(0, ((x - LEFT) / this.width) * this.end)); }
  x(t) { return LEFT + (t / this.end) * this.width; }
  y(value) {
    const place = this.log ? Math.log10(Math.abs(value)) : value;
    return TOP + this.height * (1 - (place - this.low) / (this.high - this.low));
  }

  // Range of the axis: minimum to maximum; for a diverged run, the 5 % to 95 % quantiles widened by three spans.
  range() {
    let all = [];
    for (const { values, constant } of this.curves) {
      const some = constant === undefined ? values : [constant];
      for (const value of some) if (Number.isFinite(value) && (!this.log || value)) all.push(this.log ? Math.log10(Math.abs(value)) : value);
    }
    if (!all.length) all = [0];
    let low = Infinity, high = -Infinity;
    for (const value of all) { low = Math.min(low, value); high = Math.max(high, value); }
    if (this.stop !== null && !this.log && all.length > 20) {
      const sorted = Float64Array.from(all).sort(), at = (part) => sorted[Math.floor(part * (all.length - 1))];
      const room = 3 * (at(0.95) - at(0.05)) + 1e-12;
      [low, high] = [Math.max(low, at(0.05) - room), Math.min(high, at(0.95) + room)];
    }
    if (this.log) low = Math.max(low, high - 7);
    if (!this.log && this.zero) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
    if (!this.log) [low, high] = widened(low, high);
    const pad = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
    [this.low, this.high] = [low - pad, high + pad];
    if (this.log && this.high - this.low < 1) this.low = this.high - 1;
    const most = Math.max(Math.abs(this.low), Math.abs(this.high));
    const { power, prefix } = this.log ? { power: 0, prefix: "" } : prefixed(most, this.unit);
    [this.scale, this.prefix] = [10 ** power, prefix];
    this.unitText.textContent = superscript(`${prefix}${this.unit}`);
  }

  draw() {
    if (!this.dirty || !this.seen || !this.times) return;
    this.dirty = false;
    const g = sheet(this.base);
    if (!g) return;
    this.range();
    const ink = (name) => getComputedStyle(this.element).getPropertyValue(name);
    g.font = `11px ${getComputedStyle(this.element).fontFamily}`;
    g.textAlign = "right";
    g.textBaseline = "middle";
    g.lineWidth = 1;
    for (const { value, text } of this.log ? decades(this.low, this.high) : levels(this.low, this.high, this.scale, this.height)) {
      const y = Math.round(this.log ? this.y(10 ** value) : this.y(value)) + 0.5;
      g.strokeStyle = ink(value === 0 && !this.log ? "--axis" : "--grid");
      line(g, LEFT, y, LEFT + this.width, y);
      g.fillStyle = ink("--quiet");
      g.fillText(text, LEFT - 6, y);
    }
    g.textAlign = "center";
    g.textBaseline = "top";
    const times = levels(0, this.end, 1, this.width * 0.4);
    for (const { value, text } of times) {
      const x = Math.round(this.x(value)) + 0.5;
      g.strokeStyle = ink("--grid");
      line(g, x, TOP, x, TOP + this.height);
      const edge = x > LEFT + this.width - 20;
      g.textAlign = edge ? "right" : "center";
      g.fillText(value === times.at(-1).value ? `${text} s` : text, edge ? LEFT + this.width + RIGHT - 2 : x, TOP + this.height + 6);
    }
    g.save();
    g.beginPath();
    g.rect(LEFT, TOP, this.width, this.height);
    g.clip();
    for (const curve of this.curves) this.stroke(g, curve, ink);
    if (this.stop !== null) {
      g.strokeStyle = g.fillStyle = ink("--bad");
      g.lineWidth = 1.5;
      line(g, this.x(this.stop), TOP, this.x(this.stop), TOP + this.height);
      g.globalAlpha = 0.07;
      g.fillRect(this.x(this.stop), TOP, this.width, this.height);
    }
    g.restore();
  }

  stroke(g, { values, times = this.times, constant, colour, faint, dash, wide }, ink) {
    g.strokeStyle = ink(`--c${colour}`);
    g.globalAlpha = faint ? 0.55 : 1;
    g.lineWidth = wide ? 2.2 : faint ? 1.1 : 1.5;
    g.setLineDash(dash ? [5, 4] : []);
    g.lineJoin = "round";
    g.beginPath();
    if (constant !== undefined) {
      if (Number.isFinite(constant)) line(g, LEFT, this.y(constant), LEFT + this.width, this.y(constant));
    } else {
      let pen = false;
      for (let k = 0; k < values.length; k++) {
        const y = this.y(values[k]);
        if (!Number.isFinite(y)) { pen = false; continue; }
        const x = this.x(times[k]), kept = Math.max(-1e4, Math.min(1e4, y));
        if (pen) g.lineTo(x, kept); else g.moveTo(x, kept);
        pen = true;
      }
      g.stroke();
    }
    g.globalAlpha = 1;
    g.setLineDash([]);
  }

  // A value in the unit of the axis, without rounding errors of the axis; on a logarithmic axis, whose values span several
  // prefixes, with its own.
  reading(value) {
    if (!this.log && Math.abs(value) < 1e-7 * (this.high - this.low)) value = 0;
    const { power, prefix } = this.log ? prefixed(value, this.unit) : { power: Math.log10(this.scale), prefix: this.prefix };
    return `${figure(value / 10 ** power)} ${superscript(prefix + this.unit)}`.trim();
  }

  // The cursor at a time, and with `read` the values of the curves there.
  point(time, read) {
    if (!this.seen || !this.times) return;
    const g = sheet(this.over);
    if (!g || this.low === undefined) return;
    if (time <= this.end) {
      g.strokeStyle = getComputedStyle(this.element).getPropertyValue("--axis");
      line(g, this.x(time), TOP, this.x(time), TOP + this.height);
    }
    if (!read) return;
    let place = 0;
    for (const { values, times = this.times, constant, silent } of this.curves) {
      if (silent) continue;
      const value = constant ?? values[nearest(times, time)];
      this.readings[place++].textContent = time > times.at(-1) + 1e-9 && constant === undefined ? "" : this.reading(value);
    }
  }
}

function nearest(times, time) {
  const step = times.length > 1 ? times[1] - times[0] : 1;
  return Math.min(times.length - 1, Math.max(0, Math.round(time / step)));
}

// A canvas's context, cleared, in CSS pixels; null for one that is not laid out.
function sheet(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2), wide = canvas.clientWidth, high = canvas.clientHeight;
  if (!wide || !high) return null;
  const [w, h] = [Math.round(wide * ratio), Math.round(high * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, wide, high);
  return g;
}

function line(g, x, y, u, v) {
  g.beginPath();
  g.moveTo(x, y);
  g.lineTo(u, v);
  g.stroke();
}

// Smallest range of an axis: three significant digits, so that rounding errors are not drawn as curves and tick labels
// differ.
function widened(low, high) {
  const lacking = Math.max(Math.abs(low), Math.abs(high)) * 1e-3 - (high - low);
  return lacking > 0 ? [low - lacking / 2, high + lacking / 2] : [low, high];
}

// Ticks of a linear axis at round numbers; `pixels`: its length.
function levels(low, high, scale, pixels) {
  const rough = (high - low) / scale / Math.max(2, Math.min(8, pixels / 28)), power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].find((times) => times * power >= rough * 0.999) * power, found = [];
  for (let k = Math.ceil(low / scale / step); k * step <= (high / scale) * (1 + 1e-12); k++) {
    const value = k * step, digits = decimals(step);
    const great = Math.max(Math.abs(low), Math.abs(high)) / scale;
    const text = great >= 1e5 || digits > (great < 0.1 ? 4 : 5) ? scientific(value, step) : value.toFixed(digits);
    found.push({ value: value * scale, text: text.replace("-", "−") });
  }
  return found;
}

// Decimals of a step with at most two significant digits (1 for 2.5, 8 for 2.5e-7).
function decimals(step) {
  const [mantissa, power] = Number(step.toPrecision(2)).toExponential().split("e");
  return Math.max(0, (mantissa.split(".")[1] ?? "").length - Number(power));
}

function scientific(value, step) {
  if (!value) return "0";
  const power = Math.floor(Math.log10(Math.abs(value)) + 1e-9), digits = Math.max(0, power - Math.floor(Math.log10(step) + 1e-9));
  return `${(value / 10 ** power).toFixed(Math.min(digits, 4))}·10${raised(power)}`;
}

// Ticks of a logarithmic axis: powers of ten, on a short axis also 2 and 5 times these.
function decades(low, high) {
  const every = Math.ceil((high - low) / 6), found = [];
  for (let k = Math.ceil(low / every - 1) * every; k <= high; k += every)
    for (const times of high - low < 2.5 ? [1, 2, 5] : [1]) {
      const value = k + Math.log10(times);
      if (value >= low && value <= high) found.push({ value, text: times === 1 ? `10${raised(k)}` : `${times}·10${raised(k)}` });
    }
  return found;
}

// A unit with superscripts: m^2 as m².
function superscript(unit) {
  return unit.replace(/\^(\d+)/g, (_, digits) => raised(digits)).replace(/(?<=\p{L}|[⁰-⁹²³]) (?=\p{L})/gu, "·");
}

// A name with its index as a subscript, as pieces for `make`: w_P as w and subscript P.
function nice(text) {
  return text.split(/((?<![\p{L}\d_])\p{L}{1,2}[\u0300-\u036f]*_(?:\p{L}+\d*|\d+|⋆))(?![\p{L}_])/u).map((piece, k) => {
    if (k % 2 === 0) return piece;
    const [base, index] = piece.split("_");
    return make("span", {}, base, make("sub", {}, index));
  });
}

function make(tag, properties, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}
