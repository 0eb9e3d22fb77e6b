"""The answer that a study's page begins with, in plain words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

from dmframe.errors import listed
from dmframe.report.parts import Bullets, Cell, Lead, Marked, Part
from dmframe.study.drawn import Drawn
from dmframe.study.findings import DIVERGED, Findings, Found
from dmframe.study.numbers import count, figure, percent
from dmframe.study.proof import HELD, Proof
from dmframe.study.statistics import LEVEL, Quantile
from dmframe.units import plain

WORTH: Final = 0.05
"""Share of the variance from which a quantity is named as one that decides."""
BY_CHANCE: Final = 1 - LEVEL
"""Of a quantity that is named; a share so large comes no more often where the quantity has no influence."""
NAMED: Final = 4
"""Settings that a sentence names."""
METHODS: Final = {
    "random": "independent draws",
    "sobol": "a scrambled Sobol sequence, which fills the space evenly",
    "latin_hypercube": "a Latin hypercube, which fills each quantity's range evenly",
}


@final
@dataclass(frozen=True)
class Saved:
    """One of the worst runs, and the file in which it lies as a graph."""

    file: str
    run: int
    point: str
    figure: str
    value: float
    diverged_at: float
    draws: Mapping[str, float]


@final
@dataclass(frozen=True, repr=False)
class Told:
    """All that a page is made of.

    Parameters
    ----------
    robots
        What is drawn is the robot, and not only its controller or its start.
    commands
        How to do it again, each with what it does.
    made
        Versions and machine, by name.
    """

    found: Findings
    worst: tuple[Saved, ...]
    proofs: tuple[Proof, ...]
    robots: bool
    commands: Sequence[tuple[str, str]]
    made: Sequence[tuple[str, str]]

    @property
    def noun(self) -> str:
        """What the samples are."""
        return "robots" if self.robots else "samples"

    def unit(self, name: str) -> str:
        """Of a column."""
        return self.found.results.units.get(name, "")


def lead(t: Told) -> Lead:
    """The answer in plain words, with the verdict on the proof in its first line."""
    of_runs, said = _lead(t), verdict_of(t)
    if said is None or not any(each.runs for each in t.found.points):
        return of_runs
    words, worst = said
    outcome = of_runs.outcome
    if "refuted" in (outcome, worst):
        outcome = "refuted"
    elif outcome == "proved":
        outcome = worst
    runs = of_runs.headline
    return Lead(outcome, f"{words[0].upper()}{words[1:]}; {runs[0].lower()}{runs[1:]}", of_runs.sentence)


def verdict_of(t: Told) -> tuple[str, str] | None:
    """What the proofs come to, in a few words, and the outcome that stands for it; None where none was decided."""
    if not t.proofs:
        return None
    states = [each.state for each in t.proofs]
    several, boxed = len(states) > 1, any(each.box.ends or each.box.unknown for each in t.proofs)
    of, where = f" at {{}} of {len(states)} settings" if several else "", " over what was drawn" if boxed else ""
    if refuted := states.count("refuted"):
        return f"the proof is refuted{of.format(refuted)}", "refuted"
    if all(each.proved for each in t.proofs):
        restricted = dict.fromkeys(each.verdict.headline for each in t.proofs if each.verdict is not None)
        left = "" if len(t.found.points) == len(states) else f" at the {len(states)} settings that were looked at"
        return f"{listed(list(restricted))}{where}{left}", "proved" if not left else "open"
    proved = states.count("proved")
    if proved:
        return f"proved{of.format(proved)}{where}", "open"
    unknown = states.count("not_known")
    if unknown == len(states):
        return f"whether the proof holds{where} is not known", "open"
    if _claims(t):
        return f"the proof does not hold everywhere{where}" if boxed else "the proof does not apply", "not_applicable"
    return "nothing is proved", "not_applicable"


def _claims(t: Told) -> bool:
    """Some graph claims what could be proved."""
    return any(each.verdict is not None and each.verdict.test is not None for each in t.proofs)


def _lead(t: Told) -> Lead:
    found, noun = t.found, t.noun
    ran = [each for each in found.points if each.runs]
    place = found.events.index(found.diverging)
    samples = max((each.runs for each in ran), default=0)
    unfinished, whole = _unfinished(found), not any(each.failed or each.missing for each in found.points)
    if not ran:
        return Lead("open", "No run is there yet", Marked(f"there is nothing to tell.{unfinished}"))
    if found.sheet.samples == 1:
        lost = sum(each.alone[place].count for each in ran)
        text = f"{count(len(ran))} settings ran, each once; {_diverged(lost, 'of them')}."
        says = f"Each ran once, on one robot: that is no probability.{unfinished}"
        return Lead(_outcome(len(ran) - lost, len(found.points)), text.rstrip("."), Marked(says))
    if len(found.points) == 1:
        share = ran[0].alone[place]
        head = f"Of {count(share.runs)} {noun} {_diverged(share.count, '')}".rstrip()
        outcome = _outcome(whole and share.count == 0, whole or bool(share.count))
        if share.most is None:
            return Lead(outcome, head, Marked(no_interval(found) + unfinished))
        says = f"the probability of divergence is at most {percent(share.most, up=True)}, at 95 % confidence."
        if share.count:
            says = f"{percent(share.value)} of them; {says}"
        return Lead(outcome, head, Marked(says + unfinished))
    steady, of = found.steady, len(found.points)
    fewest = min((each.runs for each in steady), default=samples)
    many = count(samples) if fewest == samples else f"{count(fewest)} to {count(samples)}"
    head = f"None of {many} {noun} diverged at {len(steady)} of {of} settings"
    if not steady:
        least = min(ran, key=lambda each: each.alone[place].value)
        at = f"At each of {of} settings" if len(ran) == of else f"At each of the {len(ran)} of {of} settings that ran"
        head = f"{at} some of {count(samples)} {noun} diverged"
        says = f"fewest at {code(least)}: {percent(least.alone[place].value)}"
        if least.together[place].most is not None:
            says += f", a probability of at most {percent(least.together[place].most or 1, up=True)} at 95 % confidence"
        return Lead("refuted", head, Marked(f"{says}.{unfinished}"))
    says = _names(steady)
    most = max(each.together[place].most or 0.0 for each in steady)
    if steady[0].together[place].most is not None:
        each_of = "at each of them " if len(steady) > 1 else ""
        says += f"; {each_of}the probability of divergence is at most {percent(most, up=True)}, at 95 % confidence"
        says += f" for all {of} settings together."
    else:
        says += f". {no_interval(found)}"
    outcome = _outcome(len(steady), of)
    return Lead(outcome if whole or outcome != "proved" else "open", head, Marked(says + unfinished))


def _outcome(good: int, of: int) -> str:
    return "proved" if good == of else "refuted" if not good else "open"


def _diverged(number: int, of: str) -> str:
    return " ".join(f"{'none' if not number else count(number)} {of} diverged".split())


def _unfinished(found: Findings) -> str:
    """What the answer does not cover: runs that are not there, and other noise."""
    missing, failed = (sum(getattr(each, what) for each in found.points) for what in ("missing", "failed"))
    told = f" {count(missing)} runs are not there yet: the same command computes them." if missing else ""
    told += f" {count(failed)} runs could not be made, of which this says nothing." if failed else ""
    if found.sheet.samples > 1 and found.results.study.noisy:
        told += " The loop draws noise or a jitter: all samples meet the same, that of the graph's `seed`, so that "
        told += "nothing is said of other noise."
    return told


def no_interval(found: Findings) -> str:
    """Why no interval of probability is given."""
    if found.sheet.samples < 2:
        return "Each setting ran once, so that nothing is said of probabilities."
    return (
        "No interval of probability is given, for it would be valid for independent draws alone, and the samples are "
        f"{METHODS[found.results.study.file.sample.method]}; `method: random` gives one."
    )


def code(each: Found) -> str:
    """A setting's name in a marked text."""
    return f"`{each.name}`"


