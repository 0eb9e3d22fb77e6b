"""Blocks: parameters, names, the contract of a class, and the signals that equations may read."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import pytest
from pydantic import Field

from dmframe.block import AbstractBlock, Equations, Signals, type_name
from dmframe.block.base import TRUE_VALUES
from dmframe.block.parameter import Box, Diagonal, Interval, Positive, Real, Scalar
from dmframe.block.port import Input, Output, State
from dmframe.common.errors import BlockError, DmframeError, Faults, MissingError, UnknownNameError, ValueFault


class LeakyThing(AbstractBlock):
    rate: Scalar = Positive("", "1/s")
    offset: Diagonal = Real("n", "m", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations()


def fault(kind: type[AbstractBlock], **values: Any) -> DmframeError:
    with pytest.raises(DmframeError) as caught:
        kind(**values)
    return caught.value


def test_a_type_is_the_class_name_in_snake_case() -> None:
    assert type_name(LeakyThing) == "leaky_thing"


def test_parameters_are_read_with_their_units() -> None:
    block = LeakyThing(rate="2 1/s", offset=["1 mm", 2])
    assert (block.rate, block.offset) == (2.0, (0.001, 2.0))


def test_a_misspelt_parameter_is_reported_once_with_the_nearest() -> None:
    found = fault(LeakyThing, rat=1)
    assert isinstance(found, UnknownNameError)
    assert str(found) == "leaky_thing.rat: unknown parameter of leaky_thing; did you mean rate?"
    assert found.path == ("rat",)


def test_a_missing_parameter_is_reported_with_its_unit() -> None:
    found = fault(LeakyThing)
    assert isinstance(found, MissingError)
    assert str(found) == "leaky_thing: leaky_thing needs the parameter rate [1/s]"


def test_all_faults_of_a_block_are_reported_together() -> None:
    found = fault(LeakyThing, rate=-1, offset="x", self=3)
    assert isinstance(found, Faults)
    assert [type(item) for item in found.faults] == [ValueFault, ValueFault, UnknownNameError]


class Counted(AbstractBlock):
    kept: int = Field(3, ge=1)
    delay: Literal[0, 1, 2] = 0
    late: Literal["no"] | int = 1
    filtered: bool = True
    name: str = ""

    def sizes(self, robot: Any) -> dict[str, int]:
        return {"W": self.kept}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations()


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"kept": True}, "counted.kept: expected a whole number, found true"),
        ({"kept": "3"}, "counted.kept: expected a whole number, found '3'"),
        ({"kept": 2.5}, "counted.kept: expected a whole number, found 2.5"),
        ({"kept": [1]}, "counted.kept: expected a whole number, found [1]"),
        ({"kept": 0}, "counted.kept: expected a whole number, at least 1, found 0"),
        ({"delay": True}, "counted.delay: expected a whole number, found true"),
        ({"delay": 3}, "counted.delay: expected 0, 1 or 2, found 3"),
        ({"late": False}, "counted.late: expected a whole number, found false"),
        ({"filtered": 1}, "counted.filtered: expected true or false, found 1"),
        ({"filtered": "yes"}, "counted.filtered: expected true or false, found 'yes'"),
        ({"filtered": []}, "counted.filtered: expected true or false, found []"),
    ],
)
def test_a_truth_a_number_and_a_text_are_reported_separately(values: dict[str, Any], text: str) -> None:
    assert str(fault(Counted, **values)) == text


def test_what_is_one_passes() -> None:
    block = Counted(kept=4.0, delay=2, late="no", filtered=False, name="x")
    assert (block.kept, block.delay, block.late, block.filtered, block.name) == (4, 2, "no", False, "x")


@pytest.mark.parametrize("kept", [10_001, 10**9, 10**30])
def test_a_size_that_no_machine_holds_is_refused(kept: int) -> None:
    with pytest.raises(BlockError, match="counted: expected at most 10000 for the size W, found 1"):
        Counted(kept=kept).evaluate()


def test_equations_that_read_what_is_not_there_name_the_nearest() -> None:
    signals = Signals("task", "inputs", {"dq_ref": 1, "sigma": 2})
    assert signals.sigma == 2
    assert "sigma" in signals
    assert list(signals) == ["dq_ref", "sigma"]
    with pytest.raises(BlockError) as caught:
        _ = signals.dq_reff
    assert str(caught.value) == "task: its equations read dq_reff, which is none of its inputs; did you mean dq_ref?"
    true = Signals("task", TRUE_VALUES, {"a_d": 1})
    with pytest.raises(BlockError) as caught:
        _ = true.a_k
    text = "its certificate reads a_k, which is none of the true values that `truth` declares and this diagram has"
    assert str(caught.value) == f"task: {text}; did you mean a_d?"


@pytest.mark.parametrize(
    ("members", "text"),
    [
        ({"inputs": (Input("c"), Input("c"))}, "declares the input c twice"),
        ({"inputs": (Input("a"),)}, "has an input and a parameter called a; rename one"),
        ({"states": (State("a", "", "fortnight"),)}, "the unit of the state a: unknown unit fortnight; "),
        (
            {"inputs": (Input("dc", derivative_of="b"), Input("c"))},
            "the input dc is declared the derivative of b, unknown; choose from c, dc",
        ),
        (
            {"states": (State("a", box="a_bux"),)},
            "the box of a is a_bux, not an Interval parameter; did you mean a_box?",
        ),
        (
            {"states": (State("b_d_hat"),), "outputs": (Output("b_hat_d"),)},
            "its names b_hat_d and b_d_hat both print as b\u0302_d; rename one",
        ),
        ({"states": (State("alpha"),), "inputs": (Input("α"),)}, "its names α and alpha both print as α; rename one"),
        ({"states": (State("у"),)}, r"the name '\u0443' contains '\u0443', not a Latin or known Greek letter"),
        ({"inputs": (Input("x - y"),)}, "expected a name such as K_star, found 'x - y'"),
        ({"states": (State("a", "n"),)}, "the parameter a and the state that it initialises have different shapes"),
    ],
)
def test_a_class_that_breaks_the_contract_is_reported_how(members: dict[str, Any], text: str) -> None:
    class Bad(AbstractBlock):
        a: Scalar = Real(default=0.0)
        a_box: Box = Interval()
        inputs: ClassVar[Any] = members.get("inputs", ())
        outputs: ClassVar[Any] = members.get("outputs", ())
        states = members.get("states", ())

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations()

    (found,) = Bad.contract("mine")
    assert isinstance(found, BlockError)
    assert str(found).startswith(f"mine: {text}")


def test_a_block_with_no_more_than_equations_keeps_the_contract() -> None:
    block = LeakyThing(rate=1)
    nothing = Signals("", "", {})
    assert LeakyThing.contract("mine") == []
    assert block.certificate(nothing, nothing, nothing, nothing) is None
    assert block.sizes(None) == {}


@pytest.mark.parametrize(
    ("written", "name"),
    [
        ("PIReference", "pi_reference"),
        ("PidInverse", "pid_inverse"),
        ("MyPID", "my_pid"),
        ("Arm2DModel", "arm2_d_model"),
    ],
)
def test_an_acronym_stays_together_in_the_name_of_a_type(written: str, name: str) -> None:
    assert type_name(type(written, (AbstractBlock,), {})) == name
