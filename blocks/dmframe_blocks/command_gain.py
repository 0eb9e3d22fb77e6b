"""Gain error between the commanded velocity and the robot."""

from __future__ import annotations

from typing import final

from dmframe.block import AbstractBlock, Equations, Input, Output, Positive, Scalar, Side, Signals


@final
class CommandGain(AbstractBlock):
    r"""Multiplies each joint's commanded velocity by a gain that is unknown to the controller.

    .. math::

        \dot q_{gain} = \mathrm{gain}\, \dot q_c   \tag{1}

    A loop that is stable with every gain from 1 to 1.3 has a gain margin of 1.3 at its command.

    Parameters
    ----------
    gain : scalar, > 0
        The factor; 1 has no effect.

    Notes
    -----
    Not for: a commanded position.

    References
    ----------
    [AstromWittenmark1997]_ Section 3.3, for the gain margin of a sampled loop.
    """

    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (Output("dq_gain", "n", "rad/s", instead_of="dq_c"),)

    gain: Scalar = Positive(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations({"dq_gain": p.gain * u.dq_c})
