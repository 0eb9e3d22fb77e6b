"""Adaptive inverse of a PID position servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, final

import casadi as ca

from dmframe.block import (
    SX,
    Access,
    Adapted,
    AdaptingBlock,
    Assumption,
    Certificate,
    CommonLyapunov,
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
    Written,
    named,
    sentence,
)


@final
class PidInverse(AdaptingBlock):
    r"""Computes the velocity command of a closed PID servo from a reference velocity and a torque.

    With :math:`e = q - q_r` and :math:`\dot z = q_c - q_r`, products element by element:

    .. math::

        \dot q_{ref} &= \dot q_r - K_c e, \quad \sigma = \dot q - \dot q_{ref}                \tag{1} \\
        \dot q_c &= \dot q_{ref} + w_P q_r + w \tau_{dc} - w_P q_c - w_I z              \tag{2} \\
        \dot w   &= -\Lambda\, \tau_{dc} \sigma                           \tag{3} \\
        \dot w_P &= \Lambda_P (q_c - q_r) \sigma                          \tag{4} \\
        \dot w_I &= \Lambda_I z \sigma                                    \tag{5}

    With ``tie: velocity``, the default, K_c feeds the position error back to the reference velocity, eq. (32). Section
    V uses this form. A cascade such as `known_tracking`, with a cross term in :math:`|s|^2, s = \dot q - \dot q_r`,
    requires it. With ``tie: position`` the feedback acts on the reference position instead, eq. (34), which then has
    another name: :math:`\dot q_{ref} = \dot q_r`, and :math:`q_{tie}` with
    :math:`\dot q_{tie} = \dot q_r + K_c (q - q_{tie})` replaces :math:`q_r` everywhere. A passive filter requires this
    form.

    True values: :math:`1/K_\star`, :math:`K_P/K_D`, :math:`K_I/K_D`, with :math:`K_\star = K K_D`. With the servo's
    integrator i, :math:`E = i + z`, :math:`s = \sigma - K_c e` and
    :math:`\bar M = (K_D + B/K) K_c + K_P - K_I/K_c`:

    .. math::

        S &= \tfrac12 |e + K_c E|^2_{K K_I/K_c} + \tfrac12 |e|^2_{K \bar M + K K_c K_D + K_c B}
             + \tfrac12 |w - 1/K_\star|^2_{K_\star/\Lambda} \\
          &\quad + \tfrac12 |w_P - K_P/K_D|^2_{K_\star/\Lambda_P}
             + \tfrac12 |w_I - K_I/K_D|^2_{K_\star/\Lambda_I}             \tag{6} \\
        \dot S &= -s^\top (K_\star + B) s - e^\top K \bar M K_c e
             - \sigma^\top (K u - \tau_{dc} - B \sigma)                   \tag{7}

    S does not contain the command. With :math:`z_2 = q_c - q_r - M \dot q / K_\star`,

    :math:`\dot z = z_2 + r_1` and :math:`\dot z_2 = -(K_I / K_D)\, z - (K_P / K_D)\, z_2 + r_2`
    is a stable linear subsystem with the true gains. Its inputs r are bounded; so are :math:`z` and
    :math:`q_c - q_r`, for any w_P and w_I.

    Parameters
    ----------
    K_c : diagonal (n,), 1/s, > 0
        Gain of the position feedback to the reference. :math:`\bar M` must be positive or zero. A larger gain increases
        the margin and passes more noise.
    tie : velocity or position
        Whether :math:`K_c` acts on the reference velocity, eq. (32), or on the reference position, eq. (34).
    Lambda : diagonal (n,), > 0
        Adaptation gain of the scale :math:`w`. A larger gain adapts to the servo faster and passes more velocity noise.
    Lambda_P, Lambda_I : diagonal (n,), > 0
        Adaptation gains of the ratios :math:`w_P` and :math:`w_I`.
    w, w_P, w_I : (n,), rad/(N m s), 1/s, 1/s^2
        Initial estimates.

    Notes
    -----
    Not for: a PI velocity servo; see `pi_inverse`; a P-PI cascade; see `p_pi_inverse`.

    References
    ----------
    [WangTAC2020]_ eqs. (32)-(39), Theorem 4 and Remark 5.
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
    states = (
        State("q_r", "n", "rad", optional=True),
        State("q_tie", "n", "rad", optional=True),
        State("z", "n", "rad s"),
    )
    estimates = (
        Adapted("w", "n", "rad/(N m s)", gain="Lambda"),
        Adapted("w_P", "n", "1/s", gain="Lambda_P"),
        Adapted("w_I", "n", "1/s^2", gain="Lambda_I"),
    )
    driven_by: ClassVar[str] = "sigma"
    truth = (
        Input("K", "n", "N m/V"),
        Input("K_D", "n", "V s/rad"),
        Input("K_P", "n", "V/rad"),
        Input("K_I", "n", "V/(rad s)"),
        Input("B", "n", "N m s/rad"),
        Input("i", "n", "rad s"),
        Input("u", "n", "V"),
        Input("momentum", "n", "N m s"),
    )

    K_c: Diagonal = Positive("n", "1/s")
    tie: Literal["velocity", "position"] = "velocity"
    Lambda: Diagonal = Positive("n", "1/(N^2 m^2 s)")
    Lambda_P: Diagonal = Positive("n", "1/(rad^2 s)")
    Lambda_I: Diagonal = Positive("n", "1/(rad^2 s^3)")
    w: Diagonal = Real("n", "rad/(N m s)", default=0.0)
    w_P: Diagonal = Real("n", "1/s", default=0.0)
    w_I: Diagonal = Real("n", "1/s^2", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        name, q_r, dq_ref = self._reference(u, x, p)
        return Equations(
            outputs={
                "dq_c": dq_ref + x.w_P * q_r + x.w * u.tau_dc - x.w_P * u.q_c - x.w_I * x.z,
                "dq_ref": dq_ref,
                "sigma": u.dq - dq_ref,
            },
            rates={
                name: u.dq_r if self.tie == "velocity" else u.dq_r + p.K_c * (u.q - x.q_tie),
                "z": u.q_c - q_r,
            },
        )

    def direction(self, u: Signals, x: Signals, p: Signals, sigma: SX) -> Mapping[str, SX]:
        """(3) to (5), but for the gains."""
        _, q_r, _ = self._reference(u, x, p)
        return {"w": -u.tau_dc * sigma, "w_P": (u.q_c - q_r) * sigma, "w_I": x.z * sigma}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The reference position starts at the measured pose."""
        return {"q_r" if self.tie == "velocity" else "q_tie": u.q}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(6) and (7), and the stable linear subsystem of the command."""
        K, K_D, K_P, K_I, B = truth.K, truth.K_D, truth.K_P, truth.K_I, truth.B
        K_star, M_bar = named("K_star", K * K_D), self._M_bar(p, truth)
        _, q_r, dq_ref = self._reference(u, x, p)
        e, sigma, h = u.q - q_r, named("sigma", u.dq - dq_ref), u.q_c - q_r
        s = named("s", u.dq - u.dq_r) if self.tie == "velocity" else sigma - p.K_c * e
        return Certificate(
            storage=(
                Square(e + p.K_c * (truth.i + x.z), K * K_I / p.K_c),
                Square(e, K * M_bar + K * p.K_c * K_D + p.K_c * B),
            ),
            estimates={
                "w": TrueValue(1 / K_star, K_star),
                "w_P": TrueValue(K_P / K_D, K_star),
                "w_I": TrueValue(K_I / K_D, K_star),
            },
            dissipation=(Square(s, K_star + B), Square(e, K * M_bar * p.K_c)),
            dominates=(1,) if self.tie == "velocity" else (1, p.K_c),
            disturbed=(1, p.K_c),
            supply=-ca.dot(sigma, K * truth.u - u.tau_dc - B * sigma),
            linear=(
                StableLinear(
                    vectors=(x.z, h - truth.momentum / K_star),
                    rates=((0, 1), (-K_I / K_D, -K_P / K_D)),
                    bounded=(x.z, h),
                    otherwise=self._otherwise(p),
                ),
            ),
        )

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """M-bar is non-negative; with ``tie: position`` a cascade has a stricter small-gain condition."""
        return (Inequality("M_bar >= 0", self._M_bar(p, truth), "Theorem 4 and Remark 5", strict=False),)

    def _reference(self, u: Signals, x: Signals, p: Signals) -> tuple[str, SX, SX]:
        """The state that is the reference position, its value, and dq_ref."""
        if self.tie == "velocity":
            return "q_r", x.q_r, u.dq_r - p.K_c * (u.q - x.q_r)
        return "q_tie", x.q_tie, u.dq_r

    def _otherwise(self, p: Signals) -> tuple[Condition, ...]:
        """(2) is stable if w_P and w_I move in suitable boxes."""
        equation = Written("z'' + w_P z' + w_I z = 0", "z̈ + w_P ż + w_I z = 0", r"\ddot z + w_P \dot z + w_I z = 0")
        moving = sentence("{equation} stays exponentially stable", equation=equation)
        if "w_P_box" in p and "w_I_box" in p:
            return (CommonLyapunov(moving, p.w_P_box, p.w_I_box, "eq. (43)"),)
        text = sentence("{moving} (give w_P_box and w_I_box to have it checked)", moving=moving)
        return (Assumption(text, "eq. (43)"),)

    def _M_bar(self, p: Signals, truth: Signals) -> SX:
        return named("M_bar", (truth.K_D + truth.B / truth.K) * p.K_c + truth.K_P - truth.K_I / p.K_c)
