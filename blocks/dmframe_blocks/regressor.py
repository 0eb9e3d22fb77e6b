"""Dynamic regressor along the reference motion."""

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
    r"""Regressor matrix: the robot's dynamics are linear in the dynamic parameters.

    .. math::

        Y_d\, a_d = M(q, a_d) \ddot q_{ref} + C(q, \dot q, a_d) \dot q_{ref} + B \dot q_{ref}
                    + D\, \phi(\dot q_{ref}) + g(q, a_d)   \tag{1}

    The initial estimates may be the fraction `nominal` of the model's inertial parameters, with zero friction; the bias
    starts at the gravity torque of the servo at rest.

    :math:`a_d` contains ten inertial parameters per link (mass, first moments, inertia about the joint frame), then,
    with `rotors`, the rotors' inertia, then the elements of B and of D according to `friction`.
    :math:`\phi(v) = \tanh(v / v_0)` smooths the sign, in the plant too. If `gravity` is apart, masses and first moments
    appear twice, for motion and for gravity; the initial estimates then assume that the servo compensates no gravity.

    Parameters
    ----------
    friction : list of viscous, coulomb
        Friction that the compensator estimates with the inertial parameters; by default viscous, as in eq. (5).
        It must include each kind that the plant has; an estimate of a kind that the plant does not have converges
        towards zero under excitation.
    rotors : true or false
        Also estimate the inertia of each joint's rotor, :math:`I_r`, with the columns
        :math:`\mathrm{diag}(\ddot q_{ref})`. It is required if the plant has `rotor`.
    gravity : together or apart
        Whether gravity has the same parameters as the motion, or separate ones, for a servo that may already compensate
        a part of gravity.
    bias : true or false
        Also estimate a constant torque per joint, such as the offset of the servo's integrator.
    nominal : scalar, >= 0
        Initial estimates as a fraction of the robot's own inertial parameters, for example of an inaccurate drawing:
        with 1 the links are known and the friction is not. By default the adaptation block determines them, else zero.

    Notes
    -----
    With a scalar gain, a gradient adaptation gives the same torque for the full set of parameters and for an
    orthonormal base set.

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
        Input("I_r", "n", "kg m^2"),
        Input("tau_bias", "n", "N m"),
        Input("g_share"),
        Input("a_held", "10"),
    )

    friction: tuple[Friction, ...] = ("viscous",)
    rotors: bool = False
    gravity: Literal["together", "apart"] = "together"
    bias: bool = False
    nominal: Scalar | None = NonNegative(default=None)

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        """p: the dynamic parameters."""
        return {"p": self._parameters(robot).elements}

    def prior(self, robot: Any, others: Fraction) -> list[list[Fraction]]:
        """The natural gain of the nominal inertia for each link; `others`, squared, for each friction and bias.

        Separate masses and first moments of gravity have the same variance as those of the motion, independently.
        """
        links, rest = [natural_gain(row) for row in robot.inertia], [[[others * others]]] * robot.n
        given: dict[Part, list[list[list[Fraction]]]] = {
            "inertial": links,
            "weighing": [[row[:WEIGHING] for row in link[:WEIGHING]] for link in links],
            "rotor": rest,
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
        """(1) and, with `nominal`, the nominal parameters."""
        robot, a_d = p.robot, self._parameters(p.robot.chain)
        columns: dict[Part, SX] = {
            "inertial": robot.regressor(u.q, u.dq, u.dq_ref, u.ddq_ref),
            "rotor": ca.diag(u.ddq_ref),
            "viscous": ca.diag(u.dq_ref),
            "coulomb": ca.diag(robot.coulomb(u.dq_ref)),
            "bias": ca.DM.eye(robot.n),
        }
        if a_d.separate_gravity:
            still = ca.DM.zeros(robot.n)
            weight = robot.regressor(u.q, still, still, still)
            columns |= {"inertial": columns["inertial"] - weight, "weighing": heavy(weight)}
        outputs = {"Y_d": ca.densify(ca.horzcat(*a_d.in_order(columns)))}
        if "nominal" in p:
            none = ca.DM.zeros(robot.n)
            start: dict[Part, SX] = {
                "inertial": p.nominal * robot.inertia,
                "weighing": p.nominal * heavy(robot.inertia),
                "rotor": none,
                "viscous": none,
                "coulomb": none,
                "bias": -p.nominal * robot.gravity_torque(u.q),
            }
            outputs["a_d_nominal"] = ca.vertcat(*a_d.in_order(start))
        return Equations(outputs=outputs)

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """No storage; the true a_d, in which the load of the plant is a part of the last link.

        The manufacturer's servo compensates gravity of the robot's own links only.
        """
        a_d, names = self._parameters(p.robot.chain), {"viscous": "B", "coulomb": "D", "bias": "tau_bias"}
        rotors = truth.I_r if "I_r" in truth else ca.DM.zeros(p.robot.n)
        true: dict[Part, SX] = {part: getattr(truth, names[part]) for part in a_d.parts if part in names}
        true |= {"inertial": self._links(p, truth), "rotor": rotors}
        if a_d.separate_gravity:
            own = truth.g_share * heavy(p.robot.inertia)
            true["weighing"] = with_held(own, truth.a_held, heavy) if "a_held" in truth else own
        return Certificate(truth={"a_d": ca.vertcat(*a_d.in_order(true))})

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """The regressor has a column for each kind of friction of the plant, and for its rotors."""
        return columns_for(self.friction, truth, rotor=self.rotors)

    def _links(self, p: Signals, truth: Signals) -> SX:
        """The inertial parameters of all links."""
        return with_held(p.robot.inertia, truth.a_held) if "a_held" in truth else p.robot.inertia

    def _parameters(self, chain: SerialChain) -> DynamicParameters:
        kinds = (*self.friction, "rotor") if self.rotors else self.friction
        return DynamicParameters(chain, kinds, self.gravity == "apart", self.bias)


@operation
def heavy(a: SX) -> SX:
    """Mass and first moments of a link's ten inertial parameters, or their columns: the four that affect gravity."""
    size = a.shape[0] if a.is_column() else a.shape[1]
    places = [place for place in range(size) if place % len(INERTIAL) < WEIGHING]
    return a[places] if a.is_column() else a[:, places]
