// The closed loop itself: a WebAssembly module that was written from its expressions, and what Python does around a
// run: where it starts, how short its steps must be, where it blew up. Nothing here knows of a page, so that tests run
// it in Node. (A page's files are put into one script, in which they share their names.)

const REACHED = 1e-9; // a start is on the path if it is this close [m or rad]
const MOST_SLOPE = 1e12; // rates that change faster are not computed with [1/s]
const LARGEST = 1e10; // the bound of a state that is no joint's velocity
const INSTANTS = 1000; // of a run that are kept, about; twice as many would not be seen
export const MOST_WORK = 1e6; // samples and steps of rk4 in one run; beyond it a page would stand still for a second or more

// What `Math` lacks of C's functions; a module that needs none of them imports none.
const LIBRARY = {
  fmod: (x, y) => x % y,
  remainder(x, y) {
    const p = Math.abs(y), whole = x % (2 * p);
    let r = Math.abs(whole);
    if (r > p / 2) {
      r -= p;
      if (r >= p / 2) r -= p;
    }
    return whole < 0 || Object.is(whole, -0) ? -r : r;
  },
  erf(x) {
    if (Math.abs(x) > 6) return Math.sign(x);
    let term = x, sum = x; // a series of terms of one sign: nothing cancels
    for (let n = 1; Math.abs(term) > 1e-17 * Math.abs(sum); n++) sum += term *= (2 * x * x) / (2 * n + 1);
    return (2 / Math.sqrt(Math.PI)) * Math.exp(-x * x) * sum;
  },
};

// The bytes of a deflated text in base64.
export async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

export async function loaded(content) {
  const module = await WebAssembly.compile(await unpacked(content.module));
  const env = {};
  for (const { name } of WebAssembly.Module.imports(module)) env[name] = Math[name] ?? LIBRARY[name];
  return new Loop(content, (await WebAssembly.instantiate(module, { env })).exports);
}

export class Loop {
  constructor(content, exports) {
    this.content = content;
    this.exports = exports;
    const { sizes } = content, states = sizes.Z + sizes.X;
    this.states = states;
    this.places = {};
    let at = Math.ceil(exports.heap.value / 8) * 8;
    const columns = {
      state: states, scratch: states, p: sizes.P, T: 1, t: 1, pose: sizes.pose, residual: sizes.reach,
      slope: sizes.reach * sizes.pose, rates: sizes.X, shown: sizes.shown, judged: sizes.judged,
      bounds: states, kept: Math.ceil(states / 2),
    };
    for (const [name, size] of Object.entries(columns)) {
      this.places[name] = at;
      at += 8 * size;
    }
    this.free = at;
    this.room(0);
    this.view("bounds", states).set(content.bounds);
    new Int32Array(exports.memory.buffer, this.places.kept, states).set(Array.from({ length: states }, (_, k) => k));
  }

  // An array of the module's memory; growing the memory makes it void.
  view(name, size) {
    return new Float64Array(this.exports.memory.buffer, this.places[name], size);
  }

  room(bytes) {
    const { memory } = this.exports, lacking = this.free + bytes - memory.buffer.byteLength;
    if (lacking > 0) memory.grow(Math.ceil(lacking / 65536));
  }

  // Margins of conditions, the least kappa and true values of estimates, at the numbers p and from a pose.
  judged(p, pose = this.pose, tick = this.content.tick) {
    this.view("p", p.length).set(p);
    this.view("pose", pose.length).set(pose);
    this.view("T", 1)[0] = tick;
    this.exports.judged(this.places.pose, this.places.T, this.places.p, this.places.judged);
    return this.view("judged", this.content.sizes.judged).slice();
  }

  // The file's pose at the start.
  get pose() {
    const { pose, state } = this.content;
    return pose ? state.slice(pose.at, pose.at + pose.size) : [];
  }

  // By how much these move with numbers that are off by sixteen roundings: a margin below that has no sure sign.
  spread(p, pose = this.pose, tick = this.content.tick) {
    const here = this.judged(p, pose, tick), most = new Float64Array(here.length);
    for (let turn = 1; turn <= 4; turn++) {
      const off = (value, k) => value * (1 + Math.sign(Math.sin(turn * (k + 0.5) * 2.4)) * 2 ** -48);
      const scratch = this.judged(p.map(off), pose.map(off), tick);
      scratch.forEach((value, k) => (most[k] = Math.max(most[k], Math.abs(value - here[k]))));
    }
    return most;
  }

  // The state from which a run begins, and the pose in it.
  begun(p, shift, tick) {
    const { q, notice } = this.posed(p, shift);
    this.view("p", p.length).set(p);
    this.view("pose", q.length).set(q);
    this.view("T", 1)[0] = tick;
    this.exports.begin(this.places.pose, this.places.T, this.places.p, this.places.state);
    return { q, notice, state: this.view("state", this.states).slice() };
  }

