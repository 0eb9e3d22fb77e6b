"""Sections of a study's report below the answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from dmframe.common.errors import listed
from dmframe.common.units import plain
from dmframe.report.parts import (
    Badge,
    Cell,
    Columns,
    Marked,
    Paragraph,
    Part,
    Picture,
    Section,
    Subsection,
    Table,
    Titled,
    Word,
)
from dmframe.study.answer import METHODS, ReportData, code, no_interval, outside_the_box, summary
from dmframe.study.figures import FACTORS
from dmframe.study.findings import DIVERGED, SHOWN, PointFindings
from dmframe.study.numbers import between, chance, count, distribution, figure, interval, percent, span
from dmframe.study.plan import Study
from dmframe.study.proof import Proof
from dmframe.study.statistics import BINS, Paired

ROWS: Final = 60
"""Grid points in a table of the page; the folder's table has all."""
GRAPHS: Final = 4
"""Graphs that the page's head names."""
VALUES: Final = 12
"""Values of a grid quantity that are listed."""
BADGES: Final = {
    "proved": ("proved", "proved"),
    "refuted": ("refuted", "refuted"),
    "not_applicable": ("not proved", "not_applicable"),
    "not_known": ("not known", "open"),
}
Pictures = Mapping[str, str]
"""SVG by the names of `figures_of`."""


def sections(t: ReportData, pictures: Pictures) -> Iterator[Section]:
    """All sections below the answer."""
    yield Section("found", "Main findings", [*summary(t)])
    yield Section("settings", "The settings" if t.several else "The figures", [*_settings(t, pictures)])
    if "distribution" in pictures or "eighths" in pictures:
        yield Section("quantiles", "Distribution of the figures", [*_spread(t, pictures)])
    if t.found.comparisons:
        yield Section("compared", "Comparison of the settings", [*_comparison(t)])
    if any(name.startswith("map") for name in pictures):
        yield Section("maps", "Maps", [*_maps(t, pictures)])
    if any(each.influences for each in t.found.points):
        yield Section("influences", "Influence of the quantities", [*_influence(t, pictures)])
    if t.worst:
        yield Section("worst", "The worst runs", [*_worst(t)])
    if t.proofs:
        drawn = " over the sampled box" if t.found.results.study.factors else ""
        yield Section("proof", f"The proof{drawn}", [*proof_section(t)])
    yield Section("design", "Varied quantities", [*_design(t)])
    yield Section("repeat", "To repeat the study", [*_repeat(t)])


def _by_setting(
    t: ReportData, heads: Sequence[Cell], cells: Callable[[PointFindings], Sequence[Cell]], **options: Any
) -> Table:
    """A table with a row per setting."""
    keys = ["setting"] * t.several
    rows = [[*([Word(each.name, "code")] if t.several else []), *cells(each)] for each in t.found.points[:ROWS]]
    numbers = range(len(keys), len(keys) + len(heads))
    return Table(rows, [*keys, *heads], kind="study", keys=t.several, numbers=numbers, **options)


def _settings(t: ReportData, pictures: Pictures) -> Iterator[Part]:
    found, independent, shown = t.found, t.found.results.independent, t.found.points[:ROWS]
    if found.sheet.samples == 1:
        yield from _single(t)
        return
    for place, event in enumerate(found.events):
        heads: list[Cell] = ["runs", event.name, "fraction", *["95 % interval", "at most"] * independent]
        heads += ["at most, all together"] * (independent and t.several)

        def cells(each: PointFindings, place: int = place) -> list[Cell]:
            proportion, together = each.alone[place], each.together[place]
            row: list[Cell] = [count(proportion.runs), count(proportion.count), percent(proportion.value)]
            row += [interval(proportion), percent(proportion.most, up=True)] if proportion.most is not None else []
            return row + ([percent(together.most, up=True)] if together.most is not None and t.several else [])

        failing = [k for k, each in enumerate(shown) if each.alone[place].count and event.figure == DIVERGED]
        yield _by_setting(t, heads, cells, failing=failing if t.several else ())
    text = no_interval(found)
    if independent:
        text = (
            "The interval is the exact one of Clopper and Pearson for a binomial probability, and holds for each row "
            "by itself; “at most” is the one-sided limit at 95 %"
        )
        all_of = f"; the last column's limits hold for all {len(found.points)} settings at once (Bonferroni)"
        text += all_of * t.several + "."
    yield Paragraph(Marked(text), note=True)
    if "divergence" in pictures:
        yield Picture(pictures["divergence"], "divergence", "Fraction of the runs that diverged, per setting.")
    for name in dict.fromkeys(name for each in found.points for name in each.quantiles):
        yield from _quantiles(t, name)
    yield from _more(t)


