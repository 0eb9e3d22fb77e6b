"""The experiments of Section V over their whole 200 s: the figures that the documentation quotes."""

from __future__ import annotations

import numpy as np
import pytest

from dmframe.config.graph import load_graph
from dmframe.simulate import simulate

RMS = {  # [mm], norm of the task error over the last eighth
    "ur10_fast": 6.89,
    "ur10_fast_kinematic": 9.38,
    "ur10_fast_tuned": 0.254,
    "ur10_slow": 6.43,
    "ur10_slow_kinematic": 5.37,
}


@pytest.fixture(scope="module")
def figures() -> dict[str, float]:
    found = dict[str, float]()
    for name in RMS:
        graph = load_graph(name)
        run = simulate(
            graph.diagram(), graph.file.duration, clock=graph.file.clock, solver=graph.solver, start=graph.start
        )
        assert run.divergence is None
        error = np.linalg.norm(run["arm.x"] - run["path.x_d"], axis=1) * 1e3
        found[name] = float(np.sqrt(np.mean(error[-(len(error) // 8) :] ** 2)))
    return found


@pytest.mark.parametrize("name", RMS)
def test_the_last_eighth_of_each_run_has_the_quoted_error(name: str, figures: dict[str, float]) -> None:
    assert figures[name] == pytest.approx(RMS[name], rel=0.01)


def test_adaptation_beats_the_kinematic_baseline_at_fast_sampling(figures: dict[str, float]) -> None:
    assert figures["ur10_fast_tuned"] < 0.05 * figures["ur10_fast_kinematic"]
    assert figures["ur10_fast"] < figures["ur10_fast_kinematic"]
