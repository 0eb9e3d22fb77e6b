"""The true parameters of an averaged servo, and the relation between its rows that holds at every instant."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Final

import casadi as ca

from dmframe.block import ANY, SX, Input, PlantIdentity, Signals
from dmframe_blocks._averaged_servo import AveragedServo
from dmframe_blocks._loads import with_held

SERVO_TRUTH: Final = (
    Input("K", "n", "N m/V"),
    Input("K_D", "n", "V s/rad"),
    Input("K_P", "n", ANY),
    Input("K_I", "n", ANY),
    Input("k_p", "n", "1/s"),
    Input("K_v", "n", "V s/rad"),
    Input("K_i", "n", "V/rad"),
    Input("f", "n"),
    Input("xi", "n", "rad"),
    Input("B", "n", "N m s/rad"),
    Input("D", "n", "N m"),
    Input("I_r", "n", "kg m^2"),
    Input("i", "n", ANY),
    Input("q", "n", "rad"),
    Input("dq", "n", "rad/s"),
    Input("q_c", "n", "rad"),
    Input("dq_s", "n", "rad/s"),
    Input("a_held", "10"),
)
"""The parameters and signals of servo and robot that a certificate of an averaged servo reads."""


def true_servo(
    averaged: AveragedServo, servo: str, friction: Collection[str], robot: Any, truth: Signals, offset: SX
) -> tuple[SX, PlantIdentity]:
    """The true theta, and psi' theta of the plant at an instant: its momentum part, and the rest."""
    w, k_P, k_I, further, e, z = _gains(servo, truth, offset)
    B, D = (truth.B if "viscous" in friction else 0 * w), (truth.D if "coulomb" in friction else 0 * w)
    links = with_held(robot.inertia, truth.a_held) if "a_held" in truth else robot.inertia
    true = averaged.row(k_P, k_I, offset, w @ links.T, w * B, w * D, *further)
    Y = robot.gravity_regressor(truth.q) - robot.kinetic_regressor(truth.q, truth.dq)
    one, phi, still = ca.DM.ones(robot.n), robot.coulomb(truth.dq), 0 * truth.dq
    effect = averaged.of_p_pi(truth.dq_s, truth.q_c) if servo == "p_pi" else ()
    rest = averaged.row(e, z, one, Y, truth.dq, phi, *effect)
    momentum = robot.momentum_regressor(truth.q, truth.dq)
    moving = averaged.row(still, still, still, momentum, still, still, *averaged.of_p_pi(still, still))
    return true, PlantIdentity(averaged.answer(moving, true), averaged.answer(rest, true) + truth.dq - truth.dq_s)


def _gains(servo: str, truth: Signals, offset: SX) -> tuple[SX, SX, SX, tuple[SX, ...], SX, SX]:
    """w, the true k_P, k_I and further elements of theta; and e and z of the servo itself."""
    if servo == "pi":
        k_I = truth.K_I / truth.K_P
        i = truth.i - offset / k_I
        return 1 / (truth.K * truth.K_P), k_I, k_I, (), i, i
    e = truth.q - truth.q_c
    if servo == "pid" or "K_v" not in truth:  # a PID servo, for which the further elements are zero
        k_I, none = truth.K_I / truth.K_D, (0 * offset, 0 * offset) if servo == "p_pi" else ()
        return 1 / (truth.K * truth.K_D), truth.K_P / truth.K_D, k_I, none, e, truth.i - offset / k_I
    k_i = truth.K_i / truth.K_v
    k_q = k_i * (1 - truth.f)
    z = -(k_i * (truth.xi + e) + k_q * truth.q_c + offset) / (truth.k_p * k_i)
    return 1 / (truth.K * truth.K_v), truth.k_p + k_i, truth.k_p * k_i, (1 - truth.f, k_q), e, z
