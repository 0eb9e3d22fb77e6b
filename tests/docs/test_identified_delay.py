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
CAUTIOUS = {("0.02", "p_pi_none"): 3.2}
"""Cells in which a sample less is better, but fatal with slower cascades: the ratio up to which it is."""
LOADED = {("0.008", "wander", "p_pi_loaded"): 1.8}
"""The cell in which a sample more is better: the ratio up to which it is."""


def test_no_other_delay_has_less_error_except_for_a_cascade_without_feed_forward_at_20_ms_or_with_a_load() -> None:
    with TABLE.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    race = load_race("packaged").file
    cells = [(float(row["clock_s"]), row["plant"], row["path"]) for row in rows]
    assert sorted(cells) == sorted(itertools.product(race.clocks, race.plants, ("stops", "wander", "eight")))
    for row in rows:
        error = float(row["identified_mm"])
        assert math.isfinite(error)
        key = row["clock_s"], row["path"], row["plant"]
        assert error <= LOADED.get(key, MARGIN) * float(row["longer_mm"]), row
        if row["shorter_mm"]:
            assert error <= CAUTIOUS.get((row["clock_s"], row["plant"]), MARGIN) * float(row["shorter_mm"]), row
        assert bool(row["shorter_mm"]) == (int(row["delay"]) > 0)
