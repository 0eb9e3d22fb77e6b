"""Whether a block's rows follow from the plant: what they leave unexplained has to fall with the sampling period.

An estimator over samples is proved up to eta = y - h' theta_true, what no true value explains. With rows that are means
over a sample of a relation of the plant, eta is of the order of the period T along every smooth motion; with a sign, a
column or a sample that is not the plant's it stays. So eta is computed along random motions (`Moved`), from the block's
and the plant's own equations, at shorter and shorter periods.

Of a UR10 with six joints it costs about 1 s of CPU time, most of it for the motions.
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
"""T [s], each half of the one before; where eta has not fallen by then, the next halves are looked at, too."""
MORE: Final = (0.000625, 0.0003125)

DURATION: Final = 0.6
"""Of each motion [s]."""

MOTIONS: Final = 2

FALLS: Final = 0.7
"""With half of the period, to less than this share: it is 0.5 in the first order, and 1 for what stays."""

SMALL: Final = 0.05
"""Of the data, at the shortest period: what is late by a sample falls as well, from far more."""

EXACT: Final = 1e-6
"""Below this share of the data, eta is what rounding leaves."""

NOTHING: Final = 1e-9
"""Rows below this size teach nothing."""

SOURCE: Final = "the means over a sample"
UNCHECKED: Final = "its rows are means over a sample of the relations that it states, and its true values theirs"


@final
@dataclass(frozen=True)
class Compared:
    """Rows compared with motions of the plant, without expressions: a copy of the process can return it.

    `reads` are the places in `ClosedLoop.p` of the parameters that no motion varies, as they are zero.
    """

    name: Text
    text: str
    room: float
    holds: bool
    reads: tuple[int, ...]


def compared(claim: Claim, part: Part, item: Steps, seed: int = 0) -> Compared | Assumption:
    """The rows of steps compared with motions of the plant; an assumption where there can be none."""
    try:
        moved = Moved(claim, part, item)
        shares = _shares(moved, np.random.default_rng(seed))
    except DmframeError as error:
        text = f"{part.block}: {UNCHECKED}; not checked: {error.text}"
        return Assumption(text, SOURCE)
    return _decided(claim, part, item, moved, shares)


def explained(claim: Claim, found: Compared | Assumption) -> Finding:
    """A comparison as a condition."""
    if isinstance(found, Assumption):
        return found
    parameters = ca.vertsplit(claim.loop.p)
    reads = ca.vertcat(ca.SX(0, 1), *(parameters[place] for place in found.reads))
    return Checked(found.name, found.text, found.room, found.holds, SOURCE, "sampled", reads=reads)


def _shares(moved: Moved, rng: np.random.Generator) -> np.ndarray:
    """(periods, outputs): eta of all motions, as a share of the data. Raises `UnmovedError` where rows are zero."""
    motions = [moved.motion(rng) for _ in range(MOTIONS)]
    found = list[np.ndarray]()
    for T in (*PERIODS, *MORE):
        if len(found) >= len(PERIODS) and np.all(_falls(np.array(found))):
            break
        found.append(_share([moved.left(motion, T, DURATION) for motion in motions]))
    return np.array(found)


def _share(lefts: Sequence[Left]) -> np.ndarray:
    """(outputs,): the root mean square of eta over that of y, or of h' theta_true where it is larger."""
    sizes = np.sum([[np.mean(each**2, axis=0) for each in _fitted(left)] for left in lefts], axis=0)
    eta, data = np.sqrt(sizes[0]), np.sqrt(np.maximum(sizes[1], sizes[2]))
    if np.any(data < NOTHING):
        raise UnmovedError("a row is zero along all motions")
    return np.asarray(eta / data)


def _fitted(left: Left) -> list[np.ndarray]:
    """eta, y and h' theta_true of a motion, each less what the unknown constants can explain of it."""
    slope = left.slope.reshape(left.left.size, left.slope.shape[2])
    columns = [np.ravel(each) for each in (left.left, left.y, left.predicted)]
    if slope.shape[1]:
        constants, *_ = np.linalg.lstsq(slope, np.column_stack(columns), rcond=None)
        columns = list((np.column_stack(columns) - slope @ constants).T)
    return [column.reshape(left.left.shape) for column in columns]


def _falls(shares: np.ndarray) -> np.ndarray:
    """(outputs,): whether what is left falls with the period, at the two shortest."""
    small = shares[min(len(shares), len(PERIODS)) - 1] <= SMALL
    return np.asarray((shares[-1] <= EXACT) | (small & (shares[-1] <= FALLS * shares[-2])))


def _decided(claim: Claim, part: Part, item: Steps, moved: Moved, shares: np.ndarray) -> Compared:
    """With the rows that do not follow from the plant; of those that do, with the one of which most is left."""
    falls, periods = _falls(shares), ", ".join(f"{1e3 * T:.3g}" for T in (*PERIODS, *MORE)[: len(shares)])
    name = Text(f"{part.block}: what the rows of ", name_of(item.estimate), " leave unexplained of the plant's motion")
    text = f"along {MOTIONS} random motions of {DURATION:g} s, at T = {periods} ms"
    if falls.all():
        name = Text(name, " falls with the period")
        text = f"{text}: at most {_numbers(shares[:, np.argmax(shares[-1])])} of the data"
    else:
        wrong = "; ".join(
            f"{_row(claim, item, moved, int(k))}, {_numbers(shares[:, k])}" for k in np.flatnonzero(~falls)
        )
        name = Text(name, f" does not fall with the period: {wrong} of the data at T = {periods} ms")
    room = 1 - float(np.max(shares[-1] / np.maximum(shares[-2], EXACT)))
    return Compared(name, text, room, bool(falls.all()), moved.reads)


def _numbers(shares: np.ndarray) -> str:
    return ", ".join(f"{share:.2g}" for share in shares)


def _row(claim: Claim, item: Steps, moved: Moved, k: int) -> str:
    """Which row, by its joint where each joint has one."""
    outputs, robot = len(item.parts), claim.diagram.robot
    stored = "stored " * moved.lessons[k // outputs].stored
    named = robot is not None and robot.n == outputs
    return f"{stored}row of {robot.joints[k % outputs].name}" if named else f"{stored}row {k % outputs + 1}"


__all__ = ["UNCHECKED", "Compared", "compared", "explained"]
