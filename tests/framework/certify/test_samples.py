"""Proofs over samples: an estimator, a filter and a delay line, each with false statements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Literal

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals, certificate
from dmframe.block.certificate import (
    Assumption,
    Certificate,
    Condition,
    DelayLine,
    Inequality,
    NormalisedSteps,
    PlantIdentity,
    Square,
    StableLinear,
)
from dmframe.block.parameter import Box, Interval, NonNegative, Positive, Real, Scalar
from dmframe.block.port import PERIOD, TIME, Access, Input, Output, Side, State
from dmframe.certify import verify
from dmframe.certify.assemble import assembled
from dmframe.certify.checked import Numbers
from dmframe.certify.claim import NotApplicableError, claim_of
from dmframe.certify.conditions import conditions_of
from dmframe.certify.statements import States as Known
from dmframe.certify.states import sampled_states
from dmframe.certify.summary import summary
from dmframe.diagram import Diagram
from dmframe.prove.refute import replay
from dmframe.report.verdict_text import verdict_text
from dmframe.report.words import meaning_of
from dmframe.simulate import simulate

States = ClassVar[tuple[State, ...]]

M, B, T = (2.0, 3.0), (0.5, 0.25), 0.05


class Carts(AbstractBlock):
    """Two carts: m dv/dt + b v = c."""

    side = Side.PLANT
    inputs = (Input("c", "2"),)
    outputs = (
        Output("y", "2", access=Access.MEASURED),
        Output("v", "2", access=Access.MEASURED),
        Output("m", "2"),
        Output("b", "2"),
        Output("force", "2"),
    )
    states = (State("y", "2"), State("v", "2"))
    mass: ClassVar[Any] = ca.DM(M)
    drag: ClassVar[Any] = ca.DM(B)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        outputs = {"y": x.y, "v": x.v, "m": self.mass, "b": self.drag, "force": u.c}
        return Equations(outputs=outputs, rates={"y": x.v, "v": (u.c - self.drag * x.v) / self.mass})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate()


class Learner(AbstractBlock):
    """Estimates m and b from c = m [v]/T + b [y]/T, which is exact over a sample; and moves the carts."""

    inputs = (Input("y", "2"), Input("v", "2"), PERIOD)
    outputs = (Output("c", "2", access=Access.COMMANDED),)
    states = (
        State("theta", "4", sampled=True),
        State("y_old", "2", sampled=True),
        State("v_old", "2", sampled=True),
        State("c_old", "2", sampled=True),
        State("count", sampled=True),
        State("rows", "6 3", sampled=True),
    )
    truth = (Input("m", "2"), Input("b", "2"), Input("force", "2"))
    gain: Scalar = Positive(default=2.0)
    floor: Scalar = NonNegative(default=0.01)
    most: Scalar = Positive(default=10.0)
    lie: Literal["", "greedy", "cut", "forgetful", "other_gain", "backwards", "unsolved", "stores_y", "moving"] = ""

    def _steps(self, u: Signals, x: Signals, p: Signals, true: Any) -> NormalisedSteps:
        a, v = (u.v - x.v_old) / u.T, (u.y - x.y_old) / u.T
        new = (ca.vertcat(a[0], v[0], a[1], v[1]), x.c_old)
        stored = [(x.rows[:4, k], x.rows[4:, k]) for k in range(3)]
        ends = (ca.DM.zeros(4), p.most * ca.DM.ones(4))
        rows = (new, *stored, new)
        return NormalisedSteps("theta", x.theta, true, p.gain * ca.DM.ones(4), (2, 2), p.floor, rows, box=ends)

    def _pushes(self, x: Signals) -> Any:
        return ca.vertcat(ca.sin(3 * x.count), ca.cos(2 * x.count) + ca.sin(5 * x.count))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        steps = self._steps(u, x, p, ca.DM.zeros(4))
        becomes, (h, y) = steps.held, steps.rows[0]
        if self.lie == "greedy":
            becomes = becomes + p.gain * h * (y[0] - ca.dot(h[:2], x.theta[:2]))
        elif self.lie == "cut":
            becomes = ca.fmin(becomes, p.most / 2)
        elif self.lie == "other_gain":
            gain = 1.01 * p.gain * ca.DM.ones(4)
            becomes = NormalisedSteps("theta", becomes, becomes, gain, (2, 2), p.floor, ((h, y),)).held
        kept = x.rows[:, :2] if self.lie != "forgetful" else x.rows[:, 1:]
        return Equations(
            outputs={"c": self._pushes(x)},
            next={
                "theta": becomes,
                "y_old": u.y,
                "v_old": u.v,
                "c_old": self._pushes(x),
                "count": x.count + u.T,
                "rows": ca.horzcat(ca.vertcat(h, y), kept),
            },
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        steps = self._steps(u, x, p, ca.vertcat(truth.m[0], truth.b[0], truth.m[1], truth.b[1]))
        drag = -1 if self.lie == "backwards" else 1
        true = steps.true if self.lie != "moving" else steps.true + ca.vertcat(x.c_old, x.c_old)
        return Certificate(
            steps=(replace(steps, true=true),),
            storage=(Square(u.y),) if self.lie == "stores_y" else (),
            delay_lines=(DelayLine("rows", ca.vertcat(*steps.rows[0])),),
            plant=(PlantIdentity(truth.m * u.v, drag * truth.b * u.v - truth.force),),
            solved=(self.equations(u, x, p).outputs["c"] - (1 + (self.lie == "unsolved")) * self._pushes(x),),
        )


class Smoother(AbstractBlock):
    """f+ = a f + y, with the claimed loss f^2 minus y^2."""

    inputs = (Input("y", "2"),)
    states = (State("f", "2", sampled=True),)
    a: Scalar = Real(default=0.5)
    boasts: bool = False

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(next={"f": p.a * x.f + u.y})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        left = 1 - p.a**2
        return Certificate(
            storage=(Square(x.f),),
            dissipation=(Square(x.f - p.a * u.y / left, left * (1.1 if self.boasts else 1) / 2),),
            residual=(Square(u.y, 1 / left / 2),),
        )


def diagram(**options: Any) -> Diagram:
    return Diagram.build({"learner": Learner(**options), "carts": Carts()})


def test_an_estimator_that_takes_normalised_steps_is_proved_over_samples() -> None:
    verdict = verify(diagram())
    assert (verdict.outcome, verdict.samples, verdict.flow_claim) == ("proved", verdict.claim, None)
    assert verdict.headline.startswith("proved over samples of learner.theta, up to what its data leave unexplained; ")
    assert verdict.headline.endswith(" states are not known to be bounded, and tracking is not part of it")
    assert [(item.name, item.holds) for item in verdict.conditions] == [
        ("learner: gain of the steps of theta", True),
        ("learner: floor of the steps of theta", True),
        ("learner: true value of theta inside its box", True),
        ("learner: what the rows of theta leave unexplained of the plant's motion falls with the period", True),
    ]
    assert all(control.refuted for control in verdict.controls)
    assert {control.fault for control in verdict.controls} >= {
        "learner.theta: increment reversed",
        "learner.rows: increment reversed",
        "learner: decrease of V dropped",
        "learner: increase of V dropped",
        "learner: remainder of its plant identity dropped",
        "learner.gain changed in the equations only",
        "learner.floor changed in the equations only",
    }
    reported = verdict_text("carts", verdict)
    assert "does not rise where eta is zero: V of θ (learner)" in reported
    assert "continuous time" not in meaning_of(verdict, T).sentence
    assert summary("carts", verdict)["residual_zero"] is True


@pytest.mark.parametrize(
    ("lie", "reports"),
    [
        ("greedy", "learner: next value of theta"),
        ("cut", "learner: next value of theta"),
        ("other_gain", "learner: next value of theta"),
        ("forgetful", "learner: next value of rows"),
        ("backwards", "learner: plant identity"),
        ("unsolved", "learner: equation solved by its output"),
    ],
)
def test_a_false_claim_is_refuted_and_its_point_replays(lie: str, reports: str) -> None:
    verdict = verify(diagram(lie=lie))
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.statement == reports
    assert verdict.refutation.blame == ("learner",)
    assert verdict.samples is not None
    assert replay(assembled(verdict.samples), verdict.refutation) == verdict.refutation.residue != 0


def test_v_of_what_moves_between_samples_is_no_claim() -> None:
    assert "learner: V contains carts.y, without its value one sample later" in verify(diagram(lie="stores_y")).reason
    assert "V contains learner.c_old" not in verify(diagram(lie="moving")).reason
    assert "learner: the true of the steps of theta varies" in verify(diagram(lie="moving")).reason


@pytest.mark.parametrize(
    ("options", "failing"),
    [({"most": 2.5}, "true value of theta inside its box"), ({"floor": 0.0}, "floor of the steps of theta")],
)
def test_conditions_are_decided_at_the_graphs_numbers(options: dict[str, float], failing: str) -> None:
    verdict = verify(diagram(**options))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason == f"the identity holds, but a condition fails: learner: {failing}"


def test_a_filter_loses_what_it_states() -> None:
    plain = Diagram.build({"smoother": Smoother(), "learner": Learner(), "carts": Carts()})
    assert verify(plain).outcome == "proved"
    unstable = Diagram.build({"smoother": Smoother(a=1.5), "carts": Carts(), "learner": Learner()})
    assert "smoother: weight of term 1 of the decrease of V" in verify(unstable).reason
    boastful = Diagram.build({"smoother": Smoother(boasts=True), "carts": Carts(), "learner": Learner()})
    assert verify(boastful).refutation.statement == "smoother: V(next) - V"  # type: ignore[union-attr]


def test_along_a_run_v_falls_by_what_numpy_states_and_the_true_values_are_found() -> None:
    run = simulate(diagram(), 20.0, clock=T, start={"y": [0.1, -0.2]})
    theta, true = run.states["learner.theta"].reshape(-1, 2, 2), np.array([M, B]).T
    V = np.sum((theta - true) ** 2, axis=(1, 2)) / (2 * 2.0)
    assert np.all(np.diff(V) < 1e-12)
    assert V[-1] < 1e-3 * V[0]
    y, v, c = (run.states[name] for name in ("carts.y", "carts.v", "learner.c_old"))
    rows = [(np.stack([v[k] - v[k - 1], y[k] - y[k - 1]], axis=1) / T, c[k]) for k in range(1, len(y))]
    k = 40  # the row used at sample k is that of the previous sample
    now, error = theta[k].copy(), 0.0
    for h, wanted in (rows[k - 1], rows[k - 2], rows[k - 3], rows[k - 4], rows[k - 1]):
        size = 0.01 + 2.0 * np.sum(h * h, axis=1)
        missed = wanted - np.sum(h * now, axis=1)
        seen = np.sum(h * (now - true), axis=1)
        np.testing.assert_allclose(missed, -seen, atol=1e-9)  # the identity is exact over a sample: eta is zero
        error += np.sum(seen**2 / size + 0.01 * missed**2 / size**2)
        now += 2.0 * h * (missed / size)[:, None]
    np.testing.assert_allclose(theta[k + 1], now, rtol=1e-12, atol=1e-12)
    assert V[k + 1] - V[k] == pytest.approx(-error / 2, rel=1e-9)


def test_with_a_small_floor_a_step_changes_an_estimate_no_more_than_a_row_requires() -> None:
    rng = np.random.default_rng(0)
    theta, h, y = rng.normal(size=5), rng.normal(size=5), rng.normal(size=2)
    steps = NormalisedSteps("theta", theta, theta, np.ones(5), (2, 3), 1e-14, ((h, y),))
    found = ca.evalf(steps.held).full()[:, 0]
    for part, wanted in ((slice(0, 2), y[0]), (slice(2, 5), y[1])):
        least, *_ = np.linalg.lstsq(h[None, part], [wanted - theta[part] @ h[part]], rcond=None)
        np.testing.assert_allclose(found[part] - theta[part], least, rtol=1e-10)


def test_a_claim_lists_blocks_without_a_certificate() -> None:
    claim = claim_of(Diagram.build({"learner": Learner(), "carts": Carts(), "mute": Mute()}))
    assert claim.silent == ("mute",)


class Mute(AbstractBlock):
    """Has no certificate."""

    inputs = (Input("y", "2"),)
    states = (State("i", "2"),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"i": u.y})


class MisshapenLearner(Learner):
    """Wrong shapes and names."""

    wrong: Literal["name", "shape", "box"] = "name"

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        steps = self._steps(u, x, p, ca.vertcat(truth.m[0], truth.b[0], truth.m[1], truth.b[1]))
        name, gain, box = "theta", steps.gain, steps.box
        match self.wrong:
            case "name":
                name = "thetta"
            case "shape":
                gain = gain[0]
            case "box":
                box = box[:1]
        return Certificate(steps=(replace(steps, estimate=name, gain=gain, box=box),))


@pytest.mark.parametrize(
    ("wrong", "reports"),
    [
        ("name", "names thetta, which is not one of its sampled states"),
        ("shape", "the steps of theta: expected a gain of 4 x 1, found 1 x 1"),
        ("box", "the steps of theta: expected a box of two ends, found 1"),
    ],
)
def test_a_value_of_the_wrong_shape_or_name_is_refused(wrong: Any, reports: str) -> None:
    reason = verify(Diagram.build({"learner": MisshapenLearner(wrong=wrong), "carts": Carts()})).reason
    assert reports in reason


class Push(AbstractBlock):
    """Moves the carts back."""

    inputs = (Input("y", "2"),)
    outputs = (Output("c", "2", access=Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"c": -u.y})


class Nothing(Square):
    """A square without effect."""

    @property
    def value(self) -> Any:
        return ca.SX(0)

    def with_pieces(self, pieces: Any) -> Nothing:
        return Nothing(*pieces)


class SaysLess(Certificate):
    """A certificate of another class."""


class Filter(AbstractBlock):
    """f+ = a f + y, with false or void statements about it."""

    inputs = (Input("y", "2"), Input("v", "2"), TIME)
    states = (State("f", "2", sampled=True), State("rows", "2 2", sampled=True))
    truth = (Input("m", "2"), Input("b", "2"), Input("force", "2"))
    a: Scalar = Real(default=0.5)
    lie: str = ""

    def _next(self, u: Signals, x: Signals, p: Signals) -> Any:
        return p.a * x.f + u.y

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(next={"f": self._next(u, x, p), "rows": x.rows})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        left = 1 - p.a**2
        honest = Certificate(
            storage=(Square(x.f),),
            dissipation=(Square(x.f - p.a * u.y / left, left / 2),),
            residual=(Square(u.y, 1 / left / 2),),
        )
        momentum, rest, nothing = truth.m * u.v, truth.b * u.v - truth.force, ca.SX.zeros(2)
        match self.lie:
            case "all_is_residual":
                return replace(honest, dissipation=(Square(x.f, 0.5),), residual=(Square(self._next(u, x, p), 0.5),))
            case "subclass":
                return replace(honest, storage=(Nothing(x.f),), dissipation=(), residual=())
            case "certificate":
                return SaysLess(honest.storage, honest.dissipation)
            case "constant":
                return replace(honest, storage=(Square(u.v),), unknown={"k": u.v})
            case "own_state":
                return replace(honest, unknown={"k": x.f})
            case "sum":
                return replace(honest, unknown={"k": ca.SX.sym("k") + 1})
            case "named_as_gain":
                return replace(honest, unknown={"a": ca.SX.sym("k")})
            case "no_name":
                return replace(honest, unknown={"k is known\nproved": ca.SX.sym("k")})
            case "never_stores":
                return replace(honest, delay_lines=(DelayLine("rows", u.y, 0.0),))
            case "MX":
                return replace(honest, storage=(Square(ca.MX.sym("x", 2)),))
            case "empty":
                return replace(honest, storage=(Square(0 * x.f),), dissipation=(), residual=())
            case "time":
                return replace(honest, plant=(PlantIdentity(momentum + u.t, rest),))
            case "jumps":
                return replace(honest, plant=(PlantIdentity(momentum + truth.force, rest),))
            case "own_memory":
                return replace(honest, plant=(PlantIdentity(momentum + x.f, rest),))
            case "no_relation":
                return replace(honest, plant=(PlantIdentity(nothing, nothing),))
            case "two_relations":
                return replace(honest, plant=(PlantIdentity(momentum, rest), PlantIdentity(u.y, -u.v)))
        return honest


def filtered(kind: type[AbstractBlock] = Filter, **options: Any) -> Diagram:
    return Diagram.build({"f": kind(**options), "push": Push(), "carts": Carts(), "other": Smoother()})


@pytest.mark.parametrize(
    ("lie", "reports"),
    [
        ("all_is_residual", "the residual contains f.f, which V also contains"),
        (
            "subclass",
            "expected storage[0] to be a Square, an InformationSquare, a Potential or a LogDet, found a Nothing",
        ),
        ("certificate", "expected a Certificate, found SaysLess"),
        ("constant", "expected the constant k to be a symbol of its own, found one of the diagram"),
        ("own_state", "expected the constant k to be a symbol of its own, found one of the diagram"),
        ("sum", "expected the constant k to be a symbol, found an expression"),
        ("named_as_gain", "expected a constant's name to be one of its own, found 'a'"),
        ("no_name", "expected a constant's name to be one of its own"),
        ("MX", "f: certificate(), "),
        ("never_stores", "identically zero, so that nothing would be proved: f: storage condition of rows"),
        ("empty", "identically zero, so that nothing would be proved: f: V(next) - V; f: term 1 of V"),
        ("time", "the momentum of a relation depends on more than continuous states"),
        ("jumps", "the momentum of a relation depends on more than continuous states"),
        ("own_memory", "the momentum of a relation depends on more than continuous states"),
        ("no_relation", "identically zero, so that nothing would be proved: f: remainder of a plant identity"),
    ],
)
def test_a_claim_that_is_false_or_empty_is_none(lie: str, reports: str) -> None:
    verdict = verify(filtered(lie=lie, a=3.0 if lie == "all_is_residual" else 0.5))
    assert verdict.outcome == "not_applicable"
    assert reports in verdict.reason


def test_two_relations_are_two_controls() -> None:
    verdict = verify(filtered(lie="two_relations"))
    assert verdict.outcome == "proved", verdict.reason
    dropped = [control for control in verdict.controls if "plant identity" in control.fault]
    assert [control.fault for control in dropped] == [f"f: remainder of its plant identity {k} dropped" for k in (1, 2)]
    assert all(control.refuted for control in dropped)


class BoxedFilter(Filter):
    """The framework projects it onto a box, which its claim does not contain."""

    states = (State("f", "2", box="f_box", sampled=True), State("rows", "2 2", sampled=True))
    f_box: Box = Interval(default=(5.0, 6.0))


def test_what_the_framework_does_after_a_sample_is_a_part_of_the_map() -> None:
    run = simulate(filtered(BoxedFilter), 1.0, clock=T, start={"f": [5.5, 5.5], "y": [0.1, -0.2]})
    assert np.all(run.states["f.f"][-1] == 5.0)
    verdict = verify(filtered(BoxedFilter))
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.statement == "f: V(next) - V"


class Steps(AbstractBlock):
    """Estimates an unknown weight from the carts' positions."""

    inputs = (Input("y", "2"), PERIOD)
    states = (State("w", "2", sampled=True),)
    gain: Scalar = Positive(default=2.0)
    floor: Scalar = Positive(default=0.1)
    lie: str = ""

    def _steps(self, u: Signals, x: Signals, p: Signals, true: Any) -> NormalisedSteps:
        one = ca.DM.ones(2)
        h, y, box = u.y, u.y[0] * u.y[1], (-10 * one, 10 * one)
        match self.lie:
            case "no_rows":
                rows = ()
            case "zero_rows":
                rows = ((0 * h, y),)
            case "own_rows":
                rows = ((h, ca.dot(h, x.w) + x.w[0]),)
            case "no_box":
                rows, box = ((h, y),), (one, -one)
            case "pole":
                rows = ((h / (u.T - T), y),)
            case "no_sample":
                rows = ((h / (p.gain - 2), y),)
            case "odd":  # the equations have another form of it than the certificate
                rows = ((ca.tanh(-h) if isinstance(true, ca.DM) else -ca.tanh(h), y),)
            case "root":
                rows = ((ca.sqrt(1 + h**2), y),)
            case "folded":
                rows = ((1 / (h - h[0] - 5), y),)
            case _:
                rows = ((h, y),)
        return NormalisedSteps("w", x.w, true, p.gain * one, (2,), p.floor, rows, box)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(next={"w": self._steps(u, x, p, ca.DM.zeros(2)).held})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        known = ca.SX.sym("known", 2)
        return Certificate(steps=(self._steps(u, x, p, known),), unknown={"known": known})


