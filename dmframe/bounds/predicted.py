r"""The next turn as a constant estimate predicts it, and how prediction errors move it.

At sample k, the update steps of a law have the row :math:`h_k` and the value :math:`y_k`, functions of the states
:math:`s_k` of the sampled law and of the measured positions :math:`q_k`. With a constant estimate
:math:`\hat\theta`, the prediction error

.. math:: \varepsilon_k = y(s_k, q_k) - h(s_k, q_k)^\top \hat\theta                                      \tag{1}

determines :math:`q_k`, whatever the plant is, and the law :math:`s_{k+1} = n(s_k, q_k)`. The predicted turn has
:math:`\varepsilon = 0`. To first order, a prediction error moves it by

.. math::

    \delta q_k &= E_q^{-1} (\varepsilon_k - E_s\,\delta s_k), \qquad E = y - h^\top \hat\theta           \tag{2} \\
    \delta s_{k+1} &= n_s\,\delta s_k + n_q\,\delta q_k                                                  \tag{3}

and the error by :math:`\delta e_k = J\,\delta q_k = \sum_{j \le k} G_{kj}\,\varepsilon_j`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Steps
from dmframe.block.model import symbols_in
from dmframe.block.steps import summed
from dmframe.bounds.disturbed import NoBoundError
from dmframe.bounds.frozen import with_constant
from dmframe.certify.claim import Claim
from dmframe.diagram.closed_loop import Variable, stack

NEWTON: Final = 30
CLOSE: Final = 1e-12
"""Steps of Newton's method for (1), and the relative change of the positions at which it ends."""


@final
@dataclass(frozen=True, eq=False)
class Turn:
    """A predicted turn of N samples.

    Parameters
    ----------
    errors
        (N, m) predicted error.
    rows
        (N, c) predicted rows.
    gains
        (N, m, N, joints): change of the error at a sample by the prediction error at another one.
    """

    errors: np.ndarray
    rows: np.ndarray
    gains: np.ndarray


@final
class Prediction:
    """Functions of one sample of a law with a constant estimate.

    Attributes
    ----------
    labels
        The sampled states on which the law depends, s.
    measured
        Label of the positions q.
    """

    def __init__(self, claim: Claim, item: Steps, estimate: str, error: SX, period: float) -> None:
        loop, moves = claim.loop, claim.sample.next
        variables = {v.label: v for v in loop.variables}
        self._period, own = period, [v for label, v in variables.items() if label in moves and label != estimate]
        theta = ca.vec(variables[estimate].symbol)
        (h, y) = item.rows[0]
        targets = [self._plain(claim, x) for x in (h, y, error)]
        self.measured = _measured(claim, targets, y.numel())
        q = ca.vec(variables[self.measured].symbol)
        seen = [ca.vec(q), theta, loop.time, stack(v.symbol for v in own)]
        moved = self._plain(claim, stack(moves[v.label] for v in own))
        after = self._plain(claim, ca.vec(moves[estimate]))
        _require_known([*targets, moved], seen)
        moved = with_constant(seen, after, theta, moved)
        kept, rows = _closed(targets, own, moved)
        self.labels = tuple(v.label for v in kept)
        s, moved = stack(v.symbol for v in kept), moved[rows]
        left = targets[1] - summed(item.parts, targets[0] * theta)
        given = [s, q, theta, loop.time]
        self._left = ca.Function("left", given, _dense(left, ca.jacobian(left, q), ca.jacobian(left, s)))
        parts = [moved, ca.jacobian(moved, s), ca.jacobian(moved, q), targets[2], ca.jacobian(targets[2], q)]
        self._after = ca.Function("after", given, _dense(*parts, targets[0]))

    def turn(self, s: np.ndarray, q: np.ndarray, before: np.ndarray, theta: np.ndarray, t: float, count: int) -> Turn:
        """The turn of `count` samples after the one at t [s] with the states s and the positions q.

        Parameters
        ----------
        before
            Positions at the sample before, from which Newton's method extrapolates.

        Raises
        ------
        NoBoundError
            The prediction has no solution, such as for a command that is clipped.
        """
        points, T = list[dict[str, np.ndarray]](), self._period
        for k in range(1, count + 1):
            moved, n_s, n_q, *_ = _arrays(self._after, s, q, theta, t + (k - 1) * T)
            s = moved.ravel()
            q, before = self._positions(s, 2 * q - before, theta, t + k * T), q
            _, e_q, e_s = _arrays(self._left, s, q, theta, t + k * T)
            *_, error, J, row = _arrays(self._after, s, q, theta, t + k * T)
            points.append({"n_s": n_s, "n_q": n_q, "e_q": e_q, "e_s": e_s, "error": error, "J": J, "row": row})
        errors, rows = (np.array([point[name].ravel() for point in points]) for name in ("error", "row"))
        with np.errstate(over="ignore", invalid="ignore"):  # a law that is unstable with this estimate
            return Turn(errors, rows, _gains(points))

    def _positions(self, s: np.ndarray, q: np.ndarray, theta: np.ndarray, t: float) -> np.ndarray:
        """The positions at which (1) is zero."""
        for _ in range(NEWTON):
            left, slope, _ = _arrays(self._left, s, q, theta, t)
            if not slope.any():
                raise NoBoundError(
                    f"its rows do not vary with the positions at t = {t:.6g} s: an encoder rounds them, or a command "
                    "is clipped"
                )
            try:
                step = np.linalg.solve(slope, left.ravel())
            except np.linalg.LinAlgError:
                break
            q = q - step
            if np.max(np.abs(step)) <= CLOSE * max(1.0, float(np.max(np.abs(q)))):
                return q
            if not np.all(np.isfinite(q)):
                break
        raise NoBoundError(
            f"the estimate at the end of the run does not predict the motion at t = {t:.6g} s: a command is clipped, "
            "or the law has not yet learned a model of its servo"
        )

    def _plain(self, claim: Claim, expression: SX) -> SX:
        """The expression on the path, with the numbers of the run."""
        loop = claim.loop
        values = ca.vertcat(loop.p, loop.period), ca.vertcat(ca.SX(ca.DM(loop.p_values)), self._period)
        return ca.densify(ca.substitute([loop.on_path(ca.vec(ca.densify(expression)))], [values[0]], [values[1]])[0])


