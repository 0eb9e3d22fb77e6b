"""Functions of a linearly implicit step: its linear system, the first stage, and the solution of the other stages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, final

import casadi as ca

from dmframe.diagram.elimination import Elimination, residual_small
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.diagram.slopes import Slopes

Bodies = Mapping[str, tuple[Sequence[Any], Sequence[Any]]]
"""Inputs of each function, without the parameters, and its results."""


@final
class Implicit(NamedTuple):
    """Functions of a linearly implicit method in addition to those of a tick, each of (..., p, c).

    Parameters
    ----------
    moving
        (t) -> (w, its derivative by time).
    begin
        (x, u, w, dw, h) -> (factors, d, u_1) in the notation of `rosenbrock`; u_1 is NaN if the solution of the system
        is not accurate, so that the run ends there.
    solve
        (factors, right-hand side) -> u_i.
    """

    moving: Any
    begin: Any
    solve: Any


def systems(trajectory: Any, rate: Any, slopes: Slopes, explicit: int, p: Any) -> Bodies:
    """The expressions of `Implicit` from the functions of a loop (see `Parts`) and the symbol p.

    The first `explicit` states are integrated explicitly. The effect of their motion, and of that of the trajectories,
    on the rates of the other states enters through d.
    """
    x, u, w = (ca.SX.sym(name, rate.numel_in(i)) for i, name in enumerate("xuw"))
    t, h, dw = ca.SX.sym("t"), ca.SX.sym("h"), ca.SX.sym("dw", w.numel())
    (f,) = ca.cse([rate(x, u, w, p)])
    slow, fast = ca.vertsplit(f, [0, explicit, x.numel()])
    gamma = float(ROS34PW2.gamma)
    matrix = ca.SX.eye(fast.numel()) - h * gamma * slopes.used(x, u, w, p)
    elimination = Elimination.of(matrix)
    drift = ca.densify(ca.jtimes(fast, ca.vertcat(x[:explicit], w), ca.vertcat(slow, dw)))
    right = gamma * (h * fast + float(ROS34PW2.drifts[0]) * h * h * drift)
    first = ca.vertcat(ca.SX(0, 1), *elimination.solution(elimination.factors, ca.vertsplit(right)))
    trusted = residual_small(matrix, first, right)
    begun = ca.vertcat(gamma * h * slow, first + ca.if_else(trusted, 0, math.nan))
    factors = ca.vertcat(ca.SX(0, 1), *elimination.factors)
    symbols, given = ca.SX.sym("factors", factors.numel()), ca.SX.sym("right", x.numel())
    solved = elimination.solution(ca.vertsplit(symbols), ca.vertsplit(given)[explicit:])
    where = trajectory(t, p)
    return {
        "moving": ([t], [where, ca.jacobian(where, t)]),
        "begin": ([x, u, w, dw, h], ca.cse([factors, ca.vertcat(ca.SX.zeros(explicit), drift), begun])),
        "solve": ([symbols, given], [ca.vertcat(given[:explicit], *solved)]),
    }
