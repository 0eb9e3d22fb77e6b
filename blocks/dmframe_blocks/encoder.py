"""Encoder quantisation and velocities from differences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    PERIOD,
    SX,
    AbstractBlock,
    Access,
    Diagonal,
    Equations,
    Input,
    NonNegative,
    Output,
    Positive,
    Scalar,
    Side,
    Signals,
    State,
)


@final
class Encoder(AbstractBlock):
    r"""Quantises the joint angles, with optional noise, and computes velocities from differences of the readings.

    .. math::

        q_m          &= \mathrm{step} \operatorname{floor}(q / \mathrm{step} + 1/2), \quad x_m = f(q_m)   \tag{1} \\
        \dot q_m     &= (q_m - q_{old}) / T, \quad q_{old}^+ = q_m   \tag{2}

    With `noise`, :math:`q + \mathrm{noise}\, \eta` is rounded. The differences are taken over one sample. With a
    `time_constant` they are filtered, with :math:`c = \exp(-T / \mathrm{time\_constant})` and :math:`v_{old}` the
    result of the previous sample:

    .. math::

        \dot q_m = c\, v_{old} + (1 - c) (q_m - q_{old}) / T   \tag{3}

    The electronics of a robot may take differences over a shorter time than a controller's sample, the `window`. The
    reading at the beginning of the window is the rounded :math:`2 \zeta - q`, the first-order Pade approximation of
    the delayed angle:

    .. math::

        \dot q_m = (q_m - \mathrm{step} \operatorname{floor}((2 \zeta - q) / \mathrm{step} + 1/2)) / \mathrm{window},
        \quad \dot \zeta = 2 (q - \zeta) / \mathrm{window}   \tag{4}

    The tool position is computed from the readings with the true kinematics. The servo and all figures use the true
    pose, which controllers cannot read.

    Parameters
    ----------
    step : diagonal (n,), rad, > 0
        Resolution of the encoder; with 17 bits per turn 47.94 urad.
    noise : diagonal (n,), rad, >= 0
        Standard deviation of the noise added to each reading, drawn at each sample.
    window : scalar, s, > 0
        Time over which the differences are taken; by default a sample.
    time_constant : scalar, s, > 0
        Time constant of the filter for differences over a sample; by default they are not filtered.
    tool_from : encoders or sensor
        Source of the tool position: the encoders, or a separate ideal sensor.

    Notes
    -----
    A difference over a window has a delay of half the window. With sampling jitter, T is the nominal period, as in a
    robot that does not measure it. Not for: encoder ripple within a turn, encoder offset, or backlash.

    References
    ----------
    [FranklinPowell1998]_ for rounding and differences.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("x", "m", "m"),
        PERIOD,
        Input("eta", "n", drawn="normal"),
        Input("eta_old", "n", drawn="normal"),
    )
    outputs = (
        Output("q_m", "n", "rad", Access.MEASURED, instead_of="q", rounded_by="step"),
        Output("dq_m", "n", "rad/s", Access.MEASURED, derivative_of="q_m", instead_of="dq"),
        Output("x_m", "m", "m", Access.MEASURED, optional=True, instead_of="x"),
    )
    states = (
        State("q_old", "n", "rad", optional=True, sampled=True),
        State("v_old", "n", "rad/s", optional=True, sampled=True),
        State("zeta", "n", "rad", optional=True),
    )

    step: Diagonal = Positive("n", "rad")
    noise: Diagonal | None = NonNegative("n", "rad", default=None)
    window: Scalar | None = Positive("", "s", default=None)
    time_constant: Scalar | None = Positive("", "s", default=None)
    tool_from: Literal["encoders", "sensor"] = "encoders"

    @model_validator(mode="after")
    def _one_way(self) -> Encoder:
        if self.window is not None and self.time_constant is not None:
            raise ValueError("expected a window or a time_constant, found both; the filter is for differences over T")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (4)."""
        read = self._read(u.q, u.eta, p)
        outputs = {"q_m": read}
        if self.tool_from == "encoders":
            outputs["x_m"] = p.robot.position(read)
        if "window" in p:
            before = self._read(2 * x.zeta - u.q, u.eta_old, p)
            velocity = (read - before) / p.window
            return Equations({**outputs, "dq_m": velocity}, rates={"zeta": 2 * (u.q - x.zeta) / p.window})
        difference = (read - x.q_old) / u.T
        if "time_constant" not in p:
            return Equations({**outputs, "dq_m": difference}, next={"q_old": read})
        c = ca.exp(-u.T / p.time_constant)
        velocity = c * x.v_old + (1 - c) * difference
        return Equations({**outputs, "dq_m": velocity}, next={"q_old": read, "v_old": velocity})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with equal earlier readings."""
        return {"q_old": self._read(u.q, u.eta, p), "v_old": 0 * u.q, "zeta": u.q}

    def _read(self, q: Any, eta: Any, p: Signals) -> Any:
        noisy = q + p.noise * eta if "noise" in p else q
        return p.step * ca.floor(noisy / p.step + 0.5)
