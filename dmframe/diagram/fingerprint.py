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
    kinds = ((variable, "state" if variable.next is None else "sampled") for variable in loop.variables)
    lines = [f"{kind} {variable.label} {variable.symbol.shape}" for variable, kind in kinds]
    lines += [f"{noise.distribution} {noise.label} {noise.symbol.shape}" for noise in loop.noises]
    for parameter in loop.parameters:
        values = " ".join(float(value).hex() for value in parameter.value.ravel(order="F"))
        lines.append(f"parameter {parameter.label} {parameter.symbol.shape} {values}")
    return [*lines, *_instructions(_field(loop))]


def _field(loop: ClosedLoop) -> Any:
    """(t, states, p, drawn, T) -> rates or next values, and where projections put their states after a finite step."""
    held = [projection.set.held(projection.state) for projection in loop.projections]
    moves = [variable.rate if variable.next is None else variable.next for variable in loop.variables]
    moves += [variable.second for variable in loop.variables if variable.second is not None]
    whole = loop.on_path(stack(loop.acting([*moves, *held])))
    return ca.Function("field", [loop.time, loop.state, loop.p, loop.drawn, loop.period], [whole])


def _instructions(function: Any) -> list[str]:
    return [
        f"{code} {read} {written} {constant.hex() if code == CONST else ''}"
        for code, read, written, constant in instructions(function)
    ]
