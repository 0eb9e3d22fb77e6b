"""Estimated bodies that stay bodies: the law on positive definite pseudo-inertias, its step and its storage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from dmframe.certificate import LogDet, Square
from dmframe.naming import named, operation
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
    """The ten inertial parameters of each link, which stand in front."""
    return [a[TEN * k : TEN * (k + 1)] for k in range(joints)]


def moved(a: Any, g: Any, joints: int, c: Any, Gamma: Any) -> tuple[Any, Any]:
    r"""The rate of the estimates that the gradient g drives, and the second term of their step on a clock.

    Each link's pseudo-inertia P moves by :math:`-c\, P Q P`. Over a sample it becomes :math:`A P A^\top` with
    :math:`A = 1 - \tfrac12 c T\, P Q`, which is positive definite whenever P is and A has an inverse.
    """
    rates, seconds = list[Any](), list[Any]()
    for P, Q in ((body(a_k), force(g_k)) for a_k, g_k in zip(links(a, joints), links(g, joints), strict=True)):
        rate = -c * (P @ Q @ P)
        rates.append(parameters(rate))
        seconds.append(parameters(-c * (P @ Q @ rate) / 4))
    rest = g[TEN * joints :]
    return ca.vertcat(*rates, -Gamma * rest), ca.vertcat(*seconds, 0 * rest)


def storage(a: Any, true: Any, joints: int, c: Any, Gamma: Any) -> tuple[LogDet | Square, ...]:
    """The divergence of each estimated body from the true one, and the square of what is no body's."""
    pairs = enumerate(zip(links(a, joints), links(true, joints), strict=True), start=1)
    bodies = [LogDet(named(f"P_hat_{k}", body(a_k)), body(true_k), 2 / c) for k, (a_k, true_k) in pairs]
    rest: Sequence[Square] = ()
    if a.shape[0] > TEN * joints:
        rest = (Square(a[TEN * joints :] - true[TEN * joints :], 1 / Gamma),)
    return (*bodies, *rest)
