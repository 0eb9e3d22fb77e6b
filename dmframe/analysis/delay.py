"""Identify the response delay of a robot in samples, from recorded commands and positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from dmframe.block.port import Signal
from dmframe.common.errors import ValueFault
from dmframe.common.units import compatible, plain
from dmframe.diagram import Diagram
from dmframe.simulate import Recording

Array = NDArray[np.float64]

MOST: Final = 2
"""Largest delay that the discrete-time blocks support [samples]."""
NEAR: Final = 0.3
"""Largest deviation from an integer, and largest uncertainty, of a usable delay [samples]."""
STEADY: Final = 0.28
"""Largest RMS jitter of a usable delay [samples]."""
FOLLOWING: Final = (0.25, 2.0)
"""Range of the ratio of actual to commanded velocity for a servo that follows its commands."""
ROUGH: Final = 0.3
"""Least roughness of commands; with smoother ones a delay cannot be distinguished from inertia."""

SHORTEST: Final = 1e-9
LONGEST: Final = 1e3
"""Range of sampling periods [s]."""
LARGEST: Final = 1e12
"""Limit of values [rad, rad/s]; a larger one indicates a diverged run."""

_LAGS: Final = (0.0, 0.003, 0.006, 0.01, 0.015, 0.022, 0.03, 0.045, 0.07, 0.1, 0.15)  # lags of a servo [s]
_DELAYS: Final = np.arange(0, 3.501, 0.05)
_FIRST: Final = 4  # rows affected by commands before the record
_FEWEST: Final = 24


@final
@dataclass(frozen=True)
class FittedDelay:
    """Identified delay in samples.

    Attributes
    ----------
    samples
        Best fit.
    half_width
        Half-width of the confidence interval (two standard deviations).
    jitter
        RMS variation of the delay from sample to sample.
    roughness
        Ratio of the median second to first differences of the commands, for the smoothest joint; above one for random
        commands, near zero for smooth ones.
    followed
        Least and largest ratio of actual to commanded velocity of a joint, about 1.
    period
        Sampling period [s].
    """

    samples: float
    half_width: float
    jitter: float
    roughness: float
    followed: tuple[float, float]
    period: float

    @property
    def refused(self) -> str:
        """Reason why the delay cannot be used in a block; empty if it can."""
        if self.roughness < ROUGH or self.half_width > NEAR:
            return "the record does not determine it: excite every joint with +-0.01 rad/s for 3 s, or more with noise"
        if self.jitter > STEADY:
            return "it changes from sample to sample: use a sampled_supervisor, or the kinematic command"
        least, most = FOLLOWING
        if not (least < self.followed[0] and self.followed[1] < most):
            return "the joints do not follow the commanded velocities: check limits, noise and lost commands"
        if self.samples > MOST + NEAR:
            return f"it is longer than {MOST} samples: sample more slowly, or use the kinematic command"
        if abs(self.samples - round(self.samples)) > NEAR:
            return "it is not an integer number of samples: use a sampled_supervisor, or the kinematic command"
        return ""

    @property
    def whole(self) -> int:
        """Integer delay for the blocks; raises `ValueFault` if it cannot be used."""
        if self.refused:
            raise ValueFault(f"delay: {self}")
        return round(self.samples)

    def __str__(self) -> str:
        found = f"{self.samples:.2f} +- {self.half_width:.2f} samples of {1e3 * self.period:g} ms"
        return f"{found}, changing by {self.jitter:.2f}" + (f"; {self.refused}" if self.refused else "")


def fitted_delay(q: Any, dq_c: Any, period: float) -> FittedDelay:
    """Fit the delay between velocity commands and joint motion.

    For each delay d and lag of a first-order servo, the mean velocity over a sample is a closed-form function of the
    commands. Measured velocities are regressed on it, its sum, its changes in the other joints, and a cubic in time; d
    minimises the sum of squares. Commands are noise-free, so noise of the positions adds variance to d but no bias.

    Parameters
    ----------
    q
        Positions (samples + 1, n), at the instants at which commands are computed [rad].
    dq_c
        Commands (samples, n) [rad/s]; those of each joint must change from sample to sample, as with `velocity_probe`.
    period
        The sampling period [s].

    Raises
    ------
    ValueFault
        If the arrays do not match or are too short.
    """
    v, u = _checked(_numbers("q", q), _numbers("dq_c", dq_c), period)
    fits = [_best(u, v, float(d), period) for d in _DELAYS]
    sums = np.array([np.sum(left**2, axis=0) for left, _, _ in fits])
    rows = fits[0][0].shape[0]
    deviance = rows * np.sum(np.log(sums + 1e-30), axis=1)  # -2 log likelihood
    place = int(np.argmin(deviance))
    likely = _DELAYS[deviance - deviance[place] < 4]
    left, lags, ratios = fits[place]
    d, step = float(_DELAYS[place]), float(_DELAYS[1])
    first, second = (np.median(np.abs(np.diff(u, order, axis=0)), axis=0) for order in (1, 2))
    roughness = float(np.min(second / np.maximum(first, 1e-30)))
    return FittedDelay(
        d,
        float(np.ptp(likely) + step) / 2,
        _jitter(left, u, d, lags, period),
        roughness,
        (float(np.min(ratios)), float(np.max(ratios))),
        float(period),
    )


def recorded_delay(recording: Recording) -> FittedDelay:
    """Fit the delay between commanded velocities and measured positions of a sampled run.

    Raises `ValueFault` for a graph without a clock or velocity commands, or a record that is too short, decimated or
    without these signals.
    """
    clock = recording.clock
    if clock is None:
        raise ValueFault("delay: expected a graph with a clock, found one in continuous time; add clock: 90 ms")
    signals = signals_of(recording.diagram)
    for label in signals:
        if label not in recording.outputs and label not in recording.states:
            raise ValueFault(f"delay: expected a record with {label}, found one without; add it to log.signals")
    if recording.divergence is not None:
        raise ValueFault(f"delay: expected a run that stays bounded, found one that diverged: {recording.divergence}")
    spacing = float(np.max(np.diff(recording.time), initial=clock))
    if spacing > 1.5 * clock:
        raise ValueFault(
            f"delay: expected a record of every sample, {plain(clock, 's')} spacing, found one of every "
            f"{plain(spacing, 's')}; set log.every to the clock"
        )
    q, u = signals
    return fitted_delay(recording[q], recording[u], clock)


def signals_of(diagram: Diagram) -> tuple[str, str]:
    """Labels of the measured positions and commanded velocities; raises `ValueFault` unless there is one of each."""
    loop = diagram.loop
    q = [
        leaf.name
        for leaf in loop.measured
        if "q" in ((port := _port(diagram, leaf.name)).name, getattr(port, "instead_of", ""))
    ]
    u = [leaf.name for leaf in loop.commanded if compatible(_port(diagram, leaf.name).unit, "rad/s")]
    for what, found in (("measured position q", q), ("commanded velocity", u)):
        if len(found) != 1:
            raise ValueFault(f"delay: expected one {what}, found {', '.join(found) or 'none'}")
    return q[0], u[0]


def _port(diagram: Diagram, label: str) -> Signal:
    """Output port of a label."""
    block, _, name = label.partition(".")
    return next(port for port in diagram.blocks[block].outputs if port.name == name)


def _numbers(name: str, values: Any) -> Array:
    """Real array of a value."""
    try:
        found = np.asarray(values)
        if np.iscomplexobj(found):
            raise TypeError
        return np.asarray(found, float)
    except (TypeError, ValueError):
        text = f"delay: expected {name} to be rows of real numbers, one for each joint, found something else"
        raise ValueFault(text) from None


def _checked(q: Array, dq_c: Array, T: Any) -> tuple[Array, Array]:
    """Mean velocities over samples, and the commands of these samples."""
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
        if not np.all(np.abs(values) < LARGEST):  # also excludes NaN
            raise ValueFault(
                f"delay: expected finite numbers below {LARGEST:g}, found others in {name}; record a run that stays "
                "bounded"
            )
    return np.asarray(np.diff(q[: count + 1], axis=0) / T, float), dq_c[:count]


def _best(u: Array, v: Array, d: float, T: float) -> tuple[Array, Array, Array]:
    """Residuals with the best lag of each joint, these lags, and the velocity ratios."""
    count, n = v.shape
    t = np.linspace(-1, 1, count)
    slow = np.column_stack([t**power for power in range(4)])
    left, lags, ratios = np.full((count - _FIRST, n), np.inf), np.zeros(n), np.zeros(n)
    for lag in _LAGS:
        made = _answer(u, d, lag, T)
        changes, sums = np.diff(made, axis=0, prepend=made[:1]), T * np.cumsum(made, axis=0)
        for j in range(n):
            columns = np.column_stack([slow, made[:, j], sums[:, j], np.delete(changes, j, axis=1)])[_FIRST:]
            factors = np.linalg.lstsq(columns, v[_FIRST:, j], rcond=None)[0]
            found = v[_FIRST:, j] - columns @ factors
            if found @ found < np.sum(left[:, j] ** 2):
                left[:, j], lags[j], ratios[j] = found, lag, factors[slow.shape[1]]
    return left, lags, ratios


def _answer(u: Array, d: float, lag: float, T: float) -> Array:
    """Mean velocities over samples after a delay of d samples and a first-order lag [s].

    The command before the record is assumed equal to the first.
    """

    def moved(t: Array) -> Array:
        """Displacement of a unit velocity step after t."""
        passed: Array = np.maximum(t, 0)
        return passed + lag * np.expm1(-passed / lag) if lag else passed

    after: Array = T * (np.arange(len(u), dtype=float) - d)
    weights = (moved(after + T) - 2 * moved(after) + moved(after - T)) / T
    changes = u - u[0]
    return np.array(u[0] + np.column_stack([np.convolve(weights, each)[: len(u)] for each in changes.T]))


def _jitter(left: Array, u: Array, d: float, lags: Array, T: float) -> float:
    """RMS jitter of the delay, from the squares of residuals or of sums of two.

    A command that acts delta samples late adds -delta h(k) to the velocities, h the response to its change for one
    sample. With independent delta of variance J^2, the expected square of the sum of the last L residuals is
    s^2 + J^2 sum over the commands of (h(k) + ... + h(k-L+1))^2 times the squared change. Noise of the positions adds
    as much to the sum of two residuals as to one, since the position in between cancels, and the displacement adds:
    L = 2 if their correlation is nearer to -1/2, that of such noise, than to zero, otherwise L = 1.
    """
    L = 2 if 4 * np.sum(left[1:] * left[:-1]) < -np.sum(left**2) else 1
    above = below = 0.0
    pulse = np.zeros((len(u), 1))
    pulse[1:] = 1.0
    soon = max(0.0, d - 0.5)
    for j, lag in enumerate(lags):
        h = (_answer(pulse, soon, lag, T) - _answer(pulse, d + 0.5, lag, T))[1:, 0] / (d + 0.5 - soon)
        moved = np.convolve(np.convolve(h, np.ones(L)) ** 2, np.diff(u[:, j], prepend=u[0, j]) ** 2)
        moved = moved[_FIRST + L - 1 : len(u)]
        squares = np.convolve(left[:, j], np.ones(L), "valid") ** 2
        weight = 1 / (float(np.mean(squares)) ** 2 + 1e-30)
        above += weight * float(np.sum((moved - moved.mean()) * (squares - squares.mean())))
        below += weight * float(np.sum((moved - moved.mean()) ** 2))
    return float(np.sqrt(max(0.0, above / below))) if below else 0.0
