"""The robot's equations in scalars, for tools that fuse or compile scalar code, such as JAX.

Vectors are lists of three; constants are Python floats, and zeros are dropped as in generated code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from tests.benchmarks.loop import Loop

Vector = list[Any]


def zero(a: Any) -> bool:
    """True for a constant zero."""
    return isinstance(a, float) and a == 0.0


def mul(a: Any, b: Any) -> Any:
    if zero(a) or zero(b):
        return 0.0
    return b if isinstance(a, float) and a == 1.0 else a if isinstance(b, float) and b == 1.0 else a * b


def add(*terms: Any) -> Any:
    total: Any = 0.0
    for term in terms:
        total = total if zero(term) else term if zero(total) else total + term
    return total


def neg(a: Any) -> Any:
    return 0.0 if zero(a) else -a


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return add(*(mul(s, t) for s, t in zip(a, b, strict=True)))


def plus(*vectors: Vector) -> Vector:
    return [add(*parts) for parts in zip(*vectors, strict=True)]


def times(s: Any, a: Vector) -> Vector:
    return [mul(s, part) for part in a]


def cross(a: Vector, b: Vector) -> Vector:
    return [
        add(mul(a[1], b[2]), neg(mul(a[2], b[1]))),
        add(mul(a[2], b[0]), neg(mul(a[0], b[2]))),
        add(mul(a[0], b[1]), neg(mul(a[1], b[0]))),
    ]


def sym(f: Callable[[Vector, Vector], Vector], a: Vector, b: Vector) -> Vector:
    """The symmetric bilinear form of the quadratic form f(a, a)."""
    return f(a, a) if a is b else times(0.5, plus(f(a, b), f(b, a)))


class Robot:
    """A chain of revolute joints; `sin` and `cos` are those of the tool."""

    def __init__(self, loop: Loop, sin: Callable[[Any], Any], cos: Callable[[Any], Any]) -> None:
        self.n, self.sin, self.cos = loop.n, sin, cos
        self.R = [link["R"].round(15).tolist() for link in loop.links]
        self.r = [link["r"].tolist() for link in loop.links]
        self.axis = [link["axis"].tolist() for link in loop.links]
        self.point = loop.point.tolist()
        self.gravity = [float(value) for value in loop.model.gravity.linear]
        self.inertia = [[float(v) for v in body.toDynamicParameters()] for body in list(loop.model.inertias)[1:]]

    def rotations(self, q: Sequence[Any]) -> list[list[Vector]]:
        """Rotation of each link relative to its parent."""
        found = []
        for j in range(self.n):
            s, c, k = self.sin(q[j]), self.cos(q[j]), self.axis[j]
            turn = []
            for row in range(3):
                line: Vector = []
                for column in range(3):
                    other = 3 - row - column
                    sign = 0.0 if row == column else 1.0 if (row - column) % 3 == 1 else -1.0
                    skew = sign * k[other] if row != column else 0.0
                    kk = k[row] * k[column]
                    diagonal = 1.0 if row == column else 0.0
                    line.append(add(kk, mul(diagonal - kk, c), mul(skew, s)))
                turn.append(line)
            columns = list(zip(*turn, strict=True))
            found.append([[dot(line, column) for column in columns] for line in self.R[j]])
        return found

    def torque(
        self, E: list[list[Vector]], dq: Vector, dq_ref: Vector, ddq: Vector, inertia: Any, *, heavy: bool = True
    ) -> Vector:
        """M ddq + C(q, dq) dq_ref + g by the Slotine-Li recursion, linear in `inertia` [link][10]."""
        same = dq is dq_ref
        w: Vector = [0.0] * 3
        v, alpha = w, [0.0] * 3
        a = [neg(g) for g in self.gravity] if heavy else [0.0] * 3
        wrenches = []
        for j in range(self.n):
            T, k = [list(column) for column in zip(*E[j], strict=True)], self.axis[j]
            r, u, x = self.r[j], w, v
            a = plus(a, cross(alpha, r), sym(lambda b, c, r=r: cross(b, cross(c, r)), u, x))  # type: ignore[misc]
            a, alpha, w = ([dot(line, b) for line in T] for b in (a, alpha, w))
            v = w if same else [dot(line, v) for line in T]
            turn = cross(w, times(dq_ref[j], k))
            turn = turn if same else times(0.5, plus(turn, cross(v, times(dq[j], k))))
            alpha = plus(alpha, times(ddq[j], k), turn)
            w = plus(w, times(dq[j], k))
            v = w if same else plus(v, times(dq_ref[j], k))
            m, mc, six = inertia[j][0], list(inertia[j][1:4]), inertia[j][4:10]
            about = [[six[0], six[1], six[3]], [six[1], six[2], six[4]], [six[3], six[4], six[5]]]

            def by(b: Vector, about: list[Vector] = about) -> Vector:
                return [dot(line, b) for line in about]

            force = plus(times(m, a), cross(alpha, mc), sym(lambda b, c, mc=mc: cross(b, cross(c, mc)), w, v))  # type: ignore[misc]
            moment = plus(by(alpha), cross(mc, a), sym(lambda b, c, by=by: cross(b, by(c)), w, v))  # type: ignore[misc]
            wrenches.append((force, moment))
        out: Vector = [0.0] * self.n
        force, moment = [0.0] * 3, [0.0] * 3
        for j in reversed(range(self.n)):
            force, moment = plus(force, wrenches[j][0]), plus(moment, wrenches[j][1])
            out[j] = dot(self.axis[j], moment)
            force, moment = ([dot(line, b) for line in E[j]] for b in (force, moment))
            moment = plus(moment, cross(self.r[j], force))
        return out

    def acceleration(self, q: Vector, dq: Vector, torque: Vector) -> Vector:
        """ddq under joint torques, by M = L D L'."""
        n, E, still = self.n, self.rotations(q), [0.0] * self.n
        moving = self.torque(E, dq, dq, still, self.inertia)
        b = [add(torque[j], neg(moving[j])) for j in range(n)]
        unit = [[1.0 if row == j else 0.0 for row in range(n)] for j in range(n)]
        M = [self.torque(E, still, still, unit[j], self.inertia, heavy=False) for j in range(n)]
        L: list[Vector] = [[0.0] * n for _ in range(n)]
        d: Vector = []
        for j in range(n):
            d.append(add(M[j][j], *(neg(L[j][k] * L[j][k] * d[k]) for k in range(j))))
            for i in range(j + 1, n):
                L[i][j] = add(M[j][i], *(neg(L[i][k] * L[j][k] * d[k]) for k in range(j))) / d[j]
        for i in range(n):
            b[i] = add(b[i], *(neg(L[i][k] * b[k]) for k in range(i)))
        x = [b[i] / d[i] for i in range(n)]
        for i in reversed(range(n)):
            x[i] = add(x[i], *(neg(L[k][i] * x[k]) for k in range(i + 1, n)))
        return x

    def kinematics(self, q: Vector) -> tuple[Vector, list[Vector]]:
        """The tool's position and its Jacobian's columns."""
        E = self.rotations(q)
        A: list[Vector] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        p: Vector = [0.0] * 3
        places = []
        for j in range(self.n):
            p = plus(p, [dot(line, self.r[j]) for line in A])
            columns = [list(column) for column in zip(*E[j], strict=True)]
            A = [[dot(line, column) for column in columns] for line in A]
            places.append((p, [dot(line, self.axis[j]) for line in A]))
        x = plus(p, [dot(line, self.point) for line in A])
        return x, [cross(axis, plus(x, times(-1.0, origin))) for origin, axis in places]
