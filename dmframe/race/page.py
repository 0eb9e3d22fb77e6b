"""HTML page of a race: result, table, tuned values, and worst cells."""

from __future__ import annotations

import math
import shlex
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from dmframe.common.units import plain
from dmframe.race.plan import listed
from dmframe.race.protocol import QUANTILES, RESAMPLES, Row, Spread, spread
from dmframe.race.run import Finished
from dmframe.report.parts import Bullets, Cell, Lead, Marked, Paragraph, Section, Subsection, Table, Word
from dmframe.study.pages import study_page

NEAR: Final = 1.15
"""Largest ratio that counts as nearly equal."""


def as_html(found: Finished) -> str:
    """Page as one self-contained HTML file."""
    race = found.race
    note = (
        f"{len(race.file.laws)} laws, {len(found.rows)} held-out cells, runs of {plain(race.file.duration, 's')}; the "
        "error is the RMS of the tool's error over the last eighth."
    )
    parts = list(_sections(found))
    return study_page("Race of control laws", race.name, race.file.title, note, lead(found), parts)


def lead(found: Finished) -> Lead:
    """Result of the race in one sentence."""
    rows, race = found.rows, found.race
    ratios = [row.ratio for row in rows]
    median = spread(ratios, race.file.seed)
    best, near = (sum(ratio <= most for ratio in ratios) for most in (1, NEAR))
    lost = sum(math.isinf(row.error) for row in rows)
    headline = f"{race.file.entrant}: median ratio {_ratio(median.median)}"
    text = (
        f"On {len(rows)} held-out cells the error of `{race.file.entrant}` over that of the best rival is "
        f"{_interval(median)} in the median; it is at most 1 in {_share(best, len(rows))} and at most {NEAR} in "
        f"{_share(near, len(rows))} of the cells. It diverged in {lost or 'none'}."
    )
    return Lead("refuted" if lost else "proved" if median.median <= 1 else "not_applicable", headline, Marked(text))


def _sections(found: Finished) -> Iterator[Section]:
    race = found.race
    yield Section("laws", "The laws", [_laws(found), _bootstrap()])
    yield Section("ratios", "The entrant and the best rival", [*_ratios(found)])
    yield Section("cells", "All cells", [_cells(found)], wide=True)
    yield Section("worst", "The worst cells", [_worst(found)])
    yield Section("tuning", "The tuning", [*_tuning(found)], wide=True)
    command = f"{race.command} --out {shlex.quote(str(found.folder))}"
    again: Cell = (Word(command, "command"), " continues this race, or adds a law to it")
    yield Section("again", "To repeat it", [Bullets([again])])


def _bootstrap() -> Paragraph:
    text = (
        f"Intervals: 95 %, percentile bootstrap of the median with {RESAMPLES} resamples of the cells. Cells share "
        "plants and paths, so that the intervals are too short for new ones. A law that diverged has an infinite error."
    )
    return Paragraph(text, note=True)


def _laws(found: Finished) -> Table:
    """Row for each law, in increasing order of error."""
    rows = list[tuple[float, list[Cell]]]()
    for law in found.race.file.laws:
        errors = [row.errors[law] for row in found.rows]
        of = spread(errors, found.race.file.seed)
        wins = sum(row.errors[law] == min(row.errors.values()) for row in found.rows)
        lost = sum(map(math.isinf, errors))
        quantiles = [_number(of.quantiles[p]) for p in QUANTILES]
        rows.append((of.median, [Word(law, "code"), *quantiles, _range(of, _number), str(wins), str(lost)]))
    heads: list[Cell] = ["law", *(f"{100 * p:g} %" for p in QUANTILES), "interval of the median", "best in", "diverged"]
    unit = found.race.file.unit
    caption = (
        f"Error in {unit} over the held-out cells: quantiles, cells in which the law is the best, and divergences."
    )
    ordered = [cells for _, cells in sorted(rows, key=lambda row: row[0])]
    return Table(ordered, heads, caption, kind="study", keys=True, numbers=range(1, len(heads)))


def _ratios(found: Finished) -> Iterator[Table | Subsection]:
    yield _groups([("all", list(found.rows))], "", found.race.file.seed)
    keys: dict[str, Callable[[Row], str]] = {
        "clock": lambda row: plain(row.cell.clock, "s"),
        "path": lambda row: row.cell.path,
        "plant": lambda row: row.cell.plant,
        "reality": lambda row: row.cell.reality,
    }
    for name, key in keys.items():
        groups = defaultdict[str, list[Row]](list)
        for row in found.rows:
            groups[key(row)].append(row)
        if len(groups) > 1:
            yield Subsection(f"By {name}", [_groups(list(groups.items()), name, found.race.file.seed)])


