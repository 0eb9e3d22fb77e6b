"""Adaptive inverse of a PID position servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Assumption, Certificate, CommonLyapunov, Condition, Inequality, Square
from dmframe.parameter import Box, Diagonal, Interval, Positive, Real, Scalar
from dmframe.port import Access, Port, State


@final
class PidInverse(AbstractBlock):
    r"""Turns a reference velocity and a torque into the velocity command of a PID servo that nobody can open.

    With :math:`e = q - q_r` and :math:`z = \int (q_c - q_r)`, products element by element:

    .. math::

        \dot q_c &= \dot q_{ref} + w_P q_r + w \tau_{dc} - w_P q_c - w_I z, \quad
        \dot q_r = \dot q_{ref} + K_c e                                   \tag{1} \\
        \dot w   &= -\Lambda\, \tau_{dc} \sigma                           \tag{2} \\
        \dot w_P &= \Lambda_P (q_c - q_r) \sigma                          \tag{3} \\
        \dot w_I &= \Lambda_I z \sigma                                    \tag{4}

    True values: :math:`1/K_\star`, :math:`K_P/K_D`, :math:`K_I/K_D`, with :math:`K_\star = K K_D`. With the servo's
    integrator i, :math:`E = i + z`, :math:`s = \sigma - K_c e` and
    :math:`\bar M = (K_D + B/K) K_c + K_P - K_I/K_c`:

    .. math::

        S &= \tfrac12 |e + K_c E|^2_{K K_I/K_c} + \tfrac12 |e|^2_{K \bar M + K K_c K_D + K_c B}
             + \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda} \\
          &\quad + \tfrac12 |w_P - K_P/K_D|^2_{K_\star/\Lambda_P}
             + \tfrac12 |w_I - K_I/K_D|^2_{K_\star/\Lambda_I}             \tag{5} \\
        \dot S &= -s^\top (K_\star + B) s - e^\top K \bar M K_c e
             - \sigma^\top (K u - \tau_{dc} - B \sigma)                   \tag{6}

    Parameters
    ----------
    K_c : diagonal (n,), 1/s, > 0
        Ties the reference to the measured pose. It must make M-bar positive; larger is safer and noisier.
    Lambda : diagonal (n,), > 0
        Adaptation gain of the scale w. Larger learns the servo's stiffness faster and passes more velocity noise.
    Lambda_P, Lambda_I : diagonal (n,), > 0
        Adaptation gains of the ratios w_P and w_I.
    w, w_P, w_I : (n,), rad/(N m s), 1/s, 1/s^2
        The estimates at the start.
    w_box, w_P_box, w_I_box : [lower, upper]
        Intervals onto which the estimates are projected.
    leak, error_leak, dead_zone : 1/s; 1/rad; (n,), rad/s; > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to sigma; no adaptation
        while sigma is below this width. See `dmframe.adaptation`.

    Notes
    -----
    Not for: a PI velocity servo; see `pi_inverse`.

    References
    ----------
    [WangTAC2020]_ eqs. (32)-(39), Theorem 4 and Remark 5.
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("q_c", "n", "rad"),
        Port("dq_ref", "n", "rad/s"),
        Port("sigma", "n", "rad/s"),
        Port("tau_dc", "n", "N m"),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("dq_c", "n", "rad/s", Access.COMMANDED),)
    states: ClassVar[tuple[State, ...]] = (
        State("q_r", "n", "rad"),
        State("z", "n", "rad s"),
        State("w", "n", "rad/(N m s)", box="w_box"),
        State("w_P", "n", "1/s", box="w_P_box"),
        State("w_I", "n", "1/s^2", box="w_I_box"),
    )
    truth: ClassVar[tuple[Port, ...]] = (
        Port("K", "n", "N m/V"),
        Port("K_D", "n", "V s/rad"),
        Port("K_P", "n", "V/rad"),
        Port("K_I", "n", "V/(rad s)"),
        Port("B", "n", "N m s/rad"),
        Port("i", "n", "rad s"),
        Port("u", "n", "V"),
    )

    K_c: Diagonal = Positive("n", "1/s")
    Lambda: Diagonal = Positive("n", "rad^2/(N^2 m^2 s)")
    Lambda_P: Diagonal = Positive("n", "1/(rad^2 s)")
    Lambda_I: Diagonal = Positive("n", "1/(rad^2 s^3)")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_P: Diagonal = Real("n", "1/s", default=0.0)
    w_I: Diagonal = Real("n", "1/s^2", default=0.0)
    w_box: Box = Interval("n", "rad/(N m s)")
    w_P_box: Box = Interval("n", "1/s")
    w_I_box: Box = Interval("n", "1/s^2")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak("1/rad")
    dead_zone: Diagonal | None = DeadZone("n", "rad/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (4)."""
        dq_c = u.dq_ref + x.w_P * x.q_r + x.w * u.tau_dc - x.w_P * u.q_c - x.w_I * x.z
        law = adaptation(p)
        sigma = law.drive(u.sigma)
        return Equations(
            outputs={"dq_c": dq_c},
            rates={
                "q_r": u.dq_ref + p.K_c * (u.q - x.q_r),
                "z": u.q_c - x.q_r,
                "w": law.rate(-p.Lambda * u.tau_dc * sigma, x.w, p.w_0, u.sigma),
                "w_P": law.rate(p.Lambda_P * (u.q_c - x.q_r) * sigma, x.w_P, p.w_P_0, u.sigma),
                "w_I": law.rate(p.Lambda_I * x.z * sigma, x.w_I, p.w_I_0, u.sigma),
            },
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The reference starts at the measured pose."""
        return {"q_r": u.q}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(5) and (6)."""
        K, K_D, K_P, K_I, B = truth.K, truth.K_D, truth.K_P, truth.K_I, truth.B
        K_star, M_bar = K * K_D, self._M_bar(p, truth)
        e = u.q - x.q_r
        E, s = truth.i + x.z, u.sigma - p.K_c * e
        w = Estimate("w - 1/K_star", "w - w(0)", x.w, 1 / K_star, p.w_0, K_star / p.Lambda)
        w_P = Estimate("w_P - K_P/K_D", "w_P - w_P(0)", x.w_P, K_P / K_D, p.w_P_0, K_star / p.Lambda_P)
        w_I = Estimate("w_I - K_I/K_D", "w_I - w_I(0)", x.w_I, K_I / K_D, p.w_I_0, K_star / p.Lambda_I)
        off = (w_P.value - w_P.truth) * (u.q_c - x.q_r) + (w_I.value - w_I.truth) * x.z
        effect = K_star * ((w.value - w.truth) * u.tau_dc - off)
        law = adaptation(p)
        robust = law.terms([w, w_P, w_I], u.sigma, "sigma") + law.idle(u.sigma, effect, "the inverse's torque error")
        return Certificate(
            storage=(
                Square("q - q_r + K_c (i + z)", e + p.K_c * E, K * K_I / p.K_c),
                Square("q - q_r", e, K * M_bar + K * p.K_c * K_D + p.K_c * B),
                w.storage,
                w_P.storage,
                w_I.storage,
            ),
            dissipation=(
                Square("dq - dq_r", s, K_star + B),
                Square("q - q_r", e, K * M_bar * p.K_c),
                *robust.dissipation,
            ),
            excess=robust.excess,
            sigma=(ca.SX(1), p.K_c),
            supply=-ca.dot(u.sigma, K * truth.u - u.tau_dc - B * u.sigma),
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """M-bar > 0, strictly, so that a cascade on top can be paid for; and (1) stable while w_P and w_I move."""
        M_bar = Inequality("M_bar > 0", self._M_bar(p, truth), "Theorem 4 and Remark 5; strict for a cascade")
        moving = "z'' + w_P z' + w_I z = 0 stays exponentially stable"
        if "w_P_box" in p and "w_I_box" in p:
            return (M_bar, CommonLyapunov(moving, p.w_P_box, p.w_I_box, "eq. (43)"))
        return (M_bar, Assumption(f"{moving} (give w_P_box and w_I_box to have it checked)", "eq. (43)"))

    def _M_bar(self, p: Signals, truth: Signals) -> SX:
        return (truth.K_D + truth.B / truth.K) * p.K_c + truth.K_P - truth.K_I / p.K_c