  // How far V, the sum of `size` numbers that are drawn from `at` on, may be wrong by rounding, at instant k of a run:
  // n eps (V + sum |dV/dz| |z|), for n operations that round and states z that do, to first order.
  wrong({ log, every }, k, p, tick, { at, size }) {
    const { exports, places, states, content } = this, part = 2 ** -20, x = log.slice(k * states, (k + 1) * states);
    this.view("p", p.length).set(p);
    this.view("T", 1)[0] = tick;
    this.view("t", 1)[0] = k * every * tick;
    const stored = (place) => {
      const state = this.view("scratch", states);
      state.set(x);
      if (place !== null) state[place] *= 1 + part;
      exports.shown(places.scratch, places.t, places.T, places.p, places.shown);
      return this.view("shown", content.sizes.shown).subarray(at, at + size).reduce((sum, value) => sum + value, 0);
    };
    const V = stored(null);
    let read = Math.abs(V);
    for (let place = 0; place < states; place++) if (x[place]) read += Math.abs(stored(place) - V) / part;
    return content.operations * Number.EPSILON * read;
  }

  // The pose at the start: the file's, put onto the path where it is sought there, then shifted.
  posed(p, shift) {
    const { pose, state } = this.content;
    if (!pose) return { q: new Float64Array(0), notice: "" };
    const { q, notice } = pose.sought ? this.sought(p) : { q: state.slice(pose.at, pose.at + pose.size), notice: "" };
    return { q: limited(pose, q.map((angle, k) => angle + (shift?.[k] ?? 0))), notice };
  }

  // The nearest solution to the file's pose; from a few others where there is none near.
  sought(p) {
    const { pose, state } = this.content;
    this.view("p", p.length).set(p);
    const lower = pose.lower.map((end) => Math.max(end ?? -Math.PI, -Math.PI));
    const upper = pose.upper.map((end) => Math.min(end ?? Math.PI, Math.PI));
    let best = null;
    for (let seed = 0; seed < 12; seed++) {
      const from = seed === 0
        ? state.slice(pose.at, pose.at + pose.size)
        : lower.map((end, k) => end + (upper[k] - end) * ((0.5 + 0.618034 * seed * (k + 1)) % 1));
      const found = this.solved(limited(pose, from));
      if (!best || found.miss < best.miss) best = found;
      if (best.miss < REACHED) return { q: best.q, notice: "" };
    }
    const unit = this.content.goal?.unit ?? "";
    const notice = `no pose within the joints' limits is on the path's start: this one is ${plain(best.miss, unit)} away`;
    return { q: best.q, notice };
  }

  // Damped Newton iteration (Levenberg and Marquardt), held within the joints' limits.
  solved(q) {
    const m = this.content.sizes.reach, { pose } = this.content, n = pose.size;
    const at = (pose) => {
      this.view("pose", n).set(pose);
      this.exports.reach(this.places.pose, this.places.p, this.places.residual, this.places.slope);
      return { r: this.view("residual", m).slice(), J: this.view("slope", m * n).slice() };
    };
    let now = at(q), miss = Math.hypot(...now.r), damping = 1e-3;
    for (let turn = 0; turn < 80 && !(miss < 1e-15) && damping < 1e12; turn++) {
      const A = Array.from({ length: n }, (_, i) => {
        const row = new Array(n + 1).fill(0);
        for (let k = 0; k < m; k++) {
          for (let j = 0; j < n; j++) row[j] += now.J[i * m + k] * now.J[j * m + k];
          row[n] -= now.J[i * m + k] * now.r[k];
        }
        row[i] += damping * 1e-2 * Math.min(1, miss) + 1e-14; // fades, so that the last steps are Newton's own
        return row;
      });
      const step = eliminated(A), tried = limited(pose, q.map((angle, k) => angle + step[k]));
      const then = at(tried), distance = Math.hypot(...then.r);
      if (distance < miss) [q, now, miss, damping] = [tried, then, distance, damping / 8];
      else if (miss < REACHED) break;
      else damping *= 8;
    }
    return { q, miss };
  }

  // The largest modulus of an eigenvalue of the plant at a state [1/s], which limits the steps of rk4.
  speed(state, T) {
    const { sizes, flowing: n } = this.content, first = this.states - n, J = [];
    const rates = (k, shift) => {
      const x = this.view("scratch", this.states);
      x.set(state);
      x[first + k] += shift;
      this.view("T", 1)[0] = T;
      this.view("t", 1)[0] = 0;
      this.exports.flow(this.places.scratch, this.places.t, this.places.T, this.places.p, this.places.rates);
      return this.view("rates", sizes.X).slice(-n);
    };
    for (let k = 0; k < n; k++) {
      const h = 1e-6 * (1 + Math.abs(state[first + k])), after = rates(k, h), before = rates(k, -h);
      J.push(after.map((value, i) => (value - before[i]) / (2 * h)));
    }
    if (!J.every((column) => column.every((slope) => Math.abs(slope) < MOST_SLOPE))) return Infinity;
    return radius(J);
  }

