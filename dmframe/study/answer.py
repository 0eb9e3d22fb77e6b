"""Answer at the top of a study's report: the verdict on the proof, what the runs did, and the main findings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

from dmframe.common.errors import listed
from dmframe.common.units import plain
from dmframe.report.parts import Bullets, Cell, Lead, Marked, Part
from dmframe.study.box import COVERAGE
from dmframe.study.findings import DIVERGED, Findings, PointFindings
from dmframe.study.numbers import count, figure, percent
from dmframe.study.proof import Proof
from dmframe.study.statistics import LEVEL, Quantile

WORTH: Final = 0.05
"""Fraction of the variance from which an influence is named."""
BY_CHANCE: Final = 1 - LEVEL
"""Largest probability of an influence by chance at which it is named."""
NAMED: Final = 4
"""Largest number of settings that a sentence names."""
METHODS: Final = {
    "random": "independent draws",
    "sobol": "a scrambled Sobol sequence, which fills the space evenly",
    "latin_hypercube": "a Latin hypercube, which fills each quantity's range evenly",
}


@final
@dataclass(frozen=True)
class Saved:
    """One of the worst runs, and the file of its graph."""

    file: str
    run: int
    point: str
    figure: str
    value: float
    diverged_at: float
    draws: Mapping[str, float]


@final
@dataclass(frozen=True, repr=False)
class ReportData:
    """The content of a report.

    Parameters
    ----------
    robots
        True if parameters of the plant are sampled, not only the controller or initial states.
    commands
        Commands that repeat the study, each with a description.
    made
        Versions and machine of the runs, by name.
    """

    found: Findings
    worst: tuple[Saved, ...]
    proofs: tuple[Proof, ...]
    robots: bool
    commands: Sequence[tuple[str, str]]
    made: Sequence[tuple[str, str]]

    @property
    def noun(self) -> str:
        """Plural noun for the samples in the report."""
        return "robots" if self.robots else "samples"

    @property
    def several(self) -> bool:
        """True for more than one grid point."""
        return len(self.found.points) > 1

    def unit(self, name: str) -> str:
        """Unit of a column."""
        return self.found.results.units.get(name, "")


def lead(t: ReportData) -> Lead:
    """The answer in one sentence, beginning with the verdict on the proof."""
    runs, proof = _runs_lead(t), verdict_of(t)
    if proof is None or not any(each.runs for each in t.found.points):
        return runs
    words, worst = proof
    outcome = worst if runs.outcome == "proved" else runs.outcome
    outcome = "refuted" if worst == "refuted" else outcome
    headline = f"{words[0].upper()}{words[1:]}; {runs.headline[0].lower()}{runs.headline[1:]}"
    return Lead(outcome, headline, runs.sentence)


def verdict_of(t: ReportData) -> tuple[str, str] | None:
    """The proofs of all settings in a few words, and their common outcome; None if none was attempted."""
    states = [each.state for each in t.proofs]
    if not states:
        return None
    boxed = any(each.box.ends or each.box.unknown for each in t.proofs)
    where = " over the sampled box" if boxed else ""
    some = f" at {{}} of {len(states)} settings" if len(states) > 1 else ""
    if refuted := states.count("refuted"):
        return f"the proof is refuted{some.format(refuted)}", "refuted"
    if all(each.proved for each in t.proofs):
        headlines = dict.fromkeys(each.verdict.headline for each in t.proofs if each.verdict is not None)
        complete = len(t.found.points) == len(states)
        rest = "" if complete else f" at the first {len(states)} settings"
        return f"{listed(list(headlines))}{where}{rest}", "proved" if complete else "open"
    if proved := states.count("proved"):
        return f"proved{some.format(proved)}{where}", "open"
    if set(states) == {"not_known"}:
        return f"the proof is undecided{where}", "open"
    if any(each.verdict is not None and each.verdict.test is not None for each in t.proofs):
        return f"the proof does not hold everywhere{where}" if boxed else "the proof does not apply", "not_applicable"
    return "no proof", "not_applicable"


def _runs_lead(t: ReportData) -> Lead:
    """The answer from the runs only."""
    found = t.found
    ran, place = [each for each in found.points if each.runs], found.events.index(found.diverging)
    rest = _limitations(found)
    if not ran:
        return Lead("open", "No runs yet", Marked(f"there are no results.{rest}"))
    if found.sheet.samples == 1:
        lost = sum(each.alone[place].count for each in ran)
        text = f"{count(len(ran))} settings ran, each once; {_diverged(lost, 'of them')}"
        sentence = f"each ran once, on one robot, which gives no probability.{rest}"
        return Lead(_outcome(len(ran) - lost, len(found.points)), text, Marked(sentence))
    if len(found.points) == 1:
        proportion, complete = ran[0].alone[place], not (ran[0].failed or ran[0].missing)
        head = f"Of {count(proportion.runs)} {t.noun} {_diverged(proportion.count, '')}"
        outcome = _outcome(complete and not proportion.count, complete or bool(proportion.count))
        if proportion.most is None:
            return Lead(outcome, head, Marked(no_interval(found) + rest))
        lost_part = f"{percent(proportion.value)} of them; " if proportion.count else ""
        limit = f"the probability of divergence is at most {percent(proportion.most, up=True)}, at 95 % confidence."
        return Lead(outcome, head, Marked(f"{lost_part}{limit}{rest}"))
    return _settings_lead(t, ran, place, rest) if found.steady else _all_diverge_lead(t, ran, place, rest)


def _settings_lead(t: ReportData, ran: Sequence[PointFindings], place: int, rest: str) -> Lead:
    """The answer for several settings, some of which never diverged."""
    found, steady = t.found, t.found.steady
    fewest, most = min(each.runs for each in steady), max(each.runs for each in ran)
    runs = count(most) if fewest == most else f"{count(fewest)} to {count(most)}"
    head = f"None of {runs} {t.noun} diverged at {len(steady)} of {len(found.points)} settings"
    names = [code(each) for each in steady[:NAMED]]
    names += [f"{len(steady) - NAMED} more, in the table below"] if len(steady) > NAMED else []
    sentence = listed(names)
    limits = [each.together[place].most for each in steady]
    if limits[0] is None:
        sentence += f". {no_interval(found)}"
    else:
        limit, each_of = max(item or 0.0 for item in limits), "at each of them " if len(steady) > 1 else ""
        sentence += f"; {each_of}the probability of divergence is at most {percent(limit, up=True)}, at 95 % confidence"
        sentence += f" for all {len(found.points)} settings together."
    complete = not any(each.failed or each.missing for each in found.points)
    outcome = _outcome(len(steady), len(found.points))
    return Lead(outcome if complete or outcome != "proved" else "open", head, Marked(sentence + rest))


def _all_diverge_lead(t: ReportData, ran: Sequence[PointFindings], place: int, rest: str) -> Lead:
    """The answer for several settings, all of which diverged in some run."""
    points, least = t.found.points, min(ran, key=lambda each: each.alone[place].value)
    where = f"each of {len(points)} settings"
    if len(ran) < len(points):
        where = f"each of the {len(ran)} of {len(points)} settings that ran"
    sentence = f"fewest at {code(least)}: {percent(least.alone[place].value)}"
    if (limit := least.together[place].most) is not None:
        sentence += f", a probability of at most {percent(limit or 1, up=True)} at 95 % confidence"
    most = count(max(each.runs for each in ran))
    return Lead("refuted", f"At {where} some of {most} {t.noun} diverged", Marked(f"{sentence}.{rest}"))


def _outcome(good: int, of: int) -> str:
    return "proved" if good == of else "refuted" if not good else "open"


def _diverged(number: int, of: str) -> str:
    return " ".join(f"{'none' if not number else count(number)} {of} diverged".split())


def _limitations(found: Findings) -> str:
    """Sentences on missing and failed runs, and on noise."""
    missing, failed = (sum(getattr(each, what) for each in found.points) for what in ("missing", "failed"))
    text = f" {count(missing)} runs are missing; the same command computes them." if missing else ""
    text += f" {count(failed)} runs could not be prepared and are not covered." if failed else ""
    if found.sheet.samples > 1 and found.results.study.noisy:
        text += " The loop has noise or jitter: all samples have the same realisation, that of the graph's `seed`, and "
        text += "other noise is not covered."
    return text


def no_interval(found: Findings) -> str:
    """Reason for the absence of a confidence interval."""
    if found.sheet.samples < 2:
        return "Each setting ran once, which gives no probability."
    return (
        "No interval of probability is given: it requires independent draws, and the samples are "
        f"{METHODS[found.results.study.file.sample.method]}; `method: random` gives one."
    )


def code(each: PointFindings) -> str:
    """A setting's name in a marked text."""
    return f"`{each.name}`"


