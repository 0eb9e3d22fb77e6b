"""Storage functions other than squares: saturating springs, and the divergence of matrices; with false claims."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scalar_blocks import Rates, scalar_loop

from dmframe.block.certificate import Certificate, Clipped, LogDet, Potential, Square, beyond, clip, soft_clip
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.certify.checked import Numbers
from dmframe.certify.conditions import conditions_of
from dmframe.diagram import Diagram
from dmframe.prove.refute import failing

WIDTH = 0.5


def pulled(
    force: Any = soft_clip, stored: Any = lambda x, p: Potential(x.y, ca.SX(WIDTH), p.k), of: str = "y z"
) -> Diagram:
    """A mass z on a saturating spring with a damper; `force` is the spring's, `stored` its energy."""

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate(storage=(stored(x, p), Square(x.z)), dissipation=(Square(x.z),))

    return scalar_loop(of, lambda x, u, p: {"y": x.z, "z": -p.k * force(x.y, WIDTH) - x.z}, claim)


def reports(verdict: Verdict) -> set[tuple[str, str]]:
    return {(item.signal, item.says) for item in verdict.statements}


def test_a_softening_spring_is_proved_and_bounds_what_pulls_it() -> None:
    verdict = verify(pulled())
    assert verdict.outcome == "proved"
    assert len(verdict.controls) > 3
    assert all(control.refuted for control in verdict.controls)
    assert {("y", "is bounded"), ("z", "goes to zero")} <= reports(verdict)
    assert not any("sqrt" in item.text for item in verdict.assumptions)  # it is defined everywhere


def test_the_energy_is_the_integral_of_the_force() -> None:
    a = ca.SX.sym("a", 3)
    width, weight = np.array([0.3, 1.0, 2.0]), np.array([1.0, 2.0, 0.5])
    value = ca.Function("value", [a], [Potential(a, ca.SX(width), ca.SX(weight)).value])
    force = ca.Function("force", [a], [soft_clip(a, ca.SX(width))])
    at = np.array([-4.0, 0.2, 7.0])
    steps = np.linspace(0, 1, 4001)
    along = np.array([weight * force(at * share).full().ravel() @ at for share in steps])
    np.testing.assert_allclose(float(value(at)) / 2, np.trapezoid(along, steps), rtol=1e-6)
    assert np.all(np.abs(force(1e6 * at).full().ravel()) <= width)


@pytest.mark.parametrize(
    "force",
    [clip, lambda a, v: v * ca.tanh(a / v), lambda a, v: a, lambda a, v: soft_clip(a, 2 * v), lambda a, v: 0 * a],
    ids=["a clip", "a tanh", "a linear spring", "another width", "none"],
)
def test_a_force_that_is_not_the_gradient_is_refuted(force: Any) -> None:
    assert verify(pulled(force)).outcome == "refuted"


@pytest.mark.parametrize(
    ("stored", "part"),
    [
        (lambda x, p: Potential(x.y, ca.SX(WIDTH), -p.k), "weight of the potential of y in V > 0"),
        (lambda x, p: Potential(x.y, p.k - 2, p.k), "width of the potential of y in V > 0"),
        (lambda x, p: Potential(x.y, 1 + x.z**2, p.k), "width of the potential of y in V > 0"),
        (lambda x, p: Potential(x.y, ca.SX(WIDTH), 1 + x.z**2), "weight of the potential of y in V > 0"),
    ],
    ids=["wrong sign", "no width", "a width that moves", "a weight that moves"],
)
def test_a_potential_that_is_not_positive_fails_its_condition(stored: Any, part: str) -> None:
    # the identity is wrong too; this test is about the sign, which is never taken for granted
    diagram = pulled(stored=stored)
    claim = claim_of(diagram)
    checked, _ = conditions_of(claim, Numbers(claim, {}))
    assert f"toy: {part}" in {item.name for item in checked if not item.holds}
    assert verify(diagram).outcome != "proved"


def test_a_potential_of_what_is_zero_elsewhere_bounds_only_that() -> None:
    lying = verify(pulled(lambda a, v: soft_clip(beyond(a, ca.SX(1)), v)))
    assert lying.outcome == "refuted"  # y itself is stored; the part beyond 1 pulls
    honest = pulled(
        lambda a, v: soft_clip(beyond(a, ca.SX(1)), v),
        lambda x, p: Potential(beyond(x.y, ca.SX(1)), ca.SX(WIDTH), p.k),
    )
    verdict = verify(honest)
    assert ("y", "goes to zero") not in reports(verdict)


def test_a_subclass_of_a_potential_is_refused() -> None:
    class Sunk(Potential):  # type: ignore[misc]
        @property
        def value(self) -> Any:
            return -(self.vector**2)

    verdict = verify(pulled(stored=lambda x, p: Sunk(x.y, ca.SX(WIDTH), p.k)))
    assert verdict.outcome == "not_applicable"
    assert "expected storage[0] to be a Square, an InformationSquare, a Potential or a LogDet" in verdict.reason


def estimating(
    rates: Rates = lambda x, u, p: {"y": -x.y * (x.y - p.k) * x.y},
    stored: Any = lambda x, p: LogDet(x.y, p.k, ca.SX(2)),
    spent: Any = lambda x, p: Square(x.y - p.k),
    states: str = "y",
) -> Diagram:
    """An estimate y of k that moves in proportion to its own square, so that it never reaches zero."""

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate(storage=(stored(x, p),), dissipation=(spent(x, p),))

    return scalar_loop(states, rates, claim)


