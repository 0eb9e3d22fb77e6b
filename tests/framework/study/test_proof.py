"""The proof over the box of a study: no run is outside, and its result equals those of single proofs."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dmframe.certify import verify
from dmframe.certify.checked import Checked
from dmframe.certify.parameter_margins import ParameterMargin
from dmframe.study import proof as module
from dmframe.study import sections
from dmframe.study.answer import ReportData, proof_in_short
from dmframe.study.box import COVERAGE, box_of
from dmframe.study.design import Spread
from dmframe.study.findings import Findings
from dmframe.study.plan import Study
from dmframe.study.proof import proofs_of
from dmframe.study.read import load_study
from dmframe.study.report import reported
from dmframe.study.sample_proofs import HOLDS, OPEN, _Samples, conditions_at
from dmframe.study.varied import Factor


def study(sample: str, graph: str = "pendulum", runs: int = 50, grid: str = "") -> Study:
    drawn = "".join(f"  {line}\n" for line in sample.split("\n"))
    return load_study(f"dmframe-study: 1\ngraph: {graph}\n{grid}sample:\n  runs: {runs}\n{drawn}")


def of(found: Study, point: int = 0) -> Any:
    return found.points[point].graph.diagram


@pytest.mark.parametrize(
    "sample",
    [
        "servo.K_D: {scale: [0.8, 1.3]}",
        "servo.K_D: {scale: {log: [0.1, 0.7]}}\nboth: {scale: [0.3, 3], of: [servo.K_D, servo.K_I]}",
        "servo.K_D: {shift: [-3, 5]}\narm.viscous: {normal: [1 N m s/rad, 0.5 N m s/rad], clip: [0, 3]}",
        "arm.viscous: {uniform: [0.1, 0.7]}\ndynamics.Gamma: {scale: [0.9, 1.1]}",
    ],
)
def test_no_run_lies_outside_of_the_box_not_by_a_rounding(sample: str) -> None:
    found = study(sample, runs=3000)
    box = box_of(of(found), found.factors)
    assert box.probability == 1
    for label, values in found.values(0, 0, 3000).items():
        low, high = box.ends[label]
        assert (low <= values.reshape(3000, -1)).all()
        assert (values.reshape(3000, -1) <= high).all()
        assert (high - low < 1.1 * np.ptp(values)).all()  # and it is not wider than necessary


def test_a_factor_at_its_ends_is_in_the_box_exactly() -> None:
    found = study("servo.K_D: {scale: [0.7, 1.1]}\nservo.K_I: {shift: [0.1, 0.3]}")
    ends = box_of(of(found), found.factors).ends
    assert [float(end[0]) for end in ends["servo.K_D"]] == [20 * 0.7, 20 * 1.1]
    assert [float(end[0]) for end in ends["servo.K_I"]] == [20 + 0.1, 20 + 0.3]


def test_the_box_of_unbounded_distributions_has_the_stated_probability() -> None:
    found = study("servo.K_D: {scale: [0.9, 1.1]}", runs=1)
    endless = Factor("P", ("servo.K_P",), "shift", Spread("normal", 0, 1, -math.inf, math.inf), None, "")
    half = Factor("I", ("servo.K_I",), "shift", Spread("normal", 0, 1, 0, math.inf), None, "")
    box = box_of(of(found), [*found.factors, endless, half])
    assert box.probability == COVERAGE
    inside = np.ones(20000, dtype=bool)
    for seed, (label, own, factor) in enumerate((("servo.K_P", 60, endless), ("servo.K_I", 20, half))):
        assert factor.spread is not None
        drawn = own + factor.spread.at(np.random.default_rng(seed).uniform(size=20000))
        inside &= (box.ends[label][0] <= drawn) & (drawn <= box.ends[label][1])
    assert np.mean(inside) == pytest.approx(COVERAGE, abs=0.003)
    assert [float(end[0]) for end in box.ends["servo.K_D"]] == [18, 22]


def test_initial_states_are_in_the_box_and_quantities_outside_of_every_proof_are_named() -> None:
    drawn = "start.q: {uniform: [-10 deg, 10 deg]}\nservo.K_D: {scale: [0.9, 1.1]}"
    found = study(f"{drawn}\nclock: {{uniform: [4 ms, 8 ms]}}")
    box = box_of(of(found), found.factors)
    assert box.outside == ("clock",)
    assert box.unknown == ()
    assert set(box.ends) == {"servo.K_D", "start.arm.q"}


def test_a_start_that_a_parameter_states_is_a_start_and_the_graph_goes_before_it() -> None:
    found = study("inverse.w_I: {scale: [1, 2]}", "arm2_joint")
    diagram = of(found)
    box = box_of(diagram, found.factors)
    own = diagram.models["inverse"].values["w_I"]
    low, high = box.ends["start.inverse.w_I"]
    np.testing.assert_allclose([low, high], [own, 2 * own])
    box = box_of(diagram, found.factors, {"w_I": 1.0})
    assert box.unknown == ("inverse.w_I",)  # no equation uses it: an unnecessary remark, but true


def test_a_narrow_box_is_proved_and_a_wide_one_is_not() -> None:
    narrow, wide = (
        proofs_of(study(f"servo.K_I: {{scale: [0.9, {most}]}}"), [""])[0] for most in (1.1, 8)
    )  # K_c K_D + K_P - K_I / K_c > 0 ends at K_I = 80, four times the graph's
    assert narrow.proved
    assert not narrow.failing
    assert narrow.drawn is None
    assert not wide.proved
    assert any("M_bar" in item.name for item in wide.failing)


def test_each_draw_is_judged_as_its_own_proof_judges_it() -> None:
    found = study("servo.K_I: {scale: [0.9, 8]}\nservo.K_D: {scale: [0.5, 1]}", runs=40)
    (proof,) = proofs_of(found, [""])
    assert proof.drawn is not None
    assert not proof.drawn.unknown.any()
    drawn = proof.drawn.fulfil
    values = found.values(0, 0, 40)
    by_hand = 1.0 * values["servo.K_D"] + 60 - values["servo.K_I"] / 1.0 >= 0  # with K_c = 1 1/s, without friction
    assert 0 < drawn.sum() < 40
    assert np.array_equal(drawn, by_hand.ravel())
    for sample in (int(np.argmin(drawn)), int(np.argmax(drawn))):
        assert found.graph_of(sample).verify().proved == drawn[sample]


def test_a_factor_of_what_is_zero_changes_nothing() -> None:
    found = study("arm.coulomb: {scale: [0.5, 2]}", "arm2_joint")
    assert box_of(of(found), found.factors).ends == {}
    assert proofs_of(found, [""])[0].proved


def test_paths_within_reach_are_decided_for_the_whole_box() -> None:
    found = study("path.radius: {uniform: [0.1, 0.2]}\npath.rate: {scale: [0.5, 2]}", "known_tracking_pi")
    assert proofs_of(found, [""])[0].proved


def test_margins_are_of_the_point_and_not_of_the_graph() -> None:
    grid = "grid: {servo.K_P: [60, 5]}\n"
    soft = proofs_of(study("servo.K_D: {scale: [0.5, 0.6]}", grid=grid), ["stiff", "soft"])
    assert [each.proved for each in soft] == [True, False]
    assert soft[1].drawn is not None
    assert not soft[1].drawn.fulfil.any()
    assert not soft[1].drawn.unknown.any()


def test_samples_of_a_loop_without_a_claim_are_undecided() -> None:
    found = study("servo.K_D: {scale: [0.9, 1.1]}", graph="pendulum_kinematic")
    assert conditions_at(of(found), {}, found.values(0, 0, 5), 5, verify(of(found))) is None


def test_only_the_first_points_are_decided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 1)
    found = study("servo.K_D: {scale: [0.9, 1.1]}", grid="grid: {dynamics.Gamma: [1, 2, 3]}\n")
    assert [each.index for each in proofs_of(found, ["a", "b", "c"])] == [0]


@pytest.mark.parametrize(
    ("sample", "reports", "apart"),
    [
        ("clock: {scale: [1, 2]}", "hold at the numbers that the graphs state", True),
        ("clock: {scale: [1, 2]}\nservo.K_P: {scale: [1, 2]}", "hold over the whole sampled box", True),
        ("servo.K_P: {scale: [1, 2]}", "hold over the whole sampled box", False),
    ],
)
def test_the_answer_states_what_the_box_does_not_hold(sample: str, reports: str, apart: bool) -> None:
    found = study(sample, "arm2_joint")
    data = ReportData(
        cast(Findings, SimpleNamespace(points=found.points, results=SimpleNamespace(study=found))),
        (),
        tuple(proofs_of(found, [""])),
        True,
        (),
        (),
    )
    assert reports in proof_in_short(data)
    assert ("Not in the box, since no proof depends on it: `clock`" in proof_in_short(data)) == apart
    parts = repr(list(sections.proof_section(data)))
    assert ("no proof depends on it" in parts) == apart


LEAKY = '''"""A tank with one number."""

from typing import Any, ClassVar, final

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Output, Side, State


@final
class Leaky(AbstractBlock):
    """It leaks.

    Parameters
    ----------
    rate : scalar, 1/s
        How fast.
    """

    side = Side.PLANT
    outputs = (Output("y"),)
    states = (State("x"),)
    rate: Scalar = Positive("", "1/s", default=1.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(outputs={"y": x.x}, rates={"x": -p.rate * x.x})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        return Certificate((Square(x.x),), (Square(x.x, DISSIPATED),))
'''


@pytest.fixture
def tank(tmp_path: Path) -> Callable[[str], Study]:
    """A study of a graph of one block with one scalar state, with a given dissipation."""

    def made(dissipated: str) -> Study:
        name = f"tank_{len(list(tmp_path.iterdir()))}"
        (tmp_path / f"{name}.py").write_text(LEAKY.replace("DISSIPATED", dissipated), encoding="utf-8")
        text = (
            f"dmframe: 1\nclock: 10 ms\nduration: 1 s\nstart: {{x: 1}}\nblocks:\n  tank: {{type: '{name}.py:Leaky'}}\n"
        )
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
        study = f"dmframe-study: 1\ngraph: {name}.yaml\nsample:\n  runs: 20\n  tank.rate: {{scale: [0.5, 2]}}\n"
        (tmp_path / f"{name}_study.yaml").write_text(study, encoding="utf-8")
        return load_study(tmp_path / f"{name}_study.yaml")

    return made


def test_a_graph_with_one_scalar_state_and_nothing_to_measure_runs(tank: Callable[[str], Study]) -> None:
    rows = tank("p.rate").rows(0, 0, 20)
    assert not any(rows["fault"])
    assert not rows["diverged"].any()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("dissipated", "begins", "outcome"),
    [
        ("p.rate", "Proved over the sampled box; of 20", "proved"),
        ("2 * p.rate", "The proof is refuted; of 20", "refuted"),
    ],
)
def test_the_first_line_of_a_study_is_the_verdict(
    tank: Callable[[str], Study], tmp_path: Path, dissipated: str, begins: str, outcome: str
) -> None:
    results = tank(dissipated).run(tmp_path / "out", workers=1, progress=False)
    made = reported(tmp_path / "out", results)
    assert made.answer.startswith(begins)
    assert made.outcome == outcome
    page = made.page.read_text(encoding="utf-8")
    assert begins.partition(";")[0] in page[: page.index("</title>")]
    assert [each["proof"] for each in made.proofs] == [outcome]


@pytest.mark.parametrize(
    ("graph", "sample"),
    [
        ("torque_direct_pid", "model.nominal: {uniform: [0.7, 1.3]}"),  # where estimates start
        ("arm2_joint", "inverse.w: {scale: [0.2, 2]}"),
        ("arm2_joint", "start.a_d_hat: {uniform: [-30, 30], per: element}"),
        ("pendulum", "arm.coulomb: {uniform: [0, 1]}"),  # zero in the graph, and without a column of the regressor
        ("known_tracking_pi", "path.radius: {uniform: [0.1, 1.4]}"),  # out of reach from some 0.57 m on
    ],
)
def test_whatever_a_box_and_a_count_state_single_proofs_state(graph: str, sample: str) -> None:
    found = study(sample, graph, runs=6)
    (proof,) = proofs_of(found, [""])
    proved = [found.graph_of(sample).verdict().outcome == "proved" for sample in range(3)]
    if proof.drawn is None:
        assert proof.proved
        assert all(proved)
        return
    assert not proof.proved
    for sample, own in enumerate(proved):
        assert proof.drawn.unknown[sample] or proof.drawn.fulfil[sample] == own


def test_a_divisor_that_is_zero_in_a_sample_is_no_large_margin() -> None:
    """1 / (K_I - 20)^2 is positive for every number except 20, where it is undefined and has no float value."""
    claim = verify(of(study("servo.K_I: {scale: [1, 2]}"))).claim
    assert claim is not None
    (K_I,) = (item.symbol for item in claim.loop.parameters if item.label == "servo.K_I")
    item = ParameterMargin(Checked("toy", "", 1.0, True, "a test"), 1 / (K_I - 20) ** 2)
    samples = _Samples(claim, {"servo.K_I": np.array([[20.0, 21.0, 40.0]])}, 3)
    assert samples.judged([item]).tolist() == [OPEN, HOLDS, HOLDS]
