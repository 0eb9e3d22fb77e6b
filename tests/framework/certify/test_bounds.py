"""Bounds of residuals, initial information matrices, gains without effect, sampled conditions, extreme numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scalar_blocks import scalar_loop

from dmframe.block.certificate import Certificate, Clipped, InformationSquare, Square, clip
from dmframe.certify import claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.certify.checked import Checked, Numbers
from dmframe.certify.memories import memory_starts
from dmframe.certify.residual import bounds_of
from dmframe.certify.summary import summary
from dmframe.certify.symbols import symbols_of
from dmframe.common.errors import DmframeError
from dmframe.common.text import Text
from dmframe.diagram import Diagram
from dmframe.exact.rational import as_float
from dmframe.graph.graph import Graph
from dmframe.prove.definite import is_semidefinite
from dmframe.prove.faults import inject_faults
from dmframe.report.content import Condition
from dmframe.report.verdict_text import verdict_text

ONE = ca.SX(1)


def drifting(width: Callable[[Any, Any], Any]) -> Diagram:
    """y' = -y + clip(y, w): the residual is at most w |y|, for a positive width."""
    return scalar_loop(
        "y z",
        lambda x, u, p: {"y": -x.y + clip(x.y, width(x, p)), "z": -x.z},
        lambda x, u, p: Certificate(
            storage=(Square(x.y, ONE), Square(x.z, ONE)),
            dissipation=(Square(x.y, ONE), Square(x.z, ONE)),
            residual=(Clipped(x.y, ca.SX(width(x, p)), x.y),),
        ),
    )


def bound(diagram: Diagram) -> float | None:
    claim = claim_of(diagram)
    (found,) = bounds_of(claim, Numbers(claim, {}), symbols_of(claim))
    assert found.known == (found.value is not None)
    return found.value


def test_a_clipped_term_has_its_width_as_bound() -> None:
    assert bound(drifting(lambda x, p: p.k / 4)) == 0.5
    assert verify(drifting(lambda x, p: p.k / 4)).outcome == "proved"


@pytest.mark.parametrize(
    "width", [lambda x, p: -p.k, lambda x, p: p.k - 2, lambda x, p: p.k + x.z, lambda x, p: 1 + x.z * x.z]
)
def test_a_width_that_is_not_positive_or_not_constant_gives_no_bound(width: Any) -> None:
    assert bound(drifting(width)) is None
    verdict = verify(drifting(width))
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith(
        (
            "the identity holds, but nothing bounds the residual",
            "the identity holds, but a condition fails: toy: ",
            "toy: ",
        )
    )


def gathering(start: float | None) -> Diagram:
    """G' = -G + 1, in the storage: G converges to 1 from every start."""

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        form = InformationSquare(x.y, ONE, x.G, ONE, ONE, ONE)
        return Certificate(storage=(Square(x.y, ONE), form), dissipation=(Square(x.y, ca.SX(3)), form, form, form))

    diagram = scalar_loop("y G", lambda x, u, p: {"y": -2 * x.y, "G": 1 - x.G}, claim)
    if start is not None:
        object.__setattr__(diagram.models["toy"], "values", {**diagram.models["toy"].values, "G": np.array(start)})
    return diagram


def test_an_information_matrix_must_not_start_below_zero() -> None:
    def starts(start: float | None) -> list[Checked]:
        claim = claim_of(gathering(start))
        return memory_starts(claim, Numbers(claim, {}), {})

    assert starts(None) == []
    (fine,) = starts(0.5)
    (below,) = starts(-0.5)
    assert fine.holds
    assert not below.holds
    assert below.name.startswith("toy: initial value of G for |")


@given(st.lists(st.lists(st.integers(-2, 2), min_size=3, max_size=3), min_size=1, max_size=3), st.booleans())
def test_a_matrix_is_semidefinite_exactly_if_no_eigenvalue_is_negative(rows: list[list[int]], lower: bool) -> None:
    a = np.array(rows)
    matrix = a.T @ a - (np.diag([0, 0, 1]) if lower else 0)
    exact = [[Fraction(int(value)) for value in row] for row in matrix]
    least = float(np.linalg.eigvalsh(matrix)[0])
    if abs(least) > 1e-9 or not lower:
        assert is_semidefinite(exact) == (least > -1e-9)


def test_a_changed_gain_is_a_seeded_fault_only_if_it_changes_a_rate() -> None:
    def loop(effect: float) -> Diagram:
        return scalar_loop(
            "y",
            lambda x, u, p: {"y": -x.y * (1 + effect * (p.k - 1))},
            lambda x, u, p: Certificate(
                storage=(Square(x.y, 1 / p.k),), dissipation=(Square(x.y, (1 + effect * (p.k - 1)) / p.k),)
            ),
        )

    def faults(diagram: Diagram) -> dict[str, bool]:
        claim = claim_of(diagram)
        return {c.fault: c.refuted for c in inject_faults(assembled(claim), seed=0)}

    changed = "toy.k changed in the equations only"
    assert faults(loop(0.0)).get(changed) is None
    assert faults(loop(1.0))[changed] is True
    assert verify(loop(0.0)).outcome == verify(loop(1.0)).outcome == "proved"


def test_a_sampled_condition_is_reported_as_sampled_and_not_proved() -> None:
    graph = Graph.read("arm2_joint")
    verdict = verify(graph.diagram)
    sampled = Checked(Text("M(q) > 0"), "200 poses", 0.1, True, Text("property P2"), "sampled")
    object.__setattr__(verdict, "conditions", (sampled,))
    (line,) = [line for line in verdict_text(graph.name, verdict).splitlines() if "M(q) > 0" in line]
    assert line.endswith("sampled, not proved")
    row = Condition("M(q) > 0", "0.1", True, "sampled", "property P2")
    assert row.status == "sampled, not proved"


def test_a_proof_in_continuous_time_names_the_sampling_below_the_headline() -> None:
    says = "in continuous time: sampling every 2 ms is not covered; see `dmframe analyse`"
    text = " ".join(str(Graph.read("arm2_joint").verify()).split())  # a narrow terminal wraps lines
    assert text.index(says) < text.index("conditions")
    assert "is not covered" not in str(Graph.read("pendulum").verify())  # in continuous time


EXTREMES = ["1e308", "5e-324", "-0.0", ".nan", ".inf"]
PLACES = {
    "theorem_1": ("path.radius",),
    "arm2_joint": ("inverse.Lambda", "servo.K_P"),
    "joint_tracking_pid": ("inverse.K_c", "servo.K_D"),
}


@pytest.mark.parametrize(("name", "place"), [(name, place) for name, places in PLACES.items() for place in places])
def test_extreme_numbers_give_a_verdict_or_an_error_of_the_graph(name: str, place: str) -> None:
    for value in EXTREMES:
        try:
            graph = Graph.read(name, [f"{place}={value}"])
            verdict = verify(graph.diagram, trials=1)
        except DmframeError:
            continue
        assert verdict.outcome != "refuted"
        assert verdict_text(graph.name, verdict)
        assert json.dumps(summary(name, verdict), allow_nan=False)


def test_a_margin_beyond_the_largest_float_is_infinite() -> None:
    assert [as_float(Fraction(10) ** 400), as_float(-(Fraction(10) ** 400))] == [float("inf"), float("-inf")]
    assert as_float(Fraction(1, 3)) == 1 / 3
