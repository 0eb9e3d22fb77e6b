"""A study's page, section by section: the one place that says what it shows, and in which words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

from dmframe.errors import listed
from dmframe.plotting import figure_svg
from dmframe.report.parts import (
    Badge,
    Bullets,
    Cell,
    Columns,
    Lead,
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
from dmframe.study.figures import FACTORS, figures_of
from dmframe.study.findings import DIVERGED, SHOWN, Findings, Found
from dmframe.study.numbers import between, chance, count, figure, interval, percent, span
from dmframe.study.proof import HELD, Proof
from dmframe.study.statistics import BINS, Paired, Quantile
from dmframe.study.varied import Factor
from dmframe.units import plain

ROWS: Final = 60
"""Grid points in a table; the folder's table holds all."""
NAMED: Final = 4
"""Settings that a sentence names."""
_METHODS: Final = {
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
    """The answer in plain words."""
    found, noun = t.found, t.noun
    ran = [each for each in found.points if each.runs]
    place = found.events.index(found.diverging)
    samples = max((each.runs for each in ran), default=0)
    unfinished = _unfinished(found)
    if not ran:
        return Lead("open", "No run is there yet", Marked(f"there is nothing to tell.{unfinished}"))
    if found.sheet.samples == 1:
        lost = sum(each.alone[place].count for each in ran)
        text = f"{count(len(ran))} settings ran, each once; {_diverged(lost, 'of them')}."
        says = f"Each ran once, on one robot: that is no probability.{unfinished}"
        return Lead(_outcome(len(ran) - lost, len(ran)), text.rstrip("."), Marked(says))
    if len(found.points) == 1:
        share = ran[0].alone[place]
        head = f"Of {count(share.runs)} {noun} {_diverged(share.count, '')}".rstrip()
        if share.most is None:
            return Lead(_outcome(share.count == 0, 1), head, Marked(_no_interval(found) + unfinished))
        says = f"the probability of divergence is at most {percent(share.most, up=True)}, at 95 % confidence."
        if share.count:
            says = f"{percent(share.value)} of them; {says}"
        return Lead(_outcome(share.count == 0, 1), head, Marked(says + unfinished))
    steady = found.steady
    head = f"None of {count(samples)} {noun} diverged at {len(steady)} of {len(ran)} settings"
    if not steady:
        least = min(ran, key=lambda each: each.alone[place].value)
        head = f"At each of {len(ran)} settings some of {count(samples)} {noun} diverged"
        says = f"fewest at {_name(least)}: {percent(least.alone[place].value)}"
        if least.together[place].most is not None:
            says += f", a probability of at most {percent(least.together[place].most or 1, up=True)} at 95 % confidence"
        return Lead("refuted", head, Marked(f"{says}.{unfinished}"))
    says = _names(steady)
    most = max(each.together[place].most or 0.0 for each in steady)
    if steady[0].together[place].most is not None:
        each_of = "at each of them " if len(steady) > 1 else ""
        says += f"; {each_of}the probability of divergence is at most {percent(most, up=True)}, at 95 % confidence"
        says += f" for all {len(ran)} settings together."
    else:
        says += f". {_no_interval(found)}"
    return Lead(_outcome(len(steady), len(ran)), head, Marked(says + unfinished))


def _outcome(good: int, of: int) -> str:
    return "proved" if good == of else "refuted" if not good else "open"


def _diverged(number: int, of: str) -> str:
    return " ".join(f"{'none' if not number else count(number)} {of} diverged".split())


def _unfinished(found: Findings) -> str:
    missing = sum(each.missing for each in found.points)
    return f" {count(missing)} runs are not there yet: the same command computes them." if missing else ""


def _no_interval(found: Findings) -> str:
    if found.sheet.samples < 2:
        return "Each setting ran once, so that nothing is said of probabilities."
    return (
        f"No interval of probability is given: the samples are {_METHODS[found.results.study.file.sample.method]}, and no "
        "independent draws, for which alone it would be valid; `method: random` gives one."
    )


def _name(each: Found) -> str:
    return f"`{each.name}`"


def _names(several: Sequence[Found]) -> str:
    first = [_name(each) for each in several[:NAMED]]
    return listed([*first, f"{len(several) - NAMED} more, in the table below"] if len(several) > NAMED else first)


def sections(t: Told) -> Iterator[Section]:
    """Everything below the answer."""
    pictures = {name: figure_svg(drawn) for name, drawn in figures_of(t.found).items()}
    yield Section("found", "What was found", [*_summary(t)])
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
        yield Section("worst", "The worst runs", [*_worst(t)])
    if t.proofs:
        yield Section("proof", "The proof over all that was drawn", [*_proof(t)])
    yield Section("design", "What was varied", [*_design(t)])
    yield Section("repeat", "To do it again", [*_repeat(t)])


def _summary(t: Told) -> Iterator[Part]:
    found, main = t.found, t.found.results.main
    items, failing = list[Cell](), list[int]()
    best = _best(found)
    if best is not None and len(found.points) > 1:
        each, top = best
        middle = next((q for q in each.quantiles[main] if q.p == 0.5), None)
        half = f", and half of them below {figure(middle.value, t.unit(main))}" if middle and top.p > 0.5 else ""
        items.append(
            Marked(
                f"Of the settings where none diverged, {_name(each)} has the smallest {_ordinal(top.p)} quantile of "
                f"`{main}`: {100 * top.p:g} % of the {t.noun} stay below {figure(top.value, t.unit(main))}{half}."
            )
        )
    elif best is not None:
        each, top = best
        told = ", ".join(f"{100 * q.p:g} % below {figure(q.value, t.unit(main))}" for q in each.quantiles[main])
        items.append(Marked(f"`{main}`: {told}."))
    for figure_name, influences in (found.points[0].influences if found.points else {}).items():
        strong = [item for item in influences if item.share >= 0.05][:3]
        if strong:
            told = listed([f"`{item.factor}` ({percent(item.share)})" for item in strong])
            what = "whether a run diverges" if figure_name == DIVERGED else f"`{figure_name}`"
            items.append(Marked(f"What decides {what} most: {told}, each as a share of the variance of ranks."))
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
        items.append(Marked(f"{count(lost)} runs could not be made; they count nowhere, and the table tells their faults."))
    yield Bullets(items, failing)


def _best(found: Findings) -> tuple[Found, Quantile] | None:
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


def _settings(t: Told, pictures: Mapping[str, str]) -> Iterator[Part]:
    found, shown = t.found, t.found.points[:ROWS]
    several, independent = len(found.points) > 1, found.results.independent
    for place, event in enumerate(found.events):
        heads: list[Cell] = ["setting"] * several + ["runs", f"{event.name}", "share"]
        heads += ["95 % interval", "at most"] if independent else []
        heads += ["at most, all together"] if independent and several else []
        rows = list[list[Cell]]()
        for each in shown:
            share, together = each.alone[place], each.together[place]
            row: list[Cell] = [Word(each.name, "code")] if several else []
            row += [count(share.runs), count(share.count), percent(share.value)]
            row += [interval(share), percent(share.most or 1.0, up=True)] if share.most is not None else []
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
        yield Paragraph(Marked(_no_interval(found)), note=True)
    if "divergence" in pictures:
        yield Picture(pictures["divergence"], "divergence", "Share of the runs that diverged, a line a setting.")
    for name in dict.fromkeys(name for each in found.points for name in each.quantiles):
        yield from _quantiles(t, name, shown)
    if len(found.points) > ROWS:
        yield Paragraph(
            Marked(f"The first {ROWS} of {count(len(found.points))} settings; `Results(folder).table` has all."), note=True
        )


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
        row: list[Cell] = [Word(each.name, "code")] if several else []
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
            f"Share of the runs with at most so large a `{t.found.results.main}`. A curve that ends below 100 % lacks the "
            f"runs that diverged.{few}"
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
        row: list[Cell] = [Word(each.name, "code"), _part(pair.better, pair), _part(pair.worse, pair), _ratio(pair.ratio)]
        row.append(_difference(pair.difference.value, t.unit(main)))
        if tested:
            ends = (pair.difference.low, pair.difference.high)
            row.append(" to ".join("-" if end is None else _difference(end, t.unit(main)) for end in ends))
            row.append(chance(each.p))
        rows.append([*row, count(each.only_here), count(each.only_there)])
    yield Paragraph(
        Marked(
            f"Each setting against the first, {_name(first)}, on the same {t.noun}: how often it has the smaller `{main}`, "
            "and the greater; the medians are of the ratio and the difference on each. A run that diverged is worse than "
            "any that did not."
        )
    )
    yield Table(rows, heads, kind="study", keys=True, numbers=range(1, len(heads)))
    if tested:
        yield Paragraph(
            "The interval is distribution-free, for the median of the differences; the sign test's probabilities are "
            "adjusted for the number of settings (Holm). Both look at signs alone, and ask nothing of how the figures are "
            "distributed.",
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
            "else varies within a bin. White bins hold no run; in hatched ones most diverged."
        )
        yield Picture(pictures[f"map_{place}"], f"map_{place}", caption)


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
        rest: list[Cell] = ["the rest, which they decide together"]
        for each in points:
            left = max(0.0, 1 - sum(item.share for item in each.influences[name]))
            rest += [percent(left), *([""] if tested else [])]
        caption = (Word(name, "code"), ": share of the variance of ranks")
        yield Table([*rows, rest], heads, caption, "study", keys=True, numbers=range(1, len(heads)))
    yield Paragraph(
        Marked(
            f"First-order Sobol indices of the ranks, from the runs themselves: the correlation ratio over {BINS} bins of "
            "each quantity, without what so many bins explain by chance. Ranks, since an error spans decades and a run that "
            "diverged has none: it is last. “By chance” is the probability of so large a share where the quantity has no "
            "influence (Kruskal and Wallis; adjusted for their number, after Holm); a design that spreads its points has "
            "none. What quantities decide only together is in no row but the last."
        ),
        note=True,
    )


def _worst(t: Told) -> Iterator[Part]:
    several = len(t.found.points) > 1
    factors = list(t.worst[0].draws)[:FACTORS]
    heads: list[Cell] = ["graph", "run", *(["setting"] if several else []), "figure", *(Word(f, "code") for f in factors)]
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
            f"Each file is a whole graph with the numbers of its run, and runs again exactly as it did: `dmframe run {first} "
            f"--out worst` draws it, `dmframe verify {first}` proves it or says why not."
        )
    )


