"""Extended state observer of a velocity servo: active disturbance rejection at the outer loop, a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX
from dmframe.parameter import Diagonal, Positive
from dmframe.port import Access, Port, State


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

    Parameters
    ----------
    bandwidth : diagonal (n,), rad/s, > 0
        Larger takes away more of the disturbance, passes more noise, and sees more of the servo's own lag as one.

    Notes
    -----
    `disturbance_observer` is the same idea with a memory of one sample: time delay control. The barrier function that
    is put beside such an observer elsewhere, to keep limits, is not here.

    References
    ----------
    [Gao2003]_ for the observer and its one bandwidth; [Zhang2025]_ for its place in the outer loop.
    """

    inputs: ClassVar[tuple[Port, ...]] = (Port("q", "n", "rad"), Port("dq_r", "n", "rad/s"))
    outputs: ClassVar[tuple[Port, ...]] = (Port("dq_c", "n", "rad/s", Access.COMMANDED),)
    states: ClassVar[tuple[State, ...]] = (State("q_hat", "n", "rad"), State("d_hat", "n", "rad/s"))

    bandwidth: Diagonal = Positive("n", "rad/s")

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