def _names(several: Sequence[Found]) -> str:
    first = [code(each) for each in several[:NAMED]]
    return listed([*first, f"{len(several) - NAMED} more, in the table below"] if len(several) > NAMED else first)


def summary(t: Told) -> Iterator[Part]:
    """What else there is to know first."""
    found, main = t.found, t.found.results.main
    items, failing = list[Cell](), list[int]()
    if found.sheet.samples == 1 and main:
        items += _ends(t)
    best = best_of(found)
    if best is not None and len(found.points) > 1:
        each, top = best
        middle = next((q for q in each.quantiles[main] if q.p == 0.5), None)
        half = f", and half of them below {figure(middle.value, t.unit(main))}" if middle and top.p > 0.5 else ""
        items.append(
            Marked(
                f"Of the settings where none diverged, {code(each)} has the smallest {_ordinal(top.p)} quantile of "
                f"`{main}`: {100 * top.p:g} % of the {t.noun} stay below {figure(top.value, t.unit(main))}{half}."
            )
        )
    elif best is not None:
        each, top = best
        told = ", ".join(f"{100 * q.p:g} % below {figure(q.value, t.unit(main))}" for q in each.quantiles[main])
        items.append(Marked(f"`{main}`: {told}."))
    for name in dict.fromkeys(name for each in found.points for name in each.influences):
        each = next(each for each in found.points if name in each.influences)
        strong = [item for item in each.influences[name] if item.share >= WORTH and item.chance <= BY_CHANCE][:3]
        if strong:
            told = listed([f"`{item.factor}` ({percent(item.share)})" for item in strong])
            what = "whether a run diverges" if name == DIVERGED else f"`{name}`"
            at = f" at {code(each)}" if each.name else ""
            items.append(Marked(f"What decides {what} most{at}: {told}, each as a share of the variance of ranks."))
    if t.worst:
        first = t.worst[0]
        how = f"diverged after {plain(first.diverged_at, 's')}" if math.isfinite(first.diverged_at) else ""
        how = how or f"{first.figure} = {figure(first.value, t.unit(first.figure))}"
        at = f" at `{first.point}`" if first.point else ""
        items.append(Marked(f"The worst run is number {first.run}{at}: {how}; it is kept as the graph `{first.file}`."))
    if t.proofs:
        items.append(Marked(_proof_in_short(t)))
    lost = sum(each.failed for each in found.points)
    if lost:
        failing.append(len(items))
        items.append(
            Marked(f"{count(lost)} runs could not be made; they count nowhere, and the table tells their faults.")
        )
    yield Bullets(items, failing)