def _proof_in_short(t: Told) -> str:
    good, all_of = sum(each.proved for each in t.proofs), len(t.proofs)
    where = f"over the whole box of what was drawn{_held(t.proofs)}"
    if good == all_of:
        return f"The proof's conditions hold {where}" + (f", at each of {all_of} settings." if all_of > 1 else ".")
    if not good:
        return f"The proof's conditions do not all hold {where}; that is no proof of the contrary."
    return f"The proof's conditions hold {where} at {good} of {all_of} settings."


def _held(proofs: Sequence[Proof]) -> str:
    endless = any(each.box.held < 1 for each in proofs)
    return f" ({100 * HELD:g} % of the draws: some have no ends)" if endless else ""


def _proof(t: Told) -> Iterator[Part]:
    yield Paragraph(
        Marked(
            "The conditions of the proof were decided exactly, for all values of the parameters in this box at once, "
            "between its corners too. The proof is in continuous time, and covers what its assumptions say; the runs of "
            "this study are sampled, so that one may diverge where the proof holds. Where a condition fails over the box, "
            "it may still hold for most of what lies in it: the box holds combinations that nobody drew."
        )
    )
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
        if first.box.outside:
            names = listed([f"`{name}`" for name in first.box.outside])
            yield Paragraph(Marked(f"Not in the box, for it is no parameter of the loop: {names}."), note=True)
    rows = []
    for each in t.proofs:
        says = each.why or ("every condition holds" if each.proved else "")
        names = "; ".join(item.name + (f" (least {item.value:.3g})" if item.value is not None else "") for item in each.failing)
        says = says or (names and f"fails somewhere: {names}") or (each.verdict.reason if each.verdict else "")
        badge = Badge("proved", "proved") if each.proved else Badge("not proved", "open")
        rows.append([*([Word(each.name, "code")] if len(t.proofs) > 1 else []), badge, says])
    heads = [*(["setting"] if len(t.proofs) > 1 else []), "over the box", "conditions"]
    yield Table(rows, heads, kind="study", keys=len(t.proofs) > 1)
    if len(t.found.points) > len(t.proofs):
        yield Paragraph(f"The first {len(t.proofs)} of {len(t.found.points)} settings.", note=True)


