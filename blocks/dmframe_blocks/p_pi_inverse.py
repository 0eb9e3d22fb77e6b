"""Adaptive inverse of a P-PI cascade servo with an unknown fraction of feed-forward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, final

import casadi as ca

from dmframe.block import (
    SX,
    Access,
    Adapted,
    AdaptingBlock,
    Assumption,
    Certificate,
    Condition,
    Diagonal,
    Equations,
    Inequality,
    Input,
    Output,
    Positive,
    Real,
    Signals,
    Square,
    StableLinear,
    State,
    TrueValue,
    named,
)


@final
class PPiInverse(AdaptingBlock):
    r"""Computes the velocity command of a closed P-PI servo from a reference velocity and a torque.

    With :math:`e = q - q_r` and :math:`\dot z = q_c - q_r`, products element by element:

    .. math::

        \dot q_{ref} &= \dot q_r - K_c e, \quad \sigma = \dot q - \dot q_{ref}                \tag{1} \\
        \dot q_c &= w_f \dot q_{ref} + w \tau_{dc} + w_r q_r - w_c q_c - w_z z    \tag{2} \\
        \dot w_f &= -\Lambda_f\, \dot q_{ref} \sigma                      \tag{3} \\
        \dot w   &= -\Lambda\, \tau_{dc} \sigma                           \tag{4} \\
        \dot w_r &= -\Lambda_r\, q_r \sigma                               \tag{5} \\
        \dot w_c &= \Lambda_c\, q_c \sigma                                \tag{6} \\
        \dot w_z &= \Lambda_z\, z \sigma                                  \tag{7}

    The law is that of `pid_inverse` with two more scales, since a fraction f of the velocity command reaches the
    servo's velocity controller: :math:`\dot q_{ref}` has its own scale, and the scales of :math:`q_r` and :math:`q_c`
    differ. True values, with :math:`K_f = K K_v f`: :math:`1/f` for w_f, :math:`1/K_f` for w,
    :math:`(K_v k_p + K_i)/(K_v f)` for w_r, :math:`(K_v k_p + K_i f)/(K_v f)` for w_c, and
    :math:`K_i k_p/(K_v f)` for w_z.

    With these values the servo's voltage is that of a PID servo with :math:`K_D = K_v`,
    :math:`K_P = K_v k_p + K_i` and :math:`K_I = K_i k_p`, whose integrator is :math:`i = (f q_c - q - \xi)/k_p`. With
    :math:`E = i + z`, :math:`s = \dot q - \dot q_r` and :math:`\bar M = (K_D + B/K) K_c + K_P - K_I/K_c`, Theorem 4
    carries over:

    .. math::

        S &= \tfrac12 |e + K_c E|^2_{K K_I/K_c} + \tfrac12 |e|^2_{K \bar M + K K_c K_D + K_c B}
             + \tfrac12 |w_f - 1/f|^2_{K_f/\Lambda_f} + \tfrac12 |w - 1/K_f|^2_{K_f/\Lambda} \\
          &\quad + \tfrac12 |w_r - K_P/(K_v f)|^2_{K_f/\Lambda_r}
             + \tfrac12 |w_c - (K_v k_p + K_i f)/(K_v f)|^2_{K_f/\Lambda_c}
             + \tfrac12 |w_z - K_I/(K_v f)|^2_{K_f/\Lambda_z}             \tag{8} \\
        \dot S &= -s^\top (K K_D + B) s - e^\top K \bar M K_c e
             - \sigma^\top (K u - \tau_{dc} - B \sigma)                   \tag{9}

    S does not contain the command. With :math:`z_2 = q_c - M \dot q / K_f`,

    :math:`\dot z = z_2 - q + r_1` and
    :math:`\dot z_2 = \frac{1}{K_v f} (-K_i k_p z - (K_v k_p + K_i f) z_2 + (K_v k_p + K_i) q) + r_2`
    is a stable linear subsystem with the poles :math:`-k_p/f` and :math:`-K_i/K_v`; r is bounded. The command and z are
    bounded if the joint angles q are. A path of the joints implies this; otherwise it is an assumption, for each f,
    since (5) and (6) read absolute angles: unlike with `pid_inverse`, whole turns of a joint change the loop.

    Parameters
    ----------
    K_c : diagonal (n,), 1/s, > 0
        Gain of the position feedback to the reference. M-bar must be positive or zero. A larger gain increases the
        margin and passes more noise.
    Lambda_f : diagonal (n,), > 0
        Adaptation gain of the scale of the reference velocity.
    Lambda : diagonal (n,), > 0
        Adaptation gain of the scale w of the torque. A larger gain adapts to the servo faster and passes more velocity
        noise.
    Lambda_r, Lambda_c, Lambda_z : diagonal (n,), > 0
        Adaptation gains of the scales of the reference position, the command and its integrated deviation.
    w_f, w, w_r, w_c, w_z : (n,)
        Initial estimates.

    Notes
    -----
    With f = 1 in all joints the servo is a PID servo, and `pid_inverse` needs two scales less and no bound of q. The
    theorem does not cover a filter of the servo's velocity or a lag of its torque. Not for: a servo without
    feed-forward, f = 0, in which the command acts through its integral only; the true scales are then infinite.

    References
    ----------
    [WangTAC2020]_ Theorem 4 and Remark 5, for the PID servo; extended here to five scales.
    """

    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("q_c", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("tau_dc", "n", "N m"),
    )
    outputs = (
        Output("dq_c", "n", "rad/s", Access.COMMANDED),
        Output("dq_ref", "n", "rad/s"),
        Output("sigma", "n", "rad/s"),
    )
    states = (State("q_r", "n", "rad"), State("z", "n", "rad s"))
    estimates = (
        Adapted("w_f", "n", gain="Lambda_f"),
        Adapted("w", "n", "rad/(N m s)", gain="Lambda"),
        Adapted("w_r", "n", "1/s", gain="Lambda_r"),
        Adapted("w_c", "n", "1/s", gain="Lambda_c"),
        Adapted("w_z", "n", "1/s^2", gain="Lambda_z"),
    )
    driven_by: ClassVar[str] = "sigma"
    truth = (
        Input("K", "n", "N m/V"),
        Input("k_p", "n", "1/s"),
        Input("K_v", "n", "V s/rad"),
        Input("K_i", "n", "V/rad"),
        Input("f", "n"),
        Input("B", "n", "N m s/rad"),
        Input("xi", "n", "rad"),
        Input("u", "n", "V"),
        Input("momentum", "n", "N m s"),
    )

    K_c: Diagonal = Positive("n", "1/s")
    Lambda_f: Diagonal = Positive("n", "s/rad^2")
    Lambda: Diagonal = Positive("n", "1/(N^2 m^2 s)")
    Lambda_r: Diagonal = Positive("n", "1/(rad^2 s)")
    Lambda_c: Diagonal = Positive("n", "1/(rad^2 s)")
    Lambda_z: Diagonal = Positive("n", "1/(rad^2 s^3)")
    w_f: Diagonal = Real("n", default=1.0)
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_r: Diagonal = Real("n", "1/s", default=0.0)
    w_c: Diagonal = Real("n", "1/s", default=0.0)
    w_z: Diagonal = Real("n", "1/s^2", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        dq_ref = self._reference(u, x, p)
        command = x.w_f * dq_ref + x.w * u.tau_dc + x.w_r * x.q_r - x.w_c * u.q_c - x.w_z * x.z
        return Equations(
            outputs={"dq_c": command, "dq_ref": dq_ref, "sigma": u.dq - dq_ref},
            rates={"q_r": u.dq_r, "z": u.q_c - x.q_r},
        )

    def direction(self, u: Signals, x: Signals, p: Signals, sigma: SX) -> Mapping[str, SX]:
        """(3) to (7), but for the gains."""
        return {
            "w_f": -self._reference(u, x, p) * sigma,
            "w": -u.tau_dc * sigma,
            "w_r": -x.q_r * sigma,
            "w_c": u.q_c * sigma,
            "w_z": x.z * sigma,
        }

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The reference position starts at the measured pose."""
        return {"q_r": u.q}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(8) and (9), and the stable linear subsystem of the command."""
        K, k_p, K_v, K_i, f, B = truth.K, truth.k_p, truth.K_v, truth.K_i, truth.f, truth.B
        K_f, K_P, K_I, M_bar = named("K_f", K * K_v * f), K_v * k_p + K_i, K_i * k_p, self._M_bar(p, truth)
        dq_ref = self._reference(u, x, p)
        e, sigma = u.q - x.q_r, named("sigma", u.dq - dq_ref)
        integral = (f * u.q_c - u.q - truth.xi) / k_p + x.z
        rest = K_v * k_p + K_i * f
        return Certificate(
            storage=(
                Square(e + p.K_c * integral, K * K_I / p.K_c),
                Square(e, K * M_bar + K * p.K_c * K_v + p.K_c * B),
            ),
            estimates={
                "w_f": TrueValue(1 / f, K_f),
                "w": TrueValue(1 / K_f, K_f),
                "w_r": TrueValue(K_P / (K_v * f), K_f),
                "w_c": TrueValue(rest / (K_v * f), K_f),
                "w_z": TrueValue(K_I / (K_v * f), K_f),
            },
            dissipation=(Square(u.dq - u.dq_r, K * K_v + B), Square(e, K * M_bar * p.K_c)),
            dominates=(1,),
            supply=-ca.dot(sigma, K * truth.u - u.tau_dc - B * sigma),
            linear=(
                StableLinear(
                    vectors=(x.z, u.q_c - truth.momentum / K_f),
                    rates=((0, 1), (-K_I / (K_v * f), -rest / (K_v * f))),
                    bounded=(x.z, u.q_c),
                    otherwise=(Assumption("the joint angles q stay bounded", "(9)"),),
                    inputs=(-u.q, K_P / (K_v * f) * u.q),
                ),
            ),
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """M-bar is non-negative, and the servo has feed-forward."""
        return (
            Inequality("M_bar >= 0", self._M_bar(p, truth), "Theorem 4 and Remark 5", strict=False),
            Inequality(
                "f > 0",
                truth.f,
                "the true value of w_f is 1/f",
                otherwise="the servo has no velocity feed-forward at a joint: the true value 1/f of w_f is infinite",
            ),
        )

    def _reference(self, u: Signals, x: Signals, p: Signals) -> SX:
        return u.dq_r - p.K_c * (u.q - x.q_r)

    def _M_bar(self, p: Signals, truth: Signals) -> SX:
        K_P, K_I = truth.K_v * truth.k_p + truth.K_i, truth.K_i * truth.k_p
        return named("M_bar", (truth.K_v + truth.B / truth.K) * p.K_c + K_P - K_I / p.K_c)
