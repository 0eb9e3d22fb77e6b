"""The table of the packaged race has each held-out cell and law once, and the figures of its page follow from it."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from dmframe.common.units import plain
from dmframe.race.read import load_race

DOCS = Path(__file__).parents[2] / "docs"


def test_the_figures_of_the_page_are_those_of_the_table() -> None:
    with (DOCS / "study" / "race.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    race = load_race("packaged")
    cells = [(row["clock"], row["path"], row["plant"], row["reality"]) for row in rows]
    assert cells == [(plain(cell.clock, "s"), cell.path, cell.plant, cell.reality) for cell in race.held_out]
    errors = {law: np.array([float(row[law]) for row in rows]) for law in race.file.laws}
    assert set(rows[0]) == {"clock", "path", "plant", "reality", *errors}
    own = errors.pop(race.file.entrant)
    ratios = own / np.min(list(errors.values()), axis=0)
    middle = np.sort(ratios)[len(ratios) // 2 - 1 : len(ratios) // 2 + 1]
    figures = {
        "cells": f"{len(rows)}",
        "cells in which the entrant is at or below the best rival": _share(ratios <= 1),
        "cells with a ratio of at most 1.15": _share(ratios <= 1.15),
        "median ratio": f"{math.sqrt(middle[0] * middle[1]):.2f}",
        "largest ratio": f"{ratios.max():.0f}",
        "divergences of the entrant": "none" if np.all(np.isfinite(own)) else "some",
    }
    page = (DOCS / "how_to" / "race.md").read_text(encoding="utf-8")
    for name, figure in figures.items():
        assert f"| {name} | {figure} |" in page


def _share(found: np.ndarray) -> str:
    return f"{found.sum()} ({100 * found.mean():.0f} %)"
