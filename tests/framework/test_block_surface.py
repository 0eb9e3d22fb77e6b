"""The authors' interface: one import line, ports by kind, and errors that contain the remedy."""

from __future__ import annotations

from typing import Any

import pytest

from dmframe.block import AbstractBlock, Diagonal, Equations, Input, Output, Positive, Real, Scalar, State
from dmframe.block.port import Port
from dmframe.common.errors import BlockError, DmframeError
from dmframe.diagram import Diagram


class Integral(AbstractBlock):
    """Integral action, dz/dt = e, u = K z."""

    inputs = (Input("e", "2", "rad"),)
    outputs = (Output("u", "2", "rad/s"),)
    states = (State("z", "2", "rad s"),)
    K: Diagonal = Positive("2", "1/s^2")

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations({"u": p.K * x.z}, rates={"z": u.e})


class Constant(AbstractBlock):
    """A constant error."""

    outputs = (Output("e", "2", "rad"),)
    value: Scalar = Real(unit="rad", default=1.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations({"e": p.value * [1, 1]})


def test_a_block_without_final_and_classvar_runs() -> None:
    diagram = Diagram.build({"i": Integral(K=2.0), "c": Constant()})
    assert [variable.label for variable in diagram.loop.variables] == ["i.z"]


@pytest.mark.parametrize("field", ["access", "full_rank", "instead_of", "rounded_by", "notice", "steps", "shown"])
def test_an_input_has_no_field_of_an_output(field: str) -> None:
    with pytest.raises(TypeError, match=field):
        Input("e", **{field: "x"})


@pytest.mark.parametrize("field", ["drawn", "ahead_of", "ahead"])
def test_an_output_has_no_field_of_an_input(field: str) -> None:
    with pytest.raises(TypeError, match=field):
        Output("e", **{field: "x"})


def test_ports_of_the_other_kind_are_refused() -> None:
    with pytest.raises(BlockError, match="Wrong: expected each of its inputs to be an Input, found Output"):
        type("Wrong", (Integral,), {"__module__": __name__, "inputs": (Output("e", "2", "rad"),)})


def test_the_former_port_becomes_an_input_or_an_output_with_a_notice() -> None:
    members = {"inputs": (Port("e", "2", "rad"),), "outputs": (Port("u", "2", "rad/s"),), "__module__": __name__}
    with pytest.warns(DeprecationWarning, match=r"Former: write (Input|Output)\(\.\.\.\) instead of Port"):
        former = type("Former", (Integral,), members)
    assert (former.inputs, former.outputs) == (Integral.inputs, Integral.outputs)
    with (
        pytest.warns(DeprecationWarning, match="instead of Port"),
        pytest.raises(BlockError, match="Bad: e: an input has no field shown"),
    ):
        type("Bad", (Integral,), {"inputs": (Port("e", "2", shown="an error"),), "__module__": __name__})


def test_the_error_for_a_plain_float_states_what_to_write() -> None:
    class Plain(Integral):
        K: float = 2.0

    with pytest.raises(DmframeError, match=r"its equations read K, a parameter annotated `float`; .* K: Scalar = Real"):
        Diagram.build({"i": Plain(), "c": Constant()})
