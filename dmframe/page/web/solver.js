// Simulation of the closed loop: a WebAssembly module generated from its expressions, and the JavaScript counterpart of
// dmframe.simulate for the initial state, the step size and divergence. This file does not access the page, so that tests
// run it in Node. (The files of a page are joined into one script and share one scope.)

const REACHED = 1e-9; // tolerance of an initial pose on the path [m or rad]
const MOST_SLOPE = 1e12; // largest entry of the plant's Jacobian [1/s]
const LARGEST = 1e10; // bound of the states other than joint velocities
const DENSE = 4e6; // most numbers of a run whose V is computed at each sample; they take 32 MB
const INSTANTS = 1000; // approximate number of recorded instants of a run; a plot resolves no more
export const MOST_WORK = 1e6; // samples and rk4 steps in one run; more would block the page for a second or longer

// Functions of the C library that `Math` lacks; a module imports only those that it calls.
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
    let term = x, sum = x; // all terms have one sign, so there is no cancellation
    for (let n = 1; Math.abs(term) > 1e-17 * Math.abs(sum); n++) sum += term *= (2 * x * x) / (2 * n + 1);
    return (2 / Math.sqrt(Math.PI)) * Math.exp(-x * x) * sum;
  },
};

// Bytes of a deflated and base64-encoded text.
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
      slope: sizes.reach * sizes.pose, rates: sizes.X, shown: sizes.shown, judged: sizes.judged, stored: sizes.stored ?? 0,
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

  // Array in the module's memory; growing the memory invalidates it.
  view(name, size) {
    return new Float64Array(this.exports.memory.buffer, this.places[name], size);
  }

  room(bytes) {
    const { memory } = this.exports, lacking = this.free + bytes - memory.buffer.byteLength;
    if (lacking > 0) memory.grow(Math.ceil(lacking / 65536));
  }

  // Margins of the conditions, the smallest kappa and the true values of the estimates, for parameters p and an initial pose.
  judged(p, pose = this.pose, tick = this.content.tick) {
    this.view("p", p.length).set(p);
    this.view("pose", pose.length).set(pose);
    this.view("T", 1)[0] = tick;
    this.exports.judged(this.places.pose, this.places.T, this.places.p, this.places.judged);
    return this.view("judged", this.content.sizes.judged).slice();
  }

  // Initial pose of the file.
  get pose() {
    const { pose, state } = this.content;
    return pose ? state.slice(pose.at, pose.at + pose.size) : [];
  }

  // Change of these values under relative perturbations of 2^-48 (16 roundings): the sign of a smaller margin is uncertain.
  spread(p, pose = this.pose, tick = this.content.tick) {
    const here = this.judged(p, pose, tick), most = new Float64Array(here.length);
    for (let turn = 1; turn <= 4; turn++) {
      const off = (value, k) => value * (1 + Math.sign(Math.sin(turn * (k + 0.5) * 2.4)) * 2 ** -48);
      const scratch = this.judged(p.map(off), pose.map(off), tick);
      scratch.forEach((value, k) => (most[k] = Math.max(most[k], Math.abs(value - here[k]))));
    }
    return most;
  }

  // Initial state of a run, and its pose, which may be given.
  initial(p, shift, tick, pose = null) {
    const { q, notice } = pose ? { q: pose, notice: "" } : this.initialPose(p, shift);
    this.view("p", p.length).set(p);
    this.view("pose", q.length).set(q);
    this.view("T", 1)[0] = tick;
    this.exports.begin(this.places.pose, this.places.T, this.places.p, this.places.state);
    return { q, notice, state: this.view("state", this.states).slice() };
  }

  // Bound on the rounding error of V (sum of `size` plotted outputs from `at` on) at instant k of a run, to first order:
  // n eps (V + sum |dV/dz| |z|), with n rounded operations and states z.
  roundingError({ log, every }, k, p, tick, { at, size }) {
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

  // Initial pose: that of the file or, if `sought`, one on the path; then shifted by the sliders.
  initialPose(p, shift) {
    const { pose, state } = this.content;
    if (!pose) return { q: new Float64Array(0), notice: "" };
    const { q, notice } = pose.sought ? this.poseOnPath(p) : { q: state.slice(pose.at, pose.at + pose.size), notice: "" };
    return { q: limited(pose, q.map((angle, k) => angle + (shift?.[k] ?? 0))), notice };
  }

  // Pose on the path: the solution from the file's pose, else from up to eleven other seeds.
  poseOnPath(p) {
    const { pose, state } = this.content;
    this.view("p", p.length).set(p);
    const lower = pose.lower.map((end) => Math.max(end ?? -Math.PI, -Math.PI));
    const upper = pose.upper.map((end) => Math.min(end ?? Math.PI, Math.PI));
    let best = null;
    for (let seed = 0; seed < 12; seed++) {
      const from = seed === 0
        ? state.slice(pose.at, pose.at + pose.size)
        : lower.map((end, k) => end + (upper[k] - end) * ((0.5 + 0.618034 * seed * (k + 1)) % 1));
      const found = this.inverseKinematics(limited(pose, from));
      if (!best || found.miss < best.miss) best = found;
      if (best.miss < REACHED) return { q: best.q, notice: "" };
    }
    const unit = this.content.goal?.unit ?? "";
    const notice = `no pose within the joint limits reaches the start of the path: the nearest one found is ${plain(best.miss, unit)} away`;
    return { q: best.q, notice };
  }

  // Levenberg-Marquardt iteration for a pose on the path, clipped to the joint limits.
  inverseKinematics(q) {
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
        row[i] += damping * 1e-2 * Math.min(1, miss) + 1e-14; // vanishes with the error, so that the last steps are Newton steps
        return row;
      });
      const step = gaussJordan(A), tried = limited(pose, q.map((angle, k) => angle + step[k]));
      const then = at(tried), distance = Math.hypot(...then.r);
      if (distance < miss) [q, now, miss, damping] = [tried, then, distance, damping / 8];
      else if (miss < REACHED) break;
      else damping *= 8;
    }
    return { q, miss };
  }

  // Spectral radius of the plant's Jacobian at a state [1/s]; it limits the rk4 step.
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

  // Simulates one run. `shift`: offset of the initial joint positions, or `pose`: these positions; `tick`, `horizon`: default those of the file; `most`:
  // largest work, beyond which the run ends early at time `short`; `dense`: V at each sample, in `V`. Result: `times`, states in `log` and plotted outputs in
  // `drawn` at the recorded instants.
  simulate({ p, shift = null, pose = null, tick = this.content.tick, horizon = this.content.horizon, most = MOST_WORK, dense = false }) {
    const { content } = this, ticks = Math.max(1, Math.round(horizon / tick)), notices = [];
    const { q, notice, state: start } = this.initial(p, shift, tick, pose);
    if (notice) notices.push(notice);

    const usual = steps(tick, content.step ?? content.solver.plain, content.solver.most);
    let substeps = usual;
    if (content.step === null) {
      const speed = this.speed(start, tick);
      if (speed === Infinity) notices.push("the Jacobian of the plant at the initial state exceeds 1e12 1/s: the step size is not computed from it");
      else if ((tick / substeps) * speed > content.solver.takes) {
        const h = Number((content.solver.takes / speed).toPrecision(2));
        substeps = steps(tick, h, content.solver.most);
        const few = tick / h > content.solver.most;
        notices.push(
          few
            ? "the plant is too stiff for this page: it requires steps shorter than 1/2000 of a sampling period"
            : `the plant is stiff: rk4 takes steps of ${plain(h, "s")}`,
        );
      }
    }
    let run = this.run(start, tick, ticks, substeps, most, dense);
    if (run.divergence && content.step === null) {
      const h = Math.max(tick / substeps / 4, tick / content.solver.most);
      const finer = this.run(start, tick, ticks, steps(tick, h, content.solver.most), most, dense);
      // a run that diverges as early with shorter steps diverges by the loop, not by the integrator
      if (!finer.divergence || finer.divergence.time >= 1.5 * run.divergence.time) {
        run = finer;
        notices.push(`the integrator diverged at longer steps: rk4 takes steps of ${plain(h, "s")}`);
      }
    }
    return { ...this.shown(run, tick), ...run, start: q, tick, horizon: ticks * tick, notices };
  }

  // States at the recorded instants of a run; `divergence`: the state that exceeded its bound.
  run(start, tick, wanted, substeps, most, dense = false) {
    const { exports, places, states } = this;
    const ticks = Math.max(1, Math.min(wanted, Math.ceil(most / (substeps + 1))));
    const every = Math.max(1, Math.ceil(ticks / INSTANTS)), stored = this.content.sizes.stored ?? 0;
    const stride = dense && stored && ticks * states < DENSE ? 1 : every, rows = Math.floor(ticks / stride) + 1;
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
      places.state, places.p, tick, substeps, 0, ticks, given, stride, places.kept, states, log, places.bounds,
    );
    // a diverged run is repeated up to its end, so that its shorter time has as many recorded instants
    if (done < ticks && every > 1 && done < ticks / 2) return this.run(start, tick, done + 1, substeps, most, dense);
    const divergence = done < ticks ? this.divergence(state, (done + 1) * tick) : null;
    const all = new Float64Array(buffer, log, states * rows);
    if (!divergence && ticks % stride === 0) all.set(state, states * (rows - 1));
    const kept = Math.floor(done / every) + 1, part = Math.round(every / stride);
    const kepts = part === 1 ? all.slice(0, states * kept) : new Float64Array(states * kept);
    if (part > 1) for (let k = 0; k < kept; k++) kepts.set(all.subarray(k * part * states, (k * part + 1) * states), k * states);
    const V = stride < every || (dense && stored) ? this.storedAlong(log, Math.floor(done / stride) + 1, tick * stride, tick) : null;
    const short = ticks < wanted && !divergence ? ticks * tick : 0;
    return { log: kepts, V, kept, every, substeps, divergence, short, work: done * (substeps + 1) };
  }

  // V and the values of stepping sources at the rows of a log, and the rows at which a source has stepped.
  storedAlong(log, rows, step, tick) {
    const { exports, places, states, content } = this, width = content.sizes.stored, values = new Float64Array(rows), restarts = [];
    this.view("T", 1)[0] = tick;
    const t = this.view("t", 1), found = this.view("stored", width), before = new Float64Array(width);
    for (let k = 0; k < rows; k++) {
      t[0] = k * step;
      exports.stored(log + 8 * states * k, places.t, places.T, places.p, places.stored);
      values[k] = found[0];
      for (let i = 1; i < width; i++) if (found[i] !== before[i]) { if (k && restarts.at(-1) !== k) restarts.push(k); before[i] = found[i]; }
    }
    return { values, restarts };
  }

  // The state that exceeded its bound; one that is not finite comes first.
  divergence(state, time) {
    const { bounds, states } = this.content;
    let row = state.findIndex((value) => !Number.isFinite(value));
    const infinite = row >= 0;
    if (!infinite) row = state.findIndex((value, k) => Math.abs(value) > bounds[k]);
    let element = row;
    const owner = states.find(({ size }) => element < size || ((element -= size), false));
    const far = owner.label.endsWith(".q") ? "farther outside of the joint's limits than they are apart" : "100 times the joint's limit";
    const limit = bounds[row] < LARGEST ? `, ${far},` : "";
    const how = infinite ? "is no longer finite" : `is beyond ${plain(bounds[row], owner.unit)}${limit}`;
    const message = `${owner.label}[${element}] ${how} at t = ${Number(time.toPrecision(6))} s`;
    return { label: owner.label, element, time, how, message };
  }

  // Times, plotted outputs, and desired tool positions: for a goal in joint space, the tool position at these joints.
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

