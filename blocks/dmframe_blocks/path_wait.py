"""A path's own time in continuous time: it goes on more slowly where the tool is behind, or joints would be fast."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import casadi as ca

from dmframe.block import (
    AbstractBlock,
    Certificate,
    Diagonal,
    Driven,
    Equations,
    Input,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    named,
)


@final
class PathWait(AbstractBlock):
    r"""Keeps the time at which a path is followed, so that the path waits for a tool that is behind.

    A path reads it where its time is wired to it, `path.t: pace.t_path`. Its rate, the pace, is led towards a wish
    between 0 and 1, that is a quarter where the tool is as far from its path as `reach`, or a joint's reference
    velocity as large as `u_max`:

    .. math::

        \dot t_{path} &= \mathrm{pace}, \quad
        \dot{\mathrm{pace}} = (\mathrm{wish} - \mathrm{pace}) / \mathrm{recovery}   \tag{1} \\
        \mathrm{wish} &= 1 - \tanh(|x - x_d|^2 / \mathrm{reach}^2 + |\dot q_r / u_{max}|^2)   \tag{2}

    The velocity and the acceleration along the path follow by the chain rule from the pace and its rate, so that no
    proof of a law in continuous time changes: what it is proved to follow is the path as it is then run through. The
    pace stays between 0 and 1, as it starts at 1.

    Parameters
    ----------
    reach : scalar, m, > 0
        Error of the tool at which the path goes at a quarter of its speed.
    u_max : diagonal (n,), rad/s, > 0
        Reference velocity of a joint at which it does too.
    recovery : scalar, s, > 0
        Time constant of the pace. Shorter waits sooner, and asks for more acceleration.

    Notes
    -----
    It shapes the path in time alone: the way stays as it is. Not for: a law that looks ahead over samples; see
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
        """The path begins at its time 0, at its own speed."""
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
        """Nothing is stored; (1) drives the pace, and its wish is bounded."""
        return Certificate(driven=(Driven(vectors=(x.pace,), rates=((-1 / p.recovery,),), bounded=(x.pace,)),))
