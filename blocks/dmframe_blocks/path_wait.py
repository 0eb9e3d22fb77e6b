"""Path time that slows down for large tool errors or reference velocities (continuous time)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    StableLinear,
    State,
    named,
)


@final
class PathWait(AbstractBlock):
    r"""Computes the time along a path, which slows down when the tool is far from the path.

    A path uses it as its time with the wire `path.t: pace.t_path`. Its rate, the pace, is a filtered wish between 0 and
    1. The wish is about a quarter if the tool's distance from the path is `reach`, or if the reference velocity of a
    joint is `u_max`:

    .. math::

        \dot t_{path} &= \mathrm{pace}, \quad
        \dot{\mathrm{pace}} = (\mathrm{wish} - \mathrm{pace}) / \mathrm{recovery}   \tag{1} \\
        \mathrm{wish} &= 1 - \tanh(|x - x_d|^2 / \mathrm{reach}^2 + |\dot q_r / u_{max}|^2)   \tag{2}

    Velocity and acceleration along the path follow from the pace and its rate by the chain rule. Proofs of
    continuous-time laws remain valid: they hold for the path with its modified timing. The pace stays between 0 and 1,
    since it starts at 1.

    Parameters
    ----------
    reach : scalar, m, > 0
        Tool error at which the path has a quarter of its speed.
    u_max : diagonal (n,), rad/s, > 0
        Reference velocity of a joint at which the path has a quarter of its speed.
    recovery : scalar, s, > 0
        Time constant of the pace. A shorter one reacts faster and requires more acceleration.

    Notes
    -----
    It changes the timing of the path only, not its geometry. Not for: a law with a preview over samples; see
    `path_pace`.

    References
    ----------
    [Siciliano2009]_ Section 4.2, for a path apart from the timing law along it.
    """

    inputs = (
        Input("x", "m", "m"),
        Input("x_d", "m", "m"),
        Input("dq_r", "n", "rad/s"),
    )
    outputs = (Output("t_path", "", "s"), Output("pace"))
    states = (State("t_path", "", "s"), State("pace"))

    reach: Scalar = Positive("", "m", default=0.05)
    u_max: Diagonal = Positive("n", "rad/s", default=2.0)
    recovery: Scalar = Positive("", "s", default=1.0)

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        """Path time 0 and pace 1."""
        return {"pace": ca.DM(1)}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        behind, fast = ca.sumsqr(u.x - u.x_d) / p.reach**2, ca.sumsqr(u.dq_r / p.u_max)
        wish = named("wish", 1 - ca.tanh(behind + fast))
        return Equations(
            outputs={"t_path": x.t_path, "pace": x.pace},
            rates={"t_path": x.pace, "pace": (wish - x.pace) / p.recovery},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage; the pace is bounded by the stable linear subsystem (1), whose wish is bounded."""
        return Certificate(linear=(StableLinear(vectors=(x.pace,), rates=((-1 / p.recovery,),), bounded=(x.pace,)),))