def _single(t: ReportData) -> Iterator[Part]:
    """Figures of settings that ran once each."""
    sheet, found = t.found.sheet, t.found
    names = list(dict.fromkeys([found.results.main, *(event.figure for event in found.events)]))
    names = [name for name in names if name in sheet.columns]
    ended = [float(sheet.diverged_at[each.index, 0]) for each in found.points]

    def cells(each: PointFindings) -> list[Cell]:
        row: list[Cell] = [figure(sheet.figure(name)[each.index, 0], t.unit(name)) for name in names]
        return [*row, plain(ended[each.index], "s") if math.isfinite(ended[each.index]) else ""]

    failing = [k for k, each in enumerate(found.points[:ROWS]) if math.isfinite(ended[each.index])]
    yield _by_setting(t, [*(Word(name, "code") for name in names), "diverged after"], cells, failing=failing)
    yield from _more(t)


def _more(t: ReportData) -> Iterator[Part]:
    if len(t.found.points) > ROWS:
        rest = f"The first {ROWS} of {count(len(t.found.points))} settings; `Results(folder).table` has all."
        yield Paragraph(Marked(rest), note=True)


def _quantiles(t: ReportData, name: str) -> Iterator[Part]:
    ps = next(each.quantiles[name] for each in t.found.points if name in each.quantiles)
    independent = t.found.results.independent

    def cells(each: PointFindings) -> list[Cell]:
        row = list[Cell]()
        for q in each.quantiles.get(name, ()):
            row += [figure(q.value, t.unit(name)), *([between(q, t.unit(name))] if independent else [])]
        return row

    if ps:
        heads = [cell for q in ps for cell in (f"{100 * q.p:g} % below", *["95 % interval"] * independent)]
        caption = (Word(name, "code"), ": quantiles" + ", with distribution-free intervals" * independent)
        yield _by_setting(t, heads, cells, caption=caption)


def _spread(t: ReportData, pictures: Pictures) -> Iterator[Part]:
    few = f" The first {SHOWN} settings." if len(t.found.points) > SHOWN else ""
    drawn = list[Titled]()
    if "distribution" in pictures:
        caption = Marked(
            f"Fraction of the runs with at most so large a `{t.found.results.main}`. A curve that ends below 100 % "
            f"omits the runs that diverged.{few}"
        )
        drawn.append(Titled("At the end", Picture(pictures["distribution"], "distribution", caption)))
    if "eighths" in pictures:
        thin = ", and as a thin line the 95 % quantile, which ends where more than 5 % have diverged"
        caption = Marked(f"RMS of the tracking error: the median{thin * (t.found.sheet.samples > 1)}.{few}")
        drawn.append(Titled("During the run", Picture(pictures["eighths"], "eighths", caption)))
    yield Columns(drawn)


def _comparison(t: ReportData) -> Iterator[Part]:
    found, main = t.found, t.found.results.main
    first, tested = found.points[0], found.comparisons[0].p is not None
    heads: list[Cell] = ["setting", "better", "worse", "median ratio", "median difference"]
    heads += ["95 % interval", "sign test"] * tested + ["diverges only here", "only there"]
    rows = list[list[Cell]]()
    for each in found.comparisons[:ROWS]:
        pair, unit = each.figure, t.unit(main)
        row: list[Cell] = [Word(each.name, "code"), _part(pair.better, pair), _part(pair.worse, pair)]
        row += [_ratio(pair.ratio), _difference(pair.difference.value, unit)]
        if tested:
            ends = (pair.difference.low, pair.difference.high)
            row += [" to ".join("-" if end is None else _difference(end, unit) for end in ends), chance(each.p)]
        rows.append([*row, count(each.only_here), count(each.only_there)])
    yield Paragraph(
        Marked(
            f"Each setting compared with the first, {code(first)}, on the same {t.noun}: how often its `{main}` is "
            "smaller and how often larger, and the medians of the ratio and of the difference. A run that diverged is "
            "worse than one that did not."
        )
    )
    yield Table(rows, heads, kind="study", keys=True, numbers=range(1, len(heads)))
    if tested:
        yield Paragraph(
            "The interval is distribution-free, for the median of the differences; the probabilities of the sign test "
            "are adjusted for the number of settings (Holm). Neither assumes a distribution of the figures.",
            note=True,
        )


def _part(number: int, pair: Paired) -> str:
    return percent(number / pair.runs) if pair.runs else "-"