  // One run. `shift` moves the joints at the start; `tick` and `horizon` are the file's where none are given; of more
  // than `most` work only the begin is run, up to `short`. Found: the kept instants' times, their states in `log`, and
  // in `drawn` what is drawn of them.
  simulate({ p, shift = null, tick = this.content.tick, horizon = this.content.horizon, most = MOST_WORK }) {
    const { content } = this, ticks = Math.max(1, Math.round(horizon / tick)), notices = [];
    const { q, notice, state: start } = this.begun(p, shift, tick);
    if (notice) notices.push(notice);

    const plainly = steps(tick, content.step ?? content.solver.plain, content.solver.most);
    let substeps = plainly;
    if (content.step === null) {
      const speed = this.speed(start, tick);
      if (speed === Infinity) notices.push("at the start the plant's rates are too steep to compute with");
      else if ((tick / substeps) * speed > content.solver.takes) {
        const h = Number((content.solver.takes / speed).toPrecision(2));
        substeps = steps(tick, h, content.solver.most);
        const few = tick / h > content.solver.most;
        notices.push(
          few
            ? "the plant is too stiff for this page: it would take steps shorter than 1/2000 of a tick"
            : `the plant is stiff: rk4 takes steps of ${plain(h, "s")}`,
        );
      }
    }
    let run = this.run(start, tick, ticks, substeps, most);
    if (run.divergence && content.step === null) {
      const h = Math.max(tick / substeps / 4, tick / content.solver.most);
      const again = this.run(start, tick, ticks, steps(tick, h, content.solver.most), most);
      // one that ends as soon at shorter steps is the loop's own fault, not that of the integrator
      if (!again.divergence || again.divergence.time >= 1.5 * run.divergence.time) {
        run = again;
        notices.push(`at longer steps the integrator itself diverged: rk4 took steps of ${plain(h, "s")}`);
      }
    }
    return { ...this.shown(run, tick), ...run, start: q, tick, horizon: ticks * tick, notices };
  }

  // The state at kept instants, from a start on; `divergence` is where it left its bounds.
  run(start, tick, wanted, substeps, most) {
    const { exports, places, states } = this;
    const ticks = Math.max(1, Math.min(wanted, Math.ceil(most / (substeps + 1))));
    const every = Math.max(1, Math.ceil(ticks / INSTANTS)), rows = Math.floor(ticks / every) + 1;
    this.room(16 * ticks + 8 * states * (rows + 1));
    const given = this.free, log = given + 16 * ticks, buffer = exports.memory.buffer;
    const instants = new Float64Array(buffer, given, 2 * ticks);
    for (let k = 0; k < ticks; k++) {
      instants[2 * k] = k * tick;
      instants[2 * k + 1] = tick;
    }
    const state = this.view("state", states);
    state.set(start);
    const done = exports.run(
      places.state, places.p, tick, substeps, 0, ticks, given, every, places.kept, states, log, places.bounds,
    );
    // one that blew up is run once more, so that as many instants are kept of its shorter time
    if (done < ticks && every > 1 && done < ticks / 2) return this.run(start, tick, done + 1, substeps, most);
    const divergence = done < ticks ? this.beyond(state, (done + 1) * tick) : null;
    const all = new Float64Array(buffer, log, states * rows);
    if (!divergence && ticks % every === 0) all.set(state, states * (rows - 1));
    const kept = Math.floor(done / every) + 1;
    const short = ticks < wanted && !divergence ? ticks * tick : 0;
    return { log: all.slice(0, states * kept), kept, every, substeps, divergence, short, work: done * (substeps + 1) };
  }

  // Which state left its bound; one that is no number goes before others.
  beyond(state, time) {
    const { bounds, states } = this.content;
    let row = state.findIndex((value) => !Number.isFinite(value));
    const infinite = row >= 0;
    if (!infinite) row = state.findIndex((value, k) => Math.abs(value) > bounds[k]);
    let element = row;
    const owner = states.find(({ size }) => element < size || ((element -= size), false));
    const limit = bounds[row] < LARGEST ? ", 100 times the joint's limit," : "";
    const how = infinite ? "is no longer finite" : `is beyond ${plain(bounds[row], owner.unit)}${limit}`;
    const says = `${owner.label}[${element}] ${how} at t = ${Number(time.toPrecision(6))} s`;
    return { label: owner.label, element, time, how, says };
  }