def _design(t: Told) -> Iterator[Part]:
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
        told += f": {_METHODS[study.file.sample.method]}, seed {study.file.sample.seed}{same}"
    yield Paragraph(f"{told}.")


def _value(value: object, unit: str) -> str:
    return plain(float(value), unit, 6) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _how_drawn(factor: Factor) -> str:
    spread, unit = factor.spread, factor.unit
    if spread is None:
        return ""
    what = {"value": "", "scale": "times the graph's own, ", "shift": "added to the graph's own, "}[factor.how]
    ends = span(spread.lower, spread.upper, unit)
    if spread.kind != "normal":
        told = f"{ends}, {'all' if spread.kind == 'uniform' else 'all logarithms'} equally likely"
    else:
        clip = f", between {ends.replace(' to ', ' and ')}" if math.isfinite(spread.lower) or math.isfinite(spread.upper) else ""
        told = f"normal, mean {plain(spread.a, unit, 5)}, standard deviation {plain(spread.b, unit, 5)}{clip}"
    of = f"; of {', '.join(factor.labels)}" if factor.labels != (factor.name,) else ""
    return f"{what}{told}{of}"


def _repeat(t: Told) -> Iterator[Part]:
    yield Table([(Word(command, "command"), does) for command, does in t.commands], kind="study")
    if t.made:
        yield Subsection("Made with", [Table(t.made, keys=True)])
