"""True numbers in a controller's equations, for every way by which a block can obtain them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
import pytest
from structures import structures

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.diagram import Diagram
from dmframe.diagram.knowledge import Known, known_truths
from dmframe.graph.graph import Graph
from dmframe.robot.library import load


class Arm(AbstractBlock):
    """dq = v; K is an output, its double is hidden."""

    side = Side.PLANT
    inputs = (Input("v", "n", "rad/s"),)
    outputs = (Output("q", "n", "rad", Access.MEASURED), Output("K", access=Access.MEASURED))
    states = (State("q", "n", "rad"),)
    K: Scalar = Positive(default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"q": x.q, "K": p.K}, rates={"q": u.v})


def law(expression: Callable[[Any, Any, Any], Any]) -> AbstractBlock:
    """A controller that commands -q times an expression of (robot, u, p)."""

    class Law(AbstractBlock):
        uses_robot = True
        inputs = (Input("q", "n", "rad"), Input("K"))
        outputs = (Output("v", "n", "rad/s", Access.COMMANDED), Output("aside", "n"))

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            held = expression(p.robot, u, p)
            acts = held if expression not in ASIDE else 1
            return Equations(outputs={"v": -u.q * acts, "aside": u.q * held})

    return Law()


ASIDE: list[Any] = []


def known(expression: Callable[[Any, Any, Any], Any], robot: str = "ur10") -> tuple[str, ...]:
    diagram = Diagram.build({"law": law(expression), "arm": Arm()}, {}, load(robot))
    found = known_truths(diagram)
    return found[0].groups if found else ()


def of(graph: str, overrides: tuple[str, ...] = ()) -> Mapping[str, Known]:
    return {item.block: item for item in known_truths(Graph.read(graph, overrides).diagram)}


@pytest.mark.parametrize(
    ("expression", "groups"),
    [
        (lambda r, u, p: 1, ()),
        (lambda r, u, p: r.n + r.m, ()),
        (lambda r, u, p: r.inertia[0], ("inertia",)),
        (lambda r, u, p: r.mass_matrix(u.q)[0, 0], ("lengths", "axes", "inertia")),
        (lambda r, u, p: r.gravity_torque(u.q)[1], ("lengths", "axes", "gravity", "inertia")),
        (lambda r, u, p: r.gravity[2], ("gravity",)),
        (lambda r, u, p: r.friction_velocity, ("friction_velocity",)),
        (lambda r, u, p: r.coulomb(u.q)[0], ("friction_velocity",)),
        (lambda r, u, p: r.a_k[2], ("lengths",)),
        (lambda r, u, p: r.position(u.q)[0], ("lengths", "axes", "tool")),
        (lambda r, u, p: r.jacobian(u.q, ca.SX.ones(r.k))[0, 0], ("axes",)),
        (lambda r, u, p: r.angular_jacobian(u.q)[0, 1], ("axes",)),
        (lambda r, u, p: r.rotation(u.q)[0, 1], ("axes", "tool_rotation")),
        (lambda r, u, p: float(r.chain.tool_rotation[0][0]), ("tool_rotation",)),
        (lambda r, u, p: r.constants[0].symbol[0], ("inertia",)),
        (lambda r, u, p: ca.vertcat(*ca.symvar(r.mass_matrix(u.q, None)))[-1], ("inertia",)),
        (lambda r, u, p: float(r.constants[0].values[0]), ("inertia",)),
        (lambda r, u, p: float(r.chain.inertia[0][0]), ("inertia",)),
        (lambda r, u, p: r.values()["robot.inertia"][0], ("inertia",)),
        (lambda r, u, p: float(r.chain.model.inertias[1].mass), ("inertia",)),
        (lambda r, u, p: float(r.chain.tool[0]), ("tool",)),
        (lambda r, u, p: float(r.chain.joints[1].translation[2]), ("lengths",)),
        (lambda r, u, p: float(r.chain.gravity[2]), ("gravity",)),
        (lambda r, u, p: float(r.chain.model.gravity.linear[2]), ("gravity",)),
        (lambda r, u, p: r.chain.friction_velocity, ("friction_velocity",)),
        (lambda r, u, p: float(r.chain.joints[1].axis[1]), ("axes",)),
        (lambda r, u, p: 2 if r.chain.inertia[0][0] > load("ur10").inertia[0][0] else 1, ("inertia",)),
        (lambda r, u, p: u.K, ("arm.K",)),
        (lambda r, u, p: u.K * r.inertia[0], ("inertia", "arm.K")),
    ],
)
def test_true_numbers_are_found_on_every_way(expression: Any, groups: tuple[str, ...]) -> None:
    assert known(expression) == groups
    ASIDE.append(expression)
    try:
        assert known(expression) == (), "what is shown and drives nothing is not held"
    finally:
        ASIDE.remove(expression)


@pytest.mark.parametrize("seed", range(4))
def test_any_one_inertial_number_is_found_as_a_symbol_and_as_a_number(seed: int) -> None:
    rng = np.random.default_rng(seed)
    i, j = int(rng.integers(0, 6)), int(rng.integers(0, 10))
    assert known(lambda r, u, p: r.inertia[10 * i + j]) == ("inertia",)
    assert known(lambda r, u, p: 1 + float(r.chain.inertia[i][j])) == ("inertia",)


def test_axes_that_leave_no_symbol_are_known_all_the_same() -> None:
    """Adapted lengths, all of them: only the directions of the axes remain."""
    found = of("theorem_1")
    assert found["geometry"].groups == ("axes",)
    assert "robot.rotations" not in {p.label for p in Graph.read("theorem_1").diagram.loop.parameters}
    assert found["model"].groups == ("lengths", "axes", "gravity", "friction_velocity")
    assert found["model"].words == "the link lengths, the joint axes, gravity and the friction velocity v_0"


@pytest.mark.parametrize(("adapt", "groups"), [("links", ("axes", "tool")), ("tool", ("lengths", "axes"))])
def test_what_is_not_adapted_is_known(adapt: str, groups: tuple[str, ...]) -> None:
    overrides = (f"geometry.adapt={adapt}",)
    assert of("theorem_1", overrides)["geometry"].groups == groups


def test_where_an_estimate_starts_is_not_known_unless_a_rate_pulls_it_back_there() -> None:
    start = ("model.nominal=0.8",)
    assert "inertia" not in of("arm2_joint", start)["model"].groups
    leaking = of("arm2_joint", (*start, "dynamics.leak=0.1"))["model"]
    assert leaking.held_by["inertia"] == ("a_d_nominal",)


@pytest.mark.parametrize("name", structures())
def test_three_packaged_controllers_alone_contain_the_inertia_one_for_comparison_and_two_for_a_load(
    name: str,
) -> None:
    leaks = {
        block
        for block, item in of(name).items()
        if "inertia" in item.groups and item.held_by["inertia"] != ("a_d_nominal",)
    }
    known = {"computed_torque": {"torque"}, "ur10_payload": {"model"}, "ur10_demo": {"model"}}
    assert leaks == known.get(name, set())