@pytest.mark.parametrize(
    ("lie", "reports"),
    [
        ("no_rows", "identically zero, so that nothing would be proved: f: V(next) - V; f: regressor rows of w"),
        ("zero_rows", "identically zero, so that nothing would be proved: f: V(next) - V; f: regressor rows of w"),
        ("own_rows", "the rows of w contain w itself"),
        ("no_box", "the identity holds, but a condition fails: f: box of w is not empty"),
    ],
)
def test_steps_without_information_are_no_claim(lie: str, reports: str) -> None:
    assert verify(filtered(Steps)).outcome == "proved"
    verdict = verify(filtered(Steps, lie=lie))
    assert verdict.outcome == "not_applicable"
    assert reports in verdict.reason


def test_rows_may_hold_any_function_of_what_is_measured() -> None:
    assert verify(filtered(Steps, lie="root")).outcome == "proved"


@pytest.mark.parametrize(
    ("lie", "reports"), [("odd", "property of a function"), ("folded", "no more than the rounding")]
)
def test_what_the_field_cannot_decide_is_not_refuted(lie: str, reports: str) -> None:
    verdict = verify(filtered(Steps, lie=lie))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("not decided: what a sample does")
    assert reports in verdict.reason


def assumed(diagram: Diagram) -> str:
    verdict = verify(diagram)
    assert verdict.outcome == "proved", verdict.reason
    return "\n".join(item.text for item in verdict.assumptions)