// Number of equal steps of length <= h in a tick. Rounded first: 8 ms is eight steps of 1 ms, not nine.
function steps(tick, h, most) {
  return Math.min(most, Math.max(1, Math.ceil(Number((tick / h).toFixed(9)))));
}

function limited(pose, q) {
  return Array.from(q, (angle, k) => Math.min(pose.upper[k] ?? Infinity, Math.max(pose.lower[k] ?? -Infinity, angle)));
}

// Solution of a small linear system by Gauss-Jordan elimination; each row ends with its right-hand side.
function gaussJordan(rows) {
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

// Spectral radius by Gelfand's formula, |A^(2^k)|^(1/2^k), by repeated squaring with the scale as a logarithm.
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

// SI prefix of a value in a unit, and its power of ten.
export function prefixed(value, unit) {
  const first = /^\p{L}+(?!\^)(?![\p{L}\p{N}_])/u.exec(unit)?.[0];
  const [least, greatest] = PREFIXED[first] ?? [0, 0];
  const digits = value ? Math.floor(Math.floor(Math.log10(Math.abs(value)) + 1e-12) / 3) * 3 : 0;
  const power = Math.min(Math.max(digits, least), greatest);
  return { power, prefix: PREFIXES[power] };
}

// A quantity to three digits with an SI prefix: 90 ms.
export function plain(value, unit) {
  if (!Number.isFinite(value)) return `${value} ${unit}`.trim();
  const rounded = Number(value.toPrecision(3)), { power, prefix } = prefixed(rounded, unit);
  return `${short(rounded / 10 ** power)} ${prefix}${unit}`.trim();
}

// A number as Python's %.6g formats it.
export function short(value, digits = 6) {
  const text = value.toPrecision(digits), [mantissa, power] = Number(text).toExponential().split("e");
  if (+power >= digits || +power < -4) return `${mantissa}e${power[0]}${power.slice(1).padStart(2, "0")}`;
  return String(Number(text));
}
