// What the tests ask of a page's scripts, in Node: one JSON document in, a list of answers out.
import { readFileSync } from "node:fs";

const { web, content, runs = [], judged = [], climbs = [], quantities = [] } = JSON.parse(readFileSync(0, "utf-8"));
const { loaded, plain } = await import(`${web}/solver.js`);
const { climbOf, judgement } = await import(`${web}/verdict.js`);

const loop = content?.module ? await loaded(content) : null;
const answers = [];
for (const { p = content.p, ...asked } of runs) {
  const run = loop.simulate({ p, ...asked });
  const { start, notices, substeps, kept, every, short } = run;
  answers.push({
    start, notices, substeps, kept, every, short,
    divergence: run.divergence ? run.divergence.says : null,
    times: Array.from(run.times),
    states: Array.from({ length: kept }, (_, k) => Array.from(run.log.subarray(k * loop.states, (k + 1) * loop.states))),
    drawn: Array.from(run.drawn.subarray(0, content.sizes.shown)),
    speed: loop.speed(run.log.subarray(0, loop.states), run.tick),
  });
}
for (const { p = null, margins = null, shift = null, run = {}, moved: { at, ...moved } } of judged) {
  const pose = p ? loop.posed(p, shift).q : null;
  const found = p ? loop.judged(p, pose) : Float64Array.from(margins, (value) => value ?? NaN);
  answers.push(judgement(content, found, at ? { ...moved, at: new Set(at) } : moved, p ? loop.spread(p, pose) : null, run));
}
for (const { V, wrong } of climbs) answers.push(climbOf(V, wrong));
process.stdout.write(JSON.stringify({ answers, plain: quantities.map((pair) => plain(...pair)) }));
