"""A rigid serial manipulator whose tool takes up a load, and puts it down again."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, final

import casadi as ca
from pydantic import model_validator

from dmframe.block import (
    SX,
    TIME,
    AbstractBlock,
    Certificate,
    Diagonal,
    Equations,
    Input,
    Lemma,
    NonNegative,
    Output,
    Positive,
    Real,
    Scalar,
    Side,
    Signals,
    Square,
    Vector,
    named,
    operation,
    solve_spd,
)
from dmframe_blocks._loads import with_body
from dmframe_blocks.manipulator import Manipulator


@final
class LoadedManipulator(AbstractBlock):
    r"""The robot, with a load at its tool that changes in steps.

    .. math::

        M(q, a) \ddot q + C(q, \dot q, a) \dot q + B \dot q + D\, \phi(\dot q) + g = K u + \tau_{ext}   \tag{1}

    and :math:`x = f(q)`, where a are the inertial parameters with the load that is there now: the ten of a `payload`,
    :math:`a_{load}`, and point masses. Nobody is told of it: the maker's servo goes on compensating its share of the
    gravity of the robot alone, and controllers adapt, or do not. :math:`\tau_{ext}` is what the environment does.

    What the tool holds, `a_held`, is a part of the last link to a `regressor`, whose true a_d has it in there, and the
    whole of the links to a `payload_regressor`. Both jump where the load does.

    Between two steps of a `payload` it stores, loses and takes up what `manipulator` does, with the mass matrix of the
    loaded robot; at each step V jumps.

    Parameters
    ----------
    payload : list, kg
        Point masses at the tool, one after another, of which nothing is proved; the block `payload` has bodies.
    payload_at : list, s
        When each of them is there, increasing; before the first there is none. With ``payload: [2, 0]`` and
        ``payload_at: [10, 20]``, 2 kg from 10 s to 20 s.
    viscous : diagonal (n,), N m s/rad, >= 0
        Viscous friction of the joints' own.
    coulomb : diagonal (n,), N m, >= 0
        Coulomb friction, D.
    K : diagonal (n,), N m/V, > 0
        Torque a volt.
    maker_gravity : scalar, >= 0
        Share of the robot's own gravity that the maker's servo compensates.
    maker_viscous : diagonal (n,), N m s/rad, >= 0
        Viscous friction that the maker's servo compensates.

    Notes
    -----
    The velocity goes on as it is where the load changes, as if it had moved along before. Not for: a load that swings.

    References
    ----------
    [Siciliano2009]_ Section 7.2.
    """

    side = Side.PLANT
    uses_robot = True
    inputs = (*Manipulator.inputs, Input("a_load", "10", optional=True), TIME)
    outputs = (*Manipulator.outputs, Output("load", "", "kg"))
    states = Manipulator.states
    truth = Manipulator.truth

    payload: Vector | None = Real("*", "kg", default=None, spread=False)
    payload_at: Vector | None = Real("*", "s", default=None, spread=False)
    viscous: Diagonal = NonNegative("n", "N m s/rad", default=0.0)
    coulomb: Diagonal = NonNegative("n", "N m", default=0.0)
    K: Diagonal = Positive("n", "N m/V", default=1.0)
    maker_gravity: Scalar = NonNegative(default=0.0)
    maker_viscous: Diagonal = NonNegative("n", "N m s/rad", default=0.0)

    @model_validator(mode="after")
    def _one_mass_a_time(self) -> LoadedManipulator:
        masses, times = self.payload or (), self.payload_at or ()
        if len(masses) != len(times):
            raise ValueError(f"expected as many masses as payload_at has times, found {len(masses)} and {len(times)}")
        if any(mass < 0 for mass in masses):
            raise ValueError(f"expected masses of 0 or above, found {list(masses)}")
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError(f"expected increasing times, found {list(times)}")
        return self

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        robot = p.robot
        load, a = self._loaded(u, p)
        carried = p.maker_gravity * robot.gravity_torque(x.q)
        moving = robot.inverse_dynamics(x.q, x.dq, x.dq, ca.DM.zeros(robot.n), a) - carried
        friction = self._viscous(p) * x.dq + p.coulomb * robot.coulomb(x.dq)
        ddq = solve_spd(robot.mass_matrix(x.q, a), p.K * u.u + u.tau_ext - friction - moving)
        return Equations(
            outputs={
                "q": x.q,
                "dq": x.dq,
                "x": robot.position(x.q),
                "dx": robot.jacobian(x.q) @ x.dq,
                "ddq": ddq,
                "g": robot.gravity_torque(x.q, a) - carried,
                "K": p.K,
                "B": self._viscous(p),
                "D": p.coulomb,
                "g_share": 1 - p.maker_gravity,
                "load": load,
            },
            rates={"q": x.dq, "dq": ddq},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """As of `manipulator`, the load constant; of a point mass, whose steps are no signal, nothing."""
        if "payload" in p:
            return None
        robot, (_, a) = p.robot, self._loaded(u, p)
        true = {"momentum": robot.mass_matrix(x.q, a) @ x.dq, "a_held": u.a_load}
        if "sigma" not in truth:
            return Certificate(truth=true)
        sigma, B, carried = truth.sigma, self._viscous(p), p.maker_gravity * robot.gravity_torque(x.q)
        reference = robot.inverse_dynamics(x.q, x.dq, truth.dq_ref, truth.ddq_ref, a) - carried
        friction = B * truth.dq_ref + p.coulomb * robot.coulomb(truth.dq_ref)
        return Certificate(
            storage=(Square(sigma, robot.mass_matrix(x.q, a)),),
            dissipation=(Lemma(p.coulomb, x.dq, truth.dq_ref, robot.friction_velocity),),
            supply=ca.dot(sigma, p.K * u.u + u.tau_ext - B * sigma - reference - friction),
            truth=true,
        )

    def _loaded(self, u: Signals, p: Signals) -> tuple[SX, SX]:
        """The load's mass, and the robot's inertial parameters with it."""
        inertia, load = p.robot.inertia, u.a_load[0]
        a = with_body(inertia, u.a_load)
        if "payload" in p:
            mass = at_time(u.t, p.payload, p.payload_at)
            load, a = load + mass, with_mass(a, p.robot.a_k[-3:], mass)
        return load, named("a", a)

    def _viscous(self, p: Signals) -> SX:
        return p.viscous - p.maker_viscous


@operation
def at_time(t: Any, values: Any, times: Any) -> Any:
    """The last of the values whose time has come, 0 before the first."""
    now = 0
    for k in range(values.numel()):
        now = now + (values[k] - (values[k - 1] if k else 0)) * (t >= times[k])
    return now


@operation
def with_mass(inertia: Any, r: Any, mass: Any) -> Any:
    """The inertial parameters with a point mass on the last link, r from its joint's origin."""
    x, y, z = ca.vertsplit(r)
    # m, m r and m (|r|^2 I - r r'), in the order of `dmframe.robot.parameters.Inertial`
    point = ca.vertcat(1, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
    return ca.vertcat(inertia[:-10], inertia[-10:] + mass * point)
