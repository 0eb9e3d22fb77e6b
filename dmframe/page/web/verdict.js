// Verdict at the values of the sliders. This file does not access the page.

// Conditions at the parameters and initial state of `judged`; `moved`: what differs from the file. A tacit condition is
// listed only if it does not hold, as in `verify`.
export function conditionsAt({ verdict }, judged, moved, spread) {
  const rows = verdict.conditions.map((condition) => decided(condition, judged, moved, spread));
  if (!moved.p && !moved.start) return rows;
  const tacit = (verdict.tacit ?? []).map((condition) => decided(condition, judged, moved, spread));
  const named = new Set(rows.map(({ name }) => name));
  return [...rows, ...tacit.filter(({ name, holds }) => holds !== true && !named.has(name))];
}

// `opens`: the margin is sufficient only; if it fails, `verify` has another method, so that the condition is undecided.
function decided({ name, how, strict, value, holds, at, size, reads, opens }, judged, moved, spread) {
  const changed = moved.p || moved.start;
  if (at === null) {
    // no expression of the parameters: the result for the file's values holds while the parameters that it reads are unchanged
    const stays = !changed || (reads && moved.at && !reads.some((place) => moved.at.has(place)));
    return stays ? { name, how, strict, margin: value, holds } : { name, how, strict, margin: null, holds: null };
  }
  if (!size) return { name, how, strict, margin: null, holds };
  const margin = Math.min(...judged.subarray(at, at + size)); // NaN where one of them is
  if (!changed && opens) return { name, how, strict, margin: value, holds };
  // the rounding error may change the sign: `verify`, in exact arithmetic, decides
  const least = judged.subarray(at, at + size).indexOf(margin);
  if (changed && spread && margin !== 0 && Math.abs(margin) <= spread[at + least]) return { name, how, strict, margin, holds: null };
  // an infinite margin comes from a zero divisor: `verify` decides
  if (changed && judged.subarray(at, at + size).some((each) => Math.abs(each) === Infinity)) return { name, how, strict, margin: null, holds: null };
  const found = strict ? margin > 0 : margin >= 0; // false for NaN
  return { name, how, strict, margin, holds: !found && opens ? null : found };
}

// Sampling period against a proof in continuous time: whether it exceeds the largest period at which the linearised loop is
// stable at its set-point, and a sentence. `tick` is the sampling period of the run [s].
export function clockAt({ clock, verdict, periods }, moved, tick) {
  if (clock === null || verdict.sampled || tick === undefined) return { beyond: false, text: "" };
  const every = `every ${duration(tick)}`;
  if (!periods) return { beyond: false, text: `The controller samples ${every}; whether that is fast enough was not computed.` };
  if (periods.reason) return { beyond: false, text: `The controller samples ${every}; whether that is fast enough is not known: ${sentence(periods.reason)}` };
  const rest = Number(periods.rest), moving = Number(periods.moving), beyond = tick > Math.min(rest, moving);
  const bounds = `${moved.p ? "at the file's values, with" : "With"} its estimates at their true values, the loop near its set-point is stable up to ${bound(rest)} at rest and ${bound(moving)} moving, linearised`;
  if (moved.p) return { beyond, text: `The controller samples ${every}; whether that is fast enough is not known at these values: ${bounds}.` };
  return { beyond, text: `${bounds}; the controller samples ${every}${beyond ? ", which is beyond that" : ""}.` };
}

function bound(period) {
  return Number.isFinite(period) ? (period > 0 ? duration(period) : "no period") : "every period that was checked";
}

function duration(seconds) {
  const ms = Number((1000 * seconds).toPrecision(3));
  return ms < 1000 ? `${ms} ms` : `${ms / 1000} s`;
}

const SLIGHT = 0.05; // rise of V, as a fraction of its decrease, up to which a verdict is green
const GREAT = 0.5; // rise from which it is red

// Largest increase of V above an earlier value, and number of instants with an increase; `rounding`: error of each value.
// A step of a source at an instant of `restarts` starts a new V.
export function climbOf(V, rounding, restarts = []) {
  let low = 0, rise = 0, rises = 0, sum = 0, least = V[0], fall = 0, first = 0;
  const jumps = [];
  for (let k = 1; k < V.length && Number.isFinite(V[k]); k++) {
    if (restarts[jumps.length] === k) {
      jumps.push(k);
      fall += V[first] - least;
      [low, first, least] = [k, k, V[k]];
      continue;
    }
    if (V[k] - V[k - 1] > rounding[k] + rounding[k - 1]) {
      rises++;
      sum += V[k] - V[k - 1];
    }
    if (V[k] < V[low]) low = k;
    const above = V[k] - V[low];
    if (above > rounding[k] + rounding[low]) rise = Math.max(rise, above);
    least = Math.min(least, V[k]);
  }
  fall += V[first] - least;
  return { rise, rises, steps: V.length - 1, fraction: fall > 0 ? rise / fall : null, total: fall > 0 ? sum / fall : null, jumps };
}

function riseText(climb, every) {
  if (!climb) return "";
  const of = `${climb.steps} ${every > 1 ? "recorded instants" : "samples"}`;
  const jumps = climb.jumps?.length ? " A step of the load or of another source starts a new V." : "";
  if (!climb.rises && !climb.rise) return `In this run V rose at none of ${of}.${jumps}`;
  const amount = climb.fraction === null ? "and was never below its initial value" : `by at most ${figure(100 * climb.fraction)} % of its decrease${climb.total == null ? "" : `, in sum by ${figure(100 * climb.total)} %`}`;
  return `In this run V rose at ${climb.rises} of ${of}, ${amount}.${jumps}`;
}

