"""Wiring, sizes, access, derived derivatives, loops: the checks and derivations of a diagram."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Diagonal, Positive, Real, Scalar
from dmframe.block.port import TIME, Access, Input, Output, Side, State
from dmframe.common.errors import (
    AccessError,
    AlgebraicLoopError,
    BlockError,
    DerivativeError,
    DmframeError,
    Faults,
    MissingError,
    ShapeError,
    UnitError,
    UnknownNameError,
    WiringError,
)
from dmframe.diagram import Diagram
from dmframe.diagram.wiring import Derived, Time, Wire, Zero
from dmframe.graph.graph import Graph
from dmframe.simulate import Solver, simulate


class Wave(AbstractBlock):
    """y_d = sin(rate t)."""

    side = Side.SOURCE
    inputs = (TIME,)
    outputs = (Output("y_d", "", "m"),)
    rate: Scalar = Positive("", "rad/s", default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y_d": ca.sin(p.rate * u.t)})


class Law(AbstractBlock):
    """v_c = dy_d - k (y - y_d), with its second derivative as an output."""

    inputs = (
        Input("y", "", "m"),
        Input("y_d", "", "m"),
        Input("dy_d", "", "m/s", derivative_of="y_d"),
        Input("extra", "", "m/s", optional=True),
    )
    outputs = (Output("v_c", "", "m/s", Access.COMMANDED), Output("inner", "", "m/s"))
    k: Scalar = Positive("", "1/s", default=3.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v_c": u.dy_d - p.k * (u.y - u.y_d) + u.extra, "inner": p.k * u.y})


class Watch(AbstractBlock):
    """Outputs the derivative of v_c, and its second derivative."""

    inputs = (
        Input("v_c", "", "m/s"),
        Input("dv_c", "", "m/s^2", derivative_of="v_c"),
        Input("ddv_c", "", "m/s^3", derivative_of="dv_c"),
    )
    outputs = (Output("first", "", "m/s^2"), Output("second", "", "m/s^3"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"first": u.dv_c, "second": u.ddv_c})


class Cart(AbstractBlock):
    """dy = v, dv = -c (v - v_c); y and v are measured, the acceleration is hidden."""

    side = Side.PLANT
    inputs = (Input("v_c", "", "m/s"),)
    outputs = (
        Output("y", "", "m", Access.MEASURED),
        Output("v", "", "m/s", Access.MEASURED, derivative_of="y"),
        Output("a", "", "m/s^2", Access.MEASURED, derivative_of="v"),
        Output("secret", "", "m"),
    )
    states = (State("y", "", "m"), State("v", "", "m/s"))
    c: Scalar = Positive("", "1/s", default=5.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        a = -p.c * (x.v - u.v_c)
        return Equations(outputs={"y": x.y, "v": x.v, "a": a, "secret": 2 * x.y}, rates={"y": x.v, "v": a})


class OddCart(Cart):
    """A cart with an optional output of its distance, which it reads in either case."""

    states = (*Cart.states, State("way", "", "m", optional=True))
    counts: bool = False
    reads: bool = False

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        reported = super().equations(u, x, p)
        rates = {**reported.rates, **({"way": x.v} if self.counts else {})}
        return Equations({**reported.outputs, "secret": x.way if self.reads else x.y}, rates)


class BlindCart(Cart):
    """The same, its velocity not an output."""

    outputs = (Output("y", "", "m", Access.MEASURED), Output("v", "", "m/s", derivative_of="y"))

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        reported = super().equations(u, x, p)
        return Equations({key: reported.outputs[key] for key in ("y", "v")}, reported.rates)


class Lag(AbstractBlock):
    """dz = out - z; its output is its state."""

    inputs = (Input("one", "n", ""),)
    outputs = (Output("two", "n", ""),)
    states = (State("z", "n"),)
    z: Diagonal = Real("n", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"two": x.z}, rates={"z": u.one - x.z})


class Gain(AbstractBlock):
    """one = g two."""

    inputs = (Input("two", "n", ""),)
    outputs = (Output("one", "n", ""),)
    g: Diagonal = Real("n", default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"one": p.g * u.two})


class Back(AbstractBlock):
    """two = one."""

    inputs = (Input("one", "n", ""),)
    outputs = (Output("two", "n", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"two": u.one})


def cart(**more: AbstractBlock) -> dict[str, AbstractBlock]:
    return {"wave": Wave(), "law": Law(), "cart": Cart(), **more}


def fault(blocks: Mapping[str, AbstractBlock], wires: Mapping[str, str] | None = None) -> DmframeError:
    with pytest.raises(DmframeError) as caught:
        Diagram.build(blocks, wires)
    return caught.value


def test_names_wire_a_diagram_by_themselves() -> None:
    sources = Diagram.build(cart()).sources
    assert sources["law", "y"] == Wire("cart", "y")
    assert sources["law", "y_d"] == Wire("wave", "y_d")
    assert sources["law", "dy_d"] == Derived("y_d")
    assert sources["law", "extra"] == Zero()
    assert sources["cart", "v_c"] == Wire("law", "v_c")
    assert sources["wave", "t"] == Time()


def test_a_wire_of_the_file_has_precedence_over_a_name() -> None:
    blocks = cart(other=Cart())
    with pytest.raises(WiringError, match=r"law\.y: expected one output of that name, found 2: cart\.y, other\.y"):
        Diagram.build(blocks)
    assert Diagram.build(blocks, {"law.y": "other.y"}).sources["law", "y"] == Wire("other", "y")


def test_an_input_without_a_source_names_the_nearest() -> None:
    found = fault({"law": Law(), "cart": Cart()})
    assert isinstance(found, WiringError)
    assert str(found).startswith("law.y_d: expected an output of that name in another block, found none")


def test_wires_from_and_to_nowhere_name_the_nearest() -> None:
    assert str(fault(cart(), {"law.yy": "cart.y"})) == "wires.law.yy: unknown input; did you mean law.y?"
    assert str(fault(cart(), {"law.y": "cart.yy"})) == "wires.law.y: cart.yy: unknown output; did you mean cart.y?"
    assert isinstance(fault(cart(), {"law.y": "cart.yy"}), UnknownNameError)


def test_no_blocks_make_no_diagram() -> None:
    assert isinstance(fault({}), MissingError)


def test_a_hidden_signal_cannot_be_read_by_a_controller() -> None:
    found = fault(cart(), {"law.y": "cart.secret"})
    assert isinstance(found, AccessError)
    assert str(found) == "cart.secret is hidden: law.y cannot read it (the robot's architecture is closed)"


def test_an_internal_signal_cannot_be_commanded() -> None:
    found = fault(cart(), {"cart.v_c": "law.inner"})
    assert isinstance(found, AccessError)
    assert str(found).startswith("law.inner cannot be commanded: cart.v_c takes only")


def test_units_must_agree() -> None:
    found = fault(cart(), {"law.y": "cart.v"})
    assert isinstance(found, UnitError)
    assert str(found) == "wire cart.v -> law.y: expected m, found m/s"


def test_a_letter_is_one_number_in_the_whole_diagram() -> None:
    found = fault({"lag": Lag(z=(1.0, 2.0)), "gain": Gain(g=(1.0, 2.0, 3.0))})
    assert isinstance(found, ShapeError)
    assert str(found) == "gain.g: expected n = 2 (bound by lag.z), found 3"


def test_a_letter_that_nothing_binds_is_reported_once_a_block() -> None:
    found = fault({"lag": Lag(), "gain": Gain()})
    assert isinstance(found, Faults)
    assert [str(item).partition(":")[0] for item in found.faults] == ["lag", "gain"]
    assert "the size n is undetermined" in str(found)


def test_wires_of_different_shapes_are_reported_with_their_reasons() -> None:
    class Wide(Lag):
        inputs = (Input("one", "m", ""),)

        def sizes(self, robot: Any) -> Mapping[str, int]:
            return {"m": 3}

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"two": x.z}, rates={"z": -x.z})

    found = fault({"lag": Wide(), "gain": Gain(g=(1.0, 2.0))})
    assert isinstance(found, ShapeError)
    assert str(found) == "wire gain.one -> lag.one: expected shape (m) with m = 3 (bound by lag), found (2,)"


def test_all_faults_of_one_stage_are_reported_together() -> None:
    found = fault(cart(), {"law.y": "cart.secret", "cart.v_c": "law.inner", "law.y_d": "cart.v"})
    assert isinstance(found, Faults)
    assert {type(item) for item in found.faults} == {AccessError, UnitError}
    assert len(found.faults) == 3


def test_a_block_whose_output_is_its_state_makes_no_loop() -> None:
    loop = Diagram.build({"gain": Gain(g=(2.0,)), "lag": Lag()}).loop
    (z,) = loop.controller
    rate = ca.Function("rate", [loop.state, loop.p], [z.own_rate])
    assert float(rate(3.0, loop.p_values)) == pytest.approx(2 * 3 - 3)


def test_a_loop_is_reported_port_by_port() -> None:
    found = fault({"gain": Gain(g=(2.0,)), "back": Back()})
    assert isinstance(found, AlgebraicLoopError)
    assert found.ports == ("gain.one", "back.two", "gain.one")


def test_a_loop_is_reported_once_and_without_blocks_downstream_of_it() -> None:
    class Reader(AbstractBlock):
        inputs = (Input("one", "n", ""),)
        outputs = (Output("three", "n", ""),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"three": u.one})

    found = fault({"reader": Reader(), "gain": Gain(g=(2.0,)), "back": Back()})
    assert isinstance(found, AlgebraicLoopError)
    assert "reader.three" not in found.ports


def test_a_loop_across_the_wall_is_reported_port_by_port() -> None:
    class Stiff(AbstractBlock):
        side = Side.PLANT
        inputs = (Input("v_c", "", "m/s"),)
        outputs = (Output("y", "", "m", Access.MEASURED),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"y": u.v_c * 1.0})

    found = fault({"wave": Wave(), "law": Law(), "stiff": Stiff()})
    assert isinstance(found, AlgebraicLoopError)
    assert set(found.ports) == {"law.v_c", "stiff.y"}
    assert found.ports[0] == found.ports[-1]


def test_a_chain_too_long_to_follow_is_reported_in_words() -> None:
    def link(i: int) -> AbstractBlock:
        class Link(AbstractBlock):
            inputs = (Input(f"s{i}"),)
            outputs = (Output(f"s{i + 1}"),)

            def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
                return Equations(outputs={f"s{i + 1}": getattr(u, f"s{i}") + 1})

        return Link()

    class First(AbstractBlock):
        side = Side.SOURCE
        outputs = (Output("s0"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"s0": ca.SX(1)})

    links = {f"link{i}": link(i) for i in reversed(range(300))}
    assert Diagram.build({**dict(list(links.items())[-40:]), "first": First()}).loop.outputs
    assert "too many blocks in a chain of direct feedthrough" in str(fault({**links, "first": First()}))


def test_the_derivative_of_a_matrix_is_one_element_by_element() -> None:
    class Turn(AbstractBlock):
        inputs = (Input("y_d", "", "m"),)
        outputs = (Output("Q", "2 3"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            row = ca.horzcat(u.y_d, u.y_d**2, 0)
            return Equations(outputs={"Q": ca.vertcat(row, 2 * row)})

    class Rate(AbstractBlock):
        inputs = (Input("Q", "2 3"), Input("dQ", "2 3", "1/s", derivative_of="Q"))
        outputs = (Output("flat", "6", "1/s"),)

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"flat": ca.vec(ca.densify(u.dQ))})

    run = simulate(Diagram.build({"wave": Wave(), "turn": Turn(), "rate": Rate()}), 1.0, clock=0.1)
    s, c = np.sin(2 * run.time), 2 * np.cos(2 * run.time)
    expected = np.stack([c, 2 * c, 2 * s * c, 4 * s * c, 0 * c, 0 * c], axis=1)
    np.testing.assert_allclose(run["rate.flat"], expected, atol=1e-12)


def differences(values: np.ndarray, h: float) -> np.ndarray:
    """Central differences of fourth order."""
    v = values
    return np.asarray((v[:-4] - 8 * v[1:-3] + 8 * v[3:-1] - v[4:]) / (12 * h))


def test_derived_derivatives_of_first_and_second_order_are_those_of_the_trajectory() -> None:
    diagram = Diagram.build(cart(watch=Watch()))
    run = simulate(diagram, 2.0, solver=Solver(step=0.001, output=0.002))
    first, second, v_c = (run[f"{name}"].ravel() for name in ("watch.first", "watch.second", "law.v_c"))
    np.testing.assert_allclose(first[2:-2], differences(v_c, 0.002), atol=1e-7)
    np.testing.assert_allclose(second[2:-2], differences(first, 0.002), atol=1e-6)


def test_the_reference_acceleration_of_the_ur10_is_the_derivative_of_its_reference() -> None:
    graph = Graph.read("ur10_fast")
    diagram = graph.diagram
    run = simulate(diagram, 0.5, solver=Solver(method="cvodes", output=0.002, tolerance=1e-11), start=graph.start)
    loop, model = diagram.loop, diagram.models["model"]
    assert "ddq_ref" in model.inputs
    (ddq_ref,) = loop.joined([diagram.resolver.input("model", "ddq_ref")])
    w = [leaf.symbol for leaf in loop.trajectories]
    path = ca.Function("path", [loop.time, loop.p], [leaf.expression for leaf in loop.trajectories])
    function = ca.Function("ddq_ref", [loop.state, *w, loop.p], [ddq_ref])
    found = []
    for k, t in enumerate(run.time):
        state = np.concatenate([run.states[v.label][k] for v in loop.variables])
        found.append(function(state, *path(t, loop.p_values), loop.p_values).full().ravel())
    expected = differences(run["inverse.dq_ref"], 0.002)
    # the servo's first transient is too fast for differences over 2 ms
    np.testing.assert_allclose(np.array(found)[102:-2], expected[100:], atol=2e-6)


def test_a_derivative_that_needs_an_unmeasured_rate_is_refused() -> None:
    found = fault({"wave": Wave(), "law": Law(), "cart": BlindCart(), "watch": Watch()})
    faults = found.faults
    assert all(isinstance(item, DerivativeError) for item in faults)
    assert "needs the rate of cart.y, which is neither measured nor computed by any block" in str(found)


def test_a_user_error_in_equations_names_block_file_and_line() -> None:
    class Broken(AbstractBlock):
        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations(outputs={"a": ca.SX(2, 1) + ca.SX(3, 1)})

    found = fault(cart(broken=Broken()))
    assert isinstance(found, BlockError)
    assert str(found).startswith("broken: equations(), test_diagram.py:")
    assert "\n" not in str(found)


def test_parameters_stay_symbols_with_their_values_and_units() -> None:
    loop = Diagram.build(cart()).loop
    found = {p.label: (float(p.value), p.unit) for p in loop.parameters}
    assert found == {"wave.rate": (2.0, "rad/s"), "law.k": (3.0, "1/s"), "cart.c": (5.0, "1/s")}
    assert loop.p_values.tolist() == [2.0, 3.0, 5.0]


def test_an_optional_state_is_there_if_its_rate_is() -> None:
    plain = Diagram.build({"path": Wave(), "law": Law(), "cart": OddCart()})
    counting = Diagram.build({"path": Wave(), "law": Law(), "cart": OddCart(counts=True, reads=True)})
    assert [variable.name for variable in plain.loop.plant] == ["y", "v"]
    assert [variable.name for variable in counting.loop.plant] == ["y", "v", "way"]


def test_a_state_that_is_left_out_cannot_be_read() -> None:
    with pytest.raises(BlockError, match="cart: equations read the state way, but do not state its rate"):
        Diagram.build({"path": Wave(), "law": Law(), "cart": OddCart(reads=True)})