def test_what_a_sample_divides_by_is_assumed_not_to_vanish() -> None:
    assert "divisors in its samples" not in assumed(filtered(Steps))
    assert "divisors in its samples" not in assumed(diagram())
    assert "f: the divisors in its samples stay away from zero" in assumed(filtered(Steps, lie="pole"))
    verdict = verify(filtered(Steps, lie="no_sample"))
    assert verdict.outcome == "not_applicable"
    assert "f.gain-2) is not zero" in verdict.reason.replace("(-2+f.gain)", "(f.gain-2)")


def test_a_residual_without_a_bound_and_rows_without_a_relation_are_listed() -> None:
    reported = assumed(filtered(Steps))
    assert (
        "f: the plant's motion satisfies the equation of its rows; the block states no relation that implies it"
        in reported
    )
    assert (
        "other: the residual other than that of the steps, a function of carts.y, is small: no bound of it is proved"
        in reported
    )
    assert "no relation" not in assumed(diagram())
    left = "what its data leave unexplained and a residual that nothing bounds"
    verdict = verify(filtered(Steps))
    assert f", up to {left}; " in verdict.headline
    assert f"rises by no more than {left}" in meaning_of(verdict, T).sentence


class Emulated(Mute):
    """Claims a statement in continuous time that is false in discrete time."""

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(x.i),), supply=ca.dot(x.i, u.y))