def _ratio(value: float) -> str:
    return "-" if math.isnan(value) else "diverged" if math.isinf(value) else f"{value:.3g}"


def _difference(value: float, unit: str) -> str:
    if math.isinf(value):
        return "diverges" if value > 0 else "no longer diverges"
    return "-" if math.isnan(value) else ("+" if value > 0 else "") + plain(value, unit)


def _maps(t: ReportData, pictures: Pictures) -> Iterator[Part]:
    for place, (x, y) in enumerate(dict.fromkeys((each.x, each.y) for each in t.found.maps), start=1):
        if (name := f"map_{place}") in pictures:
            caption = Marked(
                f"Median of `{t.found.results.main}`, and fraction of the runs that diverged, in bins of `{x}` and "
                f"`{y}`; all other quantities vary within a bin. White bins have no run; in hatched bins of the "
                "medians most runs diverged."
            )
            yield Picture(pictures[name], name, caption, wide=True)


def _influence(t: ReportData, pictures: Pictures) -> Iterator[Part]:
    found, main = t.found, t.found.results.main
    if "influence" in pictures:
        caption = Marked(f"Fraction of the variance of `{main}`, in ranks, that each quantity explains alone.")
        yield Picture(pictures["influence"], "influence", caption)
    shown = [each for each in found.points[:SHOWN] if each.influences]
    for name in dict.fromkeys(name for each in shown for name in each.influences):
        points = [each for each in shown if name in each.influences]
        tested = points[0].influences[name][0].p is not None
        heads, rest = list[Cell](["quantity"]), list[Cell](["remainder: interactions, and effects within a bin"])
        rows: list[list[Cell]] = [[Word(item.factor, "code")] for item in points[0].influences[name][:FACTORS]]
        for each in points:
            heads += [Word(each.name, "code") if each.name else "fraction", *["by chance"] * tested]
            items = {item.factor: item for item in each.influences[name]}
            for row, first in zip(rows, points[0].influences[name], strict=False):
                row += [percent(items[first.factor].explained), *[chance(items[first.factor].p)] * tested]
            left = max(0.0, 1 - sum(item.explained for item in items.values()))
            rest += [percent(left), *[""] * tested]
        caption_ = (Word(name, "code"), ": fraction of the variance of ranks")
        yield Table([*rows, rest], heads, caption_, "study", keys=True, numbers=range(1, len(heads)))
    yield Paragraph(
        Marked(
            "First-order Sobol indices of the ranks, estimated from the runs themselves: the correlation ratio over "
            f"at most {BINS} bins of each quantity, without what so many bins explain by chance. Ranks are used, as "
            "an error spans decades; a run that diverged has the last rank. “By chance” is the probability of so large "
            "a fraction if the quantity has no influence (Kruskal and Wallis, adjusted for the number of quantities "
            "after Holm); a design that spreads its points has none. Interactions, and effects within a bin, are in "
            "the last row only; with fewer runs the bins are coarser."
        ),
        note=True,
    )


def _worst(t: ReportData) -> Iterator[Part]:
    factors = list(t.worst[0].draws)[:FACTORS]
    heads: list[Cell] = ["graph", "run", *["setting"] * t.several, "figure", *(Word(f, "code") for f in factors)]
    rows = list[list[Cell]]()
    for each in t.worst:
        row: list[Cell] = [Word(each.file, "code"), str(each.run), *([Word(each.point, "code")] if t.several else [])]
        value = f" = {figure(each.value, t.unit(each.figure))}"
        diverged = f"diverged at {plain(each.diverged_at, 's')}" if math.isfinite(each.diverged_at) else ""
        row.append(diverged or (Word(each.figure, "code"), value))
        rows.append([*row, *(plain(each.draws[name], t.unit(name), 4) for name in factors)])
    yield Table(rows, heads, kind="study", keys=True, numbers=range(4 if t.several else 3, len(heads)))
    first = t.worst[0].file
    yield Paragraph(
        Marked(
            "Each file is a complete graph with the numbers of its run, and reproduces the run to rounding. In this "
            f"page's folder, `dmframe run {first} --out worst` plots it, `dmframe verify {first}` proves it or reports "
            f"why not, and `dmframe analyse {first}` computes the sampling period up to which its loop is stable."
        )
    )


