r"""What the checker forms itself from a term's parts: squares, steps of estimates, and delay lines.

All is written for numbers of any ring (`dmframe.exact.ring`): residues, sizes, reals. Matrices are column-major.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, final

Column = Sequence[Any]


def form(ring: Any, left: Column, weight: Column, right: Column) -> Any:
    """Left' W right, with W a scalar, a diagonal as a column, or a matrix."""
    n = len(left)
    if len(weight) == 1:
        return ring.reduced(weight[0] * dot(ring, left, right))
    if len(weight) == n:
        return dot(ring, left, [ring.reduced(w * x) for w, x in zip(weight, right, strict=True)])
    return dot(ring, left, [dot(ring, weight[i::n], right) for i in range(n)])


def dot(ring: Any, left: Column, right: Column) -> Any:
    """Left' right."""
    total: Any = 0
    for a, b in zip(left, right, strict=True):
        if not (type(a) is int and a == 0) and not (type(b) is int and b == 0):
            total = total + a * b
    return ring.reduced(total) if not (type(total) is int and total == 0) else 0


@dataclass(frozen=True)
class Rule:
    """Kind and sizes of steps of an estimate, ``normalised`` or of ``least_squares``.

    Parameters
    ----------
    sizes
        How many parameters each output of the estimator has.
    rows
        How many pairs ``h0, y0, h1, y1 ...`` the parts hold besides ``theta, true, gain, floor``, ``lower, upper`` of a
        box, and ``gathered, retention`` of least squares.
    """

    rule: Literal["normalised", "least_squares"]
    estimate: str
    memory: str
    sizes: tuple[int, ...]
    rows: int
    box: bool


@final
@dataclass(frozen=True)
class Taken:
    """What steps come to: the next states by name, and what they move, lose and gain of half of what they store."""

    moves: Mapping[str, list[Any]]
    moved: Any
    lost: Any
    gained: Any


class Own(NamedTuple):
    """What the steps of one output read; `G` is the triangle of its information matrix, `rows` are pairs h, y."""

    theta: Column
    true: Column
    gain: Column
    rows: list[tuple[Column, Any]]
    floor: Any
    box: tuple[Column, Column] | None
    G: Column
    retention: Any


class Moved(NamedTuple):
    """What the steps of one output come to: its next parameters and matrix, and the summands of the totals, doubled."""

    theta: list[Any]
    G: list[Any]
    moved: list[Any]
    lost: list[Any]
    gained: list[Any]


def taken(
    ring: Any, steps: Rule, parts: Mapping[str, Column], known: dict[int, tuple[Own, Moved]] | None = None
) -> Taken:
    """Take the steps; raises where a divisor vanishes.

    `known` has what outputs came to before, which is used again where they read the same; it is added to.
    """
    known, found = {} if known is None else known, list[Moved]()
    for j, own in enumerate(_own(steps, parts)):
        if j not in known or known[j][0] != own:
            known[j] = own, _RULES[steps.rule](ring, own)
        found.append(known[j][1])
    moves = {steps.estimate: [x for item in found for x in item.theta]}
    if steps.rule == "least_squares":
        moves[steps.memory] = [x for item in found for x in item.G]
    totals = ([x for item in found for x in getattr(item, name)] for name in ("moved", "lost", "gained"))
    return Taken(moves, *(_half(ring, ring.reduced(sum(total, ring.number(0)))) for total in totals))


def _half(ring: Any, value: Any) -> Any:
    return value * ring.inverse(ring.number(2))


