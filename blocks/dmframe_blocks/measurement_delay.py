"""Delay of measurements between robot and controller."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Literal, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import SX, AbstractBlock, Access, Equations, Input, NonNegative, Output, Scalar, Side, Signals, State

_MEASURED = ("q", "dq", "x")


@final
class MeasurementDelay(AbstractBlock):
    r"""Delays the measured signals of joints and tool, and the target position of a servo, by some samples.

    A delay line stores the last five values of each measured signal, the newest first. With d `samples` controllers
    read :math:`s_d`, the value measured d samples ago; with an additional `share`
    :math:`(1 - share) s_d + share\, s_{d+1}`.

    Before the start the robot was at rest.

    Parameters
    ----------
    samples : 0 to 4
        Whole samples of delay.
    share : scalar, >= 0
        Additional fraction of a sample, below 1. Values between samples are interpolated linearly.
    target : sent or none
        Whether the servo's target position is measured and delayed too; none for a robot without it.

    Notes
    -----
    Not for: accelerations, which `accelerometer` measures without delay.

    References
    ----------
    [AstromWittenmark1997]_ Section 3.2.
    """

    side = Side.PLANT
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("x", "m", "m"),
        Input("q_c", "n", "rad", optional=True),
    )
    outputs = (
        Output("q_late", "n", "rad", Access.MEASURED, instead_of="q"),
        Output("dq_late", "n", "rad/s", Access.MEASURED, derivative_of="q_late", instead_of="dq"),
        Output("x_late", "m", "m", Access.MEASURED, instead_of="x"),
        Output("q_c_late", "n", "rad", Access.MEASURED, optional=True, instead_of="q_c"),
    )
    states = (
        State("q_line", "n 5", "rad", sampled=True),
        State("dq_line", "n 5", "rad/s", sampled=True),
        State("x_line", "m 5", "m", sampled=True),
        State("q_c_line", "n 5", "rad", optional=True, sampled=True),
    )
    truth = (Input("q", "n", "rad"),)

    samples: Literal[0, 1, 2, 3, 4] = 1
    share: Scalar | None = NonNegative(default=None)
    target: Literal["sent", "none"] = "sent"

    @model_validator(mode="after")
    def _below_one(self) -> MeasurementDelay:
        if self.share is not None and self.share >= 1:
            raise ValueError(f"expected a share below 1, found {self.share:g}; raise samples")
        return self

    @classmethod
    def fitting(cls, signals: Collection[str]) -> Mapping[str, Any] | None:
        """With the target position of a servo if there is one."""
        if super().fitting(signals) is None:
            return None
        return {} if "q_c" in signals else {"target": "none"}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Columns of the delay lines, preceded by the newest measurement."""
        outputs, after = dict[str, Any](), dict[str, Any]()
        for name in self._measured:
            line = ca.horzcat(getattr(u, name), getattr(x, f"{name}_line"))
            late = line[:, self.samples]
            if "share" in p:
                late = (1 - p.share) * late + p.share * line[:, self.samples + 1]
            outputs[f"{name}_late"], after[f"{name}_line"] = late, line[:, :5]
        return Equations(outputs, next=after)

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """Delay lines filled with the initial pose, at rest."""
        rest = {"q": u.q, "dq": 0 * u.dq, "x": u.x, "q_c": truth.q}
        return {f"{name}_line": ca.repmat(rest[name], 1, 5) for name in self._measured}

    @property
    def _measured(self) -> tuple[str, ...]:
        return (*_MEASURED, "q_c") if self.target == "sent" else _MEASURED
