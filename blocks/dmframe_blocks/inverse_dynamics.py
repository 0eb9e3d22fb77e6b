"""Inverse dynamics of a known robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from dmframe.block import (
    AbstractBlock,
    Access,
    Certificate,
    Condition,
    Equations,
    Inequality,
    Input,
    Output,
    Real,
    Scalar,
    Signals,
)


@final
class InverseDynamics(AbstractBlock):
    r"""Inverse dynamics along the reference acceleration, with the inertial parameters of the robot's file.

    .. math::

        \tau_c = M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + g(q)   \tag{1}

    and with a model error

    .. math::

        \tau_c = (1 + \mathrm{off}) (M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + g(q))   \tag{2}

    The block has no estimates and no storage. It models the links without friction.

    Parameters
    ----------
    off : scalar
        Relative error of all masses and inertias of the model: with -0.2 the model is a fifth too light. By default the
        model is exact. The option demonstrates the effect of a model error: with (2) the proof is refuted.

    Notes
    -----
    Not for: a robot with an unknown load or friction; see `dynamic_compensator` and `certainty_equivalence`.

    The output `direct` is 1: V contains the tracking error.

    References
    ----------
    [Siciliano2009]_ Section 8.5.2.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_ref", "n", "rad/s"),
        Input("ddq_ref", "n", "rad/s^2", derivative_of="dq_ref"),
    )
    outputs = (Output("tau_c", "n", "N m", Access.COMMANDED),)
    truth = (
        Input("B", "n", "N m s/rad"),
        Input("D", "n", "N m"),
        Input("I_r", "n", "kg m^2"),
        Input("g_share"),
    )

    off: Scalar | None = Real(default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), or (2)."""
        torque = p.robot.inverse_dynamics(u.q, u.dq, u.dq_ref, u.ddq_ref)
        return Equations(outputs={"tau_c": (1 + p.off) * torque if "off" in p else torque})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage."""
        return Certificate(truth={"direct": 1})

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """(1) contains no friction and all of gravity, so the plant must be the same."""
        lacking = [
            ("the plant has no viscous friction", truth.B),
            ("the plant has no Coulomb friction", truth.D),
            ("the maker compensates no gravity", 1 - truth.g_share),
        ]
        if "I_r" in truth:
            lacking.append(("the plant has no rotor inertia", truth.I_r))
        otherwise = "what the plant has beyond the links of (1) has to be estimated: see `dynamic_compensator`"
        return tuple(
            Inequality(says, -rest * rest, "eq. (3)", strict=False, otherwise=otherwise) for says, rest in lacking
        )