def _ends(t: Told) -> Iterator[Marked]:
    """The settings of single runs with the smallest figure, and with the greatest."""
    main, sheet = t.found.results.main, t.found.sheet
    values = sheet.figure(main)[:, 0]
    there = [k for k in range(sheet.points) if math.isfinite(values[k])]
    if len(there) < 2:
        return
    least, most = (choose(there, key=lambda k: values[k]) for choose in (min, max))
    unit, names = t.unit(main), t.found.results.names
    yield Marked(
        f"`{main}` is smallest at `{names[least]}`, {figure(values[least], unit)}, and of those that came to their end "
        f"greatest at `{names[most]}`, {figure(values[most], unit)}."
    )


def best_of(found: Findings) -> tuple[Found, Quantile] | None:
    """Of the points where none diverged the one with the smallest greatest quantile; of one point, itself."""
    main = found.results.main
    several = [each for each in found.steady if each.quantiles.get(main)]
    if len(found.points) == 1:
        several = [each for each in found.points if each.quantiles.get(main)]
    if not several:
        return None
    best = min(several, key=lambda each: max(each.quantiles[main], key=lambda q: q.p).value)
    return best, max(best.quantiles[main], key=lambda q: q.p)


def _ordinal(p: float) -> str:
    return f"{100 * p:g} %"


def _proof_in_short(t: Told) -> str:
    good, all_of, points = sum(each.proved for each in t.proofs), len(t.proofs), len(t.found.points)
    outside = list(dict.fromkeys(name for each in t.proofs for name in each.box.outside))
    rest = f" Not in the box, since no proof reads it: {listed([f'`{name}`' for name in outside])}."
    rest = rest * bool(outside) + _other_loops(t)
    rest += f" The other {points - all_of} settings were not looked at." * (points > all_of)
    where = f"over the whole box of what was drawn{_held(t.proofs)}"
    if not t.found.results.study.factors:
        of = "" if all_of == points else " that were looked at"
        return f"The graph is proved at {good} of the {all_of} settings{of}."
    if not any(each.box.ends for each in t.proofs):
        where = "at the numbers that the graphs state"
    if refuted := sum(each.state == "refuted" for each in t.proofs):
        of = f" at {refuted} of {all_of} settings" if all_of > 1 else ""
        return f"The proof is refuted{of}: the derivative of V is not what the blocks claim.{rest}"
    if good == all_of:
        each_of = f", at each of {all_of} settings." if all_of > 1 else "."
        return f"The proof's conditions hold {where}{each_of}{rest}"
    if not good:
        at = f" at `{t.proofs[0].name}`" if all_of > 1 else ""
        looked = next((_counted(t, each.drawn, at) for each in t.proofs if each.drawn is not None), "")
        if all(each.state == "not_known" for each in t.proofs):
            return f"Whether the proof's conditions hold {where} is not known{looked}.{rest}"
        return f"The proof's conditions do not all hold {where}{looked}. That is no proof of the contrary.{rest}"
    return f"The proof's conditions hold {where} at {good} of {all_of} settings.{rest}"


def _counted(t: Told, drawn: Drawn, at: str) -> str:
    """How many samples fulfil the conditions, each by itself."""
    if not drawn.told:
        return ""
    number, of, unknown = int(drawn.fulfil.sum()), len(drawn.fulfil), int(drawn.unknown.sum())
    if not unknown:
        return f"; {count(number)} of {count(of)} {t.noun} fulfil them{at}"
    return f"; of {count(of)} {t.noun} {count(number)} fulfil them{at}, and of {count(unknown)} that is not known"


def _other_loops(t: Told) -> str:
    """What is drawn and makes another loop of each sample."""
    names = list(dict.fromkeys(name for each in t.proofs for name in each.box.unknown))
    if not names:
        return ""
    return f" Each value of {listed([f'`{name}`' for name in names])} makes another loop, with a proof of its own."


def _held(proofs: Sequence[Proof]) -> str:
    endless = any(each.box.held < 1 for each in proofs)
    return f" ({100 * HELD:g} % of the draws: some have no ends)" if endless else ""
