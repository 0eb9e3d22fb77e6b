"""Rigid serial manipulator with motor constants and joint friction."""

from __future__ import annotations

from typing import final

import casadi as ca

from dmframe.block import (
    SX,
    AbstractBlock,
    Access,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Lemma,
    NonNegative,
    Output,
    Positive,
    Scalar,
    Side,
    Signals,
    Square,
    State,
    solve_spd,
)


@final
class Manipulator(AbstractBlock):
    r"""Robot dynamics: rigid links, motors with a constant torque per volt, joint friction.

    .. math::

        M(q) \ddot q + C(q, \dot q) \dot q + B \dot q + D\, \phi(\dot q) + g = K u + \tau_{ext}, \quad x = f(q) \tag{1}

    :math:`\tau_{ext}` is the torque of the environment: see `wall`. The input is optional.

    A manufacturer's servo may already compensate a fraction `maker_gravity` of gravity :math:`g_{full}(q)`, and
    `maker_viscous` of the joints' viscous friction; the outer loop has no information about it. The remaining terms
    are :math:`g = (1 - \mathrm{maker\_gravity})\, g_{full}(q)` and
    :math:`B = \mathrm{viscous} - \mathrm{maker\_viscous}`.

    With `rotor`, :math:`M(q) + \mathrm{diag}(I_r)` replaces :math:`M(q)` everywhere, :math:`I_r` being the rotors'
    inertia, and :math:`\tau_r` contains :math:`I_r \ddot q_{ref}`. The product with the angular velocity of the links
    (gyroscopic torque of the rotors) is neglected, as usual for large gear ratios.

    :math:`\phi(v) = \tanh(v / v_0)` smooths the sign of Coulomb friction; :math:`v_0`, the robot's `friction_velocity`,
    is the same in plant and regressor. With :math:`\sigma = \dot q - \dot q_{ref}`, and the torque along the reference
    :math:`\tau_r = M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + B \dot q_{ref} + D\, \phi(\dot q_{ref}) + g`,
    which is :math:`Y_d a_d`:

    .. math::

        S &= \tfrac12 |\sigma|^2_{M(q)}   \tag{2} \\
        \dot S &= \sigma^\top (K u + \tau_{ext} - B \sigma - \tau_r)
                  - (\dot q - \dot q_{ref})^\top D (\phi(\dot q) - \phi(\dot q_{ref}))   \tag{3}

    The last term of (3) is not positive, since friction is non-decreasing in velocity.

    Parameters
    ----------
    viscous : diagonal (n,), N m s/rad, >= 0
        Viscous friction of the joints.
    coulomb : diagonal (n,), N m, >= 0
        Coulomb friction, :math:`D`.
    rotor : diagonal (n,), kg m^2, >= 0
        Inertia of each joint's rotor and gear about the joint: that of the rotor times the square of the gear ratio. By
        default there is none.
    K : diagonal (n,), N m/V, > 0
        Motor constant: torque per volt.
    maker_gravity : scalar, >= 0
        Fraction of gravity that the manufacturer's servo compensates; 1 is all of it.
    maker_viscous : diagonal (n,), N m s/rad, >= 0
        Viscous friction that the manufacturer's servo compensates; if it exceeds `viscous`, the net friction is
        negative.

    Notes
    -----
    The true value `momentum` is that of the joints; proofs of the inverses use it to bound their commands. The load
    `a_held` is zero: a `payload` has no effect on this block.

    References
    ----------
    [WangTAC2020]_ eqs. (1), (3), properties P2 and P3; Section V for the friction.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("u", "n", "V"),
        Input("tau_ext", "n", "N m", optional=True),
    )
    outputs = (
        Output("q", "n", "rad", Access.MEASURED),
        Output("dq", "n", "rad/s", Access.MEASURED, derivative_of="q"),
        Output("x", "m", "m", Access.MEASURED),
        Output("dx", "m", "m/s", derivative_of="x"),
        Output("ddq", "n", "rad/s^2", derivative_of="dq"),
        Output("g", "n", "N m"),
        Output("K", "n", "N m/V"),
        Output("B", "n", "N m s/rad"),
        Output("D", "n", "N m"),
        Output("g_share"),
        Output("I_r", "n", "kg m^2", optional=True),
    )
    states = (State("q", "n", "rad"), State("dq", "n", "rad/s"))
    truth = (
        Input("sigma", "n", "rad/s"),
        Input("dq_ref", "n", "rad/s"),
        Input("ddq_ref", "n", "rad/s^2", derivative_of="dq_ref"),
    )

    viscous: Diagonal = NonNegative("n", "N m s/rad", default=0.0)
    coulomb: Diagonal = NonNegative("n", "N m", default=0.0)
    rotor: Diagonal | None = NonNegative("n", "kg m^2", default=None)
    K: Diagonal = Positive("n", "N m/V", default=1.0)
    maker_gravity: Scalar = NonNegative(default=0.0)
    maker_viscous: Diagonal = NonNegative("n", "N m s/rad", default=0.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        robot = p.robot
        moving = robot.inverse_dynamics(x.q, x.dq, x.dq, ca.DM.zeros(robot.n), gravity_share=1 - p.maker_gravity)
        friction = self._viscous(p) * x.dq + p.coulomb * robot.coulomb(x.dq)
        ddq = solve_spd(moved(p, x.q), p.K * u.u + u.tau_ext - friction - moving)
        return Equations(
            outputs={
                "q": x.q,
                "dq": x.dq,
                "x": robot.position(x.q),
                "dx": robot.jacobian(x.q) @ x.dq,
                "ddq": ddq,
                "g": (1 - p.maker_gravity) * robot.gravity_torque(x.q),
                "K": p.K,
                "B": self._viscous(p),
                "D": p.coulomb,
                "g_share": 1 - p.maker_gravity,
                **({"I_r": p.rotor} if "rotor" in p else {}),
            },
            rates={"q": x.dq, "dq": ddq},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """(2) and (3); no storage without a sliding variable, as in the torque-based framework."""
        robot = p.robot
        true = {"momentum": moved(p, x.q) @ x.dq, "a_held": ca.DM.zeros(10)}
        if "sigma" not in truth:
            return Certificate(truth=true)
        sigma = truth.sigma
        share = 1 - p.maker_gravity
        reference = robot.inverse_dynamics(x.q, x.dq, truth.dq_ref, truth.ddq_ref, gravity_share=share)
        B = self._viscous(p)
        others = B * truth.dq_ref + p.coulomb * robot.coulomb(truth.dq_ref)
        if "rotor" in p:
            others += p.rotor * truth.ddq_ref
        return Certificate(
            storage=(Square(sigma, moved(p, x.q)),),
            dissipation=(Lemma(p.coulomb, x.dq, truth.dq_ref, robot.friction_velocity),),
            supply=ca.dot(sigma, p.K * u.u + u.tau_ext - B * sigma - reference - others),
            truth=true,
        )

    def _viscous(self, p: Signals) -> SX:
        return p.viscous - p.maker_viscous


def moved(p: Signals, q: SX, a: SX | None = None) -> SX:
    """The mass matrix of the links, and of the rotors if the plant has them."""
    M = p.robot.mass_matrix(q, a)
    return M + ca.diag(p.rotor) if "rotor" in p else M
