"""Regressor of a load at the tool of a known robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, final

import casadi as ca

from dmframe.block import AbstractBlock, Certificate, Condition, Element, Equations, Input, Output, Signals
from dmframe.robot.parameters import INERTIAL, DynamicParameters, Friction
from dmframe_blocks._friction import columns_for

_UNITS = {"m": "kg", "mc": "kg m", "I": "kg m^2"}


@final
class PayloadRegressor(AbstractBlock):
    r"""Torque of a known robot with an unknown load: the known part, and the regressor of the unknown part.

    .. math::

        \tau_{known} = M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + g(q)   \tag{1}

    :math:`Y_d a_d` is the torque of load and friction. :math:`a_d` contains the load's ten inertial parameters about
    the last joint's origin, in its frame (mass, first moments, inertia), then the parameter of `gravity`, and B and D
    according to `friction`. The load's columns are those of the last link, with complete gravity: the manufacturer's
    servo does not compensate an unknown load.

    Parameters
    ----------
    gravity : known or share
        With known, the controller compensates the complete gravity of the links. With share, the servo compensates an
        unknown fraction, and the remaining fraction is estimated as one parameter, :math:`g_{share}`.
    friction : list of viscous, coulomb
        Friction that is estimated together with the load; it must include each kind that the plant has.

    Notes
    -----
    The command depends on the product of w and the torque, so load and w can be distinguished only by the known part.
    Give w a box if that part is small, for example with a servo that compensates gravity. Not for: unknown links; use
    `regressor`, which has columns for all parameters.

    References
    ----------
    [WangTAC2020]_ eq. (5), Remark 6.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_ref", "n", "rad/s"),
        Input("ddq_ref", "n", "rad/s^2", derivative_of="dq_ref"),
    )
    outputs = (Output("Y_d", "n p", "N m"), Output("tau_known", "n", "N m"))
    truth = (
        Input("a_held", "10"),
        Input("a_load", "10"),
        Input("g_share"),
        Input("B", "n", "N m s/rad"),
        Input("D", "n", "N m"),
        Input("I_r", "n", "kg m^2"),
    )

    gravity: Literal["known", "share"] = "known"
    friction: tuple[Friction, ...] = ("viscous",)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """p: the load's ten parameters, the fraction of gravity, friction."""
        load = [Element(f"{name}_load", _UNITS[name.partition("_")[0]]) for name in INERTIAL]
        share = [Element("g_share")] if self.gravity == "share" else []
        friction = DynamicParameters(robot, self.friction).elements[len(INERTIAL) * robot.n :]
        return {"p": [*load, *share, *friction]}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1)."""
        robot, weighs = p.robot, p.robot.gravity_torque(u.q)
        whole = robot.inverse_dynamics(u.q, u.dq, u.dq_ref, u.ddq_ref)
        columns = [robot.regressor(u.q, u.dq, u.dq_ref, u.ddq_ref)[:, -len(INERTIAL) :]]
        columns += [weighs] if self.gravity == "share" else []
        columns += [ca.diag(u.dq_ref)] if "viscous" in self.friction else []
        columns += [ca.diag(robot.coulomb(u.dq_ref))] if "coulomb" in self.friction else []
        known = whole - weighs if self.gravity == "share" else whole
        return Equations({"Y_d": ca.densify(ca.horzcat(*columns)), "tau_known": known})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage; the true a_d, with the load from the plant, else from a source."""
        source = next((name for name in ("a_held", "a_load") if name in truth), "")
        true = [getattr(truth, source) if source else ca.DM.zeros(len(INERTIAL))]
        true += [truth.g_share] if self.gravity == "share" else []
        true += [truth.B] if "viscous" in self.friction else []
        true += [truth.D] if "coulomb" in self.friction else []
        return Certificate(truth={"a_d": ca.vertcat(*true)})

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """The regressor has a column for each kind of friction of the plant."""
        return columns_for(self.friction, truth)