def test_a_certificate_in_continuous_time_is_listed_as_no_contribution() -> None:
    claim = claim_of(Diagram.build({"learner": Learner(), "carts": Carts(), "emulated": Emulated()}))
    assert claim.silent == ("emulated",)


class Wordy(Steps):
    """Breaks the line of its text, so that the rest resembles a verdict."""

    reported: str = ""

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        return (Assumption(self.reported), Inequality(self.reported, p.gain, ""))


@pytest.mark.parametrize("reported", ["all is well\nproved", "\x1b[2Jproved", "fine\u2028proved"])
def test_an_authors_words_stay_on_their_line(reported: str) -> None:
    assert verify(filtered(Wordy, reported="all is well")).outcome == "proved"
    verdict = verify(filtered(Wordy, reported=reported))
    assert verdict.outcome == "not_applicable"
    assert "expected texts of one line" in verdict.reason


def stepping(
    states: str,
    becomes: Callable[[Any], dict[str, Any]],
    stored: Callable[[Any], Any] = lambda x: x.x,
    lost: Callable[[Any], Square] = lambda x: Square(x.x, ca.SX(0.375)),
) -> Diagram:
    """One block with sampled states, with its storage and losses."""

    class Toy(AbstractBlock):
        inputs = ()
        outputs = ()
        states: States

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(next=becomes(x))

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            return Certificate(storage=(Square(stored(x)),), dissipation=(lost(x),))

    Toy.states = tuple(State(name, sampled=True) for name in states.split())
    return Diagram.build({"toy": Toy()})


