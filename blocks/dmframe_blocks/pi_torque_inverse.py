"""Realises a torque through a PI velocity servo."""

from __future__ import annotations

from typing import ClassVar, final

import casadi as ca

from dmframe.adaptation import DeadZone, ErrorLeak, Estimate, Leak, adaptation
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import Assumption, Certificate, Condition, Driven, Inequality
from dmframe.naming import named
from dmframe.parameter import Box, Diagonal, Interval, Positive, Real, Scalar
from dmframe.port import Access, Port, State


@final
class PiTorqueInverse(AbstractBlock):
    r"""Turns a torque into the velocity command of a PI servo that nobody can open.

    .. math::

        \dot q_c &= \dot q + w_I (q - q_c) + w \tau_d    \tag{1} \\
        \dot w   &= -\Lambda (\tau_d\, \epsilon + \tau_f e_f)         \tag{2} \\
        \dot w_I &= -\Lambda_I ((q - q_c)\, \epsilon + q_f e_f)       \tag{3}

    products element by element; :math:`\epsilon` drives the adaptation, or :math:`e_f` of a `filtered_regressor`.
    Estimates minus true values: :math:`\tilde w = w - 1/K_\star`, :math:`\tilde w_I = w_I - K_I/K_P`, with
    :math:`K_\star = K K_P`. The servo's integrator starts anywhere; its constant offset :math:`i - (q - q_c)` acts as
    the torque :math:`-K K_I (i - q + q_c)`, which the regressor's bias column takes up.

    .. math::

        S &= \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda} + \tfrac12 |w_I - K_I/K_P|^2_{K_\star/\Lambda_I}   \tag{4} \\
        \dot S &= -\epsilon^\top K_\star (\tilde w \tau_d + \tilde w_I (q - q_c))
                  - e_f^\top K_\star (\tilde w \tau_f + \tilde w_I q_f)                                     \tag{5}

    Parameters
    ----------
    Lambda, Lambda_I : diagonal (n,), > 0
        Adaptation gains of w and w_I.
    w, w_I : (n,), rad/(N m s), 1/s
        The estimates at the start.
    w_box, w_I_box : [lower, upper]
        Intervals onto which the estimates are projected; a lower end of w_I_box above zero keeps the command stable.
    leak, error_leak, dead_zone : 1/s; a rate a unit of the error; (n,), of its unit; > 0
        Robust laws, each absent unless given: a pull back to the start; one in proportion to epsilon; no adaptation
        while epsilon is below this width. See `dmframe.adaptation`.

    Notes
    -----
    :math:`\tau_{bias}` is the constant torque of the offset of the servo's integrator.

    References
    ----------
    [WangTAC2020]_ eqs. (49)-(53).
    """

    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("q_c", "n", "rad"),
        Port("tau_d", "n", "N m"),
        Port("epsilon", "n", "*", optional=True),
        Port("tau_f", "n", "N m", optional=True),
        Port("q_f", "n", "rad", optional=True),
        Port("e_f", "n", "rad/s", optional=True),
    )
    outputs: ClassVar[tuple[Port, ...]] = (
        Port("dq_c", "n", "rad/s", Access.COMMANDED),
        Port("w", "n", "rad/(N m s)"),
        Port("w_I", "n", "1/s"),
    )
    states: ClassVar[tuple[State, ...]] = (
        State("w", "n", "rad/(N m s)", box="w_box"),
        State("w_I", "n", "1/s", box="w_I_box"),
    )
    truth: ClassVar[tuple[Port, ...]] = (
        Port("K", "n", "N m/V"),
        Port("K_P", "n", "V s/rad"),
        Port("K_I", "n", "V/rad"),
        Port("i", "n", "rad"),
    )

    Lambda: Diagonal = Positive("n")
    Lambda_I: Diagonal = Positive("n")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_I: Diagonal = Real("n", "1/s", default=0.0)
    w_box: Box = Interval("n", "rad/(N m s)")
    w_I_box: Box = Interval("n", "1/s")
    leak: Scalar | None = Leak()
    error_leak: Scalar | None = ErrorLeak()
    dead_zone: Diagonal | None = DeadZone("n")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), (2) and (3)."""
        law = adaptation(p)
        epsilon = law.drive(u.epsilon)
        return Equations(
            outputs={"dq_c": u.dq + x.w_I * (u.q - u.q_c) + x.w * u.tau_d, "w": x.w, "w_I": x.w_I},
            rates={
                "w": law.rate(-p.Lambda * (u.tau_d * epsilon + u.tau_f * u.e_f), x.w, p.w_0, u.epsilon),
                "w_I": law.rate(-p.Lambda_I * ((u.q - u.q_c) * epsilon + u.q_f * u.e_f), x.w_I, p.w_I_0, u.epsilon),
            },
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(4) and (5)."""
        K_star = named("K_star", truth.K * truth.K_P)
        w = Estimate(x.w, 1 / K_star, p.w_0, K_star / p.Lambda)
        w_I = Estimate(x.w_I, truth.K_I / truth.K_P, p.w_I_0, K_star / p.Lambda_I)
        w_err, w_I_err = w.value - w.truth, w_I.value - w_I.truth
        effect = K_star * (w_err * u.tau_d + w_I_err * (u.q - u.q_c))
        filtered = K_star * (w_err * u.tau_f + w_I_err * u.q_f)
        law = adaptation(p)
        robust = law.terms([w, w_I], u.epsilon)
        robust += law.idle(u.epsilon, effect)
        return Certificate(
            storage=(w.storage, w_I.storage),
            dissipation=robust.dissipation,
            excess=robust.excess,
            supply=-ca.dot(u.epsilon, effect) - ca.dot(u.e_f, filtered),
            driven=(Driven((u.q_c - u.q,), ((-x.w_I,),), (u.q_c - u.q,), self._otherwise(p)),),
            truth={"tau_bias": truth.K * truth.K_I * (truth.i - u.q + u.q_c)},
        )

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """The distance from q to q_c in (1) decays while w_I stays above zero, which a box guarantees."""
        if "w_I_box" in p:
            return (Inequality("w_I_box: lower end > 0", p.w_I_box[:, 0], "Section IV, K_I-hat uniformly positive"),)
        return (Assumption("w_I stays uniformly above zero (give w_I_box to make sure of it)", "Section IV"),)
