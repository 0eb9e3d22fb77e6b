"""How many samples late a robot answers, fitted from a record of commands and positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.diagram import Diagram
from dmframe.errors import ValueFault
from dmframe.port import Port
from dmframe.simulate import Recording
from dmframe.units import compatible, plain

Array = NDArray[np.float64]

MOST: Final = 2
"""Samples of delay that the blocks in sampled time know."""
NEAR: Final = 0.3
"""How far from a whole number, and how uncertain, a delay may be."""
STEADY: Final = 0.28
"""How much a delay may change from sample to sample, in samples, as a root mean square."""
FOLLOWING: Final = (0.25, 2.0)
"""Between these lies the share of a commanded velocity that each joint makes; of a servo that answers it is about 1."""
ROUGH: Final = 0.3
"""Commands that change more smoothly than this do not show a delay, which then looks like inertia."""

SHORTEST: Final = 1e-9
LONGEST: Final = 1e3
"""Periods [s] that a clock of a robot may have."""
LARGEST: Final = 1e12
"""Beyond this [rad], [rad/s], a record is that of a run that diverged."""

_LAGS: Final = (0.0, 0.003, 0.006, 0.01, 0.015, 0.022, 0.03, 0.045, 0.07, 0.1, 0.15)  # [s] of a servo
_DELAYS: Final = np.arange(0, 3.501, 0.05)
_FIRST: Final = 4  # rows that commands from before the record may move
_FEWEST: Final = 24


@final
@dataclass(frozen=True)
class FittedDelay:
    """What a record says of the delay, in samples.

    Attributes
    ----------
    samples
        The delay that explains the record best.
    half_width
        Of the interval of delays that explain it about as well, two standard deviations to each side.
    jitter
        How much the delay changes from sample to sample, as a root mean square.
    roughness
        How quickly commands change: the median of their second differences over that of their first ones, of the
        smoothest joint. Random commands have more than one, smooth ones nearly zero.
    followed
        The least and the largest share of its commanded velocity that a joint makes, about 1.
    period
        Of the samples [s].
    """

    samples: float
    half_width: float
    jitter: float
    roughness: float
    followed: tuple[float, float]
    period: float

    @property
    def refused(self) -> str:
        """Why no delay may be told to a block; empty where one may."""
        if self.roughness < ROUGH or self.half_width > NEAR:
            return "the record does not show it: probe every joint with +-0.01 rad/s for 3 s, more where noise is large"
        if self.jitter > STEADY:
            return "it changes from sample to sample: use a sampled_supervisor, or the kinematic command"
        least, most = FOLLOWING
        if not (least < self.followed[0] and self.followed[1] < most):
            return "the joints do not make the velocities that are commanded: look at limits, noise and lost commands"
        if self.samples > MOST + NEAR:
            return f"it is longer than {MOST} samples: sample more slowly, or use the kinematic command"
        if abs(self.samples - round(self.samples)) > NEAR:
            return "it is no whole number of samples: use a sampled_supervisor, or the kinematic command"
        return ""

    @property
    def whole(self) -> int:
        """The delay to be told to the blocks. Raises `ValueFault` where none may be."""
        if self.refused:
            raise ValueFault(f"delay: {self}")
        return round(self.samples)

    def __str__(self) -> str:
        found = f"{self.samples:.2f} +- {self.half_width:.2f} samples of {1e3 * self.period:g} ms"
        return f"{found}, changing by {self.jitter:.2f}" + (f"; {self.refused}" if self.refused else "")


def fitted_delay(q: Any, dq_c: Any, period: float) -> FittedDelay:
    """Fit how many samples late joints answer to velocity commands.

    For each delay d and each lag of a first-order servo the average velocity that the commands would make is known in
    closed form. The velocities measured are fitted by it, its sum, what it changes by in the other joints, and a cubic
    in time; the d with the least sum of squares counts. Commands are known without noise, so that noise of the
    positions makes d uncertain, and does not shift it.

    Parameters
    ----------
    q
        Positions (samples + 1, n), at the instants at which commands are computed [rad].
    dq_c
        Commands (samples, n) [rad/s]; each joint's has to change from sample to sample, as `velocity_probe` sees to.
    period
        The sampling period [s].

    Raises
    ------
    ValueFault
        The arrays do not belong together, or are too short.
    """
    v, u = _checked(_numbers("q", q), _numbers("dq_c", dq_c), period)
    fits = [_best(u, v, float(d), period) for d in _DELAYS]
    sums = np.array([np.sum(left**2, axis=0) for left, _, _ in fits])
    rows = fits[0][0].shape[0]
    excess = rows * np.sum(np.log(sums + 1e-30), axis=1)  # twice minus the logarithm of the likelihood
    place = int(np.argmin(excess))
    alike = _DELAYS[excess - excess[place] < 4]
    left, lags, shares = fits[place]
    d, step = float(_DELAYS[place]), float(_DELAYS[1])
    first, second = (np.median(np.abs(np.diff(u, order, axis=0)), axis=0) for order in (1, 2))
    roughness = float(np.min(second / np.maximum(first, 1e-30)))
    return FittedDelay(
        d,
        float(np.ptp(alike) + step) / 2,
        _jitter(left, u, d, lags, period),
        roughness,
        (float(np.min(shares)), float(np.max(shares))),
        float(period),
    )


def recorded_delay(recording: Recording) -> FittedDelay:
    """Fit the delay from a run on a clock: of the velocities commanded, to the positions that the controller measures.

    Raises `ValueFault` where the graph has no clock, or commands no velocities, or the record is too short, thinned out
    or without these signals.
    """
    clock = recording.clock
    if clock is None:
        raise ValueFault("delay: expected a graph with a clock, found one in continuous time; add clock: 90 ms")
    signals = signals_of(recording.diagram)
    for label in signals:
        if label not in recording.outputs and label not in recording.states:
            raise ValueFault(f"delay: expected a record that holds {label}, found one without; add it to log.signals")
    if recording.divergence is not None:
        raise ValueFault(f"delay: expected a run that stays bounded, found one that diverged: {recording.divergence}")
    apart = float(np.max(np.diff(recording.time), initial=clock))
    if apart > 1.5 * clock:
        raise ValueFault(
            f"delay: expected a record of every sample, {plain(clock, 's')} apart, found one of every "
            f"{plain(apart, 's')}; set log.every to the clock"
        )
    q, u = signals
    return fitted_delay(recording[q], recording[u], clock)


def signals_of(diagram: Diagram) -> tuple[str, str]:
    """Which positions are measured, and which velocities commanded. Raises `ValueFault` where that is not one each."""
    loop = diagram.loop
    q = [
        leaf.name
        for leaf in loop.measured
        if "q" in ((port := _port(diagram, leaf.name)).name, getattr(port, "instead_of", ""))
    ]
    u = [leaf.name for leaf in loop.commanded if compatible(_port(diagram, leaf.name).unit, "rad/s")]
    for what, found in (("position q that is measured", q), ("velocity that is commanded", u)):
        if len(found) != 1:
            raise ValueFault(f"delay: expected one {what}, found {', '.join(found) or 'none'}")
    return q[0], u[0]


def _port(diagram: Diagram, label: str) -> Port:
    """The output that a signal is."""
    block, _, name = label.partition(".")
    return next(port for port in diagram.blocks[block].outputs if port.name == name)


def _numbers(name: str, values: Any) -> Array:
    """A table of real numbers."""
    try:
        found = np.asarray(values)
        if np.iscomplexobj(found):
            raise TypeError
        return np.asarray(found, float)
    except (TypeError, ValueError):
        text = f"delay: expected {name} to be rows of real numbers, one for each joint, found something else"
        raise ValueFault(text) from None


def _checked(q: Array, dq_c: Array, T: Any) -> tuple[Array, Array]:
    """Average velocities, and the commands of their samples."""
    if q.ndim != 2 or dq_c.ndim != 2 or q.shape[1:] != dq_c.shape[1:] or not q.shape[1]:
        raise ValueFault(f"delay: expected columns of as many joints, found {q.shape} and {dq_c.shape}")
    if isinstance(T, bool) or not isinstance(T, int | float | np.number):
        raise ValueFault(f"delay: expected a period in s, a number, found {T!r:.40}")
    if not SHORTEST <= float(T) <= LONGEST:
        raise ValueFault(f"delay: expected a period above zero, {SHORTEST:g} to {LONGEST:g} s, found {T:g} s")
    count = min(len(q) - 1, len(dq_c))
    if count < _FIRST + _FEWEST:
        raise ValueFault(f"delay: expected at least {_FIRST + _FEWEST} samples, found {count}; record 3 s or more")
    for name, values in (("q", q), ("dq_c", dq_c)):
        if not np.all(np.abs(values) < LARGEST):  # what is no number, too
            raise ValueFault(
                f"delay: expected finite numbers below {LARGEST:g}, found others in {name}; record a run that stays "
                "bounded"
            )
    return np.asarray(np.diff(q[: count + 1], axis=0) / T, float), dq_c[:count]


def _best(u: Array, v: Array, d: float, T: float) -> tuple[Array, Array, Array]:
    """What the best lag of each joint leaves unexplained, these lags, and the joints' shares of their commands."""
    count, n = v.shape
    t = np.linspace(-1, 1, count)
    slow = np.column_stack([t**power for power in range(4)])
    left, lags, shares = np.full((count - _FIRST, n), np.inf), np.zeros(n), np.zeros(n)
    for lag in _LAGS:
        made = _answer(u, d, lag, T)
        changes, sums = np.diff(made, axis=0, prepend=made[:1]), T * np.cumsum(made, axis=0)
        for j in range(n):
            columns = np.column_stack([slow, made[:, j], sums[:, j], np.delete(changes, j, axis=1)])[_FIRST:]
            factors = np.linalg.lstsq(columns, v[_FIRST:, j], rcond=None)[0]
            found = v[_FIRST:, j] - columns @ factors
            if found @ found < np.sum(left[:, j] ** 2):
                left[:, j], lags[j], shares[j] = found, lag, factors[slow.shape[1]]
    return left, lags, shares


