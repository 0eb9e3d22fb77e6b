"""Extended state observer of a velocity servo: active disturbance rejection at the outer loop, a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import SX, AbstractBlock, Access, Diagonal, Equations, Input, Output, Positive, Signals, State


@final
class ExtendedStateObserver(AbstractBlock):
    r"""Takes the servo for an integrator of the command, and all else for a disturbance that it observes.

    .. math::

        \dot q_c &= \dot q_r - \hat d   \tag{1} \\
        \dot{\hat q} &= \dot q_c + \hat d + 2\, \omega_o (q - \hat q), \quad
            \dot{\hat d} = \omega_o^2 (q - \hat q)   \tag{2}

    with :math:`\omega_o = \mathrm{bandwidth}`, products element by element. If :math:`\dot q = \dot q_c + d` with a
    constant d, both errors decay with the double pole :math:`-\omega_o`. A servo is no integrator: it lags, and the
    bandwidth has to stay below what it follows. It knows no model, and learns nothing; nothing is proved of it.

    Behind `safe_reference` it keeps the joints' limits as a control barrier function does. Of all commands with
    :math:`-a h_{low} \le \dot q_c + \hat d \le a h_{up}` that one is nearest to :math:`\dot q_{wish} - \hat d`
    which is :math:`-\hat d` plus the wish between :math:`-a h_{low}` and :math:`a h_{up}`; a is `approach`, h the
    room before either limit. Since d is whatever makes up :math:`\dot q`, its error is that of following the
    reference, :math:`d - \hat d = \dot q - \dot q_r`. So :math:`\dot h \ge -a h - |d - \hat d|`, and
    :math:`h(t) \ge e^{-a t} h(0) - \max |d - \hat d| / a`.

    *Assumed*, not proved: :math:`|\dot d| \le D`. Then :math:`|d - \hat d| \le 2 D / \omega_o`, and the room is
    :math:`h \ge -2 D / (a\, \omega_o)`, up to what fades with :math:`e^{-a t}` and :math:`e^{-\omega_o t}`; no
    smaller figures hold for all such d. A margin of so much keeps the limits. D is an assumption since d holds what the
    servo makes of the observer's own command.

    Parameters
    ----------
    bandwidth : diagonal (n,), 1/s, > 0
        Larger takes away more of the disturbance, passes more noise, and sees more of the servo's own lag as one.

    Notes
    -----
    `disturbance_observer` is the same idea with a memory of one sample: time delay control.

    References
    ----------
    [Gao2003]_ for the observer and its one bandwidth; [Zhang2025]_ for its place in the outer loop, and for the barrier
    function beside it.
    """

    inputs = (Input("q", "n", "rad"), Input("dq_r", "n", "rad/s"))
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)
    states = (State("q_hat", "n", "rad"), State("d_hat", "n", "rad/s"))

    unproved: ClassVar[str] = (
        "its disturbance holds what the servo makes of the command, and how fast that changes can only be assumed; if "
        "by no more than D, joints behind a safe_reference pass what that keeps by at most 2 D/(approach bandwidth)"
    )

    bandwidth: Diagonal = Positive("n", "1/s")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and (2)."""
        missed = u.q - x.q_hat
        return Equations(
            outputs={"dq_c": u.dq_r - x.d_hat},
            rates={
                "q_hat": u.dq_r + 2 * p.bandwidth * missed,
                "d_hat": p.bandwidth * p.bandwidth * missed,
            },
        )

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At the measured pose, with no disturbance."""
        return {"q_hat": u.q}
