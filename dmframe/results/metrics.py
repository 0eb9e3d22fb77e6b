"""How well a run followed its goal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.diagram.closed_loop import ClosedLoop, Followed
from dmframe.simulate import Recording
from dmframe.simulate.keep import apart_of
from dmframe.units import plain

EIGHTHS = 8
FARTHEST = 8.0
"""The square of the distance of two rotation matrices that are half a turn from one another."""
_ROUNDING = 1e-9  # an instant k T that should open an eighth may lie this much of an eighth before it


@final
@dataclass(frozen=True, repr=False)
class TrackingError:
    r"""Actual minus desired, :math:`e = s - s_d`.

    Parameters
    ----------
    signal
        ``"x - x_d"``, or what a block makes of x_d.
    unit
        Of `values`, `norm` and the RMS figures.
    times
        (N,) [s].
    values
        (N, rows).
    norm
        (N,), Euclidean.
    rms_by_eighth
        The norm's root mean square over each eighth of the planned duration; None where the run never came.
    desired, actual
        The labels ``block.port`` of the two signals.
    """

    signal: str
    unit: str
    times: np.ndarray
    values: np.ndarray
    norm: np.ndarray
    rms_by_eighth: tuple[float | None, ...]
    desired: str
    actual: str

    @property
    def rms_final(self) -> float | None:
        """Over the last eighth; None where the run did not reach it."""
        return self.rms_by_eighth[-1]

    def __repr__(self) -> str:
        first, last = ("-" if rms is None else plain(rms, self.unit) for rms in self.rms_by_eighth[:: EIGHTHS - 1])
        return f"<TrackingError {self.signal}: {first} in the first eighth, {last} in the last>"


@final
@dataclass(frozen=True, repr=False)
class TurnError:
    r"""The angle by which a tool is turned from its desired orientation, :math:`2 \arcsin(|R - R_d| / \sqrt 8)`.

    Parameters
    ----------
    signal
        The label ``block.R_apart`` of :math:`|R - R_d|^2`.
    times
        (N,) [s].
    angle
        (N,), from 0 to 180 [deg].
    rms_by_eighth
        Its root mean square over each eighth of the planned duration [deg]; None where the run never came.
    """

    signal: str
    times: np.ndarray
    angle: np.ndarray
    rms_by_eighth: tuple[float | None, ...]

    unit: ClassVar[str] = "deg"

    @property
    def rms_final(self) -> float | None:
        """Over the last eighth [deg]; None where the run did not reach it."""
        return self.rms_by_eighth[-1]

    def __repr__(self) -> str:
        first, last = ("-" if rms is None else plain(rms, self.unit) for rms in self.rms_by_eighth[:: EIGHTHS - 1])
        return f"<TurnError: {first} in the first eighth, {last} in the last>"


def turn_error(run: Recording) -> TurnError | None:
    """The error of a tool's orientation in a run; None for a task without one."""
    label = apart_of(run.diagram.loop)
    if label is None:
        return None
    with np.errstate(invalid="ignore"):  # before a divergence
        angle = np.degrees(2 * np.arcsin(np.sqrt(np.clip(run[label][:, 0] / FARTHEST, 0.0, 1.0))))
    return TurnError(label, run.time, angle, rms_by_eighth(run.time, angle, run.duration))


def turn_of(loop: ClosedLoop) -> SX | None:
    """The angle of `turn_error` [deg], as an expression; None for a task without an orientation."""
    label = apart_of(loop)
    if label is None:
        return None
    apart = next(signal.expression for signal in loop.outputs if signal.label == label)
    return ca.asin(ca.sqrt(ca.fmin(ca.fmax(apart / FARTHEST, 0), 1))) * (360 / np.pi)


def goal_of(loop: ClosedLoop) -> Followed | None:
    """What a loop is judged by: its task where it has one, else its joints; None without a goal."""
    return loop.goal


def tracking_error(run: Recording) -> TrackingError | None:
    """The tracking error of a run: at the task where there is one, else at the joints; None without a goal."""
    goal = goal_of(run.diagram.loop)
    if goal is None:
        return None
    desired, actual = goal.desired, goal.actual
    name = actual.split(".", 1)[1]
    values = np.asarray(run[actual] - run[desired])
    norm = euclidean(values)
    signal = next(signal for signal in run.diagram.loop.outputs if signal.label == actual)
    return TrackingError(
        signal=f"{name} - {desired.split('.', 1)[1]}",
        unit=signal.unit,
        times=run.time,
        values=values,
        norm=norm,
        rms_by_eighth=rms_by_eighth(run.time, norm, run.duration),
        desired=desired,
        actual=actual,
    )


def euclidean(values: np.ndarray) -> np.ndarray:
    """The norm of each row, also of numbers whose squares overflow, as before a divergence."""
    scale = np.max(np.abs(values), axis=1, initial=0.0)
    safe = np.where((scale > 0) & np.isfinite(scale), scale, 1.0)
    return np.asarray(scale * np.sqrt(np.sum((values / safe[:, None]) ** 2, axis=1)))


def rms_by_eighth(times: np.ndarray, norm: np.ndarray, duration: float) -> tuple[float | None, ...]:
    """Root mean square over the eighths ``[k, k + 1) duration / 8``; the last one holds its end.

    None of an eighth that no instant is in, or where a number is not finite.
    """
    part = eighth_of(times, duration)
    return tuple(_rms(norm[part == k]) if np.any(part == k) else None for k in range(EIGHTHS))


def eighth_of(times: np.ndarray, duration: float) -> np.ndarray:
    """Which eighth of the planned duration each instant is in, from 0."""
    return np.floor(times * EIGHTHS / duration + _ROUNDING).astype(np.int64).clip(0, EIGHTHS - 1)


def _rms(values: np.ndarray) -> float | None:
    scale = float(np.max(values))
    if not math.isfinite(scale):
        return None
    return scale * float(np.sqrt(np.mean((values / scale) ** 2))) if scale > 0 else 0.0
