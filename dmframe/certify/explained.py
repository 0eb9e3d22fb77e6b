"""Whether a block's rows follow from the plant: their unexplained part must decrease with the sampling period.

A discrete-time estimator is proved up to eta = y - h' theta_true, the part that no true value explains. For rows that
are means over a sample of a plant identity, eta is of the order of the period T along every smooth motion. With a wrong
sign, column or sample it does not decrease. Therefore eta is computed along random motions (`Moved`), from the
equations of the block and of the plant, at decreasing periods.

The cost for a UR10 with six joints is about 1 s of CPU time, most of it for the motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import Assumption, Steps
from dmframe.certify.checked import Checked, Finding
from dmframe.certify.claim import Claim, Part
from dmframe.certify.motions import Left, Moved, UnmovedError
from dmframe.common.errors import DmframeError
from dmframe.common.text import Text, name_of

PERIODS: Final = (0.005, 0.0025, 0.00125)
"""T [s], each half of the previous; if eta has not decreased by then, the periods in `MORE` follow."""
MORE: Final = (0.000625, 0.0003125)

DURATION: Final = 0.6
"""Duration of each motion [s]."""

MOTIONS: Final = 2

FALLS: Final = 0.7
"""Largest ratio for half of the period: it is 0.5 for a first-order error, and 1 for a constant one."""

SMALL: Final = 0.05
"""Largest fraction of the data at the shortest period; an error by one sample decreases as well, but is larger."""

EXACT: Final = 1e-6
"""Fraction of the data below which eta is due to rounding."""

NOTHING: Final = 1e-9
"""Size below which rows carry no information."""

SOURCE: Final = "the means over a sample"
UNCHECKED: Final = "its rows are means over a sample of the relations that it states, and its true values theirs"


@final
@dataclass(frozen=True)
class Compared:
    """Result of the comparison without expressions, so that a forked process can return it.

    `reads` are the positions in `ClosedLoop.p` of the parameters that no motion varies since they are zero.
    """

    name: Text
    text: str
    room: float
    holds: bool
    reads: tuple[int, ...]


def compared(claim: Claim, part: Part, item: Steps, seed: int = 0) -> Compared | Assumption:
    """Rows of update steps compared with motions of the plant; an assumption if no motion is possible."""
    try:
        moved = Moved(claim, part, item)
        fractions = _fractions(moved, np.random.default_rng(seed))
    except DmframeError as error:
        text = f"{part.block}: {UNCHECKED}; not checked: {error.text}"
        return Assumption(text, SOURCE)
    return _decided(claim, part, item, moved, fractions)


def explained(claim: Claim, found: Compared | Assumption) -> Finding:
    """The result of a comparison as a condition."""
    if isinstance(found, Assumption):
        return found
    parameters = ca.vertsplit(claim.loop.p)
    reads = ca.vertcat(ca.SX(0, 1), *(parameters[place] for place in found.reads))
    return Checked(found.name, found.text, found.room, found.holds, SOURCE, "sampled", reads=reads)


def _fractions(moved: Moved, rng: np.random.Generator) -> np.ndarray:
    """(periods, outputs): eta of all motions, as a fraction of the data. Raises `UnmovedError` if rows are zero."""
    motions = [moved.motion(rng) for _ in range(MOTIONS)]
    found = list[np.ndarray]()
    for T in (*PERIODS, *MORE):
        if len(found) >= len(PERIODS) and np.all(_falls(np.array(found))):
            break
        found.append(_fraction([moved.left(motion, T, DURATION) for motion in motions]))
    return np.array(found)


def _fraction(unexplained: Sequence[Left]) -> np.ndarray:
    """(outputs,): RMS of eta over that of y, or of h' theta_true if it is larger."""
    sizes = np.sum([[np.mean(each**2, axis=0) for each in _fitted(left)] for left in unexplained], axis=0)
    eta, data = np.sqrt(sizes[0]), np.sqrt(np.maximum(sizes[1], sizes[2]))
    if np.any(data < NOTHING):
        raise UnmovedError("a row is zero along all motions")
    return np.asarray(eta / data)


def _fitted(left: Left) -> list[np.ndarray]:
    """eta, y and h' theta_true of a motion, each without its part that the unknown constants can explain."""
    slope = left.slope.reshape(left.left.size, left.slope.shape[2])
    columns = [np.ravel(each) for each in (left.left, left.y, left.predicted)]
    if slope.shape[1]:
        constants, *_ = np.linalg.lstsq(slope, np.column_stack(columns), rcond=None)
        columns = list((np.column_stack(columns) - slope @ constants).T)
    return [column.reshape(left.left.shape) for column in columns]


def _falls(fractions: np.ndarray) -> np.ndarray:
    """(outputs,): whether the unexplained part decreases with the period, at the two shortest."""
    small = fractions[min(len(fractions), len(PERIODS)) - 1] <= SMALL
    return np.asarray((fractions[-1] <= EXACT) | (small & (fractions[-1] <= FALLS * fractions[-2])))


def _decided(claim: Claim, part: Part, item: Steps, moved: Moved, fractions: np.ndarray) -> Compared:
    """Result with the rows that do not follow from the plant or, if all do, with the largest unexplained part."""
    falls, periods = _falls(fractions), ", ".join(f"{1e3 * T:.3g}" for T in (*PERIODS, *MORE)[: len(fractions)])
    name = Text(f"{part.block}: what the rows of ", name_of(item.estimate), " leave unexplained of the plant's motion")
    text = f"along {MOTIONS} random motions of {DURATION:g} s, at T = {periods} ms"
    if falls.all():
        name = Text(name, " falls with the period")
        text = f"{text}: at most {_numbers(fractions[:, np.argmax(fractions[-1])])} of the data"
    else:
        wrong = "; ".join(
            f"{_row(claim, item, moved, int(k))}, {_numbers(fractions[:, k])}" for k in np.flatnonzero(~falls)
        )
        name = Text(name, f" does not fall with the period: {wrong} of the data at T = {periods} ms")
    room = 1 - float(np.max(fractions[-1] / np.maximum(fractions[-2], EXACT)))
    return Compared(name, text, room, bool(falls.all()), moved.reads)


def _numbers(fractions: np.ndarray) -> str:
    return ", ".join(f"{fraction:.2g}" for fraction in fractions)


def _row(claim: Claim, item: Steps, moved: Moved, k: int) -> str:
    """Name of a row, by its joint if each joint has one."""
    outputs, robot = len(item.parts), claim.diagram.robot
    stored = "stored " * moved.estimator_rows[k // outputs].stored
    named = robot is not None and robot.n == outputs
    return f"{stored}row of {robot.joints[k % outputs].name}" if named else f"{stored}row {k % outputs + 1}"


__all__ = ["UNCHECKED", "Compared", "compared", "explained"]
