"""The errors predicted by a verdict, on the hidden robot in MuJoCo that recorded the log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.identification.verdict import verdict_of
from dmframe.identification.write import RACE, VERDICT
from dmframe.race.read import load_race
from tests.benchmarks.identify import recorded
from tests.framework.identify.plants import write
from tests.in_mujoco.plant import needs_mujoco
from tests.in_mujoco.verdict import true_error

pytestmark = needs_mujoco


def test_the_predicted_errors_and_the_winner_are_those_on_the_true_robot(tmp_path: Path) -> None:
    log, _, delay, plant = recorded(1)
    found = dm.identify(write(tmp_path / "log.csv", *log), "ur10_slow")
    verdict = verdict_of(found, tmp_path, draws=8)
    again = dm.load(tmp_path / VERDICT / "level.yaml").run(progress=False)
    level = next(judged for judged in verdict.laws if (judged.law, judged.path) == ("level", "wander"))
    error = 1e3 * again.recording["arm.x"] - 1e3 * again.recording["path.x_d"]
    last = np.linalg.norm(error[-(len(error) // 8) :], axis=1)
    assert np.sqrt(np.mean(last**2)) == pytest.approx(level.error, rel=0.1)
    race, errors = load_race(tmp_path / RACE), dict[str, float]()
    for judged in verdict.laws:
        if judged.path == "wander" and judged.law in ("inverse", "level", "experts"):
            values = tuple(judged.values.items())
            late = delay * found.fit.unknowns.log.period
            errors[judged.law] = true_error(race, judged.law, judged.path, values, plant, late, tmp_path)
            # the laws without a model are hardly sensitive to the rounding of positions, the aggregation is
            assert errors[judged.law] == pytest.approx(judged.error, rel=0.35 if judged.adaptive else 0.05)
    assert verdict.outcome in ("worth it", "depends on the path")
    assert min(errors, key=lambda law: errors[law]) == "experts"
