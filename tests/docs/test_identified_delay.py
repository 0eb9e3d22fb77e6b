"""The table of the identified delay: it has every plant of the race at every sampling period, and its claim holds."""

from __future__ import annotations

import csv
import itertools
import math
from pathlib import Path

from dmframe.race.read import load_race

TABLE = Path(__file__).parents[2] / "docs" / "study" / "identified_delay.csv"
MARGIN = 1.05
"""Ratio up to which errors count as equal."""


def test_the_identified_delay_has_the_least_error_in_every_cell() -> None:
    with TABLE.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    race = load_race("packaged").file
    cells = [(float(row["clock_s"]), row["plant"], row["path"]) for row in rows]
    assert sorted(cells) == sorted(itertools.product(race.clocks, race.plants, ("stops", "wander", "eight")))
    for row in rows:
        others = [float(row[name]) for name in ("shorter_mm", "longer_mm") if row[name]]
        assert math.isfinite(float(row["identified_mm"]))
        assert float(row["identified_mm"]) <= MARGIN * min(others), row
        assert bool(row["shorter_mm"]) == (int(row["delay"]) > 0)