def summary(t: ReportData) -> Iterator[Part]:
    """The main findings as a list."""
    items = list[Cell]([*_best_settings(t), *_influences(t)])
    if t.worst:
        first = t.worst[0]
        how = f"diverged after {plain(first.diverged_at, 's')}" if math.isfinite(first.diverged_at) else ""
        how = how or f"{first.figure} = {figure(first.value, t.unit(first.figure))}"
        at = f" at `{first.point}`" if first.point else ""
        items.append(Marked(f"The worst run is number {first.run}{at}: {how}; its graph is `{first.file}`."))
    if t.proofs:
        items.append(Marked(proof_in_short(t)))
    failed, failing = sum(each.failed for each in t.found.points), list[int]()
    if failed:
        failing.append(len(items))
        text = f"{count(failed)} runs could not be prepared; no figure includes them, and the table has their faults."
        items.append(Marked(text))
    yield Bullets(items, failing)


def _best_settings(t: ReportData) -> Iterator[Marked]:
    """The settings with the smallest and the largest main figure."""
    found, main, sheet = t.found, t.found.results.main, t.found.sheet
    unit = t.unit(main)
    if sheet.samples == 1 and main:
        values = sheet.figure(main)[:, 0]
        finite = [k for k in range(sheet.points) if math.isfinite(values[k])]
        if len(finite) > 1:
            least, most = (choose(finite, key=lambda k: values[k]) for choose in (min, max))
            names = found.results.names
            yield Marked(
                f"`{main}` is smallest at `{names[least]}`, {figure(values[least], unit)}, and, among the runs that "
                f"did not diverge, largest at `{names[most]}`, {figure(values[most], unit)}."
            )
    best = best_of(found)
    if best is None:
        return
    each, top = best
    if not t.several:
        quantiles = ", ".join(f"{100 * q.p:g} % below {figure(q.value, unit)}" for q in each.quantiles[main])
        yield Marked(f"`{main}`: {quantiles}.")
        return
    middle = next((q for q in each.quantiles[main] if q.p == 0.5), None)
    half = f", and half of them below {figure(middle.value, unit)}" if middle and top.p > 0.5 else ""
    yield Marked(
        f"Among the settings without a divergence, {code(each)} has the smallest {100 * top.p:g} % quantile of "
        f"`{main}`: {100 * top.p:g} % of the {t.noun} stay below {figure(top.value, unit)}{half}."
    )


