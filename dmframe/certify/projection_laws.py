r"""Checks the law of each projection against the projection lemma at random points, until every branch has occurred.

The `law` and `held` of a set are expressions that a run evaluates; in a proof the correction is a free symbol.
Therefore the law must satisfy the assumptions of the lemma:

- For every true value in the set, the correction c does not increase V: the maximum of
  :math:`(\theta - \theta_{true})^\top W c` is not positive. It is linear in the true value. Its maximum over a box is
  at the bounds, and over an ellipsoid it has a closed form; over a cone it is bounded if c is in the polar cone, and
  then attained at the apex. No true value has to be sampled.
- On the boundary of the set and outside, the nominal rate plus c does not point outward.
- `held` does not change a point of the set, and otherwise returns the nearest point of the set, in the metric of its
  semi-axes or of its nominal bodies.

The points are on each face, inside and outside, with nominal rates of either sign and zero. Every comparison in the
expressions must have occurred with both results: a branch that no point reaches fails the condition. For a box the
evaluation is exact; for a ball and for bodies a rounding error is allowed.
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
"""Number of random points, in addition to those with equal elements."""
ROUNDING = 1e-9
"""Allowed rounding error for a ball or for bodies, relative to the terms."""
BEYOND = 1e-9
"""Distance of points outside the boundary of a ball or of a set of bodies, in radii or in nominal bodies: rounding
must not move them inside.
"""

Ends = Sequence[np.ndarray]
"""Parameters of a set. Box: lower and upper bounds. Ball: centre, semi-axes, and the gain, a matrix or its diagonal.
Bodies: the nominal ones, and their fraction.
"""
Point = tuple[np.ndarray, np.ndarray]
"""Estimate, and its nominal rate."""


def check_law(projection: Projection, loop: ClosedLoop) -> Checked:
    """Condition that the law of a run satisfies the projection lemma, for this graph's set."""
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
        """All outputs at each point, by a single call, since a call takes longer than the evaluation."""
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
    with suppress(np.linalg.LinAlgError):  # for nominal bodies that are not physically consistent
        tried = list(points(found, np.random.default_rng(0)))
        values = at(tried)
        margins = [margin(found, point, *each[:2]) for point, each in zip(tried, values, strict=True)]
        seen = [each[2] for each in values]
    one_sided = int(np.count_nonzero(~(np.any(np.array(seen) > 0, axis=0) & np.any(np.array(seen) <= 0, axis=0))))
    if one_sided:
        text += f"; {one_sided} of its {len(branches)} comparisons went one way only"
    least = min(margins) if np.isfinite(margins).all() else None
    holds = least is not None and least >= 0 and not one_sided
    shown = None if holds else least  # it is zero on the faces of the set, and gives no information
    # the law of a box is affine in each region of faces and rate signs, and each region has a point
    how = "cases" if isinstance(kept, Box) else "sampled"
    name = Text(Label(projection.name), f": law of the {projection.kind}")
    # an empty set fails other conditions; otherwise the law does not depend on the location of its faces
    return Checked(name, text, shown, holds, "projection lemma", how, margin=ca.SX(0, 1))


def _branches(expressions: Sequence[SX]) -> Iterator[SX]:
    """Switching functions: one branch if positive, the other if not."""
    for element, parts in instructions(expressions):
        if element.op() in COMPARISONS:
            yield element
        elif element.op() in (ca.OP_FMIN, ca.OP_FMAX):
            yield parts[0] - parts[1]
        elif element.op() in (ca.OP_SIGN, ca.OP_FABS):
            yield parts[0]


def _box_points(ends: Ends, rng: np.random.Generator) -> Iterator[Point]:
    """Points below, on and above each bound, and between them, with rates of each sign."""
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


def _box_margin(ends: Ends, point: Point, correction: np.ndarray, projected: np.ndarray) -> float:
    """Least value that must be nonnegative; elementwise, so that it is valid for any diagonal metric."""
    (lower, upper), (state, rate) = ends, point
    moves = rate + correction
    needs = [
        *(-(state - end) * correction for end in ends),
        moves[state <= lower],
        -moves[state >= upper],
        projected - lower,
        upper - projected,
        *(-(state - projected) * (end - projected) for end in ends),
    ]
    return _least(needs)


