// What may be said of the proof where the sliders stand. Nothing here knows of a page.

// The conditions at the numbers that `judged` was evaluated at; `moved`: these are not the file's. What is tacit is
// among them only where it does not hold: `verify` names it there alone.
export function conditionsAt({ verdict }, judged, moved, spread) {
  const rows = verdict.conditions.map((condition) => decided(condition, judged, moved, spread));
  if (!moved.p) return rows;
  const tacit = (verdict.tacit ?? []).map(({ opens, ...condition }) => {
    const row = decided(condition, judged, moved, spread);
    return opens && row.holds === false ? { ...row, holds: null } : row;
  });
  return [...rows, ...tacit.filter(({ holds }) => holds !== true)];
}

function decided({ name, how, strict, value, holds, at, size, reads }, judged, moved, spread) {
  if (at === null) {
    // no expression of parameters: what was decided for the file's numbers holds while those that it reads stay
    const stays = !moved.p || (reads && moved.at && !reads.some((place) => moved.at.has(place)));
    return stays ? { name, how, strict, margin: value, holds } : { name, how, strict, margin: null, holds: null };
  }
  if (!size) return { name, how, strict, margin: null, holds };
  const margin = Math.min(...judged.subarray(at, at + size)); // NaN where one of them is
  // so close to zero that rounding may have turned its sign: `verify`, which does not round, decides
  const least = judged.subarray(at, at + size).indexOf(margin);
  if (moved.p && spread && margin !== 0 && Math.abs(margin) <= spread[at + least]) return { name, how, strict, margin, holds: null };
  return { name, how, strict, margin, holds: strict ? margin > 0 : margin >= 0 }; // NaN holds nowhere
}

// A headline, and sentences. `moved.p`: numbers of the loop are not the file's, of which `moved.at` says
// which; `moved.run`: its start or its clock.
export function judgement(content, judged, moved, spread = null) {
  const { verdict } = content, rows = conditionsAt(content, judged, moved, spread);
  const failing = rows.filter((row) => row.holds === false), open = rows.filter((row) => row.holds === null);
  const found = (state, headline, ...says) => ({ state, headline, says: says.filter(Boolean), rows });
  if (verdict.outcome !== "proved") {
    const headline = verdict.outcome === "refuted" ? "Refuted:" : "Not proved:";
    const others = moved.p && "So it was found at the file's numbers; the command below, with verify for run, decides at these.";
    return found("unproved", headline, sentence(verdict.reason), others);
  }
  const claim = sentence(verdict.reason.split(";")[0]), identity = content.clock === null || verdict.sampled ? claim : `In continuous time ${claim}`;
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
  const some = rows.filter(({ how }) => how === "sampled").length, samples = some ? ` (${some} of them found by samples, not proved)` : "";
  const over = verdict.uncertain?.length ? ` and anywhere in the intervals of ${verdict.uncertain.join(", ")}` : "";
  const hold = `All ${rows.length} conditions hold at ${moved.p ? "these values" : "the file's numbers"}${over}${samples}${weight}.`;
  const concluded = verdict.conclusions.filter((text) => !text.startsWith("d"));
  // whether all states are bounded is concluded too, and at other numbers it may be otherwise
  const follows = (moved.p && verdict.bounded ? [...concluded, "the whole loop stays bounded"] : concluded).join(" and that ");
  const end = follows && (
    moved.p ? `That ${follows} was concluded for the file's numbers; for these it is not decided.`
      : moved.run ? `That ${follows} was concluded ${verdict.sampled ? "" : "in continuous time and "}for the file's start.` : `It follows that ${follows}.`
  );
  const headline = moved.p ? verdict.headline.replace("proved", "proved at these values") : verdict.headline;
  return found("proved", headline.charAt(0).toUpperCase() + headline.slice(1), identity, hold, end);
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