// How much V rose in a run: 0 slightly or not, 1 notably, 2 so much that the run is not as proved.
function grade({ climb, divergence }) {
  if (divergence) return 2;
  if (!climb || !climb.rise) return 0;
  const { fraction } = climb;
  return fraction !== null && fraction <= SLIGHT ? 0 : fraction !== null && fraction <= GREAT ? 1 : 2;
}

// Headline and sentences of the verdict. `moved`: what differs from the file: parameters (`p`; `at`: their indices), initial
// state (`start`), initial state or sampling period (`run`). `run` has the sampling period `tick` and the `climb` of V.
export function judgement(content, judged, moved, spread = null, run = {}) {
  const { verdict } = content, rows = conditionsAt(content, judged, moved, spread), changed = moved.p || moved.start;
  const failing = rows.filter((row) => row.holds === false), open = rows.filter((row) => row.holds === null);
  const found = (state, headline, ...sentences) => ({ state, headline, sentences: sentences.filter(Boolean), rows, proved: false });
  if (verdict.outcome !== "proved") {
    const headline = verdict.outcome === "refuted" ? "Refuted:" : "Not proved:";
    const others = changed && "This verdict is for the file's values; the command below with verify in place of run decides at these.";
    return found("unproved", headline, sentence(verdict.reason), others);
  }
  const sampledLoop = content.clock !== null && !verdict.sampled;
  const claim = sentence(verdict.reason.split(";")[0]), identity = sampledLoop ? `In continuous time ${claim}` : claim;
  if (failing.length) {
    const named = failing.map(({ name, margin }) => `${name} (margin ${figure(margin)})`);
    const which = `${failing.length > 1 ? `${failing.length} conditions fail` : "A condition fails"}: ${named.slice(0, 2).join("; ")}`;
    const more = failing.length > 2 ? `; and ${failing.length - 2} more` : "";
    return found("fails", "The proof does not apply at these values", `${which}${more}.`, "V may rise here.");
  }
  const risen = grade(run), how = sampledLoop ? `sampled every ${duration(run.tick ?? content.clock)}` : "with these steps of the integrator";
  const climbs = run.climb?.fraction == null ? "V rises above its initial value" : `V rises by ${Number((100 * run.climb.fraction).toPrecision(2))} % of its decrease`;
  const unlike = `This run is not as proved: ${how}, ${run.divergence ? "it diverges" : climbs}`;
  const kappa = verdict.kappa === null ? NaN : judged[verdict.kappa];
  const weight = kappa > 0 ? `, with any κ above ${figure(kappa)}` : "";
  if (open.length) {
    const names = open.map(({ name }) => name).slice(0, 2).join("; ");
    const near = open.every(({ margin }) => margin !== null);
    const where = near ? "too close to zero for this page" : "decided for the file's values only";
    const rest = `${open.length > 1 ? `${open.length} conditions are` : "One condition is"} ${where}`;
    return found(risen === 2 ? "fails" : "undecided", risen === 2 ? unlike : "Not decided at these values", identity, `${rest}: ${names}${open.length > 2 ? "; ..." : ""}.`);
  }
  const clock = clockAt(content, moved, run.tick), rose = riseText(run.climb, run.V ? 1 : run.every);
  const some = rows.filter(({ how }) => how === "sampled").length, samples = some ? ` (${some} of them sampled, not proved)` : "";
  const over = verdict.uncertain?.length ? ` and anywhere in the intervals of ${verdict.uncertain.join(", ")}` : "";
  const hold = `All ${rows.length} conditions hold at ${changed ? "these values" : "the file's values"}${over}${samples}${weight}.`;
  const concluded = verdict.conclusions.filter((text) => !text.startsWith("d"));
  // boundedness of all states is a conclusion too, and may fail at other values
  const follows = (changed && verdict.bounded ? [...concluded, "the whole loop stays bounded"] : concluded).join(" and that ");
  const end = follows && (
    changed ? `That ${follows} was concluded for the file's values; for these it is not decided.`
      : moved.run ? `That ${follows} was concluded ${verdict.sampled ? "" : "in continuous time and "}for the initial state of the file.` : `It follows that ${follows}.`
  );
  const words = `proved${changed ? " at these values" : ""}${sampledLoop ? " in continuous time" : ""}`;
  const beyond = clock.beyond ? `; at ${duration(run.tick)} unstable near its set-point` : "";
  const headline = risen === 2 ? unlike : verdict.headline.replace("proved", words) + (beyond || (risen ? `; ${how}, ${climbs}` : ""));
  const state = risen === 2 ? "fails" : risen || clock.beyond ? "clock" : "proved";
  const unknown = content.periods?.reason ? clock.text : ""; // it is long, and comes last
  return { ...found(state, headline.charAt(0).toUpperCase() + headline.slice(1), unknown ? "" : clock.text, rose, identity, hold, end, unknown), proved: true };
}

// A text with a full stop. Its first letter is not capitalised: it may belong to a symbol or a block.
function sentence(text) {
  return /[.!]$/.test(text) ? text : `${text}.`;
}

// A number to three digits: 0.00311, 2.54·10⁻⁶.
export function figure(value) {
  const size = Math.abs(value);
  if (!Number.isFinite(value)) return String(value);
  if (!size || (size >= 1e-3 && size < 1e5)) return String(Number(value.toPrecision(3))).replace("-", "−");
  const [digits, power] = value.toExponential(2).split("e");
  return `${String(Number(digits)).replace("-", "−")}·10${raised(Number(power))}`;
}

export function raised(power) {
  return String(power).replace("-", "⁻").replace(/\d/g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]);
}