def _measured(claim: Claim, targets: Sequence[SX], count: int) -> str:
    """The label of the positions: the one state of the plant that moves between samples and is in the rows."""
    used = symbols_in(targets)
    found = [v for v in claim.loop.flowing if used & v.identities]
    if len(found) != 1 or found[0].symbol.numel() != count:
        read = ", ".join(v.label for v in found) or "no position"
        raise NoBoundError(f"its rows or its error read {read} of the plant; expected the positions of {count} joints")
    return found[0].label


def _require_known(targets: Sequence[SX], seen: Sequence[SX]) -> None:
    """Refuse symbols other than states, positions and time."""
    known = symbols_in(seen)
    for symbol in {s.element_hash(): s for target in targets for s in ca.symvar(target)}.values():
        if symbol.element_hash() not in known:
            raise NoBoundError(
                f"the next turn depends on {symbol}, which is neither a sampled state, nor a position, nor a path"
            )


def _closed(targets: Iterable[SX], own: Sequence[Variable], moved: SX) -> tuple[list[Variable], list[int]]:
    """The states on which the targets depend, also through their maps, and their rows in `moved`."""
    places, first = dict[str, range](), 0
    for v in own:
        places[v.label] = range(first, first := first + v.symbol.numel())
    found, waiting = set[str](), list(targets)
    while waiting:
        used, waiting = symbols_in(waiting), list[SX]()
        for v in own:
            if v.label not in found and used & v.identities:
                found.add(v.label)
                waiting.append(moved[list(places[v.label])])
    kept = [v for v in own if v.label in found]
    return kept, [row for v in kept for row in places[v.label]]


def _gains(points: Sequence[dict[str, np.ndarray]]) -> np.ndarray:
    """G of the module docstring, by (2) and (3)."""
    from scipy.sparse import csr_array  # most elements of the derivatives are zero

    count, joints = len(points), points[0]["e_q"].shape[0]
    gains = np.zeros((count, points[0]["J"].shape[0], count * joints))
    states, positions = np.zeros((points[0]["e_s"].shape[1], count * joints)), np.zeros((joints, count * joints))
    for k, point in enumerate(points):
        now = slice(k * joints, (k + 1) * joints)
        states = csr_array(point["n_s"]) @ states + csr_array(point["n_q"]) @ positions
        right = -(csr_array(point["e_s"]) @ states)
        right[:, now] += np.eye(joints)
        try:
            positions = np.linalg.solve(point["e_q"], right)
        except np.linalg.LinAlgError:
            raise NoBoundError("a prediction error does not determine the positions in the next turn") from None
        gains[k] = csr_array(point["J"]) @ positions
    return gains.reshape(count, -1, count, joints)


def _dense(*expressions: SX) -> list[SX]:
    return [ca.densify(x) for x in ca.cse(list(expressions))]


def _arrays(function: Any, *given: Any) -> list[np.ndarray]:
    return [item.full() for item in function.call(list(map(ca.DM, given)))]
