r"""Largest adaptation gain for a sampling period: stability of the Euler step of the adaptation.

In continuous time the adaptation :math:`\dot{\hat a} = -\Gamma Y_d^\top \sigma` is passive. Sampled, it is an Euler
step, and a servo in its quasi-steady state responds with
:math:`\sigma = -\hat w Y_d \tilde a`. With Y_d constant over the step, the estimation errors follow

.. math:: \tilde a^+ = (1 - T\, \Gamma Y_d^\top \operatorname{diag}(\hat w)\, Y_d)\, \tilde a

which grows unless :math:`T \lambda_{max}(\Gamma Y_d^\top \operatorname{diag}(\hat w) Y_d) < 2`. The analysis is
quasi-static: Y_d varies, the servo has dynamics, and w is adapted as well. It gives the order of
magnitude of the limit, not a proof.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.block.parameter import specs
from dmframe.block.port import Side
from dmframe.block.symmetric import unique
from dmframe.certify.true_values import true_values
from dmframe.diagram import Diagram
from dmframe.diagram.view import view
from dmframe.diagram.wiring import Wire
from dmframe.simulate import Solver, simulate

Array = NDArray[np.float64]

REGRESSOR, SLIDING, TORQUE, INVERSE = "Y_d", "sigma", "tau_dc", "w"

SECONDS: Final = 2.0
"""Initial part of the path that is evaluated [s]."""

_QUICK: Final = 0.002
"""Largest sampling period of the run along the path [s], independent of the graph's clock."""


@final
@dataclass(frozen=True)
class EmulationLimit:
    """Factor on the adaptation gain of a block up to the stability limit of its Euler step.

    Parameters
    ----------
    block
        Adapting block.
    gain
        Name of the gain, and its value if all elements are equal.
    at_rest, on_path
        The factor at the set-point, and the least along the first seconds of the path, with w at its true value.
    at_bound
        As `on_path`, with w at the upper end of its box; None without a box.
    """

    block: str
    gain: str
    value: float | None
    at_rest: float
    on_path: float
    at_bound: float | None

    @property
    def meaning(self) -> str:
        """Definition of the factors."""
        return (
            f"factor on {self.gain} for which T times the largest eigenvalue of Gamma Y_d' w Y_d is 2, T the sampling "
            "period: above it, the Euler step of the adaptation is unstable; a quasi-static estimate, not a proof"
        )

    @property
    def least(self) -> float:
        """The least factor."""
        return min(self.at_rest, self.on_path, self.at_bound if self.at_bound is not None else np.inf)


