r"""Checks the law of each projection against the projection lemma at random points, until every branch has occurred.

The `law` and `held` of a set are expressions that a run evaluates; in a proof the correction is a free symbol.
So the proof has to know that the law is one that the lemma speaks of:

- whatever the true value in the set is, the correction c does not raise V: the greatest
  :math:`(\theta - \theta_{true})^\top W c` is not above zero. It is linear in the true value, so that its greatest
  value over a box stands at the ends, and over an ellipsoid has a closed form; over a cone it is bounded where c is in
  the cone's polar, and then stands at its tip: no true value need be tried;
- on the set's end and beyond, the nominal rate plus c does not lead out;
- `held` leaves what is in the set where it is, and otherwise is the set's nearest point, in the metric of its own half
  axes, or of its nominal bodies.

The points stand on each face, inside and outside, with nominal rates of either sign and zero. They must have seen every
comparison in the expressions go both ways: a branch that no point reaches fails the condition. For a box there is no
rounding in all this; for a ball and for bodies a rounding error is allowed for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX
from dmframe.certify.checked import Checked
from dmframe.certify.partial_functions import instructions
from dmframe.common.text import Label, Text
from dmframe.diagram.bodies import RIM
from dmframe.diagram.closed_loop import ClosedLoop
from dmframe.diagram.projection import Ball, Bodies, Box, Projection
from dmframe.program import COMPARISONS
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import parameters_of, pseudo_inertia

POINTS = 48
"""Random points, besides those with equal elements."""
ROUNDING = 1e-9
"""What rounding may leave for a ball or for bodies, in proportion to the terms."""
BEYOND = 1e-9
"""How far outside its rim a point on a ball or among bodies stands, in radii or in nominal bodies: rounding must not
put it inside.
"""

Ends = Sequence[np.ndarray]
"""Of a box: lower and upper ends. Of a ball: centre, half axes, and the gain: a matrix, or its diagonal. Of bodies: the
nominal ones, and their share.
"""
Point = tuple[np.ndarray, np.ndarray]
"""Where the estimate is, and its nominal rate."""


def check_law(projection: Projection, loop: ClosedLoop) -> Checked:
    """That the law that a run takes obeys the projection lemma, with this graph's set."""
    text = "(estimate - true value)' W (correction) <= 0 in every branch, and no rate leads out"
    size = projection.state.numel()
    state, nominal = ca.SX.sym("state", size), ca.SX.sym("nominal", size)
    moved = replace(projection, state=state, nominal=nominal)
    law, held = moved.law, moved.set.held(state)
    branches = list(_branches([law, held]))
    kept = moved.set
    full = [end * ca.SX.ones(size) if end.numel() == 1 else end for end in kept.ends]
    outputs = [law, held, ca.vertcat(ca.SX(0, 1), *branches), *full]
    function = ca.Function("law", [state, nominal, loop.p], [ca.densify(item) for item in outputs])

    def at(points: Sequence[Point]) -> list[list[np.ndarray]]:
        """All outputs at each point, by one call: a call takes longer than the evaluation."""
        states, rates = (np.column_stack(columns) for columns in zip(*points, strict=True))
        found = [value.full() for value in function(states, rates, loop.p_values)]
        width = [value.shape[1] // len(points) for value in found]
        return [
            [value[:, k * n : (k + 1) * n].ravel() for value, n in zip(found, width, strict=True)]
            for k in range(len(points))
        ]

    found = at([(np.zeros(size), np.zeros(size))])[0][3:]
    points, margin = next(found for kind, found in _BY_KIND.items() if isinstance(kept, kind))
    margins, seen = [np.nan], [np.zeros(len(branches))]
    with suppress(np.linalg.LinAlgError):  # of nominal bodies that are none
        tried = list(points(found, np.random.default_rng(0)))
        values = at(tried)
        margins = [margin(found, point, *each[:2]) for point, each in zip(tried, values, strict=True)]
        seen = [each[2] for each in values]
    one_way = int(np.count_nonzero(~(np.any(np.array(seen) > 0, axis=0) & np.any(np.array(seen) <= 0, axis=0))))
    if one_way:
        text += f"; {one_way} of its {len(branches)} comparisons went one way only"
    least = min(margins) if np.isfinite(margins).all() else None
    holds = least is not None and least >= 0 and not one_way
    shown = None if holds else least  # on the set's own faces it is zero, which carries no information
    # a box's law is affine between its faces and between signs of the rate: each such case has been a point
    how = "cases" if isinstance(kept, Box) else "sampled"
    name = Text(Label(projection.name), f": law of the {projection.kind}")
    # a set without an inside fails other conditions; of all others the law is the same, wherever their faces lie
    return Checked(name, text, shown, holds, "projection lemma", how, margin=ca.SX(0, 1))


def _branches(expressions: Sequence[SX]) -> Iterator[SX]:
    """What decides between branches: above zero one way, and not above it the other."""
    for element, parts in instructions(expressions):
        if element.op() in COMPARISONS:
            yield element
        elif element.op() in (ca.OP_FMIN, ca.OP_FMAX):
            yield parts[0] - parts[1]
        elif element.op() in (ca.OP_SIGN, ca.OP_FABS):
            yield parts[0]


def _box_points(ends: Ends, rng: np.random.Generator) -> Iterator[Point]:
    """Below, on and above each end, and between; with rates of each sign."""
    lower, upper = ends
    width = np.where(upper > lower, upper - lower, 1.0)
    size = lower.size

    def placed(face: np.ndarray) -> np.ndarray:
        off = width * rng.uniform(0.01, 1, size)
        between = lower + (upper - lower) * rng.uniform(0.1, 0.9, size)
        return np.choose(face, [lower - off, lower, between, upper, upper + off])

    for face, sign in product(range(5), (-1, 0, 1)):
        yield placed(np.full(size, face)), sign * rng.uniform(0.1, 2, size)
    for _ in range(POINTS):
        yield placed(rng.integers(0, 5, size)), rng.integers(-1, 2, size) * rng.uniform(0.1, 2, size)


def _box_margin(ends: Ends, point: Point, correction: np.ndarray, put: np.ndarray) -> float:
    """The least value that must not be negative; element by element, so that any diagonal metric is covered."""
    (lower, upper), (state, rate) = ends, point
    moves = rate + correction
    needs = [
        *(-(state - end) * correction for end in ends),
        moves[state <= lower],
        -moves[state >= upper],
        put - lower,
        upper - put,
        *(-(state - put) * (end - put) for end in ends),
    ]
    return _least(needs)


def _ball_points(ends: Ends, rng: np.random.Generator) -> Iterator[Point]:
    """At the centre, inside, on the rim and outside, with rates that lead in, out and along."""
    center, radius, _ = ends
    size = center.size
    yield center, rng.normal(size=size)
    for k in range(POINTS):
        away = rng.normal(size=size)
        away *= (rng.uniform(0.05, 0.95), 1 + BEYOND, rng.uniform(1.01, 3))[k % 3] / np.linalg.norm(away)
        outward = away / radius
        rates = (rng.normal(size=size), outward, -outward, np.zeros(size))
        yield center + radius * away, rates[rng.integers(0, len(rates))]


def _ball_margin(ends: Ends, point: Point, correction: np.ndarray, put: np.ndarray) -> float:
    """The least value that must not be negative, with what rounding may take of it; in units of the half axes."""
    (center, radius, gain), (state, rate) = ends, point
    at, kept = (state - center) / radius, (put - center) / radius
    small = ROUNDING + 1e-15 * float(np.max(np.abs(center / radius)))
    n = correction.size
    slope = radius * (np.linalg.solve(gain.reshape(n, n), correction) if gain.size > n else correction / gain)
    away = at - kept
    needs = [
        small * float(np.linalg.norm(slope)) * (1 + float(np.linalg.norm(at))) - _greatest(at, slope),
        1 + small - float(np.linalg.norm(kept)),
        small * (1 + float(np.linalg.norm(away))) - float(np.linalg.norm(away) - kept @ away),
    ]
    if at @ at >= 1:
        outward = at / radius
        needs.append(
            small * float(np.abs(outward) @ (np.abs(rate) + np.abs(correction))) - float(outward @ (rate + correction))
        )
    return _least([np.array(needs)])


def _body_points(ends: Ends, rng: np.random.Generator) -> Iterator[Point]:
    """Links inside, on the rim and beyond, with one to four eigenvalues there, and rates that lead in, out and along.

    The rest of the estimates stands anywhere.
    """
    nominal, size = ends[0], ends[1].size
    roots = _roots(nominal)
    at = size - nominal.size

    def row(X: np.ndarray, root: np.ndarray) -> np.ndarray:
        return np.array(parameters_of((root @ X @ root.T).tolist()), dtype=float)

    def drawn(k: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for root in roots:
            V, _ = np.linalg.qr(rng.normal(size=(4, 4)))
            off = np.array(
                [rng.uniform(0.01, 3, 4), rng.uniform(0.01, 3, 4), np.full(4, -BEYOND), -rng.uniform(0.01, 3, 4)]
            )
            places = rng.integers(0, 4, 4) if k % 4 else np.full(4, rng.integers(0, 4))
            values = np.choose(places, off)
            rates = rng.normal(size=(4, 4))
            rate = (rates + rates.T, V * rng.uniform(-1, -0.1, 4) @ V.T, np.zeros((4, 4)))[rng.integers(0, 3)]
            yield row(V * (values + ends[1][0]) @ V.T, root), row(rate, root)

    for k in range(2 * POINTS):
        links = list(drawn(k))
        rest = rng.normal(size=(2, at))
        yield (
            np.concatenate([*(a for a, _ in links), rest[0]]),
            np.concatenate([*(rate for _, rate in links), rest[1]]),
        )


def _body_margin(ends: Ends, point: Point, correction: np.ndarray, put: np.ndarray) -> float:
    """The least value that must not be negative, in units of the nominal bodies."""
    nominal, share = ends[0], float(ends[1][0])
    state, rate = point
    if not np.isfinite([*correction, *put]).all():
        return np.nan
    needs = [-np.abs(correction[nominal.size :]), -np.abs((put - state)[nominal.size :])]
    for k, root in enumerate(_roots(nominal)):
        own = slice(k * len(INERTIAL), (k + 1) * len(INERTIAL))
        C, D, Z, H = (_seen(row[own], root) for row in (correction, rate, state, put))
        Z, H = Z - share * np.eye(4), H - share * np.eye(4)
        small = ROUNDING * (1 + float(np.linalg.norm(Z))) * (1 + float(np.linalg.norm(D)))
        values, V = np.linalg.eigh(Z)
        rim, away = V[:, values <= RIM], Z - H
        needs.append(small + np.linalg.eigvalsh(C))  # or some body in the set could be as far away as one likes
        needs.append(np.atleast_1d(small - np.sum((Z - RIM * np.eye(4)) * C)))
        needs.append(small + np.linalg.eigvalsh(rim.T @ (D + C) @ rim) if rim.size else np.zeros(1))
        needs += [small + np.linalg.eigvalsh(H), small - np.linalg.eigvalsh(away), np.array([small + np.sum(away * H)])]
    return _least(needs)


def _roots(nominal: np.ndarray) -> list[np.ndarray]:
    rows = nominal.reshape(-1, len(INERTIAL))
    return [np.linalg.cholesky(np.array(pseudo_inertia(row.tolist()), dtype=float)) for row in rows]


def _seen(row: np.ndarray, root: np.ndarray) -> np.ndarray:
    half = np.linalg.solve(root, np.array(pseudo_inertia(row.tolist()), dtype=float))
    whole = np.linalg.solve(root, half.T)
    return np.asarray((whole + whole.T) / 2)


def _greatest(at: np.ndarray, slope: np.ndarray) -> float:
    """The greatest (at - t)' slope, t in the unit ball."""
    return float(at @ slope + np.linalg.norm(slope))


def _least(needs: Sequence[np.ndarray]) -> float:
    """The least of all; NaN where one is no number."""
    return float(np.min(np.concatenate([np.ravel(item) for item in needs])))


_BY_KIND: Final[dict[type, tuple[Callable[..., Iterator[Point]], Callable[..., float]]]] = {
    Box: (_box_points, _box_margin),
    Ball: (_ball_points, _ball_margin),
    Bodies: (_body_points, _body_margin),
}
"""Where a set's law is tried, and what it must not fall below."""
