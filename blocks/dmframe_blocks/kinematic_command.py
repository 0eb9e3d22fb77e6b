"""The baseline that everybody uses today: command the reference velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import AbstractBlock, Access, Equations, Input, Output, Signals


@final
class KinematicCommand(AbstractBlock):
    r"""Trusts the servo to follow at once.

    .. math::

        \dot q_c = \dot q_r   \tag{1}

    It has no certificate: that the servo follows is what it assumes.

    Parameters
    ----------
    None.

    Notes
    -----
    Not for: a servo whose lag matters. It is here to be compared with.

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
