"""Aggregation of experts that forecast the velocity error of a servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, final

import casadi as ca
from pydantic import Field

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
    Signals,
    State,
    clip,
    named,
)

LEVELS = (1.0, 0.3, 0.1, 0.03)
TRENDS = ((0.7, 0.3), (0.5, 0.1), (0.3, 0.03))
HARMONICS = (4, 20)
MEMORIES = (0.03, 0.008)


@final
class ExpertAggregation(AbstractBlock):
    """Prototype."""

    inputs = (
        Input("q", "n", "rad"),
        Input("dq_r", "n", "rad/s"),
        Input("dq_model", "n", "rad/s"),
        Input("q_model", "n", "rad"),
        Input("epsilon", "n", "rad/s"),
        Input("slope", "n"),
        PERIOD,
    )
    outputs = (
        Output("dq_sent", "n", "rad/s", Access.COMMANDED),
        Output("q_start", "n", "rad"),
        Output("best", "n"),
    )
    states = (
        State("levels", "n L", "rad/s", sampled=True, recorded=False),
        State("trend_levels", "n B", "rad/s", sampled=True, recorded=False),
        State("trends", "n B", "rad/s", sampled=True, recorded=False),
        State("theta", "n O", "rad/s", sampled=True, recorded=False, optional=True),
        State("phase", sampled=True, optional=True),
        State("losses", "n E", "rad^2/s^2", sampled=True, recorded=False),
        State("weights", "n E", sampled=True, recorded=False),
        State("forecasts", "n F", "rad", sampled=True, recorded=False),
        State("q_before", "n", "rad", sampled=True),
        State("queue", "n d", "rad/s", sampled=True),
        State("count", sampled=True),
    )

    rate: Scalar | None = Positive("", "rad/s", default=None)
    delay: int = Field(0, ge=0, le=7)
    memory: Scalar = Positive("", "s", default=6.0)
    smoothing: Scalar = Positive(default=0.2)
    u_max: Diagonal = Positive("n", "rad/s", default=3.0)
    a_max: Scalar = Positive("", "rad/s^2", default=1000.0)
    fourier: bool = True

    def _experts(self) -> int:
        return 2 * (1 + len(LEVELS) + len(TRENDS) + (len(HARMONICS) * len(MEMORIES) if self.fourier else 0))

    def sizes(self, robot: Any) -> Mapping[str, int]:
        E = self._experts()
        c = 2 * len(MEMORIES) * sum(1 + 2 * H for H in HARMONICS)
        return {**super().sizes(robot), "L": 2 * len(LEVELS), "B": 2 * len(TRENDS), "O": c, "E": E,
                "F": E * (self.delay + 1), "d": self.delay + 1}

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        E = self._experts()
        one = ca.repmat(ca.horzcat(1, ca.DM.zeros(1, E - 1)), u.q.shape[0], 1)
        return {"q_before": u.q, "weights": one, "losses": 1e-12 * ca.DM.ones(u.q.shape[0], E),
                "forecasts": ca.repmat(u.q, 1, E * (self.delay + 1))}

    def _columns(self, phase: SX, H: int) -> SX:
        waves = (wave(j * phase) for j in range(1, H + 1) for wave in (ca.cos, ca.sin))
        return ca.vertcat(1, *waves)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        n, d, T = u.q.shape[0], self.delay, u.T
        lag = named("lag", x.queue[:, 0] - (u.q - x.q_before) / T)
        after: dict[str, Any] = {}
        nl, nt = len(LEVELS), len(TRENDS)
        levels, tl, tb, theta = [], [], [], []
        ahead: list[list[SX]] = [[] for _ in range(d + 1)]  # per step k=1..d+1: list of corrections (n), by expert
        for s, r in enumerate((lag, u.epsilon)):
            for k in range(d + 1):
                ahead[k].append(0 * lag)
            for i, a in enumerate(LEVELS):
                old = x.levels[:, s * nl + i]
                new = old + a * (r - old)
                levels.append(new)
                for k in range(d + 1):
                    ahead[k].append(new)
            for i, (a, b) in enumerate(TRENDS):
                l0, b0 = x.trend_levels[:, s * nt + i], x.trends[:, s * nt + i]
                e = r - l0 - b0
                l1, b1 = l0 + b0 + a * e, b0 + b * e
                tl.append(l1)
                tb.append(b1)
                for k in range(d + 1):
                    ahead[k].append(l1 + (k + 1) * b1)
            if self.fourier:
                at = s * len(MEMORIES) * sum(1 + 2 * H for H in HARMONICS)
                for H in HARMONICS:
                    h0 = named(f"h{H}_{s}", self._columns(x.phase, H))
                    hs = [named(f"h{H}_{s}_{k}", self._columns(x.phase + (k + 1) * p.rate * T, H)) for k in range(d + 1)]
                    for m in MEMORIES:
                        th = x.theta[:, at : at + 1 + 2 * H]
                        at += 1 + 2 * H
                        e = r - th @ h0
                        new = named(f"th{s}_{H}_{MEMORIES.index(m)}", th + m * e @ h0.T)
                        theta.append(new)
                        for k in range(d + 1):
                            ahead[k].append(new @ hs[k])
        E = self._experts()
        half = E // 2
        after["levels"] = ca.horzcat(*levels)
        after["trend_levels"], after["trends"] = ca.horzcat(*tl), ca.horzcat(*tb)
        if self.fourier:
            after["theta"] = ca.horzcat(*theta)
            after["phase"] = x.phase + p.rate * T
        # losses of the forecasts that end now
        arrived = x.forecasts[:, :E]
        miss = (arrived - ca.repmat(u.q, 1, E)) / T
        keep = ca.fmax(0, 1 - T / p.memory)
        ready = x.count > d + 1
        losses = named("losses_new", keep * x.losses + ready * miss * miss)
        logs = ca.log(losses + 1e-16)
        least = [ca.mmin(logs[i, :]) for i in range(n)]
        m = p.memory / T
        score = ca.exp(ca.fmax(-m / 2 * (logs - ca.repmat(ca.vertcat(*least), 1, E)), -200))
        ideal = score / ca.repmat(ca.sum2(score), 1, E)
        weights = named("w", x.weights + p.smoothing * (ideal - x.weights))
        # forecasts
        starts = []
        for i in range(E):
            if i < half:
                q = u.q
                for k in range(d):
                    q = q + T * (x.queue[:, k + 1] - ahead[k][i])
            else:
                q = u.q_model
                for k in range(d):
                    q = q - T * u.slope * ahead[k][i]
            starts.append(q)
        q_starts = named("q_starts", ca.horzcat(*starts))
        q_start = named("q_start", ca.sum2(weights * q_starts))
        commands = [u.dq_r + ahead[d][i] if i < half else u.dq_model + ahead[d][i] for i in range(E)]
        us = named("us", ca.horzcat(*commands))
        wished = clip(ca.sum2(weights * us), p.u_max)
        last = x.queue[:, d]
        dq_c = named("dq_c_", last + ca.fmin(ca.fmax(wished - last, -p.a_max * T), p.a_max * T))
        G = ca.horzcat(ca.DM.ones(n, half), ca.repmat(u.slope, 1, half))
        ends = named("ends", q_starts + T * (ca.repmat(u.dq_r, 1, E) + G * (ca.repmat(dq_c, 1, E) - us)))
        after |= {
            "losses": losses, "weights": weights, "forecasts": ca.horzcat(x.forecasts[:, E:], ends),
            "q_before": u.q, "queue": ca.horzcat(x.queue[:, 1:], dq_c), "count": x.count + 1,
        }
        best = ca.vertcat(*(ca.sum2(weights[i, :] * ca.DM(range(E)).T) for i in range(n)))
        return Equations(outputs={"dq_sent": dq_c, "q_start": q_start, "best": best}, next=after)