  // Times, what is drawn at each, and where the tool should be: for a goal of joints, where it would be at these.
  shown({ log, kept, every }, tick) {
    const { exports, places, states } = this, { sizes, pose, goal } = this.content, width = sizes.shown;
    const jointly = goal && pose && sizes.scene && goal.size === pose.size && goal.unit !== "m";
    this.room(8 * states * kept);
    new Float64Array(exports.memory.buffer, this.free, states * kept).set(log);
    this.view("T", 1)[0] = tick;
    const times = new Float64Array(kept), drawn = new Float64Array(width * kept);
    const aims = jointly ? new Float64Array(3 * kept) : null;
    const t = this.view("t", 1), result = this.view("shown", width), scratch = this.view("scratch", states);
    for (let k = 0; k < kept; k++) {
      t[0] = times[k] = k * every * tick;
      const row = this.free + 8 * states * k;
      exports.shown(row, places.t, places.T, places.p, places.shown);
      drawn.set(result, width * k);
      if (!jointly) continue;
      scratch.set(log.subarray(states * k, states * (k + 1)));
      scratch.set(drawn.subarray(width * k + goal.at, width * k + goal.at + goal.size), pose.at);
      exports.shown(places.scratch, places.t, places.T, places.p, places.shown);
      aims.set(result.subarray(sizes.scene - 3, sizes.scene), 3 * k);
    }
    return { times, drawn, aims };
  }
}

// Equal steps in a tick that are none longer than h. Rounding first: 8 ms are eight steps of 1 ms, not nine.
function steps(tick, h, most) {
  return Math.min(most, Math.max(1, Math.ceil(Number((tick / h).toFixed(9)))));
}

function limited(pose, q) {
  return Array.from(q, (angle, k) => Math.min(pose.upper[k] ?? Infinity, Math.max(pose.lower[k] ?? -Infinity, angle)));
}

// The solution of a small linear system, given as rows with the right side behind them.
function eliminated(rows) {
  const n = rows.length;
  for (let k = 0; k < n; k++) {
    let best = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
    [rows[k], rows[best]] = [rows[best], rows[k]];
    for (let i = 0; i < n; i++) {
      if (i === k || !rows[i][k]) continue;
      const factor = rows[i][k] / rows[k][k];
      for (let j = k; j <= n; j++) rows[i][j] -= factor * rows[k][j];
    }
  }
  return rows.map((row, k) => row[n] / row[k]);
}

// The spectral radius by Gelfand's formula, |A^(2^k)|^(1/2^k): each square is scaled, its scale kept as a logarithm.
function radius(A) {
  const n = A.length;
  let logarithm = 0, weight = 1;
  for (let turn = 0; turn < 24; turn++) {
    const size = Math.sqrt(A.reduce((sum, column) => column.reduce((all, value) => all + value * value, sum), 0));
    if (!(size > 0)) return 0;
    logarithm += weight * Math.log(size);
    weight /= 2;
    const B = A.map((column) => column.map((value) => value / size));
    A = B.map((right) => {
      const column = new Float64Array(n);
      for (let k = 0; k < n; k++) if (right[k]) for (let i = 0; i < n; i++) column[i] += B[k][i] * right[k];
      return column;
    });
  }
  return Math.exp(logarithm);
}

const PREFIXES = { "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M" };
const LARGE = [-6, 6];
const PREFIXED = {
  m: [-9, 3], s: [-9, 0], rad: [-6, 0], Hz: [0, 6],
  N: LARGE, J: LARGE, W: LARGE, V: LARGE, A: LARGE, Pa: LARGE,
};

// The power of ten that a unit's prefix takes of a number, and that prefix.
export function prefixed(value, unit) {
  const first = /^\p{L}+(?!\^)(?![\p{L}\p{N}_])/u.exec(unit)?.[0];
  const [least, greatest] = PREFIXED[first] ?? [0, 0];
  const digits = value ? Math.floor(Math.floor(Math.log10(Math.abs(value)) + 1e-12) / 3) * 3 : 0;
  const power = Math.min(Math.max(digits, least), greatest);
  return { power, prefix: PREFIXES[power] };
}

// A quantity for people, to three digits: 90 ms.
export function plain(value, unit) {
  if (!Number.isFinite(value)) return `${value} ${unit}`.trim();
  const rounded = Number(value.toPrecision(3)), { power, prefix } = prefixed(rounded, unit);
  return `${short(rounded / 10 ** power)} ${prefix}${unit}`.trim();
}

// As Python's %.6g would have it.
export function short(value, digits = 6) {
  const text = value.toPrecision(digits), [mantissa, power] = Number(text).toExponential().split("e");
  if (+power >= digits || +power < -4) return `${mantissa}e${power[0]}${power.slice(1).padStart(2, "0")}`;
  return String(Number(text));
}
