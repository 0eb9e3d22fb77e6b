"""The torque that a known robot needs."""

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
    r"""Inverse dynamics along the reference acceleration, with the links as the robot's file gives them.

    .. math::

        \tau_c = M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + g(q)   \tag{1}

    and with a model that is wrong

    .. math::

        \tau_c = (1 + \mathrm{off}) (M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + g(q))   \tag{2}

    Nothing is estimated and nothing stored. It knows the links, and no friction.

    Parameters
    ----------
    off : scalar
        By what share all masses and inertias of the model are wrong: -0.2 makes it a fifth too light. Left out, the
        model fits. It is there to show what a wrong model costs: of (2) the proof is refuted.

    Notes
    -----
    Not for: a robot whose load or friction is unknown; see `dynamic_compensator` and `certainty_equivalence`.

    `direct` says that V holds the tracking error: 1.

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
        Input("g_share"),
    )

    off: Scalar | None = Real(default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1), or (2)."""
        torque = p.robot.inverse_dynamics(u.q, u.dq, u.dq_ref, u.ddq_ref)
        return Equations(outputs={"tau_c": (1 + p.off) * torque if "off" in p else torque})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored."""
        return Certificate(truth={"direct": 1})

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """(1) leaves friction out and counts gravity in full, so the plant must too."""
        lacking = (
            ("the plant has no viscous friction", truth.B),
            ("the plant has no Coulomb friction", truth.D),
            ("the maker compensates no gravity", 1 - truth.g_share),
        )
        otherwise = "what the plant has beyond the links of (1) has to be estimated: see `dynamic_compensator`"
        return tuple(
            Inequality(says, -rest * rest, "eq. (3)", strict=False, otherwise=otherwise) for says, rest in lacking
        )
