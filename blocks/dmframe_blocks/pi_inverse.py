"""Adaptive inverse of a PI velocity servo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Assumption, Certificate, Condition, Driven, Inequality, Square
from dmframe.naming import named
from dmframe.parameter import Box, Diagonal, Interval, Positive, Real, Scalar
from dmframe.port import Access, Port, State


@final
class PiInverse(AbstractBlock):
    r"""Turns a reference velocity and a torque into the velocity command of a PI servo that nobody can open.

    .. math::

        \dot q_c &= \dot q_r + w_I q_r + w \tau_{dc} - w_I q_c, \quad
                    \dot q_{ref} = \dot q_r, \quad \sigma = \dot q - \dot q_{ref}             \tag{1} \\
        \dot w   &= -\Lambda (\tau_{dc} \sigma + \tau_f e_f)                                        \tag{2} \\
        \dot w_I &= \Lambda_I ((q_c - q_r) \sigma - q_f e_f)                                       \tag{3}

    products element by element; the terms in :math:`e_f` are those of a composite adaptation, with a
    `filtered_regressor`, and zero without. :math:`\tilde w = w - 1/K_\star` and :math:`\tilde w_I = w_I - K_I/K_P` are
    the estimates minus their true values, with :math:`K_\star = K K_P`. With the servo's integrator i and
    :math:`e = i + q_c - q_r`, so that :math:`\dot e = \sigma`:

    .. math::

        S &= \tfrac12 |e|^2_{K K_I} + \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda}
             + \tfrac12 |w_I - K_I/K_P|^2_{K_\star/\Lambda_I}                                      \tag{4} \\
        \dot S &= -\sigma^\top (K_\star + B) \sigma - \sigma^\top (K u - \tau_{dc} - B \sigma)
                  - e_f^\top K_\star (\tilde w \tau_f + \tilde w_I q_f)                            \tag{5}

    S does not weigh the command. With the momentum :math:`M \dot q`, the true gains drive
    :math:`z_1 = q_c - q_r - M \dot q / K_\star`, and what is left beside :math:`z_1` is bounded, so
    :math:`q_c - q_r` is too: :math:`\dot z_1 = -(K_I / K_P)\, z_1 + r`.

    Parameters
    ----------
    Lambda : diagonal (n,), > 0
        Adaptation gain of the scale w. Larger learns the servo's stiffness faster and passes more velocity noise.
    Lambda_I : diagonal (n,), > 0
        Adaptation gain of the ratio w_I.
    w, w_I : (n,), rad/(N m s), 1/s
        The estimates at the start.
    w_box, w_I_box : [lower, upper]
        Intervals onto which the estimates are projected; a known range only helps.
    leak, error_leak, dead_zone : 1/s; 1/rad; (n,), rad/s; > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to sigma; no adaptation
        while sigma is below this width. See `dmframe.adaptation`.

    Notes
    -----
    Not for: a PID position servo; see `pid_inverse`.

    References
    ----------
    [WangTAC2020]_ eqs. (12), (14), (16).
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("q_c", "n", "rad"),
        Port("dq_r", "n", "rad/s"),
        Port("tau_dc", "n", "N m"),
        Port("tau_f", "n", "N m", optional=True),
        Port("q_f", "n", "rad", optional=True),
        Port("e_f", "n", "rad/s", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (
        Port("dq_c", "n", "rad/s", Access.COMMANDED),
        Port("dq_ref", "n", "rad/s"),
        Port("sigma", "n", "rad/s"),
        Port("w", "n", "rad/(N m s)"),
        Port("w_I", "n", "1/s"),
    )
    states: ClassVar[tuple[State, ...]] = (
        State("q_r", "n", "rad"),
        State("w", "n", "rad/(N m s)", box="w_box"),
        State("w_I", "n", "1/s", box="w_I_box"),
    )
    truth: ClassVar[tuple[Port, ...]] = (
        Port("K", "n", "N m/V"),
        Port("K_P", "n", "V s/rad"),
        Port("K_I", "n", "V/rad"),
        Port("B", "n", "N m s/rad"),
        Port("i", "n", "rad"),
        Port("u", "n", "V"),
        Port("momentum", "n", "N m s"),
    )

    Lambda: Diagonal = Positive("n", "rad^2/(N^2 m^2 s)")
    Lambda_I: Diagonal = Positive("n", "1/(rad^2 s)")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_I: Diagonal = Real("n", "1/s", default=0.0)
    w_box: Box = Interval("n", "rad/(N m s)")
    w_I_box: Box = Interval("n", "1/s")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak("1/rad")
    dead_zone: Diagonal | None = DeadZone("n", "rad/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), (2) and (3)."""
        dq_ref, law = u.dq_r, adaptation(p)
        sigma = u.dq - dq_ref
        drive = law.drive(sigma)
        return Equations(
            outputs={
                "dq_c": dq_ref + x.w_I * x.q_r + x.w * u.tau_dc - x.w_I * u.q_c,
                "dq_ref": dq_ref,
                "sigma": sigma,
                "w": x.w,
                "w_I": x.w_I,
            },
            rates={
                "q_r": u.dq_r,
                "w": law.rate(-p.Lambda * (u.tau_dc * drive + u.tau_f * u.e_f), x.w, p.w_0, sigma),
                "w_I": law.rate(p.Lambda_I * ((u.q_c - x.q_r) * drive - u.q_f * u.e_f), x.w_I, p.w_I_0, sigma),
            },
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The reference starts at the measured pose."""
        return {"q_r": u.q}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5), and what drives the command."""
        K_star = named("K_star", truth.K * truth.K_P)
        sigma = named("sigma", u.dq - u.dq_r)
        e, h = truth.i + u.q_c - x.q_r, u.q_c - x.q_r
        w = Estimate(x.w, 1 / K_star, p.w_0, K_star / p.Lambda)
        w_I = Estimate(x.w_I, truth.K_I / truth.K_P, p.w_I_0, K_star / p.Lambda_I)
        effect = K_star * (w.error * u.tau_dc - w_I.error * h)
        filtered = K_star * (w.error * u.tau_f + w_I.error * u.q_f)
        law = adaptation(p)
        robust = law.terms([w, w_I], sigma) + law.idle(sigma, effect)
        return Certificate(
            storage=(Square(e, truth.K * truth.K_I), w.storage, w_I.storage),
            dissipation=(Square(sigma, K_star + truth.B), *robust.dissipation),
            excess=robust.excess,
            pays=(1,),
            supply=-ca.dot(sigma, truth.K * truth.u - u.tau_dc - truth.B * sigma) - ca.dot(u.e_f, filtered),
            driven=(
                Driven(
                    vectors=(h - truth.momentum / K_star,),
                    rates=((-truth.K_I / truth.K_P,),),
                    bounded=(h,),
                    otherwise=self._otherwise(p),
                ),
            ),
        )

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """(1) itself is stable while w_I stays above zero, which a box guarantees."""
        if "w_I_box" in p:
            return (Inequality("w_I_box: lower end > 0", p.w_I_box[:, 0], "Theorem 1, K_I-hat uniformly positive"),)
        return (Assumption("w_I stays uniformly above zero (give w_I_box to make sure of it)", "Theorem 1"),)
