"""Declarations of estimates: their consequences, and a wrong one is refuted or refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, AdaptingBlock, Equations, Signals
from dmframe.block.adaptation import Fit
from dmframe.block.certificate import SX, Certificate, Square, TrueValue
from dmframe.block.parameter import Box, Diagonal, Interval, Positive, Real, Scalar, specs
from dmframe.block.port import Access, Adapted, Input, Output, Side, State
from dmframe.block.prose import about
from dmframe.catalogue import block_types
from dmframe.certify import Verdict, verify
from dmframe.certify.true_values import estimates_of, true_values
from dmframe.common.errors import BlockError, DmframeError
from dmframe.common.names import latex_name
from dmframe.config.schema import json_schema
from dmframe.diagram import Diagram
from dmframe.results.estimate_figure import estimate_figure
from dmframe.simulate import simulate, start_state

States = ClassVar[tuple[State, ...]]
Estimates = ClassVar[tuple[Adapted, ...]]


class Drift(AbstractBlock):
    """dx = -x (1/s) + (w - theta)."""

    side = Side.PLANT
    inputs = (Input("w", "n", "m/s^2"),)
    outputs = (Output("x", "n", "m/s", Access.MEASURED), Output("theta", "n", "m/s^2"))
    states = (State("x", "n", "m/s"),)
    theta: Diagonal = Real("n", "m/s^2")
    rate: Diagonal = Positive("n", "1/s", default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"x": x.x, "theta": p.theta}, rates={"x": -p.rate * x.x + u.w - p.theta})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(
            storage=(Square(x.x),), dissipation=(Square(x.x, p.rate),), supply=ca.dot(x.x, u.w - p.theta)
        )


class Learner(AdaptingBlock):
    """dw = -Gamma x: the only statement."""

    inputs = (Input("x", "n", "m/s"), Input("w_nominal", "n", "m/s^2", optional=True))
    outputs = (Output("w", "n", "m/s^2", Access.COMMANDED),)
    truth = (Input("theta", "n", "m/s^2"),)
    estimates: Estimates = (Adapted("w", "n", "m/s^2", gain="Gamma", nominal="w_nominal", ball=True),)
    driven_by: ClassVar[str] = "x"
    Gamma: Diagonal = Positive("n", "1/s^2", default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"w": x.w})

    def direction(self, u: Signals, x: Signals, p: Signals, error: SX) -> Mapping[str, SX]:
        return {"w": -error}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(estimates={"w": TrueValue(truth.theta)}, supply=-ca.dot(u.x, x.w - truth.theta))


class Started(Learner):
    """The same with a start method."""

    w: Diagonal | None = Real("n", "m/s^2", default=None)


class Nominal(AbstractBlock):
    """Outputs the initial value of the estimate."""

    outputs = (Output("w_nominal", "n", "m/s^2"),)
    at: Diagonal = Real("n", "m/s^2", default=0.3)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"w_nominal": p.at})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate()


def diagram(learner: AbstractBlock, **more: AbstractBlock) -> Diagram:
    return Diagram.build({**more, "learner": learner, "plant": Drift(theta=[0.5, 0.8])})


def proof(learner: AbstractBlock, **more: AbstractBlock) -> Verdict:
    return verify(diagram(learner, **more), trials=1)


def test_the_parameters_of_the_options_are_made_of_the_declaration() -> None:
    made = {name: (spec.shape, spec.unit, spec.form) for name, spec in specs(Learner).items()}
    assert list(made) == ["Gamma", "w_box", "w_ball", "leak", "error_leak", "dead_zone"]
    assert made["w_box"] == ("n", "m/s^2", "box")
    assert made["w_ball"] == ("n", "m/s^2", "ball")
    assert made["leak"] == ("", "1/s", "diagonal")
    assert made["error_leak"] == ("", "1/m", "diagonal")
    assert made["dead_zone"] == ("n", "m/s", "diagonal")
    assert [state.name for state in Started.states] == ["w"]
    assert Started(w=0.1, dead_zone="20 mm/s").model_dump()["dead_zone"] == 0.02
    with pytest.raises(DmframeError, match=r"learner\.leek: unknown parameter of learner; did you mean leak\?"):
        Learner(leek=1)


def test_the_composed_rate_is_the_textbooks() -> None:
    x, w, start, gain = np.array([0.5, -0.03]), np.array([2.0, 1.0]), np.array([0.2, 0.4]), np.array([2.0, 3.0])
    block = Started(Gamma=list(gain), w=list(start), leak=0.3, error_leak=0.7, dead_zone=0.1)
    rate = block.evaluate({"x": x}, {"w": w}).rates["w"]
    outside = np.sign(x) * np.maximum(np.abs(x) - 0.1, 0)
    np.testing.assert_allclose(rate, -gain * outside - (0.3 + 0.7 * np.hypot(*x)) * (w - start), atol=1e-14)


@pytest.mark.parametrize(
    ("learner", "nominal", "start"),
    [(Started(w=0.1), True, 0.1), (Started(), True, 0.3), (Learner(), True, 0.3), (Learner(), False, 0.0)],
)
def test_an_estimate_starts_where_its_parameter_states_else_at_its_nominal_else_at_zero(
    learner: AbstractBlock, nominal: bool, start: float
) -> None:
    built = diagram(learner, **({"nominal": Nominal()} if nominal else {}))
    assert start_state(built, {})[:2] == pytest.approx([start, start])
    pulled = diagram(
        type(learner)(**{**learner.model_dump(), "leak": 1.0}), **({"nominal": Nominal()} if nominal else {})
    )
    run = simulate(pulled, 1e-3, clock=1e-3, start={"learner.w": [1.0, 1.0]})
    np.testing.assert_allclose(run["learner.w"][1], 1 - 1e-3 * (1 - start), atol=1e-12)


@pytest.mark.parametrize(
    "options",
    [{}, {"leak": 0.1}, {"error_leak": 0.2}, {"dead_zone": 0.1}, {"leak": 0.1, "dead_zone": 0.1, "w_ball": (0, 2)}],
)
def test_what_the_options_add_to_the_certificate_is_proved(options: dict[str, Any]) -> None:
    verdict = proof(Started(w=0.1, **options))
    assert verdict.outcome == "proved", verdict.reason
    assert len(verdict.bounds) == len(options.keys() & {"leak", "error_leak", "dead_zone"})
    assert all(control.refuted for control in verdict.controls)


def test_an_effect_that_is_not_the_transpose_of_the_direction_is_refuted(monkeypatch: pytest.MonkeyPatch) -> None:
    right = AdaptingBlock._effect
    monkeypatch.setattr(AdaptingBlock, "_effect", lambda *given: 2 * right(*given))
    verdict = proof(Learner(dead_zone=0.1))
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.blame == ("learner",)


def says(estimates: Callable[[Signals, Signals], dict[str, TrueValue]]) -> AdaptingBlock:
    """The learner with another statement of what it estimates."""

    class Liar(Learner):
        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            return Certificate(estimates=estimates(x, truth), supply=-ca.dot(u.x, x.w - truth.theta))

    return Liar()


@pytest.mark.parametrize(
    "estimates",
    [
        lambda x, truth: {"w": TrueValue(truth.theta + 1)},
        lambda x, truth: {"w": TrueValue(2 * truth.theta)},
        lambda x, truth: {"w": TrueValue(truth.theta, 2)},
        lambda x, truth: {"w": TrueValue(truth.theta, ca.SX([1, 3]))},
    ],
)
def test_a_true_value_or_a_weight_that_is_not_that_of_the_law_is_refuted(estimates: Any) -> None:
    verdict = proof(says(estimates))
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.blame == ("learner",)


@pytest.mark.parametrize(
    ("estimates", "text"),
    [
        (
            lambda x, truth: {"w": TrueValue(truth.theta), "v": TrueValue(0)},
            "learner: certificate() gives the true value of v, which is not one of its estimates; choose from w",
        ),
        (
            lambda x, truth: {},
            "learner: certificate() gives the true value of nothing, and omits the estimate w",
        ),
        (
            lambda x, truth: {"w": TrueValue(truth.theta + 0.1 * x.w)},
            "learner: certificate() gives a true value for w that depends on w",
        ),
        (
            lambda x, truth: {"w": truth.theta},
            "Certificate: expected estimates['w'] to be a TrueValue, found an SX",
        ),
    ],
)
def test_a_certificate_that_does_not_state_the_true_value_of_each_estimate_is_refused(
    estimates: Any, text: str
) -> None:
    verdict = proof(says(estimates))
    assert verdict.outcome == "not_applicable"
    assert text in verdict.reason


def moves(law: Callable[[Signals, SX], dict[str, SX]], **stated: Any) -> type[AdaptingBlock]:
    """The learner with another law, whose certificate is that of the gradient law with it."""

    class Moves(Learner):
        def direction(self, u: Signals, x: Signals, p: Signals, error: SX) -> Mapping[str, SX]:
            return law(u, error)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"w": x.w}, rates=stated)

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            return Certificate(
                estimates={"w": TrueValue(truth.theta)},
                supply=ca.dot(law(u, u.x)["w"], x.w - truth.theta),
            )

    return Moves


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (
            lambda u, error: {"w": -error, "v": error},
            "learner: direction() moves v, which is not one of its estimates; choose from w",
        ),
        (lambda u, error: {}, "learner: direction() moves nothing, and omits the estimate w"),
    ],
)
def test_a_direction_of_something_else_is_refused(law: Any, text: str) -> None:
    with pytest.raises(BlockError) as fault:
        diagram(moves(law)())
    assert text in str(fault.value)


def test_a_rate_that_is_stated_together_with_its_direction_is_refused() -> None:
    with pytest.raises(
        BlockError, match=r"equations\(\) state the rate of w, which direction\(\) determines; remove it"
    ):
        diagram(moves(lambda u, error: {"w": -error}, w=ca.SX(0))())


def test_a_dead_zone_of_a_law_that_is_not_linear_in_its_error_is_refused() -> None:
    cubic = moves(lambda u, error: {"w": -error - error**3})
    verdict = proof(cubic(dead_zone=0.1))
    assert verdict.outcome == "not_applicable"
    assert "learner: direction() is not linear in x, so that the residual of a dead zone is unknown" in verdict.reason
    assert "linear" not in proof(cubic()).reason


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"estimates": (Adapted("w", "n", "m/s^2", gain="Gama"),)},
            "the gain of the estimate w is Gama, which is not a parameter; did you mean Gamma?",
        ),
        (
            {"estimates": (Adapted("w", "n", "m/s^2"),)},
            "the gain of the estimate w is none, which is not a parameter; choose from",
        ),
        (
            {"estimates": (Adapted("w", "n", "m/s^2", gain="Gamma", nominal="w_nom"),)},
            "the estimate w starts at w_nom, which is not an input; did you mean w_nominal?",
        ),
        ({"driven_by": "y"}, "is driven by y, which is neither an input nor an output; choose from"),
        ({"states": (State("w", "n", "m/s^2"),)}, "declares the state w twice"),
    ],
)
def test_a_declaration_of_what_the_block_lacks_is_refused(changes: dict[str, Any], text: str) -> None:
    kind = type("Lying", (Learner,), {"__module__": __name__, "__annotations__": {}, **changes})
    assert any(text in str(fault) for fault in kind.contract("learner"))


def test_a_declaration_of_another_type_is_refused_when_the_class_is_made() -> None:
    with pytest.raises(BlockError, match=r"Wrong: expected estimates to be a tuple of Adapteds, found .*; a comma"):
        type("Wrong", (Learner,), {"__module__": __name__, "estimates": Adapted("w", "n")})
    with pytest.raises(BlockError, match=r"Wrong: expected driven_by to be the name of an input or output"):
        type("Wrong", (Learner,), {"__module__": __name__, "driven_by": Input("x", "n")})


def test_a_parameter_that_every_adapting_block_is_given_is_not_declared_again() -> None:
    with pytest.raises(BlockError, match="Again: declares the parameter leak, which the framework adds; remove it"):

        class Again(Learner):
            leak: Scalar = Positive("", "1/s", default=1.0)


def test_estimates_of_a_block_that_does_not_adapt_are_refused() -> None:
    class Plain(Drift):
        estimates: Estimates = (Adapted("x", "n", gain="theta"),)

    assert any("declares estimates, but is not an AdaptingBlock" in str(fault) for fault in Plain.contract("plain"))


class Minimal(AbstractBlock):
    """dw = -Gamma x, stated with all rates; only its certificate declares what w estimates."""

    inputs = (Input("x", "n", "m/s"),)
    outputs = (Output("w", "n", "m/s^2", Access.COMMANDED),)
    states = (State("w", "n", "m/s^2", box="w_box"), State("other_hat", "n"))
    truth = (Input("theta", "n", "m/s^2"),)
    Gamma: Diagonal = Positive("n", "1/s^2", default=2.0)
    decay: Diagonal = Positive("n", "1/s", default=1.0)
    w_box: Box = Interval("n", "m/s^2")
    says: str = "estimates"

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"w": x.w}, rates={"w": -p.Gamma * u.x, "other_hat": -p.decay * x.other_hat})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        stated: dict[str, Any] = {
            "estimates": {"estimates": {"w": TrueValue(truth.theta, 1 / p.Gamma)}},
            "storage": {"storage": (Square(x.w - truth.theta, 1 / p.Gamma),)},
            "nothing": {"estimates": {"v": TrueValue(truth.theta)}},
        }
        return Certificate(**stated[self.says], supply=-ca.dot(u.x, x.w - truth.theta))


def test_a_block_of_its_own_law_states_what_it_estimates_in_its_certificate() -> None:
    verdict = proof(Minimal(w_box=(0, 1)))
    assert verdict.outcome == "proved", verdict.reason
    assert "learner.w: true value inside the box" in [item.name for item in verdict.conditions]
    np.testing.assert_allclose(true_values(diagram(Minimal()))["learner.w"], [0.5, 0.8])


def test_a_projected_state_has_to_be_declared_an_estimate() -> None:
    verdict = proof(Minimal(w_box=(0, 1), says="storage"))
    assert verdict.outcome == "not_applicable"
    assert "learner.w is projected, but is not stored as one square of its error" in verdict.reason
    assert "say what it estimates by estimates={'w': TrueValue(...)}" in verdict.reason
    assert proof(Minimal(says="storage")).outcome == "proved"


def test_an_estimate_that_is_not_a_state_is_refused() -> None:
    verdict = proof(Minimal(says="nothing"))
    assert verdict.outcome == "not_applicable"
    assert (
        "learner: certificate() gives a true value for v, which is not one of its states; choose from" in verdict.reason
    )


def test_a_figure_of_estimates_shows_what_is_declared_and_guesses_nothing_from_names() -> None:
    for learner in (Learner(), Minimal()):
        built = diagram(learner)
        assert {label: list(value) for label, value in estimates_of(built).items() if value is not None} == {
            "learner.w": [0.5, 0.8]
        }
        figure = estimate_figure("toy", simulate(built, 0.1, clock=0.01))
        (panel,) = figure.axes
        assert panel.get_ylabel().startswith("w")


def test_every_adapting_block_states_what_its_options_are_on_its_page_and_to_an_editor() -> None:
    adapting = {name: kind for name, kind in block_types().items() if issubclass(kind, AdaptingBlock)}
    assert len(adapting) == 12
    schema = json_schema()["$defs"]
    for name, kind in adapting.items():
        for option in ("leak", "error_leak", "dead_zone"):
            text = about(kind).parameters[option]
            assert "Robust adaptation laws, each off by default" in text
            assert f"${latex_name(kind.driven_by)}$" in text
            assert "Robust adaptation laws" in schema[f"block_{name}"]["properties"][option]["description"]


class Seen(Drift):
    """The same, with theta measured."""

    outputs = (*Drift.outputs, Output("theta_m", "n", "m/s^2", Access.MEASURED))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        stated = super().equations(u, x, p)
        return Equations({**stated.outputs, "theta_m": p.theta}, stated.rates)


class Fitter(AdaptingBlock):
    """Composite adaptation, with forgetting."""

    inputs = (Input("x", "n", "m/s"), Input("theta_m", "n", "m/s^2"))
    outputs = (Output("w", "n", "m/s^2", Access.COMMANDED),)
    truth = (Input("theta", "n", "m/s^2"),)
    estimates: Estimates = (Adapted("w", "n", "m/s^2", gain="Gamma", memory="M_w"),)
    driven_by: ClassVar[str] = "x"
    Gamma: Diagonal = Positive("n", "", default=2.0)
    R: Diagonal | None = Positive("n", "s", default=None)
    forgetting: Scalar | None = Positive("", "1/s", default=None)
    M_w: Scalar = Real("n n", "", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"w": x.w})

    def direction(self, u: Signals, x: Signals, p: Signals, error: SX) -> Mapping[str, SX]:
        return {"w": -error}

    def fits(self, u: Signals, x: Signals, p: Signals) -> Mapping[str, Fit]:
        return {"w": Fit(x.w - u.theta_m, ca.SX.eye(2), p.R * ca.SX.ones(2))}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(estimates={"w": TrueValue(truth.theta)}, supply=-ca.dot(u.x, x.w - truth.theta))


class StartedElsewhere(Fitter):
    """Starts at another value."""

    def nominal(self, u: Signals, p: Signals) -> Mapping[str, SX]:
        return {"w": ca.DM([0.1, 0.1])}


@pytest.mark.parametrize("kind", [Fitter, StartedElsewhere])
@pytest.mark.parametrize(("start", "outcome"), [(0.0, "proved"), (0.6, "proved"), (-0.6, "not_applicable")])
def test_a_memory_that_starts_below_zero_is_no_storage_however_it_is_started(
    kind: Any, start: float, outcome: str
) -> None:
    rows = [[start, 0.0], [0.0, start]]
    numbers: dict[str, Any] = {"R": 0.001, "forgetting": 0.01}
    plant = Seen(theta=[0.5, 0.8])
    by_graph = Diagram.build({"plant": plant, "learner": kind(**numbers)})
    for given in ({"learner.M_w": rows}, {"M_w": rows}):
        assert verify(by_graph, start=given).outcome == outcome
    if start < 0:
        assert "initial value of G for" in verify(by_graph, start={"M_w": rows}).reason
        spread = Diagram.build({"plant": plant, "learner": kind(**numbers, M_w=start)})
        assert verify(spread).outcome == "not_applicable"


def test_what_a_method_states_of_no_estimate_is_refused() -> None:
    class Foreign(Fitter):
        def fits(self, u: Signals, x: Signals, p: Signals) -> Mapping[str, Fit]:
            return {"w_hat": Fit(x.w - u.theta_m, ca.SX.eye(2), p.R * ca.SX.ones(2))}

    class Stranger(Fitter):
        def nominal(self, u: Signals, p: Signals) -> Mapping[str, SX]:
            return {"ww": ca.SX(1.0)}

    class Nothing(Fitter):
        def nominal(self, u: Signals, p: Signals) -> Mapping[str, SX]:
            return None  # type: ignore[return-value]

    class Twice(Fitter):
        def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
            return {"w": ca.SX.ones(2)}

    texts = {
        Foreign: "fits() returns w_hat, which is not one of its estimates",
        Stranger: "nominal() returns ww, which is not one of its estimates; did you mean w?",
        Nothing: "expected nominal() to return values by estimate, found NoneType",
    }
    for kind, text in texts.items():
        with pytest.raises(DmframeError) as caught:
            Diagram.build({"plant": Seen(theta=[0.5, 0.8]), "learner": kind(R=50.0)})
        assert text in str(caught.value)
    built = Diagram.build({"plant": Seen(theta=[0.5, 0.8]), "learner": Twice(R=50.0)})
    with pytest.raises(DmframeError, match=r"start\(\) sets the initial value of w, which a leak does not use"):
        simulate(built, 0.1)
