"""Linearisation of the closed loop at a set-point: continuous-time and sampled poles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.memory import without_memory
from dmframe.analysis.rounding import unrounded
from dmframe.analysis.set_point import (
    LARGE,
    MOST,
    at_rest,
    at_set_point,
    computable,
    equilibrium,
    frozen,
    moves,
    period_of,
    rates,
    undrawn,
)
from dmframe.analysis.switches import turning
from dmframe.common.errors import EngineError, ShapeError, listed
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.simulate import Solver
from dmframe.simulate.instants import DRAWN
from dmframe.simulate.step import build_step

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FRICTION_VELOCITY: Final = "robot.friction_velocity"
_SATURATED: Final = 1e12  # [rad/s]; makes the slope of smooth Coulomb friction zero
_NULL: Final = 1e-9
"""Singular values below this, relative to the largest of the balanced matrix, count as zero."""

_PARTED: Final = 1e-6
"""Imaginary parts below this, relative to the modulus, count as zero: rounding splits a double real pole."""


@final
@dataclass(frozen=True)
class Linear:
    r"""Linearised loop; x is the deviation of all states, with the controller's z first.

    .. math:: \dot x = A x + B w, \qquad z^+ = Z(T) x, \quad u = D x, \qquad \dot x_p = A_p x_p + B_p u

    with w the desired trajectory and its derivatives, Z `advanced`, D `command`, :math:`A_p` `plant_A` and
    :math:`B_p` `plant_B`. In a discrete-time loop, z includes the plant's sampled states, u every signal that is held
    over a sample, and rows of A for sampled states give the change per sample.

    Parameters
    ----------
    states, trajectories, commands
        Labels, one an element: ``"inverse.w[0]"``.
    point
        The state at which it was linearised.
    controller
        Number of controller states or sampled states.
    drift
        Largest rate at `point`; it would be zero at an equilibrium.
    advanced
        Z as a function of the period T [s]: Jacobian of the map over one sample, as in a run.
    kinks
        Operations whose slope jumps at `point`: the linearisation is one-sided.
    clock
        Period [s] at which a discrete-time loop was linearised; None in continuous time.
    at_period
        The same loop at its set-point for another period; only with a `clock`, or with a step that depends on the
        period.
    period
        Period [s] of `point` and the Jacobians; zero in continuous time.
    """

    states: tuple[str, ...]
    trajectories: tuple[str, ...]
    commands: tuple[str, ...]
    point: Array
    controller: int
    drift: float
    A: Array
    B: Array
    advanced: Callable[[float], Array]
    command: Array
    plant_A: Array
    plant_B: Array
    kinks: tuple[str, ...] = ()
    clock: float | None = None
    at_period: Callable[[float], Linear] | None = None
    period: float = 0.0

    @cached_property
    def _others(self) -> Array:
        """Orthonormal basis of the complement of the equilibrium directions."""
        rest = rest_space(self.A)
        return np.asarray(np.linalg.qr(rest, mode="complete")[0][:, rest.shape[1] :])

    @property
    def poles(self) -> Complex:
        """Eigenvalues of A [1/s], without those at zero; slowest first. Empty for a discrete-time loop."""
        if self.clock is not None:
            return np.zeros(0, dtype=complex)
        found = np.linalg.eigvals(self._others.T @ self.A @ self._others)
        return np.asarray(found[np.lexsort((found.imag, -found.real))], dtype=complex)

    def pole(self, place: int) -> complex | None:
        """The slowest pole (0) or the fastest (-1), if there is one.

        Imaginary parts within the rounding error of a double real pole count as zero.
        """
        if not len(self.poles):
            return None
        found = complex(self.poles[np.argsort(np.abs(self.poles))][place])
        return complex(found.real) if abs(found.imag) <= _PARTED * abs(found) else found

    @property
    def at_rest(self) -> int:
        """Number of zero eigenvalues of A (equilibrium coordinates), such as unexcited estimates."""
        return self._resting[0] if self.clock is not None else len(self.states) - int(self._others.shape[1])

    @property
    def ramp_modes(self) -> int:
        """Number of ramp modes (Jordan blocks at one) of a discrete-time loop; 0 for continuous ones."""
        return self._resting[1] if self.clock is not None else 0

    @cached_property
    def _resting(self) -> tuple[int, int]:
        still, all_of_them = _rest_on_a_clock(self._remembering(self.sampled(self.clock or 1.0)))
        return int(still.shape[1]), int(all_of_them.shape[1] - still.shape[1])

    def _remembering(self, Phi: Array) -> Array:
        return without_memory(Phi) if len(Phi) > LARGE else Phi

    def on(self, period: float) -> Linear:
        """Linearisation at the set-point for that period [s]."""
        return self if self.at_period is None or period == self.period else self.at_period(period)

    def sampled(self, period: float) -> Array:
        r"""The state's transition over one tick of that period [s].

        The controller's step as in a run, and exact zero-order hold for the plant:

        .. math:: z^+ = Z(T) x, \qquad
            x_p^+ = e^{A_p T} x_p + \int_0^T e^{A_p \tau} d\tau\, B_p\, D x.
        """
        from scipy.linalg import expm

        if self.on(period) is not self:
            return self.on(period).sampled(period)
        size, inputs = self.plant_B.shape
        joined = np.zeros((size + inputs, size + inputs))
        joined[:size, :size], joined[:size, size:] = self.plant_A * period, self.plant_B * period
        with np.errstate(all="ignore"):  # overflows are reported with the poles
            held = expm(joined)
        Phi = np.zeros_like(self.A)
        Phi[: self.controller] = self.advanced(period)
        with np.errstate(all="ignore"):
            Phi[self.controller :] = held[:size, size:] @ self.command
            Phi[self.controller :, self.controller :] += held[:size, :size]
        return Phi

    def sampled_poles(self, period: float) -> Complex:
        """Eigenvalues of `sampled`, without those at one, largest first."""
        found = self._multipliers(period)
        if found is None:
            raise EngineError(f"linearise: the transition over a tick of {period:g} s overflows; take a faster clock")
        return np.asarray(found[np.argsort(-np.abs(found))], dtype=complex)

    def spectral_radius(self, period: float) -> float:
        """Largest modulus of `sampled_poles`, infinite on overflow; the loop converges if it is below 1."""
        found = self._multipliers(period)
        return float("inf") if found is None else float(np.max(np.abs(found), initial=0.0))

    def _multipliers(self, period: float) -> Complex | None:
        """Eigenvalues of `sampled`, without those at one; None where the transition overflows."""
        try:
            here = self.on(period)
        except EngineError:  # no equilibrium at this period
            return None
        Phi = here.sampled(period)
        if not np.max(np.abs(Phi), initial=0.0) < MOST:  # nan too
            return None
        if self.clock is not None:
            Phi = self._remembering(Phi)
            _, rest = _rest_on_a_clock(Phi)
            others = np.linalg.qr(rest, mode="complete")[0][:, rest.shape[1] :]
            return np.asarray(np.linalg.eigvals(others.T @ Phi @ others), dtype=complex)
        # The equilibrium directions of continuous time exist for every period: they are determined once, in continuous
        # time.
        return np.asarray(np.linalg.eigvals(here._others.T @ Phi @ here._others), dtype=complex)


def linearise(
    diagram: Diagram,
    state: Array | None = None,
    *,
    start: Mapping[str, Any] | None = None,
    moving: bool = False,
    clock: float | None = None,
) -> Linear:
    """Jacobians of the closed loop of a run, with trajectories frozen at t = 0 and random signals zero.

    Outputs declared as rounded are replaced by their mean; other switches keep their piece at the point.

    Parameters
    ----------
    state
        Point of linearisation; by default the `equilibrium`.
    moving
        Omit the slope of smooth Coulomb friction at rest: it acts within a few mrad/s and would hide the behaviour of
        the moving loop.
    clock
        Sampling period [s]; required by discrete-time loops only.

    Raises
    ------
    ShapeError, EngineError
        The state has the wrong size; there is no equilibrium; the loop is discontinuous there; it needs a clock.
    """
    still = unrounded(frozen(diagram))
    loop, T = still.loop, period_of(still.loop, clock)
    point = equilibrium(still, start=start, clock=clock) if state is None else np.array(state, dtype=float)
    if point.shape != (loop.state.numel(),):
        raise ShapeError(f"linearise: expected a state of {loop.state.numel()} numbers, found {point.size}")
    p = at_speed(loop) if moving else loop.p_values
    field, slope = rates(loop), rates(loop).jacobian()
    kinks = _kinks(loop, point, p, T)
    slopes = at_set_point(loop, "advanced", loop.advanced).jacobian()
    held = at_set_point(loop, "held", loop.held_over_a_sample[1])
    command, (plant_A, plant_B) = held.jacobian(), _plant(loop)
    first, timed = slopes.size1_out(0), bool(loop.discrete_time or ca.depends_on(moves(loop), loop.period))

    def checked(matrix: Any) -> Array:
        return np.asarray(computable(loop, "linearise", np.asarray(matrix.full())))

    def at(point: Array, T: float) -> Linear:
        def advanced(period: float) -> Array:
            return np.asarray(slopes(point, p, period, 0)[0].full())

        def at_period(period: float) -> Linear:
            moved = point
            if not at_rest(field(point, loop.p_values, period), point):
                moved = equilibrium(still, start=_by_label(loop, point), clock=period)
            return at(moved, period)

        u = held(point, loop.p_values, T)
        checked(
            slopes(point, p, T or 1.0, 0)[0]
        )  # at one period only: overflow at long periods is no fault of the parameters
        return Linear(
            states=_labels([(v.label, v.symbol.numel()) for v in loop.variables]),
            trajectories=_labels([(leaf.name, leaf.symbol.numel()) for leaf in loop.trajectories]),
            commands=_labels([(leaf.name, leaf.symbol.numel()) for leaf in loop.commanded]),
            point=point,
            controller=first,
            drift=float(np.max(np.abs(field(point, loop.p_values, T).full()), initial=0.0)),
            A=checked(slope(point, p, T, 0)[0]),
            B=_trajectory_slope(loop, point, p, T),
            advanced=advanced,
            command=checked(command(point, p, T, 0)[0]),
            plant_A=checked(plant_A(point[first:], u, p)),
            plant_B=checked(plant_B(point[first:], u, p)),
            kinks=kinks,
            clock=T if loop.discrete_time else None,
            at_period=at_period if timed else None,
            period=T,
        )

    return at(point, T)


def _kinks(loop: ClosedLoop, point: Array, p: Array, T: float) -> tuple[str, ...]:
    """Operations whose slope is discontinuous at the point; raises `EngineError` if an operation itself is."""
    symbols = [loop.state, loop.p, loop.period]
    held = undrawn(loop, loop.on_path(loop.acting([moves(loop)])[0]))
    jumps, kinks = turning(held, symbols, [point, p, T])
    if jumps:
        raise EngineError(
            f"linearise: expected a loop that is continuous at its set-point, found that {listed(jumps)} "
            "jumps there: it has no derivative; use another set-point, or replace the switch by a steep smooth function"
        )
    return tuple(kinks)


def _by_label(loop: ClosedLoop, point: Array) -> dict[str, Array]:
    parts = [(variable, point[rows]) for variable, rows in rows_of(loop.variables)]
    return {v.label: part if v.symbol.is_column() else part.reshape(v.symbol.shape, order="F") for v, part in parts}


def _trajectory_slope(loop: ClosedLoop, point: Array, p: Array, T: float) -> Array:
    """Jacobian of all rates with respect to the trajectory variables."""
    (rate,) = loop.acting([moves(loop)])
    leaves = stack(leaf.symbol for leaf in loop.trajectories)
    slope = undrawn(loop, loop.on_path(ca.densify(ca.jacobian(rate, leaves))))
    return np.asarray(ca.Function("B", [loop.state, loop.p, loop.period], [slope])(point, p, T).full())


def _plant(loop: ClosedLoop) -> tuple[Any, Any]:
    """Jacobians of the plant's rates with respect to continuous states and signals held over a sample."""
    x, (held, _) = stack(v.symbol for v in loop.flowing), loop.held_over_a_sample
    rate, inputs = loop.on_path(loop.flow), [x, held, loop.p]
    return (
        ca.Function("plant_A", inputs, [ca.jacobian(rate, x)]),
        ca.Function("plant_B", inputs, [ca.jacobian(rate, held)]),
    )


