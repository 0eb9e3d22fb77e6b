"""What a study's page says of its worst runs, of the proof, of what was varied, and of how to do it again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from dmframe.errors import listed
from dmframe.report.parts import Badge, Cell, Marked, Paragraph, Part, Subsection, Table, Word
from dmframe.study.answer import METHODS, Told
from dmframe.study.figures import FACTORS
from dmframe.study.numbers import count, figure, span
from dmframe.study.plan import Study
from dmframe.study.proof import Proof
from dmframe.study.varied import Factor
from dmframe.units import plain

NAMED: Final = 4
"""Graphs that the page's head names."""
BADGES: Final = {
    "proved": ("proved", "proved"),
    "refuted": ("refuted", "refuted"),
    "not_applicable": ("not proved", "not_applicable"),
    "not_known": ("not known", "open"),
}
SHOWN: Final = 12
"""Values of a grid quantity that are listed."""


def worst(t: Told) -> Iterator[Part]:
    """The worst runs, with the graphs that they are kept as."""
    several = len(t.found.points) > 1
    factors = list(t.worst[0].draws)[:FACTORS]
    heads: list[Cell] = [
        "graph",
        "run",
        *(["setting"] if several else []),
        "figure",
        *(Word(f, "code") for f in factors),
    ]
    rows = list[list[Cell]]()
    for each in t.worst:
        how = figure(each.value, t.unit(each.figure))
        if math.isfinite(each.diverged_at):
            how = f"diverged at {plain(each.diverged_at, 's')}"
        row: list[Cell] = [Word(each.file, "code"), str(each.run), *([Word(each.point, "code")] if several else [])]
        row.append(how if math.isfinite(each.diverged_at) else (Word(each.figure, "code"), f" = {how}"))
        rows.append([*row, *(plain(each.draws[name], t.unit(name), 4) for name in factors)])
    yield Table(rows, heads, kind="study", keys=True, numbers=range(4 if several else 3, len(heads)))
    first = t.worst[0].file
    yield Paragraph(
        Marked(
            "Each file is a whole graph with the numbers of its run, and runs as it did, to rounding: `dmframe run "
            f"{first} --out worst` draws it, in this page's folder; `dmframe verify {first}` proves it, or says why "
            f"not; `dmframe analyse {first}` says up to which sampling period its loop is stable."
        )
    )


def proof(t: Told) -> Iterator[Part]:
    """The box, and whether the certificate's conditions hold in it."""
    says = (
        "The conditions of the proof were decided exactly, for all values of the parameters in this box at once, "
        "between its corners too. The proof is in continuous time; the runs of this study are sampled, so that one may "
        "diverge where the proof holds. Where a condition fails somewhere in the box, it may still hold for most of "
        "what was drawn: each of these was looked at by itself, and a column says how many fulfil every condition. "
        "Where nothing is known of a sample from its numbers, the first few were verified as graphs of their own."
    )
    if not t.found.results.study.factors:
        says = (
            "Each setting has its own proof, or none. It is in continuous time; the runs of this study are sampled, so "
            "that one may diverge where the proof holds."
        )
    yield Paragraph(says)
    first = next((each for each in t.proofs if each.box.ends), None)
    if first is not None:
        rows = list[list[Cell]]()
        for label, (low, high) in first.box.ends.items():
            unit = first.box.units.get(label, "")
            ends = list(zip(low.ravel(), high.ravel(), strict=True))
            alike = len(set(ends)) == 1
            told = [span(a, b, unit if alike or k + 1 == len(ends) else "") for k, (a, b) in enumerate(ends)]
            told = told[:1] if alike else told if len(told) <= 7 else [*told[:6], "...", unit]
            rows.append([Word(label, "code"), ", ".join(told)])
        at = f" at {first.name}" if len(t.proofs) > 1 else ""
        yield Table(rows, ("parameter", f"from and to{at}"), kind="study", keys=True)
    outside = list(dict.fromkeys(name for each in t.proofs for name in each.box.outside))
    if outside:
        names = listed([f"`{name}`" for name in outside])
        yield Paragraph(
            Marked(f"Not in the box, since no proof reads it: {names}."),
            note=True,
        )
    if names_of_others := list(dict.fromkeys(name for each in t.proofs for name in each.box.unknown)):
        names = listed([f"`{name}`" for name in names_of_others])
        text = f"Each value of {names} makes another loop, with a proof of its own: of the box nothing is known."
        yield Paragraph(Marked(text), note=True)
    several, looked = len(t.proofs) > 1, any(each.drawn is not None for each in t.proofs)
    rows = []
    for each in t.proofs:
        badge = Badge(*BADGES[each.state])
        row: list[Cell] = [Word(each.name, "code")] if several else []
        rows.append([*row, badge, *([_fulfilled(each)] if looked else []), _conditions(each)])
    heads = (
        ["setting"] * several
        + ["over the box" if first else "verdict"]
        + [f"{t.noun} that fulfil all"] * looked
        + ["conditions"]
    )
    yield Table(rows, heads, kind="study", keys=several)
    if len(t.found.points) > len(t.proofs):
        yield Paragraph(f"The first {len(t.proofs)} of {len(t.found.points)} settings.", note=True)