def _groups(groups: Sequence[tuple[str, Sequence[Row]]], name: str, seed: int) -> Table:
    rows = list[list[Cell]]()
    for group, some in groups:
        of, ratios = spread([row.ratio for row in some], seed), [row.ratio for row in some]
        shares = [_share(sum(ratio <= most for ratio in ratios), len(some)) for most in (1, NEAR)]
        quantiles = [_ratio(of.quantiles[p]) for p in QUANTILES]
        rows.append([group, str(len(some)), *quantiles, _range(of, _ratio), *shares])
    heads: list[Cell] = [name, "cells", *(f"{100 * p:g} %" for p in QUANTILES), "interval of the median"]
    heads += ["at most 1", f"at most {NEAR}"]
    caption = "Error of the entrant over that of the best rival, infinite where the entrant diverged."
    return Table(rows, heads, caption, kind="study", numbers=range(1, len(heads)))


def _cells(found: Finished) -> Table:
    laws = list(found.race.file.laws)
    rows = list[list[Cell]]()
    failing = list[int]()
    for place, row in enumerate(found.rows):
        least = min(row.errors.values())
        errors: list[Cell] = [
            Word(_number(row.errors[law]), "strong") if row.errors[law] == least else _number(row.errors[law])
            for law in laws
        ]
        rows.append([row.cell.name, *errors, row.best_rival, _ratio(row.ratio)])
        if row.ratio > NEAR:
            failing.append(place)
    heads: list[Cell] = ["cell", *laws, "best rival", "ratio"]
    caption = (
        f"Errors in {found.race.file.unit}, the least of a cell in bold; cells with a ratio above {NEAR} are marked."
    )
    return Table(
        rows, heads, caption, kind="study wide", numbers=[*range(1, len(laws) + 1), len(heads) - 1], failing=failing
    )


def _worst(found: Finished) -> Table:
    rows = list[list[Cell]]()
    for row, files in found.worst:
        again = [
            Word(f"dmframe run {files[law]}", "command") if law in files else "" for law in (row.law, row.best_rival)
        ]
        errors: list[Cell] = [_number(row.error), row.best_rival, _number(row.rival_error)]
        rows.append([row.cell.name, *errors, *again])
    heads = ["cell", "error", "best rival", "its error", "run of the entrant", "run of the rival"]
    caption = f"Errors in {found.race.file.unit}; the graphs are in the folder of this page."
    return Table(rows, heads, caption, kind="study", numbers=(1, 3))


def _tuning(found: Finished) -> Iterator[Paragraph | Table]:
    file = found.race.file
    candidates = f"{file.budget} {'candidate' if file.budget == 1 else 'candidates'}"
    margins = f"{file.margins.gain:g} times its command and {_samples(file.margins.delay)} of transport delay"
    yield Paragraph(
        f"Each law has {candidates} at each sampling period: the graph's own values, then a Halton sequence, "
        "log-uniform over the ranges of the race file. A candidate is rejected if it diverges on a training cell as it "
        f"is, or with {margins}. Of the others, that with the least mean of log error over the training cells is "
        "chosen. No held-out cell has its plant or its path in training."
    )
    training = file.training
    rows: list[list[Cell]] = []
    for choice in found.choices:
        best = choice.best
        values = "all rejected" if best is None else listed(best.values)
        score = "" if best is None else _number(math.exp(best.score))
        own, rejected = choice.tried[0], sum(bool(each.why) for each in choice.tried)
        cells: list[Cell] = [Word(choice.law, "code"), plain(choice.clock, "s"), values, score]
        rows.append([*cells, "rejected" if own.why else _number(math.exp(own.score)), f"{rejected} of {file.budget}"])
    heads = ["law", "clock", "values", "training error", "with its own values", "rejected"]
    caption = (
        f"Training error in {file.unit}: the geometric mean over the training cells "
        f"({', '.join(training.plants)}; {', '.join(training.paths)}; {', '.join(training.realities)})."
    )
    yield Table(rows, heads, caption, kind="study", numbers=(3, 4, 5))


def _ratio(value: float) -> str:
    return "infinite" if math.isinf(value) else f"{value:.3g}"


def _number(value: float) -> str:
    return "diverged" if math.isinf(value) else f"{value:.3g}"


def _samples(count: int) -> str:
    return f"{count} further {'sample' if count == 1 else 'samples'}"


def _range(of: Spread, shown: Callable[[float], str]) -> str:
    return f"{shown(of.low)} to {shown(of.high)}"


def _interval(of: Spread) -> str:
    return f"{_ratio(of.median)} ({_range(of, _ratio)})"


def _share(count: int, whole: int) -> str:
    return f"{count} of {whole} ({100 * count / whole:.0f} %)"