def test_a_state_that_nothing_bounds_is_named_wherever_the_verdict_is_read() -> None:
    verdict = verify(stepping("x z", lambda x: {"x": x.x / 2, "z": 2 * x.z}))
    assert verdict.outcome == "proved"
    assert verdict.states == Known(("toy.x",), (), ("toy.z",))
    last = "and tracking is not part of it"
    assert verdict.headline == f"proved over samples of toy.x; toy.z is not known to be bounded, {last}"
    text = " ".join(verdict_text("x", verdict).split())
    assert "not proved bounded, so stability of the whole loop is not proved: toy.z" in text
    assert summary("x", verdict)["states"] == {"bounded": ["toy.x"], "unfelt": [], "open": ["toy.z"]}
    sentence = meaning_of(verdict, T).sentence
    assert "$V$ of `toy.x` never rises" in sentence
    assert sentence.endswith("bound `toy.z`.")


def test_a_loop_over_samples_that_is_bounded_as_a_whole_names_no_state() -> None:
    moves = {"x": lambda x: x.x / 2, "y": lambda x: ca.sin(x.x) + x.k, "k": lambda x: x.k, "c": lambda x: x.y**2}
    verdict = verify(stepping("x y k c", lambda x: {name: move(x) for name, move in moves.items()}))
    assert verdict.states == Known(("toy.x", "toy.y", "toy.k", "toy.c"))
    assert verdict.headline == "proved over samples of toy.x; tracking is not part of it"


