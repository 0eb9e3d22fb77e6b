"""Fourier series of a servo's velocity error on a path that repeats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, final

import casadi as ca
from pydantic import Field

from dmframe.block import (
    PERIOD,
    SX,
    AbstractBlock,
    Access,
    Acted,
    Certificate,
    Diagonal,
    Element,
    Equations,
    Input,
    NormalisedSteps,
    Output,
    Positive,
    Scalar,
    Signals,
    State,
    clip,
    named,
    operation,
)


@final
class RepetitiveInverse(AbstractBlock):
    r"""Estimates the velocity error of each joint as a Fourier series, and adds its forecast to the command.

    The motion repeats with the angular frequency `rate`. At the phase :math:`\varphi` of the middle of a sample

        h(phi)  = (1, cos phi, ..., cos H phi, sin phi, ..., sin H phi)
        lag     = u_applied - (q - q_before)/T
        theta_i = theta_i + Gamma h (lag_i - h' theta_i)/(nu + Gamma h'h)
        u_i     = clip(dq_r_i + h(phi + (1 + delay) rate T)' theta_i, u_max)

    with :math:`h^\top h = 1 + H`. The coefficients of joint i converge with the time constant
    :math:`T (\nu / \Gamma + 1 + H)` if the motion of the joint lags its command at the estimated frequencies by less
    than a quarter of a period. The block uses no model of servo or robot.

    A command acts `delay` samples later. The start of that sample, q_start, is predicted from the commands until then
    and the forecasts of the series.

    *Certificate.* For any constant coefficients :math:`\theta^\ast`, the squared distance
    :math:`|\theta - \theta^\ast|^2 / \Gamma` increases by at most :math:`\eta^2 / (\nu + \Gamma h^\top h)` per sample,
    where :math:`\eta = \mathrm{lag} - h^\top \theta^\ast` is the part of the lag that does not repeat. The command in
    the lag is the one that acted: a condition compares `delay` with the delays of the graph.

    Parameters
    ----------
    rate : scalar, rad/s, > 0
        Angular frequency with which the motion repeats.
    harmonics : number, >= 1
        H: number of multiples of the rate.
    Gamma, nu : scalar, rad^2/s^2, > 0
        Only their ratio affects the estimate: see the time constant above.
    delay : 0, 1 or 2
        Whole samples from a command to its effect. It must be correct.
    u_max : diagonal (n,), rad/s, > 0
        Largest command.

    Notes
    -----
    Not for: a motion that does not repeat, or an unknown rate. After a change of load or path the old series decays
    with its time constant.

    References
    ----------
    [Bodson1994]_, adaptive feedforward cancellation, of which the law (3) is the normalised form in discrete time.
    """

    uses_robot = True
    inputs = (Input("q", "n", "rad"), Input("dq_r", "n", "rad/s"), PERIOD)
    truth = (Input("dq_s", "n", "rad/s"), Input("q", "n", "rad"))
    outputs = (
        Output("dq_c", "n", "rad/s", Access.COMMANDED),
        Output("q_start", "n", "rad"),
        Output("lag", "n", "rad/s"),
        Output("epsilon", "n", "rad/s"),
    )
    states = (
        State("theta", "c", "rad/s", sampled=True),
        State("phase", "", "rad", sampled=True),
        State("q_before", "n", "rad", sampled=True),
        State("queue", "n d", "rad/s", sampled=True),
    )

    rate: Scalar = Positive("", "rad/s")
    harmonics: int = Field(4, ge=1)
    Gamma: Scalar = Positive("", "rad^2/s^2", default=1.0)
    nu: Scalar = Positive("", "rad^2/s^2", default=100.0)
    delay: Literal[0, 1, 2] = 0
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """c: the coefficients of all joints."""
        names = ["mean", *(f"{kind}{k}" for kind in ("cos", "sin") for k in range(1, self.harmonics + 1))]
        return {"c": [Element(f"{name}_{i}", "rad/s") for i in range(1, robot.n + 1) for name in names]}

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """d: length of the queue."""
        return {**super().sizes(robot), "d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest."""
        return {"q_before": u.q}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The step of the coefficients, and the command with their forecast."""
        lag, h = self._sample(u, x, p)
        epsilon = named("epsilon", lag - forecast(x.theta, h))
        gain = p.Gamma / (p.nu + p.Gamma * (1 + self.harmonics))
        theta = named("theta_new", x.theta + gain * outer(h, epsilon))
        q_start = u.q
        for k in range(1, self.delay + 1):
            q_start = q_start + u.T * (x.queue[:, k] - forecast(theta, self._columns(x, u, p, k)))
        dq_c = clip(u.dq_r + forecast(theta, self._columns(x, u, p, self.delay + 1)), p.u_max)
        return Equations(
            outputs={"dq_c": dq_c, "q_start": q_start, "lag": lag, "epsilon": epsilon},
            next={
                "theta": theta,
                "phase": x.phase + p.rate * u.T,
                "q_before": u.q,
                "queue": ca.horzcat(x.queue[:, 1:], dq_c),
            },
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Normalised steps towards any constant coefficients."""
        lag, h = self._sample(u, x, p)
        n = lag.shape[0]
        true = type(x.theta).sym("theta_true", x.theta.shape[0])
        rows = ((ca.repmat(h, n, 1), lag),)
        gain = p.Gamma * ca.DM.ones(x.theta.shape[0])
        steps = NormalisedSteps("theta", x.theta, true, gain, (h.shape[0],) * n, p.nu, rows, ())
        known = "dq_s" in truth and "q" in truth
        acted = (Acted(x.queue[:, 0], truth.dq_s, u.q, truth.q),) if known else ()
        return Certificate(steps=(steps,), acted=acted, unknown={"theta_true": true})

    def _sample(self, u: Signals, x: Signals, p: Signals) -> tuple[SX, SX]:
        """The lag of the last sample, and the columns of its middle."""
        lag = named("lag", x.queue[:, 0] - (u.q - x.q_before) / u.T)
        return lag, named("h", self._columns(x, u, p, 0))

    def _columns(self, x: Signals, u: Signals, p: Signals, k: int) -> SX:
        """The columns of the k-th sample after the last one, of which `phase` is the middle."""
        phase = x.phase + k * p.rate * u.T
        waves = phase * ca.DM(range(1, self.harmonics + 1))
        return ca.vertcat(1, ca.cos(waves), ca.sin(waves))


@operation
def forecast(theta: Any, h: Any) -> Any:
    """The product of h and the coefficients of each joint."""
    return ca.reshape(theta, h.shape[0], -1).T @ h


@operation
def outer(h: Any, epsilon: Any) -> Any:
    """The product of h and the error of each joint, one joint after the other."""
    return ca.vec(h @ epsilon.T)
