"""Delay, jitter and loss of commands between controller and robot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Literal, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import SX, AbstractBlock, Equations, Input, NonNegative, Output, Scalar, Side, Signals, State

_CARRIED: Mapping[str, tuple[str, ...]] = {
    "velocity": ("dq_c",),
    "position": ("dq_c", "q_t"),
    "torque": ("tau_c",),
}


@final
class TransportDelay(AbstractBlock):
    r"""Delays commands by some samples, the same for all joints.

    A delay line stores the last five commands, the newest first. With d `samples` the output is :math:`c_d`, the
    command of d samples ago; with an additional `share` s of a sample :math:`(1 - s) c_d + s c_{d+1}`; or, with a
    probability `late`, :math:`c_{d+1}` instead of :math:`c_d`. With a probability `lost` no command arrives, and the
    last received command remains active.

    Before the first command arrives the robot is held at rest against gravity.

    Parameters
    ----------
    carries : velocity, position or torque
        The kind of command: `dq_c`, `dq_c` with `q_t`, or `tau_c`.
    samples : 0 to 4
        Whole samples of delay.
    share : scalar, >= 0
        Additional fraction of a sample, at most 1. With an exact delay the held command would change within a sample.
        The output is the mean over the sample instead. Its integral, the servo's :math:`q_c`, is exact at each sampling
        instant; between them its error is at most a quarter of a sample times the change of the command.
    late : scalar, >= 0
        Probability, at each sample, that the command is one sample later.
    lost : scalar, >= 0
        Probability, at each sample, that no command arrives.

    Notes
    -----
    A late command has not arrived at the sample at which it is due; with a delay of d or d + 1 the robot then uses the
    previous command. Not for: larger variations of the delay, or commands that overtake each other.

    References
    ----------
    [AstromWittenmark1997]_ Section 3.2 for delays of a fraction of a sample.
    """

    side = Side.PLANT
    inputs = (
        Input("dq_c", "n", "rad/s", optional=True),
        Input("q_t", "n", "rad", optional=True),
        Input("tau_c", "n", "N m", optional=True),
        Input("chance", "2", drawn="uniform"),
    )
    outputs = (
        Output("dq_c_late", "n", "rad/s", optional=True, instead_of="dq_c"),
        Output("q_t_late", "n", "rad", optional=True, instead_of="q_t"),
        Output("tau_c_late", "n", "N m", optional=True, instead_of="tau_c"),
    )
    states = (
        State("dq_c_line", "n 5", "rad/s", optional=True, sampled=True),
        State("q_t_line", "n 5", "rad", optional=True, sampled=True),
        State("tau_c_line", "n 5", "N m", optional=True, sampled=True),
        State("dq_c_last", "n", "rad/s", optional=True, sampled=True),
        State("q_t_last", "n", "rad", optional=True, sampled=True),
        State("tau_c_last", "n", "N m", optional=True, sampled=True),
    )
    truth = (Input("q", "n", "rad"), Input("g", "n", "N m"))

    carries: Literal["velocity", "position", "torque"] = "velocity"
    samples: Literal[0, 1, 2, 3, 4] = 1
    share: Scalar | None = NonNegative(default=None)
    late: Scalar | None = NonNegative(default=None)
    lost: Scalar | None = NonNegative(default=None)

    @model_validator(mode="after")
    def _one_more(self) -> TransportDelay:
        if self.share is not None and self.late is not None:
            raise ValueError("expected share or late, found both")
        if self.share is not None and self.share > 1:
            raise ValueError(f"expected a share of at most 1, found {self.share:g}; raise samples")
        for name in ("late", "lost"):
            if (value := getattr(self, name)) is not None and value > 1:
                raise ValueError(f"expected {name} to be a probability, at most 1, found {value:g}")
        return self

    @classmethod
    def fitting(cls, signals: Collection[str]) -> Mapping[str, Any] | None:
        """The kind of command in the graph."""
        found = {"q_t": "position", "dq_c": "velocity", "tau_c": "torque"}
        return next(({"carries": word} for name, word in found.items() if name in signals), None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """Columns of the delay line, preceded by the newest command."""
        outputs, after = dict[str, Any](), dict[str, Any]()
        for name in _CARRIED[self.carries]:
            line = ca.horzcat(getattr(u, name), getattr(x, f"{name}_line"))
            arrived, before = line[:, self.samples], line[:, self.samples + 1]
            if "share" in p:
                arrived = (1 - p.share) * arrived + p.share * before
            if "late" in p:
                arrived = ca.if_else(u.chance[0] < 2 * p.late - 1, before, arrived)
            if "lost" in p:
                arrived = ca.if_else(u.chance[1] < 2 * p.lost - 1, getattr(x, f"{name}_last"), arrived)
                after[f"{name}_last"] = arrived
            outputs[f"{name}_late"] = arrived
            after[f"{name}_line"] = line[:, :5]
        return Equations(outputs, next=after)

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """A delay line of commands that hold the robot at rest."""
        found = dict[str, SX]()
        for name in _CARRIED[self.carries]:
            rest = 0 * u.dq_c if name == "dq_c" else truth.q if name == "q_t" else truth.g
            found |= {f"{name}_line": ca.repmat(rest, 1, 5), f"{name}_last": rest}
        return found