FOLLOWS = {
    "a sum that never ends": ("x z", lambda x: {"x": x.x / 2, "z": x.z + x.x}),
    "a quotient": ("x z", lambda x: {"x": x.x / 2, "z": 1 / x.x}),
    "two that exchange": ("x z w", lambda x: {"x": x.x / 2, "z": 2 * x.w, "w": x.z}),
}


@pytest.mark.parametrize("name", FOLLOWS)
def test_a_state_does_not_follow_from_bounded_ones_where_its_next_value_need_not(name: str) -> None:
    verdict = verify(stepping(*FOLLOWS[name]))
    assert verdict.outcome == "proved"
    assert verdict.states is not None
    assert verdict.states.bounded == ("toy.x",)


def test_a_vector_that_jumps_does_not_bound_the_state_that_it_holds() -> None:
    rest = stepping(  # x - floor(x) stays below 1 while x is unbounded
        "x",
        lambda x: {"x": x.x + 1 + 0 * x.x},
        lambda x: x.x - ca.floor(x.x),
        lambda x: Square(x.x * 0, ca.SX(1)),
    )
    states = sampled_states(claim := claim_of(rest), Numbers(claim, {}), 0)
    assert states.open == ("toy.x",)


def test_of_sums_of_states_only_what_they_determine_is_bounded() -> None:
    def bounded(stored: Callable[[Any], Any]) -> tuple[str, ...]:
        diagram = stepping(
            "x z", lambda x: {"x": x.x / 2, "z": x.z / 2}, stored, lambda x: Square(stored(x), ca.SX(0.375))
        )
        claim = claim_of(diagram)
        return sampled_states(claim, Numbers(claim, {}), 0).bounded

    assert bounded(lambda x: x.x + x.z) == ()
    assert bounded(lambda x: ca.vertcat(x.x + x.z, x.x - 2 * x.z)) == ("toy.x", "toy.z")
    assert bounded(lambda x: ca.vertcat(x.x + x.z, 2 * x.x + 2 * x.z)) == ()


