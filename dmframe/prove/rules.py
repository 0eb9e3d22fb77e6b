r"""Quantities that the checker computes from a term's parts: squares, update steps of estimates, and delay lines.

Numbers can be of any ring (`dmframe.exact.ring`): residues, sizes, reals. Matrices are column-major.
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
    """Kind and sizes of the update steps of an estimate: ``normalised`` or ``least_squares``.

    Parameters
    ----------
    sizes
        Number of parameters of each output of the estimator.
    rows
        Number of pairs ``h0, y0, h1, y1 ...`` that the parts contain in addition to ``theta, true, gain, floor``,
        ``lower, upper`` of a box, and ``gathered, retention`` of least squares.
    """

    rule: Literal["normalised", "least_squares"]
    estimate: str
    memory: str
    sizes: tuple[int, ...]
    rows: int
    box: bool


@final
@dataclass(frozen=True)
class StepResult:
    """Result of update steps: next states by name, and change, decrease and increase of half of the storage."""

    moves: Mapping[str, list[Any]]
    moved: Any
    lost: Any
    gained: Any


class OutputData(NamedTuple):
    """Data of the steps of one output; `G` is the triangle of its information matrix, `rows` are pairs h, y."""

    theta: Column
    true: Column
    gain: Column
    rows: list[tuple[Column, Any]]
    floor: Any
    box: tuple[Column, Column] | None
    G: Column
    retention: Any


class OutputResult(NamedTuple):
    """Result of the steps of one output: next parameters and matrix, and the summands of the totals, doubled."""

    theta: list[Any]
    G: list[Any]
    moved: list[Any]
    lost: list[Any]
    gained: list[Any]


def step_result(
    ring: Any, steps: Rule, parts: Mapping[str, Column], known: dict[int, tuple[OutputData, OutputResult]] | None = None
) -> StepResult:
    """Evaluate the update steps; raises if a divisor vanishes.

    `known` contains results of outputs for earlier data, which are used again for equal data; new results are added.
    """
    known, found = {} if known is None else known, list[OutputResult]()
    for j, data in enumerate(_output_data(steps, parts)):
        if j not in known or known[j][0] != data:
            known[j] = data, _RULES[steps.rule](ring, data)
        found.append(known[j][1])
    moves = {steps.estimate: [x for item in found for x in item.theta]}
    if steps.rule == "least_squares":
        moves[steps.memory] = [x for item in found for x in item.G]
    totals = ([x for item in found for x in getattr(item, name)] for name in ("moved", "lost", "gained"))
    return StepResult(moves, *(_half(ring, ring.reduced(sum(total, ring.number(0)))) for total in totals))


def _half(ring: Any, value: Any) -> Any:
    return value * ring.inverse(ring.number(2))


def _output_data(steps: Rule, parts: Mapping[str, Column]) -> Iterator[OutputData]:
    """Data of each output."""
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
        data = [(h[j], y[j]) for h, y in rows]
        yield OutputData(theta, true, gain, data, floor, box, triangles[j] if squares else (), retention)


def _pieces(sizes: Sequence[int], column: Column) -> list[Column]:
    ends = [sum(sizes[: j + 1]) for j in range(len(sizes))]
    return [column[end - size : end] for end, size in zip(ends, sizes, strict=True)]


def _into_box(ring: Any, value: Any, lower: Any, upper: Any) -> Any:
    return ring.call("fmin", ring.call("fmax", value, lower), upper)


def _normalised(ring: Any, data: OutputData) -> OutputResult:
    r"""For each row :math:`\theta \leftarrow \theta + \Gamma h \varepsilon / n`, :math:`n = \nu + h' \Gamma h`."""
    moved, lost, gained = list[Any](), list[Any](), list[Any]()
    theta, true, gain, floor = list(data.theta), data.true, data.gain, data.floor
    inverses = [ring.inverse(g) for g in gain]
    for h, y in data.rows:
        direction = [ring.reduced(g * x) for g, x in zip(gain, h, strict=True)]
        inverse = ring.inverse(floor + dot(ring, h, direction))
        innovation = ring.reduced(y - dot(ring, h, theta))
        error = dot(ring, h, [a - b for a, b in zip(theta, true, strict=True)])
        factor = ring.reduced(innovation * inverse)
        lost += [ring.reduced(error * error) * inverse, floor * ring.reduced(factor * factor)]
        gained.append(ring.reduced((innovation + error) * (innovation + error)) * inverse)
        after = [ring.reduced(now + step * factor) for now, step in zip(theta, direction, strict=True)]
        steps = [ring.reduced((new - now) * w) for new, now, w in zip(after, theta, inverses, strict=True)]
        sums = [new + now - 2 * x for new, now, x in zip(after, theta, true, strict=True)]
        moved.append(dot(ring, steps, sums))
        theta = after
        if data.box:
            theta = [_into_box(ring, x, a, b) for x, a, b in zip(after, *data.box, strict=True)]
    return OutputResult(theta, [], moved, lost, gained)


def _least_squares(ring: Any, data: OutputData) -> OutputResult:
    r"""For each row :math:`\theta \leftarrow \theta + W^{-1} h \varepsilon / n`, :math:`G \leftarrow G + h h'/\nu`."""
    moved, lost, gained = list[Any](), list[Any](), list[Any]()
    theta, true, floor, n = list(data.theta), data.true, data.floor, len(data.theta)
    by_floor, metric, G = ring.inverse(floor), [ring.inverse(g) for g in data.gain], _unpacked(n, data.G)
    for h, y in data.rows:
        W = _plus_diagonal(G, metric)
        direction = [dot(ring, row, h) for row in inverse_of(ring, W)]
        factor = ring.inverse(floor + dot(ring, h, direction))
        innovation = ring.reduced(y - dot(ring, h, theta))
        error = [a - b for a, b in zip(theta, true, strict=True)]
        step = ring.reduced(innovation * factor)
        after = [ring.reduced(now + part * step) for now, part in zip(theta, direction, strict=True)]
        G = [[ring.reduced(G[i][k] + ring.reduced(h[i] * h[k]) * by_floor) for k in range(n)] for i in range(n)]
        next_W = _plus_diagonal(G, metric)
        wrong = [a - b for a, b in zip(after, true, strict=True)]
        moved += [_quadratic(ring, wrong, next_W), -_quadratic(ring, error, W)]
        lost.append(innovation * step)
        remainder = innovation + dot(ring, h, error)
        gained.append(ring.reduced(remainder * remainder) * by_floor)
        theta = after
        if data.box:
            theta, G = _project_onto_box(ring, theta, G, inverse_of(ring, next_W), *data.box)
    kept = [ring.reduced(data.retention * G[row][column]) for column in range(n) for row in range(column, n)]
    return OutputResult(theta, kept, moved, lost, gained)


_RULES: Final = {"normalised": _normalised, "least_squares": _least_squares}


def _quadratic(ring: Any, vector: Column, W: Sequence[Column]) -> Any:
    return dot(ring, vector, [dot(ring, row, vector) for row in W])


def _plus_diagonal(G: Sequence[Column], diagonal: Column) -> list[list[Any]]:
    return [[x + diagonal[i] if i == k else x for k, x in enumerate(row)] for i, row in enumerate(G)]


def _unpacked(n: int, triangle: Column) -> list[list[Any]]:
    """Symmetric matrix from its lower triangle, stored by columns."""
    matrix: list[list[Any]] = [[0] * n for _ in range(n)]
    numbers = iter(triangle)
    for column in range(n):
        for row in range(column, n):
            matrix[row][column] = matrix[column][row] = next(numbers)
    return matrix


def inverse_of(ring: Any, W: Sequence[Column]) -> list[list[Any]]:
    """Inverse of a matrix with nonzero leading minors: by the ring's method, or by elimination without pivoting."""
    if data := getattr(ring, "inverse_matrix", None):
        found: list[list[Any]] = data(W)
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


def _project_onto_box(
    ring: Any, theta: list[Any], G: list[list[Any]], P: Sequence[Column], lower: Column, upper: Column
) -> tuple[list[Any], list[list[Any]]]:
    """Project onto the faces one after the other in the norm of P^-1; otherwise clip to the box and set G to zero."""
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        face = _into_box(ring, theta[i], low, high)
        factor = ring.reduced((theta[i] - face) * ring.inverse(P[i][i]))
        theta = [ring.reduced(x - P[k][i] * factor) for k, x in enumerate(theta)]
        theta[i] = face
    cut = [_into_box(ring, x, low, high) for x, low, high in zip(theta, lower, upper, strict=True)]
    kept = ring.number(1)
    for i in range(len(theta) - 1):  # the last element is already on its face or inside
        kept = ring.reduced(kept * ring.call("eq", theta[i], cut[i]))
    return cut, [[ring.reduced(x * kept) for x in row] for row in G]


def shifted(
    ring: Any, newest: Column, state: Column, shapes: tuple[tuple[int, int], tuple[int, int]], when: Any | None
) -> list[Any]:
    """Delay line at the next sample: the newest entry is inserted first, and the oldest is dropped."""
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
