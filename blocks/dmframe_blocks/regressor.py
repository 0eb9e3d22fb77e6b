"""The dynamic regressor along the reference motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, Literal, final

import casadi as ca

from dmframe.block import (
    SX,
    AbstractBlock,
    Certificate,
    Condition,
    Element,
    Equations,
    Input,
    NonNegative,
    Output,
    Scalar,
    Signals,
    operation,
)
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import INERTIAL, WEIGHING, DynamicParameters, Friction, Part
from dmframe.robot.pseudo_inertia import natural_gain
from dmframe_blocks._friction import columns_for
from dmframe_blocks._loads import with_held


@final
class Regressor(AbstractBlock):
    r"""The matrix in which the robot's dynamics is linear in its dynamic parameters.

    .. math::

        Y_d\, a_d = M(q, a_d) \ddot q_{ref} + C(q, \dot q, a_d) \dot q_{ref} + B \dot q_{ref}
                    + D\, \phi(\dot q_{ref}) + g(q, a_d)   \tag{1}

    The estimates may start at the share `nominal` of the model's inertial parameters; the friction is unknown, and the
    bias starts at the gravity that the servo holds at rest.

    :math:`a_d` holds ten inertial parameters a link (mass, first moments, inertia about the joint frame), then the
    elements of B and of D, as `friction` says; :math:`\phi(v) = \tanh(v / v_0)` smooths the sign in the plant too.
    Masses and first moments count twice, once in motion and once in gravity, where `gravity` is apart; the start then
    takes the servo to compensate nothing.

    Parameters
    ----------
    friction : list of viscous, coulomb
        Friction that the compensator estimates along with the inertial parameters. Left out, that of (5), viscous; each
        kind that the plant has is needed, and one that it has not is learnt to be zero.
    gravity : together or apart
        Whether gravity is estimated by the masses that the motion has too, or apart from them, for a servo that may
        already compensate some of it.
    bias : true or false
        Estimate a constant torque a joint too, such as the offset of the servo's integrator.
    nominal : scalar, >= 0
        Let the estimates start at this share of the robot's own inertial parameters, as from a drawing that is wrong:
        1 knows the links and not the friction. Left out, they start where the adaptation says, or at zero.

    Notes
    -----
    The full set of parameters and an orthonormal base set move a gradient adaptation with a scalar gain alike.

    References
    ----------
    [WangTAC2020]_ eq. (5), and Section V for the friction.
    """

    uses_robot = True
    inputs = (
        Input("q", "n", "rad"),
        Input("dq", "n", "rad/s"),
        Input("dq_ref", "n", "rad/s"),
        Input("ddq_ref", "n", "rad/s^2", derivative_of="dq_ref"),
    )
    outputs = (
        Output("Y_d", "n p", "N m"),
        Output("a_d_nominal", "p", "", optional=True),
    )
    truth = (
        Input("B", "n", "N m s/rad"),
        Input("D", "n", "N m"),
        Input("tau_bias", "n", "N m"),
        Input("g_share"),
        Input("a_held", "10"),
    )

    friction: tuple[Friction, ...] = ("viscous",)
    gravity: Literal["together", "apart"] = "together"
    bias: bool = False
    nominal: Scalar | None = NonNegative(default=None)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """p: the dynamic parameters."""
        return {"p": self._parameters(robot).elements}

    def prior(self, robot: Any, others: Fraction) -> list[list[Fraction]]:
        """Link by link the natural gain of the nominal inertia; `others`, squared, for each friction and bias.

        The gravity's own masses and first moments, where it is apart, vary like those of the motion, and by themselves.
        """
        links, rest = [natural_gain(row) for row in robot.inertia], [[[others * others]]] * robot.n
        given: dict[Part, list[list[list[Fraction]]]] = {
            "inertial": links,
            "weighing": [[row[:WEIGHING] for row in link[:WEIGHING]] for link in links],
            "viscous": rest,
            "coulomb": rest,
            "bias": rest,
        }
        parts = [part for parts in self._parameters(robot).in_order(given) for part in parts]
        size, done, rows = sum(map(len, parts)), 0, list[list[Fraction]]()
        for part in parts:
            left, right = [Fraction(0)] * done, [Fraction(0)] * (size - done - len(part))
            rows += [[*left, *row, *right] for row in part]
            done += len(part)
        return rows

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and, if asked, the nominal parameters."""
        robot, a_d = p.robot, self._parameters(p.robot.chain)
        columns: dict[Part, SX] = {
            "inertial": robot.regressor(u.q, u.dq, u.dq_ref, u.ddq_ref),
            "viscous": ca.diag(u.dq_ref),
            "coulomb": ca.diag(robot.coulomb(u.dq_ref)),
            "bias": ca.DM.eye(robot.n),
        }
        if a_d.gravity_apart:
            still = ca.DM.zeros(robot.n)
            weight = robot.regressor(u.q, still, still, still)
            columns |= {"inertial": columns["inertial"] - weight, "weighing": heavy(weight)}
        outputs = {"Y_d": ca.densify(ca.horzcat(*a_d.in_order(columns)))}
        if "nominal" in p:
            none = ca.DM.zeros(robot.n)
            start: dict[Part, SX] = {
                "inertial": p.nominal * robot.inertia,
                "weighing": p.nominal * heavy(robot.inertia),
                "viscous": none,
                "coulomb": none,
                "bias": -p.nominal * robot.gravity_torque(u.q),
            }
            outputs["a_d_nominal"] = ca.vertcat(*a_d.in_order(start))
        return Equations(outputs=outputs)

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored; the true a_d, with what the plant's tool holds as a part of the last link.

        A maker's servo knows the robot's own links alone: what it compensates of their gravity is taken from that.
        """
        a_d, names = self._parameters(p.robot.chain), {"viscous": "B", "coulomb": "D", "bias": "tau_bias"}
        true: dict[Part, SX] = {part: getattr(truth, names[part]) for part in a_d.parts if part in names}
        true["inertial"] = self._links(p, truth)
        if a_d.gravity_apart:
            own = truth.g_share * heavy(p.robot.inertia)
            true["weighing"] = with_held(own, truth.a_held, heavy) if "a_held" in truth else own
        return Certificate(truth={"a_d": ca.vertcat(*a_d.in_order(true))})

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """Whatever friction the plant has, the regressor has a column for it."""
        return columns_for(self.friction, truth)

    def _links(self, p: Signals, truth: Signals) -> SX:
        """The inertial parameters of all links."""
        return with_held(p.robot.inertia, truth.a_held) if "a_held" in truth else p.robot.inertia

    def _parameters(self, chain: SerialChain) -> DynamicParameters:
        return DynamicParameters(chain, self.friction, self.gravity == "apart", self.bias)


@operation
def heavy(a: SX) -> SX:
    """Of a link's ten inertial parameters, or of their columns, the four that weigh: mass and first moments."""
    size = a.shape[0] if a.is_column() else a.shape[1]
    places = [place for place in range(size) if place % len(INERTIAL) < WEIGHING]
    return a[places] if a.is_column() else a[:, places]