def _answer(u: Array, d: float, lag: float, T: float) -> Array:
    """Average velocities of the samples behind a delay of d samples and a first-order lag [s].

    The command before the record is taken to be its first.
    """

    def moved(t: Array) -> Array:
        """How far a unit step has led after t."""
        passed: Array = np.maximum(t, 0)
        return passed + lag * np.expm1(-passed / lag) if lag else passed

    after: Array = T * (np.arange(len(u), dtype=float) - d)
    weights = (moved(after + T) - 2 * moved(after) + moved(after - T)) / T
    changes = u - u[0]
    return np.array(u[0] + np.column_stack([np.convolve(weights, each)[: len(u)] for each in changes.T]))


def _jitter(left: Array, u: Array, d: float, lags: Array, T: float) -> float:
    """By how much the delay changes: where commands change more, more would be left unexplained."""
    above = below = 0.0
    for j, lag in enumerate(lags):
        late, early = (_answer(u[:, [j]], max(0.0, d + half), lag, T)[_FIRST:, 0] for half in (0.5, -0.5))
        moved = (late - early) ** 2 / (1.0 if d >= 0.5 else (0.5 + d) ** 2)
        squares = left[:, j] ** 2
        weight = 1 / (float(np.mean(squares)) ** 2 + 1e-30)
        above += weight * float(np.sum((moved - moved.mean()) * (squares - squares.mean())))
        below += weight * float(np.sum((moved - moved.mean()) ** 2))
    return float(np.sqrt(max(0.0, above / below))) if below else 0.0
