// Runs the scripts of a page in Node: one JSON document on stdin, results as JSON on stdout.
import { readFileSync } from "node:fs";

const { web, content, runs = [], judged = [], climbs = [], quantities = [] } = JSON.parse(readFileSync(0, "utf-8"));
const { loaded, plain } = await import(`${web}/solver.js`);
const { climbOf, judgement } = await import(`${web}/verdict.js`);

const loop = content?.module ? await loaded(content) : null;
const answers = [];
for (const { p = content.p, ...options } of runs) {
  const run = loop.simulate({ p, ...options });
  const { start, notices, substeps, kept, every, short } = run;
  answers.push({
    start, notices, substeps, kept, every, short,
    divergence: run.divergence ? run.divergence.message : null,
    times: Array.from(run.times),
    states: Array.from({ length: kept }, (_, k) => Array.from(run.log.subarray(k * loop.states, (k + 1) * loop.states))),
    drawn: Array.from(run.drawn.subarray(0, content.sizes.shown)),
    speed: loop.speed(run.log.subarray(0, loop.states), run.tick),
  });
}
for (const { p = null, margins = null, shift = null, run = {}, moved: { at, ...moved } } of judged) {
  const pose = p ? loop.initialPose(p, shift).q : null;
  const found = p ? loop.judged(p, pose) : Float64Array.from(margins, (value) => value ?? NaN);
  answers.push(judgement(content, found, at ? { ...moved, at: new Set(at) } : moved, p ? loop.spread(p, pose) : null, run));
}
for (const { V, rounding, restarts } of climbs) answers.push(climbOf(V, rounding, restarts));
process.stdout.write(JSON.stringify({ answers, plain: quantities.map((pair) => plain(...pair)) }));