def _own(steps: Rule, parts: Mapping[str, Column]) -> Iterator[Own]:
    """What each output reads."""
    squares = steps.rule == "least_squares"
    (floor,), (retention,) = parts["floor"], parts["retention"] if squares else (0,)
    pieces = {
        name: _pieces(steps.sizes, parts[name])
        for name in ("theta", "true", "gain", *(("lower", "upper") if steps.box else ()))
    }
    triangles = _pieces([n * (n + 1) // 2 for n in steps.sizes], parts["gathered"]) if squares else []
    rows = [(_pieces(steps.sizes, parts[f"h{k}"]), parts[f"y{k}"]) for k in range(steps.rows)]
    for j in range(len(steps.sizes)):
        theta, true, gain = (pieces[name][j] for name in ("theta", "true", "gain"))
        box = (pieces["lower"][j], pieces["upper"][j]) if steps.box else None
        own = [(h[j], y[j]) for h, y in rows]
        yield Own(theta, true, gain, own, floor, box, triangles[j] if squares else (), retention)


def _pieces(sizes: Sequence[int], column: Column) -> list[Column]:
    ends = [sum(sizes[: j + 1]) for j in range(len(sizes))]
    return [column[end - size : end] for end, size in zip(ends, sizes, strict=True)]


def _into_box(ring: Any, value: Any, lower: Any, upper: Any) -> Any:
    return ring.call("fmin", ring.call("fmax", value, lower), upper)


def _normalised(ring: Any, own: Own) -> Moved:
    r"""For each row :math:`\theta \leftarrow \theta + \Gamma h \varepsilon / n`, :math:`n = \nu + h' \Gamma h`."""
    moved, lost, gained = list[Any](), list[Any](), list[Any]()
    theta, true, gain, floor = list(own.theta), own.true, own.gain, own.floor
    inverses = [ring.inverse(g) for g in gain]
    for h, y in own.rows:
        learnt = [ring.reduced(g * x) for g, x in zip(gain, h, strict=True)]
        inverse = ring.inverse(floor + dot(ring, h, learnt))
        missed = ring.reduced(y - dot(ring, h, theta))
        error = dot(ring, h, [a - b for a, b in zip(theta, true, strict=True)])
        share = ring.reduced(missed * inverse)
        lost += [ring.reduced(error * error) * inverse, floor * ring.reduced(share * share)]
        gained.append(ring.reduced((missed + error) * (missed + error)) * inverse)
        after = [ring.reduced(now + step * share) for now, step in zip(theta, learnt, strict=True)]
        steps = [ring.reduced((new - now) * w) for new, now, w in zip(after, theta, inverses, strict=True)]
        sums = [new + now - 2 * x for new, now, x in zip(after, theta, true, strict=True)]
        moved.append(dot(ring, steps, sums))
        theta = after
        if own.box:
            theta = [_into_box(ring, x, a, b) for x, a, b in zip(after, *own.box, strict=True)]
    return Moved(theta, [], moved, lost, gained)


def _least_squares(ring: Any, own: Own) -> Moved:
    r"""For each row :math:`\theta \leftarrow \theta + W^{-1} h \varepsilon / n`, :math:`G \leftarrow G + h h'/\nu`."""
    moved, lost, gained = list[Any](), list[Any](), list[Any]()
    theta, true, floor, n = list(own.theta), own.true, own.floor, len(own.theta)
    by_floor, metric, G = ring.inverse(floor), [ring.inverse(g) for g in own.gain], _unpacked(n, own.G)
    for h, y in own.rows:
        W = _plus_diagonal(G, metric)
        learnt = [dot(ring, row, h) for row in inverse_of(ring, W)]
        share = ring.inverse(floor + dot(ring, h, learnt))
        missed = ring.reduced(y - dot(ring, h, theta))
        error = [a - b for a, b in zip(theta, true, strict=True)]
        step = ring.reduced(missed * share)
        after = [ring.reduced(now + part * step) for now, part in zip(theta, learnt, strict=True)]
        G = [[ring.reduced(G[i][k] + ring.reduced(h[i] * h[k]) * by_floor) for k in range(n)] for i in range(n)]
        next_W = _plus_diagonal(G, metric)
        wrong = [a - b for a, b in zip(after, true, strict=True)]
        moved += [_quadratic(ring, wrong, next_W), -_quadratic(ring, error, W)]
        lost.append(missed * step)
        left = missed + dot(ring, h, error)
        gained.append(ring.reduced(left * left) * by_floor)
        theta = after
        if own.box:
            theta, G = _put_back(ring, theta, G, inverse_of(ring, next_W), *own.box)
    kept = [ring.reduced(own.retention * G[row][column]) for column in range(n) for row in range(column, n)]
    return Moved(theta, kept, moved, lost, gained)


_RULES: Final = {"normalised": _normalised, "least_squares": _least_squares}


def _quadratic(ring: Any, vector: Column, W: Sequence[Column]) -> Any:
    return dot(ring, vector, [dot(ring, row, vector) for row in W])


def _plus_diagonal(G: Sequence[Column], diagonal: Column) -> list[list[Any]]:
    return [[x + diagonal[i] if i == k else x for k, x in enumerate(row)] for i, row in enumerate(G)]


def _unpacked(n: int, triangle: Column) -> list[list[Any]]:
    """The symmetric matrix of a lower triangle, column by column."""
    matrix: list[list[Any]] = [[0] * n for _ in range(n)]
    numbers = iter(triangle)
    for column in range(n):
        for row in range(column, n):
            matrix[row][column] = matrix[column][row] = next(numbers)
    return matrix


def inverse_of(ring: Any, W: Sequence[Column]) -> list[list[Any]]:
    """The inverse of a matrix whose leading minors do not vanish: the ring's, or by elimination without pivoting."""
    if own := getattr(ring, "inverse_matrix", None):
        found: list[list[Any]] = own(W)
        return found
    n = len(W)
    rows = [[*row, *(ring.number(int(i == k)) for k in range(n))] for i, row in enumerate(W)]
    for k in range(n):
        pivot = ring.inverse(ring.reduced(rows[k][k]))
        rows[k] = [ring.reduced(x * pivot) for x in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [ring.reduced(x - factor * y) for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def _put_back(
    ring: Any, theta: list[Any], G: list[list[Any]], P: Sequence[Column], lower: Column, upper: Column
) -> tuple[list[Any], list[list[Any]]]:
    """Onto one face after the other in the norm of P^-1; else cut at the box, and G set to zero."""
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        face = _into_box(ring, theta[i], low, high)
        share = ring.reduced((theta[i] - face) * ring.inverse(P[i][i]))
        theta = [ring.reduced(x - P[k][i] * share) for k, x in enumerate(theta)]
        theta[i] = face
    cut = [_into_box(ring, x, low, high) for x, low, high in zip(theta, lower, upper, strict=True)]
    kept = ring.number(1)
    for i in range(len(theta) - 1):  # the last one is on its face or inside
        kept = ring.reduced(kept * ring.call("eq", theta[i], cut[i]))
    return cut, [[ring.reduced(x * kept) for x in row] for row in G]


def pushed(
    ring: Any, newest: Column, state: Column, shapes: tuple[tuple[int, int], tuple[int, int]], when: Any | None
) -> list[Any]:
    """A delay line at the next sample: the newest entry first, the others pushed back, the oldest dropped."""
    (rows, columns), (height, width) = shapes
    if columns == width:
        after = [
            newest[r + c * rows] if r < rows else state[r - rows + c * height]
            for c in range(width)
            for r in range(height)
        ]
    else:
        after = [*newest, *state[: height * (width - columns)]]
    if when is None:
        return after
    kept = ring.call("not", when)
    pairs = zip(after, state, strict=True)
    return [ring.call("if_else_zero", when, new) + ring.call("if_else_zero", kept, old) for new, old in pairs]
