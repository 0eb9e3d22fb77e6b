"""The usual baseline: the reference velocity is the command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import AbstractBlock, Access, Equations, Input, Output, Signals


@final
class KinematicCommand(AbstractBlock):
    r"""Commands the reference velocity directly, assuming that the servo tracks it without error.

    .. math::

        \dot q_c = \dot q_r   \tag{1}

    It has no certificate, since it assumes that the servo tracks the command.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: a servo whose lag is relevant. It is a baseline for comparisons.

    References
    ----------
    [WangTAC2020]_ Section V, the comparison.
    """

    renamed: ClassVar[Mapping[str, str]] = {"dq_ref": "dq_r"}
    inputs = (Input("dq_r", "n", "rad/s"),)
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        return Equations(outputs={"dq_c": u.dq_r})
