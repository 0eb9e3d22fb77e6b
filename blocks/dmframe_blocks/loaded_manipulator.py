"""Rigid serial manipulator with a load at the tool that changes in steps."""

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
    Rows,
    Scalar,
    Side,
    Signals,
    Square,
    Table,
    Vector,
    named,
    operation,
    solve_spd,
)
from dmframe_blocks._loads import with_body
from dmframe_blocks.manipulator import Manipulator, moved


@final
class LoadedManipulator(AbstractBlock):
    r"""Robot dynamics with a load at the tool that changes in steps.

    .. math::

        M(q, a) \ddot q + C(q, \dot q, a) \dot q + B \dot q + D\, \phi(\dot q) + g = K u + \tau_{ext}   \tag{1}

    and :math:`x = f(q)`, where a are the inertial parameters with the present load: the ten parameters of a `payload`,
    :math:`a_{load}`, and point masses. Servo and controllers have no information about the load: the manufacturer's
    servo compensates a fraction of the gravity of the robot alone, and controllers may adapt. :math:`\tau_{ext}` is
    the torque of the environment.

    The true a_d of a `regressor` contains the load, `a_held`, in the parameters of the last link. The true a_d of a
    `payload_regressor` is the load itself. Both are discontinuous when the load changes.

    Between two steps of a `payload` the certificate is that of `manipulator` with the mass matrix of the loaded robot.
    At each step V is discontinuous.

    Parameters
    ----------
    payload : list, kg
        Successive point masses at the tool, without a proof; use the block `payload` for bodies.
    payload_at : list, s
        Increasing start times of the masses; there is no mass before the first. With ``payload: [2, 0]`` and
        ``payload_at: [10, 20]`` the load is 2 kg from 10 s to 20 s.
    bodies : one row a link, (10,)
        Inertial parameters of the plant's links instead of those of the robot's file, which controllers read; without a
        proof. A row is m, m r and the inertia xx, xy, yy, xz, yz, zz about the joint's origin, in its frame's axes.
    viscous : diagonal (n,), N m s/rad, >= 0
        Viscous friction of the joints.
    coulomb : diagonal (n,), N m, >= 0
        Coulomb friction, :math:`D`.
    rotor : diagonal (n,), kg m^2, >= 0
        Inertia of each joint's rotor and gear about the joint: that of the rotor times the square of the gear ratio. By
        default there is none.
    K : diagonal (n,), N m/V, > 0
        Motor constant: torque per volt.
    maker_gravity : scalar, >= 0
        Fraction of the robot's own gravity that the manufacturer's servo compensates.
    maker_viscous : diagonal (n,), N m s/rad, >= 0
        Viscous friction that the manufacturer's servo compensates.

    Notes
    -----
    The velocity is continuous when the load changes, as if the load had moved with the tool before. Not for: a load
    that swings.

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
    bodies: Table | None = Rows("10", count="n", default=None)
    viscous: Diagonal = NonNegative("n", "N m s/rad", default=0.0)
    coulomb: Diagonal = NonNegative("n", "N m", default=0.0)
    rotor: Diagonal | None = NonNegative("n", "kg m^2", default=None)
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
        ddq = solve_spd(moved(p, x.q, a), p.K * u.u + u.tau_ext - friction - moving)
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
                **({"I_r": p.rotor} if "rotor" in p else {}),
            },
            rates={"q": x.dq, "dq": ddq},
        )

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """That of `manipulator` with a constant load; none for `payload`, whose steps are not a signal, or `bodies`."""
        if "payload" in p or "bodies" in p:
            return None
        robot, (_, a) = p.robot, self._loaded(u, p)
        true = {"momentum": moved(p, x.q, a) @ x.dq, "a_held": u.a_load}
        if "sigma" not in truth:
            return Certificate(truth=true)
        sigma, B, carried = truth.sigma, self._viscous(p), p.maker_gravity * robot.gravity_torque(x.q)
        reference = robot.inverse_dynamics(x.q, x.dq, truth.dq_ref, truth.ddq_ref, a) - carried
        others = B * truth.dq_ref + p.coulomb * robot.coulomb(truth.dq_ref)
        if "rotor" in p:
            others += p.rotor * truth.ddq_ref
        return Certificate(
            storage=(Square(sigma, moved(p, x.q, a)),),
            dissipation=(Lemma(p.coulomb, x.dq, truth.dq_ref, robot.friction_velocity),),
            supply=ca.dot(sigma, p.K * u.u + u.tau_ext - B * sigma - reference - others),
            truth=true,
        )

    def _loaded(self, u: Signals, p: Signals) -> tuple[SX, SX]:
        """The load's mass, and the robot's inertial parameters with it."""
        inertia, load = ca.vec(p.bodies.T) if "bodies" in p else p.robot.inertia, u.a_load[0]
        a = with_body(inertia, u.a_load)
        if "payload" in p:
            mass = at_time(u.t, p.payload, p.payload_at)
            load, a = load + mass, with_mass(a, p.robot.a_k[-3:], mass)
        return load, named("a", a)

    def _viscous(self, p: Signals) -> SX:
        return p.viscous - p.maker_viscous


@operation
def at_time(t: Any, values: Any, times: Any) -> Any:
    """The last value whose time has come, 0 before the first."""
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
