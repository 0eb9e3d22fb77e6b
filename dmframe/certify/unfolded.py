r"""Rules of the framework, unfolded into the few that a checker of certificates knows.

- The energy :math:`e^\top M(q) e` of a chain of rigid bodies becomes the sum of the squares :math:`|\xi_i|^2_{I_i}` of
  its bodies, with the twists :math:`\xi_i` for the joint speeds e and their spatial inertias in the bodies' frames.
- A stable linear equation :math:`\dot z = A z + r` becomes a Lyapunov function: :math:`P \dot z = -Q z + P r` with
  :math:`P = P^\top > 0` and :math:`Q + Q^\top > 0`.
- Normalised steps of an estimate become squares of V(next) - V, and projections onto a box.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, final

import casadi as ca

from dmframe.block.certificate import SX, NormalisedSteps, StableLinear
from dmframe.robot.bodies import Body, bodies_of, skew


@final
@dataclass(frozen=True, eq=False)
class Unfolded:
    """A term of the file: a rule, the role of its value, and its parts."""

    name: str
    role: str
    rule: str
    parts: Mapping[str, SX]
    assumed: str | None = None


def square(name: str, role: str, vector: Any, weight: Any, assumed: str | None = None) -> Unfolded:
    """The square of a vector in a weight, a diagonal or a matrix."""
    return Unfolded(name, role, "square", {"vector": ca.SX(vector), "weight": ca.SX(weight)}, assumed)


# ---- The energy of a chain


def twists(robot: Any, q: SX, speeds: SX) -> list[SX]:
    r"""Twists :math:`(\omega_i, v_i)` of the bodies, SX (6), each in its own frame and for its origin.

    .. math:: \omega_i = R_i^\top \omega_{i-1} + a_i \dot q_i, \quad
        v_i = R_i^\top (v_{i-1} + \omega_{i-1} \times r_i)

    at a revolute joint; a prismatic joint moves v.
    """
    omega, v, found = ca.SX(3, 1), ca.SX(3, 1), list[SX]()
    for link, speed in zip(robot.links(q), ca.vertsplit(speeds), strict=True):
        v = link.rotation.T @ (v + ca.cross(omega, link.offset))
        omega = link.rotation.T @ omega
        if link.revolute:
            omega = omega + link.axis * speed
        else:
            v = v + link.axis * speed
        found.append(ca.densify(ca.vertcat(omega, v)))
    return found


def spatial_inertia(body: Body) -> SX:
    r"""Matrix of the energy :math:`\omega^\top I \omega + 2 \omega^\top (h \times v) + m v^\top v`, SX (6, 6)."""
    h = skew(body.moment)
    return ca.blockcat([[body.inertia, h], [h.T, body.mass * ca.SX.eye(3)]])


def energy(name: str, robot: Any, q: SX, speeds: SX, inertia: SX, rotors: SX) -> Iterator[Unfolded]:
    """Squares whose sum is e' M(q) e.

    The last body may contain a load. The square of its own half and the load is assumed to have a positive weight,
    which follows if the load is a rigid body; the other half, and all other bodies, are decided.
    """
    own, whole = bodies_of(robot.inertia), bodies_of(inertia)
    matrices = [spatial_inertia(body) for body in own]
    loaded = not ca.is_equal(ca.vec(ca.densify(inertia)), ca.vec(ca.densify(robot.inertia)), 1)
    moved = twists(robot, q, speeds)
    for k, (twist, matrix) in enumerate(zip(moved, matrices, strict=True), start=1):
        last = loaded and k == len(moved)
        yield square(f"{name}, body {k}", "stored", twist, matrix / 2 if last else matrix)
    if loaded:
        rest = spatial_inertia(whole[-1]) - matrices[-1] / 2
        yield square(f"{name}, load", "stored", moved[-1], rest, "the load is a rigid body")
    if not rotors.is_zero():
        yield square(f"{name}, rotors", "stored", speeds, rotors)


# ---- Stable linear equations


def lyapunov(item: StableLinear) -> dict[str, SX] | None:
    r"""z, P and Q of :math:`P \dot z = -Q z + P r`; None for more than two equations.

    For two, :math:`P = \det A\, 1 + \mathrm{adj}(A)^\top \mathrm{adj}(A)` and :math:`Q = -P A`, whose symmetric part is
    :math:`-\mathrm{tr} A \det A\, 1`.
    """
    n = item.vectors[0].numel()
    A = [[ca.SX(rate) + ca.SX.zeros(n) for rate in row] for row in item.rates]
    z = ca.vertcat(*item.vectors)
    if len(A) == 1:
        return {"vector": z, "weight": ca.SX.ones(n), "loss": -A[0][0]}
    if len(A) > 2:
        return None
    (a, b), (c, d) = A
    det = a * d - b * c
    p, s, r = det + d * d + c * c, -(d * b + c * a), det + b * b + a * a
    P = ca.blockcat([[ca.diag(p), ca.diag(s)], [ca.diag(s), ca.diag(r)]])
    Q = ca.blockcat(
        [
            [-ca.diag(p * a + s * c), -ca.diag(p * b + s * d)],
            [-ca.diag(s * a + r * c), -ca.diag(s * b + r * d)],
        ]
    )
    return {"vector": z, "weight": P, "loss": Q}


# ---- Steps from sample to sample


def stepped(label: str, item: NormalisedSteps) -> Iterator[Unfolded]:
    r"""Terms of :math:`V^+ - V` with :math:`V = \tfrac12 |\theta - \theta_{true}|^2_{1/\Gamma}`.

    A step with a row (h, y) contributes half of :math:`-(h^\top \tilde\theta)^2/n - \nu \varepsilon^2/n^2 + \eta^2/n`,
    and :math:`a^2/n = \nu (a/n)^2 + \sum_i \Gamma_i (h_i a/n)^2` since :math:`n = \nu + h^\top \Gamma h`. A projection
    from z to x contributes :math:`(x - \theta_{true})^\top \Gamma^{-1} (x - z) - \tfrac12 |x - z|^2_{1/\Gamma}`.
    """
    theta, true, gain, floor = (ca.densify(ca.SX(x)) for x in (item.theta, item.true, item.gain, item.floor))
    gain = gain + ca.SX.zeros(theta.numel())
    yield square(f"|{label} - true value|^2 in the metric gain^-1", "stored", theta - true, 1 / gain)
    ends = [sum(item.parts[:j]) for j in range(len(item.parts) + 1)]
    box = [ca.densify(ca.SX(end)) + ca.SX.zeros(theta.numel()) for end in item.box]
    for h, y in item.rows:
        errors, innovations, unexplained, moved = (list[SX]() for _ in range(4))
        for j, (begin, end) in enumerate(pairwise(ends)):
            own, row = theta[begin:end], ca.densify(ca.SX(h))[begin:end]
            direction = gain[begin:end] * row
            inverse = 1 / (floor + _dot(row, direction))
            innovation = ca.SX(y)[j] - _dot(row, own)
            factor = innovation * inverse
            scaled = ca.vertcat(ca.SX(1), row)
            errors.append(scaled * (_dot(row, own - true[begin:end]) * inverse))
            unexplained.append(scaled * ((ca.SX(y)[j] - _dot(row, true[begin:end])) * inverse))
            innovations.append(factor)
            moved.append(own + direction * factor)
        weights = ca.vertcat(*(ca.vertcat(floor, gain[a:b]) for a, b in pairwise(ends))) / 2
        yield square(f"(h'({label} - true value))^2 / n", "dissipated", ca.vertcat(*errors), weights)
        lost = f"floor (y - h'{label})^2 / n^2"
        yield square(lost, "dissipated", ca.vertcat(*innovations), floor / 2 + ca.SX.zeros(len(innovations)))
        yield square("eta^2 / n", "residual", ca.vertcat(*unexplained), weights)
        theta = ca.vertcat(*moved)
        if box:
            inside = ca.fmin(ca.fmax(theta, box[0]), box[1])
            own = {"lower": box[0], "upper": box[1], "weight": 1 / gain}
            parts = {"vector": theta, "correction": inside - theta, "true": true, **own}
            yield Unfolded(label, "dissipated", "projected", parts)
            yield square(f"the distance of {label} to its box", "dissipated", inside - theta, 1 / (2 * gain))
            theta = inside


def _dot(left: SX, right: SX) -> SX:
    """Sum of products, in the order of the claim's steps."""
    total = ca.SX(0)
    for x, y in zip(ca.vertsplit(left), ca.vertsplit(right), strict=True):
        total = total + x * y
    return total
