"""A study's page, section by section: the one place that says what it shows, and in which words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from dmframe.report.parts import Cell, Columns, Marked, Paragraph, Part, Picture, Section, Table, Titled, Word
from dmframe.study import basis
from dmframe.study.answer import Told, code, no_interval, summary
from dmframe.study.figures import FACTORS
from dmframe.study.findings import DIVERGED, SHOWN, Found
from dmframe.study.numbers import between, chance, count, figure, interval, percent
from dmframe.study.statistics import BINS, Paired
from dmframe.units import plain

ROWS: Final = 60
"""Grid points in a table; the folder's table holds all."""


def sections(t: Told, pictures: Mapping[str, str]) -> Iterator[Section]:
    """Everything below the answer; `pictures` are SVG, by the names of `figures_of`."""
    yield Section("found", "What was found", [*summary(t)])
    yield Section("settings", "The settings" if len(t.found.points) > 1 else "The figures", [*_settings(t, pictures)])
    if "distribution" in pictures or "eighths" in pictures:
        yield Section("quantiles", "How the figures are spread", [*_spread(t, pictures)])
    if t.found.comparisons:
        yield Section("compared", "The settings compared", [*_comparison(t)])
    if any(name.startswith("map") for name in pictures):
        yield Section("maps", "Where it happens", [*_maps(t, pictures)])
    if any(each.influences for each in t.found.points):
        yield Section("influences", "What decides it", [*_influence(t, pictures)])
    if t.worst:
        yield Section("worst", "The worst runs", [*basis.worst(t)])
    if t.proofs:
        drawn = " over all that was drawn" if t.found.results.study.factors else ""
        yield Section("proof", f"The proof{drawn}", [*basis.proof(t)])
    yield Section("design", "What was varied", [*basis.design(t)])
    yield Section("repeat", "To do it again", [*basis.repeat(t)])


def _settings(t: Told, pictures: Mapping[str, str]) -> Iterator[Part]:
    found, shown = t.found, t.found.points[:ROWS]
    if found.sheet.samples == 1:
        yield from _single(t, shown)
        return
    several, independent = len(found.points) > 1, found.results.independent
    for place, event in enumerate(found.events):
        heads: list[Cell] = [*["setting"] * several, "runs", event.name, "share"]
        heads += ["95 % interval", "at most"] if independent else []
        heads += ["at most, all together"] if independent and several else []
        rows = list[list[Cell]]()
        for each in shown:
            share, together = each.alone[place], each.together[place]
            row: list[Cell] = [Word(each.name, "code")] if several else []
            row += [count(share.runs), count(share.count), percent(share.value)]
            row += [interval(share), percent(share.most, up=True)] if share.most is not None else []
            row += [percent(together.most, up=True)] if together.most is not None and several else []
            rows.append(row)
        numbers = range(int(several), len(heads))
        failing = [k for k, each in enumerate(shown) if each.alone[place].count and event.figure == DIVERGED]
        yield Table(rows, heads, kind="study", keys=several, numbers=numbers, failing=failing if several else ())
    if independent:
        yield Paragraph(
            Marked(
                "The interval is the exact one of Clopper and Pearson for a binomial probability, and holds for each "
                "row by itself; “at most” is the one-sided limit at 95 %"
                + (
                    f"; the last column's limits hold for all {len(found.points)} settings at once (Bonferroni)."
                    if several
                    else "."
                )
            ),
            note=True,
        )
    else:
        yield Paragraph(Marked(no_interval(found)), note=True)
    if "divergence" in pictures:
        yield Picture(pictures["divergence"], "divergence", "Share of the runs that diverged, a line a setting.")
    for name in dict.fromkeys(name for each in found.points for name in each.quantiles):
        yield from _quantiles(t, name, shown)
    yield from _more(t)


def _single(t: Told, shown: Sequence[Found]) -> Iterator[Part]:
    """Settings that ran once each: their figures."""
    sheet, several = t.found.sheet, len(t.found.points) > 1
    names = list(dict.fromkeys([t.found.results.main, *(event.figure for event in t.found.events)]))
    names = [name for name in names if name in sheet.columns]
    rows, failing = list[list[Cell]](), list[int]()
    for k, each in enumerate(shown):
        row = list[Cell]([Word(each.name, "code")] if several else [])
        row += [figure(sheet.figure(name)[each.index, 0], t.unit(name)) for name in names]
        when = float(sheet.diverged_at[each.index, 0])
        rows.append([*row, plain(when, "s") if math.isfinite(when) else ""])
        failing += [k] if math.isfinite(when) else []
    heads = list[Cell](["setting"] * several + [Word(name, "code") for name in names] + ["diverged after"])
    yield Table(rows, heads, kind="study", keys=several, numbers=range(int(several), len(heads)), failing=failing)
    yield from _more(t)


def _more(t: Told) -> Iterator[Part]:
    if len(t.found.points) > ROWS:
        rest = f"The first {ROWS} of {count(len(t.found.points))} settings; `Results(folder).table` has all."
        yield Paragraph(Marked(rest), note=True)


def _quantiles(t: Told, name: str, shown: Sequence[Found]) -> Iterator[Part]:
    several = len(t.found.points) > 1
    ps = next(each.quantiles[name] for each in t.found.points if name in each.quantiles)
    if not ps:
        return
    independent = t.found.results.independent
    heads: list[Cell] = ["setting"] * several
    for q in ps:
        heads += [f"{100 * q.p:g} % below", *(["95 % interval"] if independent else [])]
    rows = list[list[Cell]]()
    for each in shown:
        row = list[Cell]([Word(each.name, "code")] if several else [])
        for q in each.quantiles.get(name, ()):
            row += [figure(q.value, t.unit(name)), *([between(q, t.unit(name))] if independent else [])]
        rows.append(row)
    caption = (Word(name, "code"), ": quantiles" + ", with distribution-free intervals" * independent)
    yield Table(rows, heads, caption, "study", several, range(int(several), len(heads)))


