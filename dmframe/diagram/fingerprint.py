"""A fingerprint of the closed loop: what was proved is what ran, if both have the same."""

from __future__ import annotations

import hashlib
from typing import Any

import casadi as ca

from dmframe.diagram.closed_loop import ClosedLoop, stack
from dmframe.program import CONST, instructions


def fingerprint(loop: ClosedLoop) -> str:
    """SHA-256 of the closed loop's vector field, in hexadecimal digits.

    It covers the names and sizes of the states, their rates operation by operation and constant by constant, with the
    measured and commanded signals, the trajectories as functions of time and the laws of the projections put in, and
    the labels and values of all parameters. It does not depend on how the graph file is laid out, on the clock, or on
    the solver. Nothing is rounded: a constant enters as the bits of its double.
    """
    digest = hashlib.sha256()
    for line in _lines(loop):
        digest.update(line.encode())
        digest.update(b"\n")
    return digest.hexdigest()


def _lines(loop: ClosedLoop) -> list[str]:
    """The field as text; the instructions are numbered by CasADi in the order in which it evaluates them."""
    variables = (*loop.controller, *loop.plant)
    lines = [f"state {variable.label} {variable.symbol.shape}" for variable in variables]
    for parameter in loop.parameters:
        values = " ".join(float(value).hex() for value in parameter.value.ravel(order="F"))
        lines.append(f"parameter {parameter.label} {parameter.symbol.shape} {values}")
    return [*lines, *_instructions(_field(loop))]


def _field(loop: ClosedLoop) -> Any:
    """(t, states, parameters) -> rates, and where each projection puts its state after a finite step."""
    held = [projection.set.held(projection.state) for projection in loop.projections]
    rates = [variable.rate for variable in (*loop.controller, *loop.plant)]
    whole = stack(loop.joined([*rates, *held]))
    for projection in reversed(loop.projections):  # the nominal rate of a later one may hold an earlier correction
        (law,) = loop.joined([projection.law])
        whole = ca.substitute(whole, projection.correction, law)
    leaves = stack(leaf.symbol for leaf in loop.trajectories)
    whole = ca.substitute(whole, leaves, stack(leaf.expression for leaf in loop.trajectories))
    return ca.Function("field", [loop.time, loop.state, loop.p], [whole])


def _instructions(function: Any) -> list[str]:
    return [
        f"{code} {read} {written} {constant.hex() if code == CONST else ''}"
        for code, read, written, constant in instructions(function)
    ]
