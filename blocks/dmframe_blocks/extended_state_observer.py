"""Extended state observer for a velocity servo: active disturbance rejection in the outer loop, a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import SX, AbstractBlock, Access, Diagonal, Equations, Input, Output, Positive, Signals, State


@final
class ExtendedStateObserver(AbstractBlock):
    r"""Models the servo as an integrator of the command with an unknown disturbance, which it observes and cancels.

    .. math::

        \dot q_c &= \dot q_r - \hat d   \tag{1} \\
        \dot{\hat q} &= \dot q_c + \hat d + 2\, \omega_o (q - \hat q), \quad
            \dot{\hat d} = \omega_o^2 (q - \hat q)   \tag{2}

    with :math:`\omega_o = \mathrm{bandwidth}`, products element by element. If :math:`\dot q = \dot q_c + d` with a
    constant d, both errors decay with the double pole :math:`-\omega_o`. A real servo lags, so the bandwidth has to
    stay below that of the servo. The block uses no model and estimates no parameters; it has no proof.

    In series with `safe_reference` it enforces the joint limits like a control barrier function. Among all commands
    with :math:`-a h_{low} \le \dot q_c + \hat d \le a h_{up}` the one nearest to :math:`\dot q_{wish} - \hat d` is
    :math:`-\hat d` plus the wish clipped to :math:`-a h_{low}` and :math:`a h_{up}`; a is `approach`, h the distance
    to either limit. Since d is defined by :math:`\dot q`, its error is the velocity tracking error,
    :math:`d - \hat d = \dot q - \dot q_r`. Therefore :math:`\dot h \ge -a h - |d - \hat d|`, and
    :math:`h(t) \ge e^{-a t} h(0) - \max |d - \hat d| / a`.

    *Assumption*, not proved: :math:`|\dot d| \le D`. Then :math:`|d - \hat d| \le 2 D / \omega_o`, and the distance is
    :math:`h \ge -2 D / (a\, \omega_o)`, up to terms that decay with :math:`e^{-a t}` and :math:`e^{-\omega_o t}`. These
    bounds are tight. A margin of this size keeps the limits. The bound D has to be assumed since d depends on the
    servo's response to the observer's own command.

    Parameters
    ----------
    bandwidth : diagonal (n,), 1/s, > 0
        A larger bandwidth rejects more of the disturbance and passes more noise. It also treats more of the servo's lag
        as a disturbance.

    Notes
    -----
    `disturbance_observer` is the corresponding law with a memory of one sample: time delay control.

    References
    ----------
    [Gao2003]_ for the observer and its single bandwidth; [Zhang2025]_ for its use in the outer loop, with a barrier
    function.
    """

    inputs = (Input("q", "n", "rad"), Input("dq_r", "n", "rad/s"))
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)
    states = (State("q_hat", "n", "rad"), State("d_hat", "n", "rad/s"))

    unproved: ClassVar[str] = (
        "its disturbance depends on the servo's response to the command, whose rate can only be assumed; if the rate "
        "is at most D, joints behind a safe_reference exceed its limits by at most 2 D/(approach bandwidth)"
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
        """The measured pose, and zero disturbance."""
        return {"q_hat": u.q}