def _spread(t: Told, pictures: Mapping[str, str]) -> Iterator[Part]:
    few = f" The first {SHOWN} settings." if len(t.found.points) > SHOWN else ""
    drawn = list[Titled]()
    if "distribution" in pictures:
        caption = Marked(
            f"Share of the runs with at most so large a `{t.found.results.main}`. A curve that ends below 100 % lacks "
            f"the runs that diverged.{few}"
        )
        drawn.append(Titled("In the end", Picture(pictures["distribution"], "distribution", caption)))
    if "eighths" in pictures:
        thin = ", and as a thin line the 95 % quantile, which ends where more than 5 % have diverged"
        caption = Marked(f"RMS of the tracking error: the median{thin * (t.found.sheet.samples > 1)}.{few}")
        drawn.append(Titled("During the run", Picture(pictures["eighths"], "eighths", caption)))
    yield Columns(drawn)


def _comparison(t: Told) -> Iterator[Part]:
    found, main = t.found, t.found.results.main
    first, tested = found.points[0], found.comparisons[0].p is not None
    heads: list[Cell] = ["setting", "better", "worse", "median ratio", "median difference"]
    heads += ["95 % interval", "sign test"] if tested else []
    heads += ["diverges only here", "only there"]
    rows = list[list[Cell]]()
    for each in found.comparisons[:ROWS]:
        pair = each.figure
        row: list[Cell] = [
            Word(each.name, "code"),
            _part(pair.better, pair),
            _part(pair.worse, pair),
            _ratio(pair.ratio),
        ]
        row.append(_difference(pair.difference.value, t.unit(main)))
        if tested:
            ends = (pair.difference.low, pair.difference.high)
            row.append(" to ".join("-" if end is None else _difference(end, t.unit(main)) for end in ends))
            row.append(chance(each.p))
        rows.append([*row, count(each.only_here), count(each.only_there)])
    yield Paragraph(
        Marked(
            f"Each setting against the first, {code(first)}, on the same {t.noun}: how often its `{main}` is smaller, "
            "and how often greater; the medians are of the ratio and the difference on each. A run that diverged is "
            "worse than any that did not."
        )
    )
    yield Table(rows, heads, kind="study", keys=True, numbers=range(1, len(heads)))
    if tested:
        yield Paragraph(
            "The interval is distribution-free, for the median of the differences; the sign test's probabilities are "
            "adjusted for the number of settings (Holm). Both look at signs alone, and ask nothing of how the figures "
            "are distributed.",
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


def _maps(t: Told, pictures: Mapping[str, str]) -> Iterator[Part]:
    seen = list(dict.fromkeys((each.x, each.y) for each in t.found.maps))
    for place, (x, y) in enumerate(seen, start=1):
        if f"map_{place}" not in pictures:
            continue
        caption = Marked(
            f"Median of `{t.found.results.main}`, and share of the runs that diverged, in bins of `{x}` and `{y}`; all "
            "else varies within a bin. Of the medians, white bins hold no run, and in hatched ones most diverged."
        )
        yield Picture(pictures[f"map_{place}"], f"map_{place}", caption, wide=True)


def _influence(t: Told, pictures: Mapping[str, str]) -> Iterator[Part]:
    found, main = t.found, t.found.results.main
    if "influence" in pictures:
        yield Picture(
            pictures["influence"], "influence", Marked(f"What each quantity alone explains of `{main}`, in ranks.")
        )
    shown = [each for each in found.points[:SHOWN] if each.influences]
    for name in dict.fromkeys(name for each in shown for name in each.influences):
        points = [each for each in shown if name in each.influences]
        order = [item.factor for item in points[0].influences[name]][:FACTORS]
        tested = points[0].influences[name][0].p is not None
        heads: list[Cell] = ["quantity"]
        for each in points:
            heads += [Word(each.name, "code") if each.name else "share", *(["by chance"] if tested else [])]
        rows = list[list[Cell]]()
        for factor in order:
            row: list[Cell] = [Word(factor, "code")]
            for each in points:
                item = next(item for item in each.influences[name] if item.factor == factor)
                row += [percent(item.share), *([chance(item.p)] if tested else [])]
            rows.append(row)
        rest: list[Cell] = ["the rest: decided together, or too fine for so few runs"]
        for each in points:
            left = max(0.0, 1 - sum(item.share for item in each.influences[name]))
            rest += [percent(left), *([""] if tested else [])]
        caption = (Word(name, "code"), ": share of the variance of ranks")
        yield Table([*rows, rest], heads, caption, "study", keys=True, numbers=range(1, len(heads)))
    yield Paragraph(
        Marked(
            "First-order Sobol indices of the ranks, from the runs themselves: the correlation ratio over at most "
            f"{BINS} bins of each quantity, without what so many bins explain by chance. Ranks, since an error spans "
            "decades and a run that diverged has none: it is last. “By chance” is the probability of so large a share "
            "where the quantity has no influence (Kruskal and Wallis; adjusted for their number, after Holm); a design "
            "that spreads its points has none. What quantities decide only together is in no row but the last; so is "
            "what one decides within its bins, which are the coarser the fewer runs there are."
        ),
        note=True,
    )
