r"""Bound on the error of the next turn of a repeated path, from the data of a turn, with the estimate held constant.

Let :math:`(h_i, y_i)` be the rows of the last turn, joint by joint, and :math:`\bar\eta` an upper limit of what the
true parameters :math:`\theta` leave of a sample unexplained. The true parameters are then in the polytope

.. math:: \Theta = \{\theta \in \text{box} : |y_i - h_i^\top \theta| \le \bar\eta \text{ for all } i\}.  \tag{1}

In the next turn the law runs with the constant estimate :math:`\hat\theta`. Its prediction error is
:math:`\varepsilon_j = h_j^\top (\theta - \hat\theta) + \eta_j`, where the rows :math:`h_j` are those of the predicted
turn (`dmframe.bounds.predicted`) up to a difference that counts as a part of :math:`\eta_j`. With the gains G of the
prediction, and for each element and sign of the error,

.. math:: \pm e_k \le \pm e_k^0 + \max_{\theta \in \Theta} \pm\Big(\sum_j G_{kj} h_j^\top\Big) (\theta - \hat\theta)
          + \sum_j |G_{kj}|\,\bar\eta                                                                    \tag{2}

The maximum is a linear program for each joint (`dmframe.bounds.polytope`). The bound is the largest norm of the
elements over all samples of the turn.

What it assumes: the parameters are constant; no sample of the recorded and of the next turn leaves more than
:math:`\bar\eta` unexplained; and products of prediction errors are small: (2) is of the first order in them. It is a
statement about data, at the sampling instants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from dmframe.bounds.disturbed import NoBoundError
from dmframe.bounds.polytope import Polytope, least_residual
from dmframe.bounds.predicted import Turn
from dmframe.common.slices import slices

WIDEST: Final = 1.0
"""Size of a parameter's interval above which it is scaled as if it had this one."""

Source = Literal["observed", "given"]


@final
@dataclass(frozen=True, eq=False)
class Recorded:
    """Samples of the last turn of a run, and the box of the parameters.

    Parameters
    ----------
    rows, goals
        (N, c) rows of all joints side by side, and (N, joints) values.
    estimates
        (N, c) estimate before each sample.
    estimate
        (c,) estimate after the last one.
    parts
        Number of parameters of each joint.
    lower, upper
        (c,) box.
    """

    rows: np.ndarray
    goals: np.ndarray
    estimates: np.ndarray
    estimate: np.ndarray
    parts: tuple[int, ...]
    lower: np.ndarray
    upper: np.ndarray

    @property
    def joints(self) -> list[slice]:
        """The columns of each joint."""
        return slices(self.parts)

    def errors(self, estimates: np.ndarray) -> np.ndarray:
        """(N, joints) prediction errors with these estimates."""
        products = self.rows * estimates
        predicted = np.stack([products[:, part].sum(axis=1) for part in self.joints], axis=1)
        return np.asarray(self.goals - predicted)

    @property
    def observed(self) -> np.ndarray:
        """(joints,) largest prediction error of the adapting law in this turn."""
        return np.asarray(np.max(np.abs(self.errors(self.estimates)), axis=0))


@final
@dataclass(frozen=True, eq=False)
class TurnBound:
    """Bound (2).

    Parameters
    ----------
    value
        Largest norm of the error in the next turn.
    eta
        (joints,) upper limit of what a sample leaves unexplained, on which it rests.
    least
        (joints,) the smallest upper limit with which the recorded turn is consistent.
    predicted, parameters, unexplained
        The three contributions at the sample with the largest bound.
    """

    value: float
    eta: tuple[float, ...]
    source: Source
    least: tuple[float, ...]
    predicted: float
    parameters: float
    unexplained: float


def turn_bound(recorded: Recorded, turn: Turn, eta: Sequence[float] | None = None) -> TurnBound:
    """The bound on the next turn.

    Parameters
    ----------
    eta
        Upper limits by joint; by default the largest prediction errors of the adapting law in the recorded turn.

    Raises
    ------
    NoBoundError
        No parameters in the box explain the recorded turn up to eta, or the predicted turn is not finite.
    """
    if not (np.all(np.isfinite(turn.gains)) and np.all(np.isfinite(turn.rows))):
        raise NoBoundError("the predicted turn grows without limit")
    limits = recorded.observed if eta is None else np.asarray(eta, dtype=float)
    ends = np.stack([turn.errors, -turn.errors])
    shares = np.zeros((2, *ends.shape))
    least = list[float]()
    for j, part in enumerate(recorded.joints):
        gains = turn.gains[..., j]
        directions = np.einsum("kmj,ji->kmi", gains, turn.rows[:, part])
        polytope, scale, needed = _polytope(recorded, j, part, float(limits[j]))
        least.append(needed)
        for sign in (0, 1):
            for m in range(ends.shape[2]):
                for k, direction in enumerate(directions[:, m] * scale):
                    shares[0, sign, k, m] += polytope.top(direction if sign == 0 else -direction)
        shares[1] += np.abs(gains).sum(axis=2) * limits[j]
    size = np.linalg.norm(np.max(ends + shares.sum(axis=0), axis=0), axis=1)
    worst = int(np.argmax(size))
    alone = [np.linalg.norm(np.max(part[:, worst], axis=0)) for part in (ends, *shares)]
    source: Source = "observed" if eta is None else "given"
    return TurnBound(float(size[worst]), tuple(map(float, limits)), source, tuple(least), *map(float, alone))


def _polytope(recorded: Recorded, j: int, part: slice, limit: float) -> tuple[Polytope, np.ndarray, float]:
    """(1) for a joint, in the scaled deviation from the estimate; its scale, and the least limit."""
    estimate = recorded.estimate[part]
    lower, upper = recorded.lower[part] - estimate, recorded.upper[part] - estimate
    scale = np.clip((upper - lower) / 2, np.finfo(float).tiny, WIDEST)
    rows, left = recorded.rows[:, part] * scale, recorded.goals[:, j] - recorded.rows[:, part] @ estimate
    lower, upper = lower / scale, upper / scale
    needed = least_residual(rows, left, lower, upper)
    if needed > limit:
        raise NoBoundError(
            f"no parameters in the box explain the last turn up to {limit:.3g} in joint {j + 1}: the smallest limit is "
            f"{needed:.3g}; the servo is none of the law's model, or eta is too small"
        )
    A = np.vstack([rows, -rows])
    b = np.concatenate([left + limit, limit - left])
    return Polytope(A, b, lower, upper), scale, needed
