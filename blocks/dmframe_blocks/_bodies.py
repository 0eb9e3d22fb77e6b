"""Adaptation of physically consistent inertial parameters: two laws on pseudo-inertias, their steps and storage.

The first law uses the metric of the present estimate, in which the boundary of the set is at infinite distance. The
second uses the constant metric of the nominal body, and projects the estimate onto the set.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from dmframe.block import LogDet, Square, inverse_spd, named, operation
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import dual, parameters_of, pseudo_inertia

TEN = len(INERTIAL)


@operation
def body(a: Any) -> Any:
    """The pseudo-inertia of a link's ten inertial parameters."""
    return ca.blockcat(pseudo_inertia(ca.vertsplit(ca.SX(a))))


@operation
def force(g: Any) -> Any:
    """Q, with trace(Q body(a)) = g'a for all a."""
    return ca.blockcat(dual(ca.vertsplit(ca.SX(g))))


@operation
def parameters(P: Any) -> Any:
    """The ten inertial parameters of a pseudo-inertia."""
    return ca.vertcat(*parameters_of([[P[i, j] for j in range(4)] for i in range(4)]))


def links(a: Any, joints: int) -> list[Any]:
    """The ten inertial parameters of each link, which come first."""
    return [a[TEN * k : TEN * (k + 1)] for k in range(joints)]


def moved(a: Any, g: Any, joints: int, c: Any, Gamma: Any) -> tuple[Any, Any]:
    r"""The rate of the estimates driven by the gradient g, and the second-order term of their step on a clock.

    The rate of each link's pseudo-inertia P is :math:`-c\, P Q P`. Over a sample P becomes :math:`A P A^\top` with
    :math:`A = 1 - \tfrac12 c T\, P Q`, which is positive definite if P is and A is invertible.
    """
    rates, seconds = list[Any](), list[Any]()
    for P, Q in ((body(a_k), force(g_k)) for a_k, g_k in zip(links(a, joints), links(g, joints), strict=True)):
        rate = -c * (P @ Q @ P)
        rates.append(parameters(rate))
        seconds.append(parameters(-c * (P @ Q @ rate) / 4))
    rest = g[TEN * joints :]
    return ca.vertcat(*rates, -Gamma * rest), ca.vertcat(*seconds, 0 * rest)


def natural(g: Any, nominal: Any, joints: int, c: Any, Gamma: Any) -> Any:
    r"""The rate driven by the gradient g in the metric of the nominal bodies: :math:`-c\, P_0 Q P_0` for each link."""
    pairs = zip(links(nominal, joints), links(g, joints), strict=True)
    rates = [parameters(-c * (body(n_k) @ force(g_k) @ body(n_k))) for n_k, g_k in pairs]
    return ca.vertcat(*rates, -Gamma * g[TEN * joints :])


def weight(nominal: Any, joints: int, c: Any, Gamma: Any) -> Any:
    """The metric in which `natural` is the gradient law."""
    rest = nominal.shape[0] - TEN * joints
    return metric_of(nominal[: TEN * joints], c, ca.DM.ones(rest) / Gamma)


@operation
def metric_of(a: Any, c: Any, rest: Any) -> Any:
    """W for each link in a, d'W d = trace(X body(d) X body(d))/c with X the inverse of its body; then diag(rest)."""
    units = [body(ca.DM([float(i == j) for i in range(TEN)])) for j in range(TEN)]
    inverses = [inverse_spd(body(link)) for link in links(a, a.shape[0] // TEN)]
    moved = ([X @ unit @ X / c for unit in units] for X in inverses)
    parts = (ca.blockcat([[ca.trace(unit @ column) for column in columns] for unit in units]) for columns in moved)
    return ca.diagcat(*parts, ca.diag(rest))


def storage(a: Any, true: Any, joints: int, c: Any, Gamma: Any) -> tuple[LogDet | Square, ...]:
    """The divergence of each estimated body from the true one, and the square of the other errors."""
    pairs = enumerate(zip(links(a, joints), links(true, joints), strict=True), start=1)
    bodies = [LogDet(named(f"P_hat_{k}", body(a_k)), body(true_k), 2 / c) for k, (a_k, true_k) in pairs]
    rest: Sequence[Square] = ()
    if a.shape[0] > TEN * joints:
        rest = (Square(a[TEN * joints :] - true[TEN * joints :], 1 / Gamma),)
    return (*bodies, *rest)
