// What may be said of the proof where the sliders stand. Nothing here knows of a page.

// The conditions at the numbers and the start that `judged` was evaluated at; `moved`: these are not the file's. What is
// tacit is among them only where it does not hold: `verify` names it there alone.
export function conditionsAt({ verdict }, judged, moved, spread) {
  const rows = verdict.conditions.map((condition) => decided(condition, judged, moved, spread));
  if (!moved.p && !moved.start) return rows;
  const tacit = (verdict.tacit ?? []).map((condition) => decided(condition, judged, moved, spread));
  const named = new Set(rows.map(({ name }) => name));
  return [...rows, ...tacit.filter(({ name, holds }) => holds !== true && !named.has(name))];
}

// `opens`: where its margin does not hold, `verify` would look in another way, so that nothing is decided.
function decided({ name, how, strict, value, holds, at, size, reads, opens }, judged, moved, spread) {
  const elsewhere = moved.p || moved.start;
  if (at === null) {
    // no expression of parameters: what was decided for the file's numbers holds while those that it reads stay
    const stays = !elsewhere || (reads && moved.at && !reads.some((place) => moved.at.has(place)));
    return stays ? { name, how, strict, margin: value, holds } : { name, how, strict, margin: null, holds: null };
  }
  if (!size) return { name, how, strict, margin: null, holds };
  const margin = Math.min(...judged.subarray(at, at + size)); // NaN where one of them is
  if (!elsewhere && opens) return { name, how, strict, margin: value, holds };
  // so close to zero that rounding may have turned its sign: `verify`, which does not round, decides
  const least = judged.subarray(at, at + size).indexOf(margin);
  if (elsewhere && spread && margin !== 0 && Math.abs(margin) <= spread[at + least]) return { name, how, strict, margin, holds: null };
  // a divisor that is zero is no margin, however large: `verify` decides
  if (elsewhere && judged.subarray(at, at + size).some((each) => Math.abs(each) === Infinity)) return { name, how, strict, margin: null, holds: null };
  const found = strict ? margin > 0 : margin >= 0; // NaN holds nowhere
  return { name, how, strict, margin, holds: !found && opens ? null : found };
}

// What is known of the clock of a proof in continuous time: whether the period is beyond the largest one at which the
// loop is stable near its set-point, and a sentence. `tick` is the period of the run [s].
export function clockAt({ clock, verdict, periods }, moved, tick) {
  if (clock === null || verdict.sampled || tick === undefined) return { beyond: false, says: "" };
  const every = `every ${duration(tick)}`;
  if (!periods) return { beyond: false, says: `The controller samples ${every}; whether that is fast enough was not computed.` };
  if (periods.reason) return { beyond: false, says: `The controller samples ${every}; whether that is fast enough is not known: ${sentence(periods.reason)}` };
  const rest = Number(periods.rest), moving = Number(periods.moving), beyond = tick > Math.min(rest, moving);
  const bounds = `${moved.p ? "at the file's numbers, with" : "With"} its estimates at their true values, the loop near its set-point is stable up to ${bound(rest)} at rest and ${bound(moving)} moving, linearised`;
  if (moved.p) return { beyond, says: `The controller samples ${every}; whether that is fast enough is not known at these values: ${bounds}.` };
  return { beyond, says: `${bounds}; the controller samples ${every}${beyond ? ", which is beyond that" : ""}.` };
}

function bound(period) {
  return Number.isFinite(period) ? (period > 0 ? duration(period) : "no period") : "every period looked at";
}

function duration(seconds) {
  const ms = Number((1000 * seconds).toPrecision(3));
  return ms < 1000 ? `${ms} ms` : `${ms / 1000} s`;
}

// How far V rose above an earlier value, and at how many of the instants; `wrong`: by how much each value may be wrong.
export function climbOf(V, wrong) {
  let low = 0, rise = 0, rises = 0, least = V[0];
  for (let k = 1; k < V.length && Number.isFinite(V[k]); k++) {
    if (V[k] - V[k - 1] > wrong[k] + wrong[k - 1]) rises++;
    if (V[k] < V[low]) low = k;
    const above = V[k] - V[low];
    if (above > wrong[k] + wrong[low]) rise = Math.max(rise, above);
    least = Math.min(least, V[k]);
  }
  const fall = V[0] - least;
  return { rise, rises, steps: V.length - 1, share: fall > 0 ? rise / fall : null };
}

