"""CasADi functions of a closed loop, from which every engine is made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import casadi as ca

from dmframe.common.slices import slices
from dmframe.diagram.implicit import Bodies, Implicit, systems
from dmframe.diagram.slopes import Slopes


@final
class Hoisted(NamedTuple):
    """The functions of one tick, each of (..., p, c), and c(p), the values that are constant in a run."""

    trajectory: Any
    sample: Any
    rate: Any
    clip: Any
    constants: Any


def split(bodies: Bodies, p: Any) -> tuple[list[Any], Any]:
    """Functions of (inputs..., p, c), and c(p), the values that are constant in a run."""
    flat = [ca.vertcat(*map(ca.vec, map(ca.densify, expressions))) for _, expressions in bodies.values()]
    remaining, symbols, constants = ca.extract_parametric(ca.vertcat(*flat), p)
    c = ca.SX.sym("c", len(symbols))
    (remaining,) = ca.substitute([remaining], [ca.vertcat(ca.SX(0, 1), *symbols)], [c])
    parts = iter(slices(item.numel() for _, expressions in bodies.values() for item in expressions))
    made = [
        ca.Function(name, [*inputs, p, c], [remaining[next(parts)] for _ in expressions])
        for name, (inputs, expressions) in bodies.items()
    ]
    return made, ca.Function("constants", [p], [ca.vertcat(ca.SX(0, 1), *constants)])


@final
@dataclass(frozen=True)
class Parts:
    """The functions of one tick; the state consists of z, the stepped states, and x, the integrated states.

    In continuous time z is empty and x contains all states.

    Parameters
    ----------
    trajectory
        (t, p) -> w, the exogenous signals.
    sample
        (state, w, drawn, T, p) -> (z one sample later, u): u are the plant's inputs, held until then.
    rate
        (x, u, w, p) -> dx.
    outputs
        (state, w, drawn, T, p) -> y, the recorded signals other than states.
    clip
        (x, p) -> x projected onto its sets.
    explicit
        Number of leading elements of x that a linearly implicit method integrates explicitly: those of a continuous
        controller.
    """

    trajectory: Any
    sample: Any
    rate: Any
    outputs: Any
    clip: Any
    explicit: int = 0

    @cached_property
    def hoisted(self) -> Hoisted:
        """The same functions, with the values that depend on p only computed separately."""
        p, bodies = self._bodies
        (trajectory, sample, rate, clip), constants = split(bodies, p)
        return Hoisted(trajectory, sample, rate, clip, constants)

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """What was derived from these functions, by a key of the module that made it."""
        return {}

    @cached_property
    def slopes(self) -> Slopes:
        """The plant's Jacobian, in two forms if it is expensive."""
        return Slopes.of(self.rate, self.explicit)

    @cached_property
    def implicit(self) -> tuple[Hoisted, Implicit]:
        """`hoisted`, and the functions of a linearly implicit method. Raises `EngineError` if they are too large."""
        p, bodies = self._bodies
        more = systems(self.trajectory, self.rate, self.slopes, self.explicit, p)
        (trajectory, sample, rate, clip, *made), constants = split({**bodies, **more}, p)
        return Hoisted(trajectory, sample, rate, clip, constants), Implicit(*made)

    @cached_property
    def _bodies(self) -> tuple[Any, Bodies]:
        """p, and the inputs and expressions of each function."""
        t, p = ca.SX.sym("t"), ca.SX.sym("p", self.trajectory.numel_in(1))
        state, w, drawn, period = (
            ca.SX.sym(name, self.sample.numel_in(i)) for i, name in enumerate(("state", "w", "drawn", "T"))
        )
        x, u = (ca.SX.sym(name, self.rate.numel_in(i)) for i, name in enumerate("xu"))
        seen = (state, w, drawn, period, p)
        return p, {
            "trajectory": ([t], [self.trajectory(t, p)]),
            # sample and outputs are evaluated at the same instant and share most of their operations
            "sample": (list(seen[:-1]), ca.cse([*self.sample(*seen), self.outputs(*seen)])),
            "rate": ([x, u, w], [self.rate(x, u, w, p)]),
            "clip": ([x], [self.clip(x, p)]),
        }

    @property
    def moved(self) -> bool:
        """True if trajectories act on the integrated states within a tick."""
        return bool(self.rate.jac_sparsity(0, 2).nnz() > 0)

    @property
    def sizes(self) -> dict[str, int]:
        """Number of elements of each column, by its name in the C source."""
        return {
            "Z": self.sample.numel_out(0),
            "X": self.rate.numel_in(0),
            "U": self.rate.numel_in(1),
            "W": self.rate.numel_in(2),
            "N": self.sample.numel_in(2),
            "P": self.rate.numel_in(3),
            "Y": self.outputs.numel_out(0),
        }