class Listener(Learner):
    """Adapts from the commands of another block."""

    inputs = (*Learner.inputs, Input("received", "2"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        own = super().equations(u, x, p)
        return replace(own, next={**own.next, "c_old": u.received})


def test_of_two_estimators_both_are_named_and_the_plant_is_not_called_bounded() -> None:
    two = Diagram.build(
        {"carts": Carts(), "learner": Learner(), "other": Listener(gain=3.0)},
        {"carts.c": "learner.c", "other.received": "learner.c"},
    )
    verdict = verify(two)
    assert verdict.outcome == "proved"
    assert verdict.headline.startswith("proved over samples of learner.theta and other.theta, up to ")
    assert verdict.states is not None
    assert verdict.states.bounded == ("learner.theta", "other.theta")
    assert {"carts.y", "carts.v", "learner.count"} <= set(verdict.states.open)


def test_the_former_names_give_the_same_proof_with_a_notice() -> None:
    class Former(Filter):
        """The same filter by the former class, whose losses were halved."""

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Any:
            left = 1 - p.a**2
            with pytest.warns(
                DeprecationWarning, match="dmframe.block.certificate.SampledCertificate is now Certificate"
            ):
                former = certificate.SampledCertificate
            return former(
                storage=(Square(x.f),),
                decrease=(Square(x.f - p.a * u.y / left, left),),
                residual=(Square(u.y, 1 / left),),
            )

    now, then = verify(filtered()), verify(filtered(Former))
    assert then.outcome == now.outcome == "proved"
    assert [(c.name, c.value, c.holds) for c in then.conditions] == [(c.name, c.value, c.holds) for c in now.conditions]
    with pytest.warns(DeprecationWarning, match="Certificate: pays is now dominates"):
        assert Certificate(pays=(1,)).dominates == (1,)  # type: ignore[call-arg]
    with pytest.warns(DeprecationWarning, match="Kept is now DelayLine"):
        assert certificate.Kept is DelayLine
    with pytest.warns(DeprecationWarning, match="Relation is now PlantIdentity"):
        assert certificate.Relation is PlantIdentity
    with pytest.warns(DeprecationWarning, match="Driven is now StableLinear"):
        assert certificate.Driven is StableLinear
    with pytest.warns(DeprecationWarning, match="Certificate: excess is now residual"):
        renamed = Certificate(excess=(Square(ca.SX.sym("x")),))  # type: ignore[call-arg]
    with pytest.warns(DeprecationWarning, match="Certificate: excess is now residual"):
        assert renamed.excess == renamed.residual  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["task", "linear", "supply"])
def test_a_field_of_continuous_time_is_refused_over_samples(name: str) -> None:
    class Mixed(Filter):
        """A filter with a statement in continuous time in addition."""

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            linear = StableLinear((x.f,), ((ca.DM([-1, -1]),),), (x.f,))
            given = {"task": True, "linear": (linear,), "supply": ca.dot(x.f, u.y)}
            return replace(super().certificate(u, x, p, truth), **{name: given[name]})

    verdict = verify(filtered(Mixed))
    assert verdict.outcome == "not_applicable"
    assert f"expected no {name} of a block whose stored states are sampled" in verdict.reason


def test_what_holds_in_continuous_time_alone_is_not_stated_of_a_claim_over_samples() -> None:
    verdict = verify(filtered())
    assert verdict.outcome == "proved"
    assert verdict.samples is not None
    assert verdict.samples.left == "a residual that nothing bounds"
    assert verdict.residual_bound is None
    found = summary("x", verdict)
    assert (found["residual_bound"], found["storage"], found["dissipation"]) == (None, [], [])
    with pytest.raises(NotApplicableError, match="a proof in continuous time does not reach it"):
        conditions_of(verdict.samples, Numbers(verdict.samples, {}))
