"""Self-motion of a redundant robot towards a posture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, final

from dmframe.block import (
    AbstractBlock,
    Assumption,
    Certificate,
    Condition,
    Diagonal,
    Equations,
    Input,
    Output,
    Positive,
    Real,
    Signals,
    sentence,
)


@final
class NullSpacePosture(AbstractBlock):
    r"""Joint velocity towards a posture; the generator uses its null-space part, which does not move the tool.

    .. math::

        \dot q_{null} = -K_{null} (q - q_0)   \tag{1}

    The generator adds :math:`(I - \hat J^+ \hat J) \dot q_{null}` to its reference velocity. With a scalar K_null this
    is gradient descent of :math:`\tfrac12 |q - q_0|^2` along the self-motion. The proof of the tool's motion does not
    depend on it.

    Parameters
    ----------
    K_null : diagonal (n,), 1/s, > 0
        Posture gain. A larger gain returns faster to the posture and requires a faster servo.
    q_0 : (n,), rad
        The posture.

    Notes
    -----
    Not for: a robot with as many joints as task coordinates, which has no self-motion; the block then has no effect.

    References
    ----------
    [Siciliano2009]_ section 3.5.1, the gradient of a cost projected onto the null space.
    """

    renamed: ClassVar[Mapping[str, str]] = {"z": "dq_null", "k": "K_null"}
    inputs = (Input("q", "n", "rad"),)
    outputs = (Output("dq_null", "n", "rad/s"),)

    K_null: Diagonal = Positive("n", "1/s")
    q_0: Diagonal = Real("n", "rad")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"dq_null": -p.K_null * (u.q - p.q_0)})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage: V does not contain the self-motion."""
        return Certificate()

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        """V bounds the task error, not the joints of a redundant robot."""
        return (Assumption(sentence("the joints stay bounded along the self-motion, which {V} does not contain")),)
