// Rivals of the controller: their parameters, error and place of the tool. This file does not access the page.

const PART = 5; // errors are compared over the last fifth of a run

// Parameters of a rival: its own, with those that it shares with the page's loop.
export function sharedValues({ shared, loop }, p) {
  const found = loop.p.slice();
  for (const [from, to, size] of shared) for (let k = 0; k < size; k++) found[to + k] = p[from + k];
  return found;
}

// Norm of the error at the recorded instants: rows `at` to `at + size` of the plotted outputs, of which there are `width`.
export function normOf(run, { at, size }, width) {
  return Float64Array.from({ length: run.kept }, (_, k) => Math.hypot(...run.drawn.subarray(k * width + at, k * width + at + size)));
}

// Root mean square of values at `times` over the last fifth of the horizon; null for a run that ended before.
export function lastRms(times, values, horizon) {
  const from = horizon * (1 - 1 / PART) - 1e-9, some = values.filter((_, k) => times[k] >= from);
  if (!some.length || times.at(-1) < horizon * (1 - 1e-3)) return null;
  return Math.sqrt(some.reduce((sum, value) => sum + value * value, 0) / some.length);
}

// The tool's trace and its desired path as points in space. `factor` enlarges the deviation of one from the other.
export function tracesOf(run, { sizes, goal }, axes, factor) {
  const { scene: places, shown } = sizes, trace = new Float32Array(3 * run.kept), path = new Float32Array(3 * run.kept);
  const aimed = goal && (run.aims || goal.unit === "m");
  for (let k = 0; k < run.kept; k++) {
    const tool = run.drawn.subarray(k * shown + places - 3, k * shown + places);
    path.set(run.aims ? run.aims.subarray(3 * k, 3 * k + 3) : tool, 3 * k);
    if (!run.aims && aimed) [...axes].forEach((axis, i) => (path[3 * k + "xyz".indexOf(axis)] = run.drawn[k * shown + goal.at + i]));
    for (let i = 0; i < 3; i++) trace[3 * k + i] = path[3 * k + i] + factor * (tool[i] - path[3 * k + i]);
  }
  return { trace: aimed ? trace : factor === 1 ? trace : tracesOf(run, { sizes, goal }, axes, 1).trace, path: aimed ? path : null };
}

// A point of a polyline at a time, between two recorded instants.
export function pointAt(points, run, time) {
  const step = run.every * run.tick, last = run.kept - 1;
  const k = Math.max(0, Math.min(last, Math.floor(time / step))), then = Math.min(last, k + 1), part = Math.min(1, Math.max(0, time / step - k));
  return { past: k, point: [0, 1, 2].map((i) => points[3 * k + i] * (1 - part) + points[3 * then + i] * part) };
}