function risen(climb, every) {
  if (!climb) return "";
  const of = `${climb.steps} ${every > 1 ? "instants that are kept" : "samples"}`;
  if (!climb.rises && !climb.rise) return `In this run V rose at none of ${of}.`;
  const share = climb.share === null ? "and never came below its start" : `by at most ${figure(100 * climb.share)} % of its fall`;
  return `In this run V rose at ${climb.rises} of ${of}, ${share}.`;
}

// A headline, and sentences. `moved.p`: numbers of the loop are not the file's, of which `moved.at` says which;
// `moved.start`: nor is its start; `moved.run`: its start or its clock. `run` has its period `tick`, and V's `climb`.
export function judgement(content, judged, moved, spread = null, run = {}) {
  const { verdict } = content, rows = conditionsAt(content, judged, moved, spread), elsewhere = moved.p || moved.start;
  const failing = rows.filter((row) => row.holds === false), open = rows.filter((row) => row.holds === null);
  const found = (state, headline, ...says) => ({ state, headline, says: says.filter(Boolean), rows });
  if (verdict.outcome !== "proved") {
    const headline = verdict.outcome === "refuted" ? "Refuted:" : "Not proved:";
    const others = elsewhere && "So it was found at the file's numbers; the command below, with verify for run, decides at these.";
    return found("unproved", headline, sentence(verdict.reason), others);
  }
  const clocked = content.clock !== null && !verdict.sampled;
  const claim = sentence(verdict.reason.split(";")[0]), identity = clocked ? `In continuous time ${claim}` : claim;
  if (failing.length) {
    const named = failing.map(({ name, margin }) => `${name} (margin ${figure(margin)})`);
    const which = `${failing.length > 1 ? `${failing.length} conditions fail` : "A condition fails"}: ${named.slice(0, 2).join("; ")}`;
    const more = failing.length > 2 ? `; and ${failing.length - 2} more` : "";
    return found("fails", "The proof does not apply at these values", `${which}${more}.`, "V may rise here.");
  }
  const kappa = verdict.kappa === null ? NaN : judged[verdict.kappa];
  const weight = kappa > 0 ? `, with any κ above ${figure(kappa)}` : "";
  if (open.length) {
    const names = open.map(({ name }) => name).slice(0, 2).join("; ");
    const edge = open.every(({ margin }) => margin !== null);
    const where = edge ? "too close to the edge for this page" : "decided for the file's numbers only";
    const rest = `${open.length > 1 ? `${open.length} conditions are` : "One condition is"} ${where}`;
    return found("undecided", "Not decided at these values", identity, `${rest}: ${names}${open.length > 2 ? "; ..." : ""}.`);
  }
  const clock = clockAt(content, moved, run.tick), rose = risen(run.climb, run.every);
  const some = rows.filter(({ how }) => how === "sampled").length, samples = some ? ` (${some} of them found by samples, not proved)` : "";
  const over = verdict.uncertain?.length ? ` and anywhere in the intervals of ${verdict.uncertain.join(", ")}` : "";
  const hold = `All ${rows.length} conditions hold at ${elsewhere ? "these values" : "the file's numbers"}${over}${samples}${weight}.`;
  const concluded = verdict.conclusions.filter((text) => !text.startsWith("d"));
  // whether all states are bounded is concluded too, and at other numbers it may be otherwise
  const follows = (elsewhere && verdict.bounded ? [...concluded, "the whole loop stays bounded"] : concluded).join(" and that ");
  const end = follows && (
    elsewhere ? `That ${follows} was concluded for the file's numbers; for these it is not decided.`
      : moved.run ? `That ${follows} was concluded ${verdict.sampled ? "" : "in continuous time and "}for the file's start.` : `It follows that ${follows}.`
  );
  const words = `proved${elsewhere ? " at these values" : ""}${clocked ? " in continuous time" : ""}`;
  const headline = verdict.headline.replace("proved", words) + (clock.beyond ? `; at ${duration(run.tick)} unstable near its set-point` : "");
  const state = clock.beyond || run.divergence ? "clock" : "proved";
  return found(state, headline.charAt(0).toUpperCase() + headline.slice(1), clock.says, rose, identity, hold, end);
}

// A full stop behind a text; its first letter stays as it is, for it may be a symbol's or a block's.
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