def at_speed(loop: ClosedLoop) -> Array:
    """Parameters with the velocity scale of smooth Coulomb friction so small that its slope is zero when moving."""
    labels = [parameter.label for parameter in loop.parameters for _ in range(parameter.symbol.numel())]
    return np.where([label == FRICTION_VELOCITY for label in labels], _SATURATED, loop.p_values)


def tick_jacobian(
    diagram: Diagram, linear: Linear, clock: float, solver: Solver | None = None, *, moving: bool = False
) -> Array:
    """Jacobian of the tick that a run computes at this period, at the same point with frozen trajectories.

    `moving` omits the slope of smooth Coulomb friction at rest. Outputs declared as rounded are replaced by their mean.
    """
    loop = unrounded(frozen(diagram)).loop
    step = build_step(loop, clock, solver or Solver(), ca.SX(0, 1))
    given = step.instants.rows(0, 1).ravel()
    given[DRAWN:] = 0.0
    p = at_speed(loop) if moving else loop.p_values
    return np.asarray(step.tick.jacobian()(linear.point, given, p, 0, 0)[0].full())


def _rest_on_a_clock(Phi: Array) -> tuple[Array, Array]:
    """Eigenvectors at one of a transition; and the generalised eigenspace at one (with ramp modes)."""
    moved = Phi - np.eye(len(Phi))
    still = found = rest_space(moved)
    while True:
        more = rest_space(moved - found @ (found.T @ moved))
        if more.shape[1] <= found.shape[1]:
            return still, found
        found = more


def rest_space(A: Array) -> Array:
    """Orthonormal basis of the null space of A, as columns; computed on the balanced matrix."""
    from scipy.linalg import matrix_balance

    with np.errstate(invalid="ignore"):  # SciPy casts a wide scale even without a permutation
        balanced, scale = matrix_balance(A, permute=False, separate=True)
    _, values, rows = np.linalg.svd(balanced)
    null = rows[values <= _NULL * max(float(np.max(values, initial=0.0)), 1e-300)].T
    return np.asarray(np.linalg.qr(null * np.asarray(scale[0])[:, None])[0])


def _labels(items: list[tuple[str, int]]) -> tuple[str, ...]:
    return tuple(f"{label}[{row}]" for label, size in items for row in range(size))
