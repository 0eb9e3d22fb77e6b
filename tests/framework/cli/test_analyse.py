"""``dmframe analyse``: a page, JSON, faults."""

from __future__ import annotations

import json
from typing import Any

import pytest

from dmframe.catalogue import graphs


def test_the_page_prints_margins_poles_and_periods(dmframe: Any) -> None:
    reported = dmframe("analyse", "pendulum", "--horizon", "2")
    assert (reported.status, reported.err) == (0, "")
    for expected in ("crossover", "phase margin", "slowest pole", "poles at zero", "linearised, moving", "simulated"):
        assert expected in reported.out
    loop, tie = (line for line in reported.out.splitlines() if line.split()[:1] == ["joint1"])
    assert loop.endswith("not passive  passive")  # a PID servo is passive only with its inverse
    assert tie.split()[1:] == ["1", "0.3024", "0.3028"]  # 20.3 k^2 + 60 k = 20, and 20 k^2 + 60 k = 20
    assert "over the graph's own servo gains" in reported.out


def test_json_holds_poles_that_are_stable_and_periods_in_order(dmframe: Any) -> None:
    data = json.loads(dmframe("analyse", "arm2_joint", "--horizon", "2", "--set", "clock=2 ms", "--json").out)
    assert set(data) == {
        "graph",
        "field_hash",
        "clock",
        "set_point",
        "at_rest",
        "moving",
        "joints",
        "largest_stable_period",
        "proof",
        "emulation",
        "K_c",
        "averaged",
        "kinks",
        "note",
    }
    assert data["clock"] == 0.002
    assert max(real for real, _ in data["at_rest"]["poles"]) < 0
    assert data["at_rest"]["spectral_radius"] < 1
    period = data["largest_stable_period"]["at_rest"]
    assert 0.002 < period["stable"] < period["unstable"] < 0.005
    proof = data["proof"]["at_rest"]
    assert data["at_rest"]["spectral_radius"] < proof["proved_radius"] < 1
    assert 0.99 * period["stable"] < proof["proved_period"] < period["stable"]
    assert (proof["directions"], proof["resting"], proof["reason"]) == (8, data["at_rest"]["zero_poles"], "")
    (limit,) = data["emulation"]
    assert (limit["gain"], limit["value"]) == ("dynamics.Gamma", 100)
    assert limit["most_at_bound"] < limit["most_at_rest"]
    assert data["joints"][0]["servo"]["num"] == pytest.approx([60, 240])
    assert data["joints"][0]["gain_margin"] is None


def test_a_clock_beyond_the_largest_period_has_a_spectral_radius_above_one(dmframe: Any) -> None:
    data = json.loads(dmframe("analyse", "arm2_joint", "--horizon", "2", "--set", "clock=5 ms", "--json").out)
    assert data["at_rest"]["spectral_radius"] > 1
    assert data["proof"]["at_rest"]["proved_radius"] is None
    assert data["proof"]["at_rest"]["reason"] == "it is unstable in floating point"


def test_a_graph_that_runs_on_a_clock_alone_is_analysed(dmframe: Any, tmp_path: Any) -> None:
    (tmp_path / "line.py").write_text(
        """
from typing import ClassVar
from dmframe.block import AbstractBlock, Equations
from dmframe.block.port import Input, Output, Side, State

class Line(AbstractBlock):
    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (Output("dq_late", "n", "rad/s"),)
    states = (State("dq_held", "n", "rad/s", sampled=True),)

    def equations(self, u, x, p):
        return Equations(outputs={"dq_late": x.dq_held}, next={"dq_held": u.dq_c})
""",
        encoding="utf-8",
    )
    text = graphs()["arm2_joint"].read_text(encoding="utf-8")
    text = text.replace("  servo: ", "  line: {type: line.py:Line}\n  servo: ") + "wires: {servo.dq_c: line.dq_late}\n"
    (tmp_path / "late.yaml").write_text(text, encoding="utf-8")
    reported = dmframe(
        "analyse", str(tmp_path / "late.yaml"), "--horizon", "0.1", "--trust", "--set", "dynamics.Gamma=10"
    )
    assert (reported.status, reported.err) == (0, "")
    assert "eigenvalues at one, free equilibrium coordinates" in reported.out
    assert "slowest pole" not in reported.out
    assert "its upper bound, proved by interval arithmetic" in reported.out
    assert "This loop is discrete-time" in reported.out


def test_a_horizon_that_is_not_a_time_is_refused(dmframe: Any) -> None:
    reported = dmframe("analyse", "pendulum", "--horizon", "-1")
    assert reported.status == 2
    assert reported.err == "dmframe: horizon -1.0: expected a time above zero\n"


def test_a_feedback_correction_too_weak_for_the_uncertain_gains_is_reported(dmframe: Any, tmp_path: Any) -> None:
    text = graphs()["pendulum"].read_text(encoding="utf-8")
    file = tmp_path / "mine.yaml"
    file.write_text(text + "uncertain: {servo.K_I: [1, 2000]}\n", encoding="utf-8")
    reported = dmframe("analyse", str(file), "--horizon", "0.1")
    assert "over the intervals of uncertain:" in reported.out
    assert ", too small" in reported.out
    (tie,) = json.loads(dmframe("analyse", str(file), "--horizon", "0.1", "--json").out)["K_c"]
    assert tie.keys() == {"block", "joint", "own", "holds", "least", "least_without_friction"}
    assert tie["holds"] is False
    assert tie["own"] < tie["least"] <= tie["least_without_friction"]


def test_a_graph_without_a_pid_inverse_has_no_K_c(dmframe: Any) -> None:
    assert "K_c" not in dmframe("analyse", "arm2_joint", "--horizon", "0.1").out