def _conditions(each: Proof) -> str:
    if each.proved or each.verdict is None:
        return each.why or "every condition holds"
    if each.state == "refuted" or not each.failing:
        return each.verdict.reason
    failed = [
        item.name + ("" if item.value is None else f" (its least value is {item.value:.3g})") for item in each.failed
    ]
    undecided = [item.name for item in each.failing if item not in each.failed]
    parts = [f"fails somewhere: {'; '.join(failed)}"] * bool(failed)
    return ". ".join([*parts, *[f"Not decided over the box: {'; '.join(undecided)}"] * bool(undecided)])


def _fulfilled(each: Proof) -> str:
    if each.proved:
        return "all"
    if each.drawn is None or not each.drawn.told:
        return "not known"
    number, of, unknown = int(each.drawn.fulfil.sum()), len(each.drawn.fulfil), int(each.drawn.unknown.sum())
    return f"{count(number)} of {count(of)}" + f"; of {count(unknown)} not known" * bool(unknown)


def what(study: Study) -> str:
    """Which graphs ran, and for how long: an answer holds for these alone."""
    experiments = [point.graph.experiment for point in study.points]
    names = list(dict.fromkeys(each.name for each in experiments))
    times = sorted({each.file.duration for each in experiments})
    shown = [*names[:NAMED], f"{len(names) - NAMED} more"] if len(names) > NAMED else names
    graphs = f"{'Graph' if len(names) == 1 else 'Graphs'} {listed(shown)}"
    return f"{graphs}; runs of {plain(times[0], 's') if len(times) == 1 else span(times[0], times[-1], 's')}."


def design(t: Told) -> Iterator[Part]:
    """What varied, and how it was drawn."""
    study = t.found.results.study
    drawn = {name: _how_drawn(factor) for factor in study.factors for name in factor.columns}
    rows = list[list[Cell]]()
    for column in study.varied:
        grid = column.kind == "grid"
        if grid:
            values = list(dict.fromkeys(_value(point.values[column.name], column.unit) for point in study.points))
            how = ", ".join(values[:12]) + (", ..." if len(values) > 12 else "")
        else:
            how = drawn[column.name]
        rows.append([Word(column.name, "code"), "grid" if grid else "drawn", how])
    if rows:
        yield Table(rows, ("quantity", "how", "values"), kind="study", keys=True)
    told = f"{count(len(study.points))} settings, {count(study.samples)} samples at each"
    if study.samples > 1:
        same = ", the same at each setting, so that settings are compared on the same robots" * (len(study.points) > 1)
        told += f": {METHODS[study.file.sample.method]}, seed {study.file.sample.seed}{same}"
    yield Paragraph(f"{told}.")


def _value(value: object, unit: str) -> str:
    return (
        plain(float(value), unit, 6) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
    )


def _how_drawn(factor: Factor) -> str:
    spread, unit = factor.spread, factor.unit
    if spread is None:
        return ""
    what = {"value": "", "scale": "times the graph's own, ", "shift": "added to the graph's own, "}[factor.how]
    ends = span(spread.lower, spread.upper, unit)
    if spread.kind != "normal":
        told = f"{ends}, {'all' if spread.kind == 'uniform' else 'all logarithms'} equally likely"
    else:
        clip = (
            f", between {ends.replace(' to ', ' and ')}"
            if math.isfinite(spread.lower) or math.isfinite(spread.upper)
            else ""
        )
        told = f"normal, mean {plain(spread.a, unit, 5)}, standard deviation {plain(spread.b, unit, 5)}{clip}"
    of = f"; of {', '.join(factor.labels)}" if factor.labels != (factor.name,) else ""
    return f"{what}{told}{of}"


def repeat(t: Told) -> Iterator[Part]:
    """Commands, and what made the runs."""
    yield Table([(Word(command, "command"), does) for command, does in t.commands], kind="study")
    if t.made:
        yield Subsection("Made with", [Table(t.made, keys=True)])
