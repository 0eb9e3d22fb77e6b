// What may be said of the proof where the sliders stand. Nothing here knows of a page.

// The conditions at the numbers that `judged` was evaluated at; `moved`: these are not the file's.
export function conditionsAt(content, judged, moved) {
  return content.verdict.conditions.map(({ name, strict, value, holds, at, size }) => {
    // not an expression of parameters: what was decided for the file's numbers is all that is known
    if (at === null) return moved ? { name, strict, margin: null, holds: null } : { name, strict, margin: value, holds };
    if (!size) return { name, strict, margin: null, holds };
    const margins = Array.from(judged.subarray(at, at + size));
    const margin = margins.some(Number.isNaN) ? NaN : Math.min(...margins);
    return { name, strict, margin, holds: strict ? margin > 0 : margin >= 0 }; // NaN holds nowhere
  });
}

// A headline, and sentences. `moved.p`: numbers of the loop are not the file's; `moved.run`: its start or its clock.
export function judgement(content, judged, moved) {
  const { verdict } = content, rows = conditionsAt(content, judged, moved.p);
  const failing = rows.filter((row) => row.holds === false), open = rows.filter((row) => row.holds === null);
  const found = (state, headline, ...says) => ({ state, headline, says: says.filter(Boolean), rows });
  if (verdict.outcome !== "proved") {
    const headline = verdict.outcome === "refuted" ? "Refuted" : "Not proved";
    const others = moved.p && "Found at the file's numbers; the command below with verify for run decides at these.";
    return found("unproved", headline, sentence(verdict.reason), others);
  }
  const identity = sentence(verdict.reason.split(";")[0]);
  if (failing.length) {
    const named = failing.map(({ name, strict, margin }) => `${name} (margin ${figure(margin)}, must ${strict ? "be above zero" : "not be below zero"})`);
    const which = `${failing.length > 1 ? `${failing.length} conditions fail` : "A condition fails"}: ${named.slice(0, 2).join("; ")}`;
    const more = failing.length > 2 ? `; and ${failing.length - 2} more` : "";
    return found("fails", "The proof does not apply at these values", `${which}${more}.`, "V may rise here.");
  }
  const kappa = verdict.kappa === null ? NaN : judged[verdict.kappa];
  const weight = kappa > 0 ? `, with any κ above ${figure(kappa)}` : "";
  if (open.length) {
    const names = open.map(({ name }) => name).slice(0, 2).join("; ");
    const rest = `${open.length > 1 ? `${open.length} conditions were` : "One condition was"} decided for the file's numbers only`;
    return found("undecided", "Not decided at these values", identity, `${rest}: ${names}${open.length > 2 ? "; ..." : ""}.`);
  }
  const hold = `All ${rows.length} conditions hold at ${moved.p ? "these values" : "the file's numbers"}${weight}.`;
  const [follows] = verdict.conclusions, some = moved.p || moved.run;
  const end = follows && (some ? `For the file's numbers it follows that ${follows}; for these that is not decided.` : `It follows that ${follows}.`);
  const headline = sentence(moved.p ? verdict.headline.replace("proved", "proved at these values") : verdict.headline);
  return found("proved", headline.slice(0, -1), identity, hold, end && pretty(end));
}

function sentence(text) {
  const whole = pretty(text);
  return `${whole.charAt(0).toUpperCase()}${whole.slice(1)}${/[.!]$/.test(whole) ? "" : "."}`;
}

// With the signs of a formula.
export function pretty(text) {
  return text.replaceAll("dV/dt", "V̇").replaceAll(" - ", " − ").replaceAll(">=", "≥");
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