def emulation_limits(
    diagram: Diagram,
    clock: float,
    point: Array,
    *,
    solver: Solver | None = None,
    start: Mapping[str, Any] | None = None,
    seconds: float = SECONDS,
) -> tuple[EmulationLimit, ...]:
    """Limits of all blocks with the adaptation law Y_d' sigma in continuous time, whose torque enters an inverse.

    Parameters
    ----------
    clock
        The sampling period [s].
    point
        The set-point's state.
    """
    pairs = list(_adapting(diagram))
    if not pairs:
        return ()
    run = simulate(diagram, seconds, clock=min(clock, _QUICK), solver=solver, start=start)
    moving = np.hstack([run.states[v.label].reshape(len(run.time), -1) for v in diagram.loop.variables])
    finite = np.all(np.isfinite(moving), axis=1)
    every = max(1, int(np.count_nonzero(finite)) // 200)
    return tuple(
        _limit(diagram, clock, pair, point, run.time[finite][::every], moving[finite][::every]) for pair in pairs
    )


def _adapting(diagram: Diagram) -> Iterator[tuple[str, str]]:
    """Adapting controller blocks, each with the inverse that reads its torque."""
    for (inverse, port), source in diagram.sources.items():
        if port != TORQUE or not isinstance(source, Wire) or INVERSE not in diagram.models[inverse].states:
            continue
        model = diagram.models[source.block]
        adapts = any(item.name in model.equations.rates for item in model.estimates)
        if (
            diagram.blocks[source.block].side is Side.CONTROLLER
            and adapts
            and {REGRESSOR, SLIDING} <= set(model.inputs)
        ):
            yield source.block, inverse


def _limit(
    diagram: Diagram, clock: float, pair: tuple[str, str], point: Array, times: Array, states: Array
) -> EmulationLimit:
    block, inverse = pair
    loop, model = diagram.loop, diagram.models[block]
    (estimate,) = [item for item in model.estimates if item.name in model.equations.rates]
    Y = getattr(view(diagram, block).u, REGRESSOR)
    seen = loop.on_path(loop.acting([Y])[0])
    regressor = ca.Function("Y_d", [loop.time, loop.state, loop.p, loop.period], [ca.densify(seen)])
    growth = _growth(diagram, block, estimate.name)
    truth = true_values(diagram).get(f"{inverse}.{INVERSE}")
    w = np.asarray(truth if truth is not None else point[_places(diagram, f"{inverse}.{INVERSE}")], dtype=float)
    box = diagram.models[inverse].values.get(f"{INVERSE}_box")
    bound = None if box is None or not np.all(np.isfinite(box)) else np.broadcast_to(np.asarray(box)[..., -1], w.shape)

    def factor(w: Array, t: float, state: Array) -> float:
        largest = growth(regressor(t, state, loop.p_values, clock).full(), w)
        return 2 / (clock * largest) if largest > 0 else float("inf")

    def along(w: Array) -> float:
        return min((factor(w, float(t), x) for t, x in zip(times, states, strict=True)), default=float("inf"))

    gain = model.values.get(estimate.gain or "")
    alike = gain is not None and gain.size and np.all(_diagonal(gain) == _diagonal(gain)[0])
    return EmulationLimit(
        block=block,
        gain=f"{block}.{estimate.gain}",
        value=float(_diagonal(gain)[0]) if alike and gain is not None else None,
        at_rest=factor(w, 0.0, point),
        on_path=along(w),
        at_bound=None if bound is None else along(bound),
    )


def _diagonal(gain: Array) -> Array:
    return np.diag(gain) if gain.ndim == 2 and gain.shape[0] == gain.shape[1] else np.ravel(gain)


def _places(diagram: Diagram, label: str) -> list[int]:
    labels = [v.label for v in diagram.loop.variables for _ in range(v.symbol.numel())]
    return [place for place, other in enumerate(labels) if other == label]


def _growth(diagram: Diagram, block: str, estimate: str) -> Any:
    """(Y_d, w) -> largest eigenvalue of the torque rate of the adaptation, weighted by w."""
    model = diagram.models[block]
    x, sigma, Y = model.states[estimate], model.inputs[SLIDING], model.inputs[REGRESSOR]
    updates = -ca.jacobian(ca.vec(model.equations.rates[estimate]), ca.vec(sigma))
    acts = ca.jacobian(ca.vec(model.equations.outputs[TORQUE]), ca.vec(x))
    everything = {**model.states, **model.inputs, **model.parameters}
    zero = {name: np.zeros(symbol.shape) for name, symbol in everything.items() if symbol is not Y}
    values = {**zero, **model.values}
    kinds = specs(type(model.block))
    robot = [] if model.robot is None else [(c.symbol, model.robot.values()[c.name]) for c in model.robot.constants]
    # the elements of a symmetric gain occur twice, but function arguments must be unique
    pairs = [*(unique(kinds.get(name), everything[name], np.asarray(values[name])) for name in zero), *robot]
    slopes = ca.Function("slopes", [Y, *(symbol for symbol, _ in pairs)], [updates, acts])

    def largest(regressor: Array, w: Array) -> float:
        gain, action = (np.asarray(part.full()) for part in slopes(regressor, *(value for _, value in pairs)))
        product = np.diag(w) @ action @ gain
        return float(np.max(np.linalg.eigvals(product).real, initial=0.0)) if np.all(np.isfinite(product)) else 0.0

    return largest


__all__ = ["EmulationLimit", "emulation_limits"]
