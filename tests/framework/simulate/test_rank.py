"""A run reports the minimum distance of a Jacobian from rank loss."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dmframe.diagram.closed_loop import Signal
from dmframe.graph.graph import Graph
from dmframe.results.summary import summary
from dmframe.simulate import Recording, simulate
from dmframe.simulate.rank import NEAR, Rank, ranks
from dmframe_plants.arm2 import closed_form


def graph(folder: Path, goal: str, start: str) -> Path:
    file = folder / "graph.yaml"
    file.write_text(
        f"dmframe: 1\nrobot: arm2\nclock: 4 ms\nduration: 4\nstart: {{q: {start}}}\nblocks:\n"
        f"  goal: {goal}\n  geometry: {{type: kinematics}}\n  task: {{type: known_tracking, gamma: 4}}\n"
        "  inverse: {type: kinematic_command}\n  servo: {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}\n"
        "  arm: {type: manipulator}\n",
        encoding="utf-8",
    )
    return file


def run(file: Path | str, duration: float) -> Recording:
    loaded = Graph.read(str(file))
    return simulate(loaded.diagram, duration, clock=loaded.file.clock, solver=loaded.solver, start=loaded.start)


def matrix(rows: int, columns: int) -> Signal:
    return Signal("geometry", "J_hat", "m n", "m/rad", ca.SX.sym("J", rows, columns))


def rank_of(values: list[np.ndarray]) -> Rank:
    signal = matrix(*values[0].shape)
    stacked = np.array([value.ravel(order="F") for value in values])
    (rank,) = ranks([signal], {signal.label: stacked}, np.arange(len(values)) * 0.5)
    return rank


def test_the_smallest_singular_value_is_found_with_its_time() -> None:
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    rank = rank_of([turn @ np.diag(pair) for pair in ([3, 2], [2, 0.5], [4, 2])])
    assert (rank.smallest, rank.time, rank.share) == pytest.approx((0.5, 0.5, 0.25))
    assert rank.since is None
    assert rank.notice is None


def test_of_a_wide_matrix_only_the_rows_count_and_a_tall_one_has_no_full_row_rank() -> None:
    assert rank_of([np.array([[3.0, 0, 0], [0, 0, 2]])]).smallest == pytest.approx(2)
    assert rank_of([np.array([[3.0], [2]])]).share == 0


def test_near_rank_loss_is_reported_from_its_first_moment_with_value_and_time() -> None:
    rank = rank_of([np.diag([2.0, value]) for value in (1, 0.03, 0.001, 0.5)])
    assert rank.since == 0.5
    assert rank.notice == (
        "geometry.J_hat is near rank loss from t = 0.5 s: its smallest singular value falls to 0.001 m/rad at t = 1 s, "
        "0.0005 of its largest; a reference that inverts it commands correspondingly large joint velocities"
    )


def test_numbers_that_are_not_finite_are_passed_over() -> None:
    rank = rank_of([np.eye(2), np.full((2, 2), np.nan), 0.5 * np.eye(2)])
    assert rank.share == pytest.approx(1)
    signal = matrix(2, 2)
    assert ranks([signal], {signal.label: np.full((2, 4), np.nan)}, np.arange(2.0)) == ()


def test_a_run_ranks_the_jacobian_as_the_textbooks_arm_has_it() -> None:
    done = run("known_tracking_pi", 1.0)
    assert [rank.signal for rank in done.ranks] == ["geometry.J_hat"]
    assert done.ranks[0].since is None
    assert done.notices == ()


def test_an_arm_that_swings_through_its_stretched_pose_is_reported_as_its_closed_form_has_it(tmp_path: Path) -> None:
    swing = "{type: sinusoid, center: [0.3, 0], amplitude: [0.1, 0.5], rate: 2, phase: 1}"
    file = graph(tmp_path, swing, "[0.3, 0.4]")
    text = file.read_text(encoding="utf-8").replace(
        "{type: known_tracking, gamma: 4}", "{type: joint_tracking, alpha: 4}"
    )
    file.write_text(text, encoding="utf-8")
    done = run(file, 2.0)
    assert done.divergence is None
    (rank,) = done.ranks
    singular = [np.linalg.svd(closed_form.jacobian(q), compute_uv=False) for q in done["arm.q"]]
    shares = np.array([least / largest for largest, least in singular])
    assert rank.share == pytest.approx(shares.min(), rel=1e-9)
    assert rank.time == pytest.approx(done.time[int(shares.argmin())])
    assert rank.since == pytest.approx(done.time[int(np.flatnonzero(shares < NEAR)[0])])
    assert rank.notice in done.notices
    assert summary("g", done)["rank"] == [
        {
            "signal": "geometry.J_hat",
            "unit": "m/rad",
            "smallest": rank.smallest,
            "time": rank.time,
            "share": rank.share,
            "since": rank.since,
        }
    ]


def test_a_run_that_begins_at_rank_loss_diverges_and_gives_the_reason(tmp_path: Path) -> None:
    done = run(graph(tmp_path, "{type: circle, center: [0.5, 0.2], radius: 0.1, rate: 1}", "[0, 0]"), 1.0)
    assert done.divergence is not None
    assert done.ranks[0].smallest == pytest.approx(0, abs=1e-12)
    assert any("near rank loss from t = 0 s" in notice for notice in done.notices)
