"""Manufacturer's P-PI cascade servo with velocity feed-forward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, final

from dmframe.block import (
    SX,
    AbstractBlock,
    Access,
    Certificate,
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
class PPiServo(AbstractBlock):
    r"""Closed cascade servo for joint positions, P around PI: it can be neither read nor changed.

    A proportional position controller and a fraction f of the velocity command, `feed_forward`, give the set-point of a
    PI velocity controller:

    .. math::

        e_v       &= f \dot q_c + k_p (q_c + q_{step} - q) - \dot q       \tag{1} \\
        \dot \xi  &= e_v                                                  \tag{2} \\
        u         &= K_v e_v + K_i \xi                                    \tag{3}

    The servo integrates the velocity command, :math:`q_c = q(0) + \int \dot q_c`, and reports the result, usually
    called the target position. :math:`q_{step}` is zero unless positions are commanded: see `position_interface`. With
    a `velocity_filter` or a `cycle`, :math:`\dot q_f` replaces :math:`\dot q` in (1), with the time constant
    :math:`T_f = \mathrm{velocity\_filter} + \mathrm{cycle} / 2`. With a `torque_lag`, :math:`u_a` is the voltage
    instead of (3):

    .. math::

        \ddot q_f    &= (\dot q - \dot q_f) / T_f   \tag{4} \\
        \dot u_a     &= (K_v e_v + K_i \xi - u_a) / \mathrm{torque\_lag}            \tag{5}

    Initially the integrator holds the robot against gravity: :math:`\xi(0) = g(q)/(K K_i)`.

    With f = 1, (1) to (3) are those of `pid_servo` with :math:`K_D = K_v`, :math:`K_P = K_v k_p + K_i` and
    :math:`K_I = K_i k_p`. Industrial cascades are stiffer than this paper's PID servo: :math:`K_P / K_D` is
    :math:`k_p + K_i / K_v`, 30/s with :math:`k_p` = 20/s and :math:`K_i / K_v` = 10/s.

    Parameters
    ----------
    k_p : diagonal (n,), 1/s, > 0
        Gain of the position controller.
    K_v : diagonal (n,), V s/rad, > 0
        Proportional gain of the velocity controller.
    K_i : diagonal (n,), V/rad, > 0
        Integral gain of the velocity controller.
    feed_forward : diagonal (n,), >= 0
        Fraction f of the velocity command that the velocity controller receives: 1 is all of it, 0 none.
    velocity_filter : scalar, s, > 0
        Time constant of the filter of the measured velocity; by default there is none.
    torque_lag : scalar, s, > 0
        Time constant of the current controller, from the demanded to the acting voltage; by default there is none.
    cycle : scalar, s, > 0
        Cycle of the servo, approximately; by default it is continuous.

    Notes
    -----
    The theorem of `p_pi_inverse` covers :math:`f > 0` without filter, lag and cycle. With any of them, `verify` is not
    applicable. A `cycle` is an approximation in continuous time of a servo that reads its joints and
    updates a held torque once in each cycle: its readings are, on average, half a cycle old. With 1 ms and velocity
    loops of 160 and 400 rad/s it differs from that servo by a fifth of the effect of the cycle at most. Not for: a
    servo with anti-windup, or with acceleration feed-forward.

    References
    ----------
    [Siciliano2009]_ Section 8.5, position and velocity feedback.
    """

    side = Side.PLANT
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_c", "n", "rad/s"),
        Input("q_step", "n", "rad", optional=True),
    )
    outputs = (
        Output("q_c", "n", "rad", Access.MEASURED),
        Output("u", "n", "V"),
        Output("xi", "n", "rad"),
        Output("k_p", "n", "1/s"),
        Output("K_v", "n", "V s/rad"),
        Output("K_i", "n", "V/rad"),
        Output("f", "n"),
    )
    states = (
        State("q_c", "n", "rad"),
        State("xi", "n", "rad"),
        State("dq_f", "n", "rad/s", optional=True),
        State("u_a", "n", "V", optional=True),
    )
    truth = (Input("g", "n", "N m"), Input("K", "n", "N m/V"))
    unproved: ClassVar[str] = "no theorem covers its velocity_filter, torque_lag or cycle"

    k_p: Diagonal = Positive("n", "1/s")
    K_v: Diagonal = Positive("n", "V s/rad")
    K_i: Diagonal = Positive("n", "V/rad")
    feed_forward: Diagonal = NonNegative("n", default=1.0)
    velocity_filter: Scalar | None = Positive("", "s", default=None)
    torque_lag: Scalar | None = Positive("", "s", default=None)
    cycle: Scalar | None = Positive("", "s", default=None)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) to (5)."""
        delay = [p.velocity_filter] if "velocity_filter" in p else []
        delay += [p.cycle / 2] if "cycle" in p else []
        measured = x.dq_f if delay else u.dq
        e_v = p.feed_forward * u.dq_c + p.k_p * (x.q_c + u.q_step - u.q) - measured
        demanded = p.K_v * e_v + p.K_i * x.xi
        rates = {"q_c": u.dq_c, "xi": e_v}
        if delay:
            rates["dq_f"] = (u.dq - x.dq_f) / sum(delay)
        if "torque_lag" in p:
            rates["u_a"] = (demanded - x.u_a) / p.torque_lag
        gains = {"k_p": p.k_p, "K_v": p.K_v, "K_i": p.K_i, "f": p.feed_forward}
        acting = x.u_a if "torque_lag" in p else demanded
        return Equations(outputs={"q_c": x.q_c, "u": acting, "xi": x.xi, **gains}, rates=rates)

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """At rest, with the integrator balancing gravity."""
        held = truth.g / truth.K
        return {"q_c": u.q, "xi": held / p.K_i, "dq_f": 0 * u.q, "u_a": held}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """No storage: that of the servo is in the block that inverts it. The truth is the command as it arrives."""
        if any(name in p for name in ("velocity_filter", "torque_lag", "cycle")):
            return None
        return Certificate(truth={"dq_s": u.dq_c})