def _influences(t: ReportData) -> Iterator[Marked]:
    points = t.found.points
    for name in dict.fromkeys(name for each in points for name in each.influences):
        each = next(each for each in points if name in each.influences)
        strong = [item for item in each.influences[name] if item.explained >= WORTH and item.chance <= BY_CHANCE][:3]
        if strong:
            fractions = listed([f"`{item.factor}` ({percent(item.explained)})" for item in strong])
            what = "whether a run diverges" if name == DIVERGED else f"`{name}`"
            at = f" at {code(each)}" if each.name else ""
            yield Marked(f"Largest influence on {what}{at}: {fractions}, as a fraction of the variance of ranks.")


def best_of(found: Findings) -> tuple[PointFindings, Quantile] | None:
    """Point without divergence and with the smallest value of its largest quantile; a single point in any case."""
    main = found.results.main
    several = [each for each in (found.steady if len(found.points) > 1 else found.points) if each.quantiles.get(main)]
    if not several:
        return None
    tops = [(each, max(each.quantiles[main], key=lambda q: q.p)) for each in several]
    return min(tops, key=lambda pair: pair[1].value)


def proof_in_short(t: ReportData) -> str:
    """The result of the proofs over the box, in one or two sentences."""
    proofs, points = t.proofs, len(t.found.points)
    good, tried = sum(each.proved for each in proofs), len(proofs)
    if not t.found.results.study.factors:
        return f"The graph is proved at {good} of the {'' if tried == points else 'first '}{tried} settings."
    rest = "".join(f" {text}" for text in outside_the_box(t))
    rest += f" The other {points - tried} settings were not examined." * (points > tried)
    where = "at the numbers that the graphs state"
    if any(each.box.ends for each in proofs):
        unbounded = any(each.box.probability < 1 for each in proofs)
        where = "over the whole sampled box"
        where += f" ({100 * COVERAGE:g} % of the draws: some distributions are unbounded)" * unbounded
    if refuted := sum(each.state == "refuted" for each in proofs):
        at = f" at {refuted} of {tried} settings" if tried > 1 else ""
        return f"The proof is refuted{at}: the derivative of V differs from the blocks' certificates.{rest}"
    if good == tried:
        return f"The proof's conditions hold {where}{f', at each of {tried} settings' if tried > 1 else ''}.{rest}"
    if good:
        return f"The proof's conditions hold {where} at {good} of {tried} settings.{rest}"
    counted = next((_counted(t, each) for each in proofs if each.drawn is not None), "")
    if all(each.state == "not_known" for each in proofs):
        return f"The proof's conditions {where} are undecided{counted}.{rest}"
    return f"The proof's conditions do not all hold {where}{counted}. This does not prove instability.{rest}"


def _counted(t: ReportData, proof: Proof) -> str:
    """Number of samples that meet the conditions, each tested separately."""
    if proof.drawn is None or not proof.drawn.known:
        return ""
    at = f" at `{proof.name}`" if len(t.proofs) > 1 else ""
    number, of, unknown = proof.drawn.counts
    if not unknown:
        return f"; {count(number)} of {count(of)} {t.noun} meet them{at}"
    return f"; of {count(of)} {t.noun} {count(number)} meet them{at}, and {count(unknown)} are undecided"


def outside_the_box(t: ReportData) -> list[str]:
    """Sentences about sampled quantities that the box does not contain."""
    found = list[str]()
    if outside := dict.fromkeys(f"`{name}`" for each in t.proofs for name in each.box.outside):
        found.append(f"Not in the box, since no proof depends on it: {listed(list(outside))}.")
    if unknown := dict.fromkeys(f"`{name}`" for each in t.proofs for name in each.box.unknown):
        names = listed(list(unknown))
        found.append(f"Each value of {names} changes the equations, so that it needs a proof of its own.")
    return found
