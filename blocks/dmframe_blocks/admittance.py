"""Admittance control: a measured force moves the goal of the tool like a mass with spring and damper."""

from __future__ import annotations

from typing import Final, final

from dmframe.block import (
    AbstractBlock,
    Assumption,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Signals,
    StableLinear,
    State,
    sentence,
)

FORCE: Final = sentence("the environment's force {f_ext} stays bounded")


@final
class Admittance(AbstractBlock):
    r"""Computes a compliant goal of the tool from a measured force, and the joint torque that compensates the force.

    .. math::

        \dot{v_a} &= (f_{ext} - D_a v_a - K_a x_a) / M_a, \quad \dot{x_a} = v_a, \quad x_c = x_d + x_a   \tag{1} \\
        \tau_{task} &= -\hat J^\top f_{ext}   \tag{2}

    Wire the goal of the generator to `x_c`, ``task.x_d: NAME.x_c``. Its velocity and acceleration follow from (1)
    without a derivative of the force. With known kinematics, (2) cancels the force in dV/dt, which is then the same as
    without contact: V contains no energy of the environment and bounds :math:`x - x_c` only. The force drives the
    remaining states,

    .. math:: \dot{v_a} = -(K_a / M_a)\, x_a - (D_a / M_a)\, v_a + f_{ext} / M_a   \tag{3}

    so that :math:`x_c` is bounded if the force is, which is assumed. Then :math:`x - x_c` converges to zero, and the
    tool responds to the force with the admittance (1).

    Parameters
    ----------
    M_a : diagonal (m,), kg, > 0
        Mass of the goal. A smaller mass follows the force faster.
    D_a : diagonal (m,), N s/m, > 0
        Damping. On a clock with period :math:`T`, contact with a wall of stiffness :math:`k` requires more than about
        :math:`T k`.
    K_a : diagonal (m,), N/m, > 0
        Stiffness. If the goal :math:`x_d` is at the depth :math:`e` inside a wall of stiffness :math:`k`, the contact
        force settles at :math:`e k K_a / (k + K_a)`.

    Notes
    -----
    Not for: uncertain kinematics, whose Jacobian does not cancel the force; a force that is not measured at the tool
    point.

    References
    ----------
    [Siciliano2009]_ Section 9.3.
    """

    inputs = (
        Input("f_ext", "m", "N"),
        Input("x_d", "m", "m"),
        Input("J_hat", "m n", "m/rad"),
    )
    outputs = (
        Output("x_c", "m", "m"),
        Output("tau_task", "n", "N m"),
    )
    states = (State("x_a", "m", "m"), State("v_a", "m", "m/s"))

    M_a: Diagonal = Positive("m", "kg")
    D_a: Diagonal = Positive("m", "N s/m")
    K_a: Diagonal = Positive("m", "N/m")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        return Equations(
            outputs={"x_c": u.x_d + x.x_a, "tau_task": -u.J_hat.T @ u.f_ext},
            rates={"x_a": x.v_a, "v_a": (u.f_ext - p.D_a * x.v_a - p.K_a * x.x_a) / p.M_a},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage; x_a is bounded by the stable linear subsystem (3)."""
        return Certificate(
            linear=(
                StableLinear(
                    vectors=(x.x_a, x.v_a),
                    rates=((0, 1), (-p.K_a / p.M_a, -p.D_a / p.M_a)),
                    bounded=(x.x_a, x.v_a),
                    otherwise=(Assumption(FORCE, "a passive environment"),),
                    inputs=(0, u.f_ext / p.M_a),
                ),
            ),
        )
