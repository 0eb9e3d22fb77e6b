"""Tracking and orientation errors of a run, with RMS values by eighth of its duration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.common.text import Text
from dmframe.common.units import plain, sliding
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import ClosedLoop, Followed
from dmframe.formula import Formula, tree
from dmframe.formula.tree import SCALAR, Name
from dmframe.robot.chain import SerialChain
from dmframe.simulate import Recording
from dmframe.simulate.keep import rotation_distance_of

EIGHTHS = 8
DEGREES = "deg"
"""Unit of `TurnError`."""
FARTHEST = 8.0
"""Squared Frobenius distance of two rotation matrices half a turn apart."""
_ROUNDING = 1e-9  # tolerance, in eighths, for an instant k T at the start of an eighth


@dataclass(frozen=True, repr=False)
class Deviation:
    """Deviation over a run, summarised by its RMS.

    Parameters
    ----------
    signal
        Name of the signal.
    times
        (N,) [s].
    rms_by_eighth
        RMS of its norm over each eighth of the planned duration; None for eighths that were not reached.
    unit
        Unit of all values.
    """

    signal: str
    times: np.ndarray
    rms_by_eighth: tuple[float | None, ...]
    unit: str

    @property
    def rms_final(self) -> float | None:
        """RMS over the last eighth; None if the run did not reach it."""
        return self.rms_by_eighth[-1]

    def __repr__(self) -> str:
        first, last = ("-" if rms is None else plain(rms, self.unit) for rms in self.rms_by_eighth[:: EIGHTHS - 1])
        return f"<{type(self).__name__} {self.signal}: {first} in the first eighth, {last} in the last>"


@final
@dataclass(frozen=True, repr=False)
class TrackingError(Deviation):
    r"""Actual minus desired, :math:`e = s - s_d`; its signal is ``"x - x_d"``, or what a block derives from x_d.

    Parameters
    ----------
    values
        (N, rows).
    norm
        (N,), Euclidean; of a joint error, that of the revolute joints if there are any.
    desired, actual
        Labels ``block.port`` of the two signals.
    prismatic
        That of prismatic joints of a robot that has revolute joints too [m].
    """

    signal: Text
    values: np.ndarray
    norm: np.ndarray
    desired: str
    actual: str
    prismatic: Deviation | None = None


@final
@dataclass(frozen=True, repr=False)
class TurnError(Deviation):
    r"""Angle between actual and desired tool orientation, :math:`2 \arcsin(|R - R_d| / \sqrt 8)`.

    Its signal is the label ``block.R_apart`` of :math:`|R - R_d|^2`.

    Parameters
    ----------
    angle
        (N,), from 0 to 180 [deg].
    """

    unit: str = field(default=DEGREES, kw_only=True)
    angle: np.ndarray


def turn_error(run: Recording) -> TurnError | None:
    """Orientation error of a run; None for a task without orientation."""
    label = rotation_distance_of(run.diagram.loop)
    if label is None:
        return None
    with np.errstate(invalid="ignore"):  # before a divergence
        angle = np.degrees(2 * np.arcsin(np.sqrt(np.clip(run[label][:, 0] / FARTHEST, 0.0, 1.0))))
    return TurnError(label, run.time, rms_by_eighth(run.time, angle, run.duration), angle)


def turn_of(loop: ClosedLoop) -> SX | None:
    """Angle of `turn_error` [deg] as an expression; None for a task without orientation."""
    label = rotation_distance_of(loop)
    if label is None:
        return None
    distance = next(signal.expression for signal in loop.outputs if signal.label == label)
    return ca.asin(ca.sqrt(ca.fmin(ca.fmax(distance / FARTHEST, 0), 1))) * (360 / np.pi)


def goal_of(loop: ClosedLoop) -> Followed | None:
    """Goal by which a loop is judged: its task if it has one, else its joints; None without a goal."""
    return loop.goal


def counted_rows(diagram: Diagram, shape: str, unit: str) -> tuple[list[int] | slice, str, list[int]]:
    """Rows of a signal that its Euclidean norm counts, their unit, and the rows of prismatic joints that it leaves out.

    Angles and lengths have no common norm.
    """
    joints = diagram.robot.joints if isinstance(diagram.robot, SerialChain) and shape == "n" else ()
    slides = [row for row, joint in enumerate(joints) if joint.kind == "prismatic"]
    if not slides:
        return slice(None), unit, []
    turns = [row for row in range(len(joints)) if row not in slides]
    return (turns, unit, slides) if turns else (slides, sliding(unit), [])


def tracking_error(run: Recording) -> TrackingError | None:
    """Tracking error of a run, at the task if there is one, else at the joints; None without a goal."""
    goal = goal_of(run.diagram.loop)
    if goal is None:
        return None
    desired, actual = goal.desired, goal.actual
    names = [label.split(".", 1)[1] for label in (actual, desired)]
    values = np.asarray(run[actual] - run[desired])
    signal = next(signal for signal in run.diagram.loop.outputs if signal.label == actual)
    rows, unit, others = counted_rows(run.diagram, signal.shape, signal.unit)
    norm = euclidean(values[:, rows])
    text = Text(Formula(tree.subtract(Name(names[0]), Name(names[1]), SCALAR)))
    prismatic_rms = rms_by_eighth(run.time, euclidean(values[:, others]), run.duration) if others else ()
    return TrackingError(
        signal=text,
        unit=unit,
        times=run.time,
        values=values,
        norm=norm,
        rms_by_eighth=rms_by_eighth(run.time, norm, run.duration),
        desired=desired,
        actual=actual,
        prismatic=Deviation(text, run.time, prismatic_rms, sliding(signal.unit)) if others else None,
    )


def euclidean(values: np.ndarray) -> np.ndarray:
    """Euclidean norm of each row, without overflow of the squares."""
    scale = np.max(np.abs(values), axis=1, initial=0.0)
    safe = np.where((scale > 0) & np.isfinite(scale), scale, 1.0)
    return np.asarray(scale * np.sqrt(np.sum((values / safe[:, None]) ** 2, axis=1)))


def rms_by_eighth(times: np.ndarray, norm: np.ndarray, duration: float) -> tuple[float | None, ...]:
    """RMS over the eighths ``[k, k + 1) duration / 8``, the last one with its end.

    None for an eighth without instants or with non-finite values.
    """
    part = eighth_of(times, duration)
    return tuple(_rms(norm[part == k]) if np.any(part == k) else None for k in range(EIGHTHS))


def eighth_of(times: np.ndarray, duration: float) -> np.ndarray:
    """Index of the eighth of the planned duration for each instant, from 0."""
    return np.floor(times * EIGHTHS / duration + _ROUNDING).astype(np.int64).clip(0, EIGHTHS - 1)


def _rms(values: np.ndarray) -> float | None:
    scale = float(np.max(values))
    if not math.isfinite(scale):
        return None
    return scale * float(np.sqrt(np.mean((values / scale) ** 2))) if scale > 0 else 0.0