def proof_section(t: ReportData) -> Iterator[Part]:
    """The box, and the verdict on the certificate's conditions in it."""
    sampled = "The proof is in continuous time, and the runs are sampled: a run may diverge where the proof holds."
    text = f"Each setting has its own proof, or none. {sampled}"
    if t.found.results.study.factors:
        text = (
            "The conditions of the proof were decided exactly for all values of the parameters in this box, not only "
            f"at its corners. {sampled} A condition that fails somewhere in the box may hold for most of the samples: "
            "a column counts the samples that meet every condition. Where this cannot be decided from a sample's "
            "numbers, the first few were verified as graphs of their own."
        )
    yield Paragraph(text)
    first = next((each for each in t.proofs if each.box.ends), None)
    if first is not None:
        at = f" at {first.name}" if len(t.proofs) > 1 else ""
        rows = [(Word(label, "code"), _ends(first, label)) for label in first.box.ends]
        yield Table(rows, ("parameter", f"from and to{at}"), kind="study", keys=True)
    for sentence in outside_the_box(t):
        yield Paragraph(Marked(sentence), note=True)
    several, counted = len(t.proofs) > 1, any(each.drawn is not None for each in t.proofs)
    verdicts = list[list[Cell]]()
    for each in t.proofs:
        row: list[Cell] = [Word(each.name, "code")] if several else []
        verdicts.append([*row, Badge(*BADGES[each.state]), *([_met(each)] if counted else []), _conditions(each)])
    heads = ["setting"] * several + ["over the box" if first else "verdict"]
    heads += [f"{t.noun} that meet all"] * counted + ["conditions"]
    yield Table(verdicts, heads, kind="study", keys=several)
    if len(t.found.points) > len(t.proofs):
        yield Paragraph(f"The first {len(t.proofs)} of {len(t.found.points)} settings.", note=True)


def _ends(proof: Proof, label: str) -> str:
    """The interval of a parameter, or those of its elements if they differ."""
    unit, (low, high) = proof.box.units.get(label, ""), proof.box.ends[label]
    ends = list(zip(low.ravel(), high.ravel(), strict=True))
    if len(set(ends)) == 1:
        return span(*ends[0], unit)
    texts = [span(a, b, unit if k + 1 == len(ends) else "") for k, (a, b) in enumerate(ends)]
    return ", ".join(texts if len(texts) <= 7 else [*texts[:6], "...", unit])


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


def _met(each: Proof) -> str:
    """How many samples meet all conditions."""
    if each.proved:
        return "all"
    if each.drawn is None or not each.drawn.known:
        return "not known"
    number, of, unknown = each.drawn.counts
    return f"{count(number)} of {count(of)}" + f"; {count(unknown)} not known" * bool(unknown)


def scope(study: Study) -> str:
    """Graphs and duration of the runs, for the page's head."""
    experiments = [point.graph for point in study.points]
    names = list(dict.fromkeys(each.name for each in experiments))
    times = sorted({each.file.duration for each in experiments})
    shown = [*names[:GRAPHS], f"{len(names) - GRAPHS} more"] if len(names) > GRAPHS else names
    graphs = f"{'Graph' if len(names) == 1 else 'Graphs'} {listed(shown)}"
    return f"{graphs}; runs of {plain(times[0], 's') if len(times) == 1 else span(times[0], times[-1], 's')}."


def _design(t: ReportData) -> Iterator[Part]:
    study = t.found.results.study
    drawn = {name: distribution(factor, k) for factor in study.factors for k, name in enumerate(factor.columns)}
    rows = list[list[Cell]]()
    for column in study.varied:
        how = drawn.get(column.name, "")
        if column.kind == "grid":
            values = list(dict.fromkeys(_value(point.values[column.name], column.unit) for point in study.points))
            how = ", ".join(values[:VALUES]) + (", ..." if len(values) > VALUES else "")
        rows.append([Word(column.name, "code"), "grid" if column.kind == "grid" else "drawn", how])
    if rows:
        yield Table(rows, ("quantity", "how", "values"), kind="study", keys=True)
    text = f"{count(len(study.points))} settings, {count(study.samples)} samples at each"
    if study.samples > 1:
        same = ", the same at each setting, so that settings are compared on the same robots" * t.several
        text += f": {METHODS[study.file.sample.method]}, seed {study.file.sample.seed}{same}"
    yield Paragraph(f"{text}.")


def _value(value: object, unit: str) -> str:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return plain(float(value), unit, 6) if is_number else str(value)  # type: ignore[arg-type]


def _repeat(t: ReportData) -> Iterator[Part]:
    yield Table([(Word(command, "command"), does) for command, does in t.commands], kind="study")
    if t.made:
        yield Subsection("Made with", [Table(t.made, keys=True)])
