"""What a closed loop is made of, as CasADi functions: the one set of expressions from which every engine runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import casadi as ca

from dmframe.diagram.elimination import Elimination, residual_small
from dmframe.diagram.rosenbrock import ROS34PW2
from dmframe.diagram.slopes import slopes


@final
class Hoisted(NamedTuple):
    """The functions of one tick, each of (..., p, c), and c as a function of p: what stays the same for a run."""

    trajectory: Any
    sample: Any
    rate: Any
    clip: Any
    constants: Any


@final
class Slopes(NamedTuple):
    """(x, u, w, p) -> what a linearly implicit method uses of the Jacobian of the plant's rates, and all of it.

    They are one object where it uses all.
    """

    used: Any
    exact: Any


@final
class Implicit(NamedTuple):
    """What a linearly implicit method takes beside a tick's functions, each of (..., p, c).

    Parameters
    ----------
    moving
        (t) -> (w, its derivative by time).
    begin
        (x, u, w, dw, h) -> (factors, drift, u_1): the linear system of a step, d of (1) in `rosenbrock`, and the first
        stage, not a number where the system has no solution that can be trusted.
    solve
        (factors, right-hand side) -> u_i.
    """

    moving: Any
    begin: Any
    solve: Any


def split(bodies: Mapping[str, tuple[Sequence[Any], Sequence[Any]]], p: Any) -> tuple[list[Any], Any]:
    """Functions of (inputs..., p, c), and c as a function of p: what stays the same for a whole run."""
    flat = [ca.vertcat(*map(ca.vec, map(ca.densify, expressions))) for _, expressions in bodies.values()]
    remaining, symbols, constants = ca.extract_parametric(ca.vertcat(*flat), p)
    c = ca.SX.sym("c", len(symbols))
    (remaining,) = ca.substitute([remaining], [ca.vertcat(ca.SX(0, 1), *symbols)], [c])
    made, first = list[Any](), 0
    for name, (inputs, expressions) in bodies.items():
        outputs = list[Any]()
        for expression in expressions:
            outputs.append(remaining[first : first + expression.numel()])
            first += expression.numel()
        made.append(ca.Function(name, [*inputs, p, c], outputs))
    return made, ca.Function("constants", [p], [ca.vertcat(ca.SX(0, 1), *constants)])


@final
@dataclass(frozen=True)
class Parts:
    """The functions of one tick; the state is what a sample moves, z, then what is integrated, x.

    In continuous time z is empty and x is everything.

    Parameters
    ----------
    trajectory
        (t, p) -> w: what moves by itself.
    sample
        (state, w, drawn, T, p) -> (z one sample later, u): u is what the plant is given, held until then.
    rate
        (x, u, w, p) -> dx.
    outputs
        (state, w, drawn, T, p) -> y: what is recorded beside the state.
    clip
        (x, p) -> x put back into its sets.
    explicit
        How many of x, its first, a linearly implicit method integrates explicitly: the controller's in continuous time.
    """

    trajectory: Any
    sample: Any
    rate: Any
    outputs: Any
    clip: Any
    explicit: int = 0

    @cached_property
    def hoisted(self) -> Hoisted:
        """The same, with what follows from p alone taken out of each."""
        p, bodies = self._bodies
        (trajectory, sample, rate, clip), constants = split(bodies, p)
        return Hoisted(trajectory, sample, rate, clip, constants)

    @cached_property
    def implicit(self) -> tuple[Hoisted, Implicit]:
        """The same, and the functions of a linearly implicit method. Raises `EngineError` where they are too large."""
        p, bodies = self._bodies
        (trajectory, sample, rate, clip, *more), constants = split({**bodies, **self._linear(p)}, p)
        return Hoisted(trajectory, sample, rate, clip, constants), Implicit(*more)

    @cached_property
    def slopes(self) -> Slopes:
        """The plant's Jacobian, in two forms where it is dear."""
        x, u, w, p = (ca.SX.sym(name, self.rate.numel_in(i)) for i, name in enumerate("xuwp"))
        (rates,) = ca.cse([self.rate(x, u, w, p)[self.explicit :]])
        used, exact = slopes(rates, x[self.explicit :], ca.vertcat(x[: self.explicit], u, w, p))
        made = ca.Function("exact", [x, u, w, p], [exact])
        return Slopes(made if used is exact else ca.Function("used", [x, u, w, p], [used]), made)

    def _linear(self, p: Any) -> dict[str, tuple[Sequence[Any], Sequence[Any]]]:
        x, u, w = (ca.SX.sym(name, self.rate.numel_in(i)) for i, name in enumerate("xuw"))
        t, h, dw, first = ca.SX.sym("t"), ca.SX.sym("h"), ca.SX.sym("dw", w.numel()), self.explicit
        (f,) = ca.cse([self.rate(x, u, w, p)])
        _, plant = ca.vertsplit(x, [0, first, x.numel()])
        _, rates = ca.vertsplit(f, [0, first, x.numel()])
        gamma = float(ROS34PW2.gamma)
        matrix = ca.SX.eye(plant.numel()) - h * gamma * self.slopes.used(x, u, w, p)
        elimination = Elimination.of(matrix)
        drift = ca.densify(ca.jtimes(rates, ca.vertcat(x[:first], w), ca.vertcat(f[:first], dw)))
        right = gamma * (h * rates + h * h * float(ROS34PW2.drifts[0]) * drift)
        solved = ca.vertcat(ca.SX(0, 1), *elimination.solution(elimination.factors, ca.vertsplit(right)))
        trusted = residual_small(matrix, solved, right) if plant.numel() else ca.SX(1)
        begun = ca.vertcat(gamma * h * f[:first], solved + ca.if_else(trusted, 0, math.nan))
        factors = ca.vertcat(ca.SX(0, 1), *elimination.factors)
        symbols, given = ca.SX.sym("factors", factors.numel()), ca.SX.sym("right", x.numel())
        after = elimination.solution(ca.vertsplit(symbols), ca.vertsplit(given)[first:])
        where = self.trajectory(t, p)
        return {
            "moving": ([t], [where, ca.jacobian(where, t)]),
            "begin": ([x, u, w, dw, h], ca.cse([factors, ca.vertcat(ca.SX.zeros(first), drift), begun])),
            "solve": ([symbols, given], [ca.vertcat(given[:first], *after)]),
        }

    @cached_property
    def _bodies(self) -> tuple[Any, dict[str, tuple[Sequence[Any], Sequence[Any]]]]:
        """p, and of each function its inputs and expressions."""
        t, p = ca.SX.sym("t"), ca.SX.sym("p", self.trajectory.numel_in(1))
        state, w, drawn, period = (
            ca.SX.sym(name, self.sample.numel_in(i)) for i, name in enumerate(("state", "w", "drawn", "T"))
        )
        x, u = (ca.SX.sym(name, self.rate.numel_in(i)) for i, name in enumerate("xu"))
        seen = (state, w, drawn, period, p)
        return p, {
            "trajectory": ([t], [self.trajectory(t, p)]),
            # sample and outputs see the same instant, and share most of their work
            "sample": (list(seen[:-1]), ca.cse([*self.sample(*seen), self.outputs(*seen)])),
            "rate": ([x, u, w], [self.rate(x, u, w, p)]),
            "clip": ([x], [self.clip(x, p)]),
        }

    @property
    def moved(self) -> bool:
        """True where trajectories act within a tick, on what is integrated."""
        return bool(self.rate.jac_sparsity(0, 2).nnz() > 0)

    @property
    def sizes(self) -> dict[str, int]:
        """How many numbers each column holds, by its name in the C source."""
        return {
            "Z": self.sample.numel_out(0),
            "X": self.rate.numel_in(0),
            "U": self.rate.numel_in(1),
            "W": self.rate.numel_in(2),
            "N": self.sample.numel_in(2),
            "P": self.rate.numel_in(3),
            "Y": self.outputs.numel_out(0),
        }
