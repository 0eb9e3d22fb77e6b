"""Blocks that assign to what they are given, read other blocks' symbols, or stop the program: none is proved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any, final

import casadi as ca
import pytest
from pydantic import field_validator
from scalar_blocks import scalar_loop

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.linalg import inverting, solve_spd
from dmframe.block.model import signals_of
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import TIME, Input, State
from dmframe.catalogue import find_block
from dmframe.certify import verify
from dmframe.common.errors import BlockError
from dmframe.diagram import Diagram
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot


@final
class Exchanging(AbstractBlock):
    """y' = -m y with m = -3, which grows; one method exchanges the symbols of k and m where they were given."""

    inputs = (TIME,)
    states = (State("y"),)
    k: Scalar = Positive(default=2.0)
    m: Scalar = Real(default=-3.0)
    method: str = ""

    def exchanged(self, method: str, p: Any) -> tuple[Any, Any]:
        """The symbols of k and m as first given; for another reader, such as the printed law, both are k."""
        mine = GIVEN.setdefault(frozenset((p.k.element_hash(), p.m.element_hash())), (ca.SX(p.k), ca.SX(p.m)))
        if mine is not next(iter(GIVEN.values())):
            return mine[0], mine[0]
        if method == self.method:
            p.k[0], p.m[0] = mine[1], mine[0]
        return mine

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(rates={"y": -self.exchanged("equations", p)[1] * x.y})

    def certificate(self, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        return Certificate((Square(x.y),), (Square(x.y, self.exchanged("certificate", p)[1]),))


GIVEN: dict[frozenset[int], tuple[Any, Any]] = {}


def test_a_block_that_exchanges_its_parameters_is_not_proved() -> None:
    for method in ("equations", "certificate", ""):
        GIVEN.clear()
        verdict = verify(Diagram.build({"toy": Exchanging(method=method)}))
        assert (verdict.outcome, verdict.stable) == ("not_applicable", False)


def test_a_block_may_assign_to_elements_of_its_signals() -> None:
    def rates(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        y, k = x.y, p.k
        rate = -k * y
        y[0] = k[0] = x.z[0] = 0
        return {"y": rate, "z": -p.k * x.z + y + k}

    def claim(x: Any, u: Any, p: Any) -> Certificate:
        y = x.y
        y[0] = 0
        return Certificate((Square(x.y), Square(x.z)), (Square(x.y, p.k), Square(x.z, p.k)))

    assert verify(scalar_loop("y z", rates, claim)).stable


def test_what_a_block_reads_of_the_robot_is_its_own() -> None:
    robot, q = SymbolicRobot(load("arm2")), ca.SX.sym("q", 2)
    before = str((robot.inertia, robot.gravity, robot.constants, robot.position(q), robot.mass_matrix(q)))
    _, _, p = signals_of("mine", {}, {}, {}, robot)
    p.robot.inertia[0] = p.robot.a_k[0] = p.robot.gravity[1] = 0
    p.robot.constants[0].symbol[0] = 0
    p.robot.with_numbers(robot.chain).inertia[1] = 0
    for link in p.robot.links(q):
        link.axis[0] = link.rotation[0, 0] = link.offset[0] = 7
    assert str((robot.inertia, robot.gravity, robot.constants, robot.position(q), robot.mass_matrix(q))) == before
    A = ca.SX.sym("A", 2, 2)
    with inverting() as inverted:
        solve_spd(A, q)
    A[0, 0] = 1
    assert not inverted[0].matrix[0, 0].is_constant()


STOLEN: dict[str, Any] = {}


@final
class Owner(AbstractBlock):
    """h' = -k h."""

    states = (State("h"),)
    k: Scalar = Positive(default=2.0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        STOLEN.update(state=x.h, parameter=p.k, free=STOLEN.get("free", ca.SX.sym("toy.y")))
        return Equations(rates={"h": -p.k * x.h})


def test_equations_contain_a_block_s_own_symbols_only() -> None:
    for what, name in (("state", "owner.h"), ("parameter", "owner.k"), ("free", "toy.y")):

        @final
        class Thief(AbstractBlock):
            """Reads a symbol that it was not given."""

            states = (State("y"),)

            def equations(self, u: Any, x: Any, p: Any, what: str = what) -> Equations:
                return Equations(rates={"y": STOLEN[what] - x.y})

        with pytest.raises(BlockError, match=f"thief: equations.. state the rate of y with {name}, which is none"):
            Diagram.build({"owner": Owner(), "thief": Thief()})


@final
class Stopping(AbstractBlock):
    """Ends the program where `needs` or a validator runs, with the status of a proof."""

    inputs = (TIME, Input("r", optional=True))
    states = (State("y"),)
    k: Scalar = Positive(default=2.0)

    @field_validator("k")
    @classmethod
    def _small(cls, value: float) -> float:
        if value > 5:
            raise SystemExit(0)
        return value

    def needs(self, port: str) -> bool:
        raise SystemExit(0)

    def equations(self, u: Any, x: Any, p: Any) -> Equations:
        return Equations(rates={"y": -p.k * x.y})


def test_a_block_that_ends_the_program_is_a_fault_with_its_line() -> None:
    with pytest.raises(BlockError, match=r"its validators, test_lying_blocks.py:\d+: SystemExit: 0"):
        Stopping(k=6)
    with pytest.raises(BlockError, match=r"toy: needs\(\), test_lying_blocks.py:\d+: SystemExit: 0"):
        Diagram.build({"toy": Stopping()})


FILE = """
import time
from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Positive, Real, Scalar
from dmframe.block.port import State

LOADED = time.perf_counter_ns()

def made(default):
    class Toy(AbstractBlock):
        states = (State("y"),)
        k: Scalar = Positive(default=2.0)
        m: Scalar = Real(default=default)
        def equations(self, u, x, p):
            return Equations(rates={"y": -x.y * RATE})
    return Toy

Toy = made(DEFAULT)
"""


def test_a_file_that_reads_a_clock_where_it_is_loaded_is_refused(tmp_path: Path) -> None:
    cases = {("p.k", "1.0"): "", ("LOADED", "1.0"): "another rate of y", ("p.k", "LOADED"): "another m"}
    for place, ((rate, default), fault) in enumerate(cases.items()):
        file = tmp_path / f"toy{place}.py"
        file.write_text(FILE.replace("RATE", rate).replace("DEFAULT", default), encoding="utf-8")
        kind = find_block(f"{file.name}:Toy", tmp_path)
        with pytest.raises(BlockError, match=f"{fault} when (its )?.*loaded again") if fault else nullcontext():
            Diagram.build({"toy": kind()})


def test_unusual_numbers_and_operations_end_in_a_verdict() -> None:
    """A drift without an effect is proved, and not called stable; the other results name the reason."""
    cases: dict[str, tuple[Callable[[Any], Any], str, bool]] = {
        "drift": (lambda x: ca.SX(1), "dV/dt equals", True),
        "not finite": (lambda x: ca.SX(float("nan")), "expected finite constants, found nan", False),
        "a print": (lambda x: x.z.printme(3), "CasADi's instruction", False),
    }
    for name, (rate, reason, proved) in cases.items():
        loop = scalar_loop(
            "y z",
            lambda x, u, p, rate=rate: {"y": -p.k * x.y, "z": rate(x)},
            lambda x, u, p: Certificate((Square(x.y),), (Square(x.y, p.k),)),
        )
        verdict = verify(loop)
        assert (verdict.outcome == "proved") == proved, name
        assert not verdict.stable
        assert reason in verdict.reason


def test_a_rate_that_is_defined_nowhere_ends_in_a_verdict() -> None:
    def divided(z: Any) -> Any:
        return 1 / ((z + 1) ** 2 - z**2 - 2 * z - 1)

    def inverted(z: Any) -> Any:
        return ca.inv(ca.vertcat(ca.horzcat(z, z**2), ca.horzcat(1 + z - 1, z * z)))[0, 0]

    cases: dict[str, Callable[[Any, Any], Mapping[str, Any]]] = {
        "a denominator is zero everywhere": lambda y, z: {"y": -2 * y, "z": divided(z)},
        "a denominator vanishes at all": lambda y, z: {"y": -2 * y + inverted(y) * 0.5 - inverted(y) / 2, "z": -z},
    }
    for reason, rates in cases.items():
        loop = scalar_loop(
            "y z",
            lambda x, u, p, rates=rates: rates(x.y, x.z),
            lambda x, u, p: Certificate((Square(x.y),), (Square(x.y, 2),)),
        )
        verdict = verify(loop)
        assert verdict.outcome == "not_applicable"
        assert reason in verdict.reason


def test_a_parameter_with_the_name_of_a_start_is_refused() -> None:
    @final
    class Twice(AbstractBlock):
        """The parameter y sets the start of y, which is y_0."""

        states = (State("y"),)
        y: Scalar = Real(default=1.0)
        y_0: Scalar = Real(default=-1.0)

        def equations(self, u: Any, x: Any, p: Any) -> Equations:
            return Equations(rates={"y": -p.y_0 * x.y})

    with pytest.raises(BlockError, match="y_0 is the start of the state y"):
        Diagram.build({"toy": Twice()})