def _ball_points(ends: Ends, rng: np.random.Generator) -> Iterator[Point]:
    """Points at the centre, inside, on the boundary and outside, with inward, outward and tangential rates."""
    center, radius, _ = ends
    size = center.size
    yield center, rng.normal(size=size)
    for k in range(POINTS):
        away = rng.normal(size=size)
        away *= (rng.uniform(0.05, 0.95), 1 + BEYOND, rng.uniform(1.01, 3))[k % 3] / np.linalg.norm(away)
        outward = away / radius
        rates = (rng.normal(size=size), outward, -outward, np.zeros(size))
        yield center + radius * away, rates[rng.integers(0, len(rates))]


def _ball_margin(ends: Ends, point: Point, correction: np.ndarray, projected: np.ndarray) -> float:
    """Least value that must be nonnegative, with an allowance for rounding, in units of the semi-axes."""
    (center, radius, gain), (state, rate) = ends, point
    at, kept = (state - center) / radius, (projected - center) / radius
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
    """Links inside, on the boundary and outside, for one to four eigenvalues, with rates in all directions.

    The other estimates are arbitrary.
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


def _body_margin(ends: Ends, point: Point, correction: np.ndarray, projected: np.ndarray) -> float:
    """Least value that must be nonnegative, in units of the nominal bodies."""
    nominal, share = ends[0], float(ends[1][0])
    state, rate = point
    if not np.isfinite([*correction, *projected]).all():
        return np.nan
    needs = [-np.abs(correction[nominal.size :]), -np.abs((projected - state)[nominal.size :])]
    for k, root in enumerate(_roots(nominal)):
        own = slice(k * len(INERTIAL), (k + 1) * len(INERTIAL))
        C, D, Z, H = (_transformed(row[own], root) for row in (correction, rate, state, projected))
        Z, H = Z - share * np.eye(4), H - share * np.eye(4)
        small = ROUNDING * (1 + float(np.linalg.norm(Z))) * (1 + float(np.linalg.norm(D)))
        values, V = np.linalg.eigh(Z)
        rim, away = V[:, values <= RIM], Z - H
        needs.append(small + np.linalg.eigvalsh(C))  # otherwise the product would be unbounded over the set
        needs.append(np.atleast_1d(small - np.sum((Z - RIM * np.eye(4)) * C)))
        needs.append(small + np.linalg.eigvalsh(rim.T @ (D + C) @ rim) if rim.size else np.zeros(1))
        needs += [small + np.linalg.eigvalsh(H), small - np.linalg.eigvalsh(away), np.array([small + np.sum(away * H)])]
    return _least(needs)


def _roots(nominal: np.ndarray) -> list[np.ndarray]:
    rows = nominal.reshape(-1, len(INERTIAL))
    return [np.linalg.cholesky(np.array(pseudo_inertia(row.tolist()), dtype=float)) for row in rows]


def _transformed(row: np.ndarray, root: np.ndarray) -> np.ndarray:
    half = np.linalg.solve(root, np.array(pseudo_inertia(row.tolist()), dtype=float))
    whole = np.linalg.solve(root, half.T)
    return np.asarray((whole + whole.T) / 2)


def _greatest(at: np.ndarray, slope: np.ndarray) -> float:
    """Maximum of (at - t)' slope for t in the unit ball."""
    return float(at @ slope + np.linalg.norm(slope))


def _least(needs: Sequence[np.ndarray]) -> float:
    """The least of all values; NaN if one is NaN."""
    return float(np.min(np.concatenate([np.ravel(item) for item in needs])))


_BY_KIND: Final[dict[type, tuple[Callable[..., Iterator[Point]], Callable[..., float]]]] = {
    Box: (_box_points, _box_margin),
    Ball: (_ball_points, _ball_margin),
    Bodies: (_body_points, _body_margin),
}
"""Test points and margin for each kind of set."""