def matrix_of(x: Any) -> Any:
    return ca.blockcat([[x.a, x.b], [x.b, x.c]])


def estimating_a_matrix(matrix: Any = matrix_of, true: Any = None) -> Diagram:
    def moved(x: Any, p: Any) -> Any:
        P = matrix_of(x)
        return -P @ (P - wanted(p)) @ P

    def wanted(p: Any) -> Any:
        return ca.blockcat([[p.k, 1], [1, p.k]])

    return estimating(
        lambda x, u, p: dict(zip("abc", (moved(x, p)[0, 0], moved(x, p)[1, 0], moved(x, p)[1, 1]), strict=True)),
        lambda x, p: LogDet(matrix(x), wanted(p) if true is None else true(p), ca.SX(2)),
        lambda x, p: Square(ca.vec(matrix_of(x) - wanted(p))),
        states="a b c",
    )


START = {"toy.a": 1.0, "toy.b": 0.5, "toy.c": 1.0}


def test_an_estimate_stays_positive_definite_if_it_starts_so() -> None:
    verdict = verify(estimating(), start={"toy.y": 1.0})
    assert verdict.outcome == "proved"
    assert all(control.refuted for control in verdict.controls)
    assert ("y", "stays in a compact set of positive definite matrices") in reports(verdict)
    assert verdict.states is not None
    assert verdict.states.open == ()


def test_the_same_of_a_matrix() -> None:
    verdict = verify(estimating_a_matrix(), start=START)
    assert verdict.outcome == "proved"
    assert any(item.says == "stays in a compact set of positive definite matrices" for item in verdict.statements)


@pytest.mark.parametrize("start", [{"toy.a": 1.0, "toy.b": 2.0, "toy.c": 1.0}, {"toy.a": -1.0, "toy.c": -1.0}, {}])
def test_one_that_does_not_start_positive_definite_proves_nothing(start: dict[str, float]) -> None:
    verdict = verify(estimating_a_matrix(), start=start)
    assert verdict.outcome == "not_applicable"
    assert "starts positive definite" in verdict.reason


def test_the_divergence_is_that_of_eigenvalues() -> None:
    rng = np.random.default_rng(0)
    A, B = (M @ M.T + np.eye(4) for M in rng.normal(size=(2, 4, 4)))
    found = float(ca.DM(ca.evalf(LogDet(ca.SX(A), ca.SX(B), ca.SX(3)).value)))
    ratios = np.linalg.eigvals(np.linalg.solve(A, B)).real
    np.testing.assert_allclose(found, 3 * np.sum(ratios - 1 - np.log(ratios)), rtol=1e-12)
    assert found > 0


@pytest.mark.parametrize(
    "lie",
    [
        {"stored": lambda x, p: LogDet(x.y, p.k, ca.SX(-2)), "spent": lambda x, p: Square(x.y - p.k, ca.SX(-1))},
        {"stored": lambda x, p: LogDet(x.y, -p.k, ca.SX(2)), "spent": lambda x, p: Square(x.y + p.k)},
        {"stored": lambda x, p: LogDet(x.y, p.k - 2, ca.SX(2)), "spent": lambda x, p: Square(x.y - p.k + 2)},
        {"stored": lambda x, p: LogDet(x.y, p.k, 1 + x.y**2)},
        {"stored": lambda x, p: LogDet(x.y, p.k + x.y, ca.SX(2))},
        {"rates": lambda x, u, p: {"y": -(x.y - p.k)}},
    ],
    ids=["wrong sign", "of what is not positive", "of zero", "a weight that moves", "a truth that moves", "a gradient"],
)
def test_a_divergence_that_is_none_is_never_proved(lie: dict[str, Any]) -> None:
    assert verify(estimating(**lie), start={"toy.y": 1.0}).outcome != "proved"


def test_what_only_moves_the_upper_triangle_is_refuted() -> None:
    def lopsided(x: Any) -> Any:
        return ca.blockcat([[x.a, 5 * x.b], [x.b, x.c]])

    verdict = verify(estimating_a_matrix(lopsided), start=START)
    assert verdict.outcome == "refuted"
    claim = assembled(claim_of(estimating_a_matrix(lopsided)))
    assert any(label.endswith("is symmetric") for label, _ in failing(claim, seed=0))


def test_with_a_bounded_residual_it_is_assumed_to_stay_positive_definite() -> None:
    def rates(x: Any, u: Any, p: Any) -> dict[str, Any]:
        return {"y": -x.y * (x.y - p.k) * x.y, "z": -x.z + clip(x.z, p.k)}

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        return Certificate(
            storage=(LogDet(x.y, p.k, ca.SX(2)), Square(x.z)),
            dissipation=(Square(x.y - p.k), Square(x.z)),
            residual=(Clipped(x.z, p.k, x.z),),
        )

    verdict = verify(scalar_loop("y z", rates, claim), start={"toy.y": 1.0})
    assert verdict.outcome == "proved"
    assert any("stays positive definite, although V may rise" in item.text for item in verdict.assumptions)
    assert not any(item.says.startswith("stays in a compact set") for item in verdict.statements)
