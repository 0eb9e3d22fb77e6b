"""The torque that a known robot needs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import Certificate, Condition, Inequality
from dmframe.port import Access, Port


@final
class InverseDynamics(AbstractBlock):
    r"""Inverse dynamics along the reference acceleration, with the links as the robot's file gives them.

    .. math::

        \tau_c = M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + g(q)   \tag{1}

    Nothing is estimated and nothing stored. It knows the links, and no friction.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: a robot whose load or friction is unknown; see `dynamic_compensator` and `certainty_equivalence`.

    `direct` says that V holds the tracking error: 1.

    References
    ----------
    [Siciliano2009]_ Section 8.5.2.
    """

    uses_robot: ClassVar[bool] = True
    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("dq_ref", "n", "rad/s"),
        Port("ddq_ref", "n", "rad/s^2", derivative_of="dq_ref"),
    )
    outputs: ClassVar[tuple[Port, ...]] = (Port("tau_c", "n", "N m", Access.COMMANDED),)
    truth: ClassVar[tuple[Port, ...]] = (
        Port("B", "n", "N m s/rad"),
        Port("D", "n", "N m"),
        Port("g_share"),
    )

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"tau_c": p.robot.inverse_dynamics(u.q, u.dq, u.dq_ref, u.ddq_ref)})

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
        says = "it is not the robot of (1): estimate it instead, see `dynamic_compensator`"
        return tuple(
            Inequality(name, -zero * zero, "eq. (3)", strict=False, otherwise=says) for name, zero in lacking
        )
