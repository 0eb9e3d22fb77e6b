"""The dynamic regressor along the reference motion."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, ClassVar, Literal, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.certificate import SX, Certificate, Condition, Inequality
from dmframe.naming import operation
from dmframe.parameter import NonNegative, Scalar
from dmframe.port import Port
from dmframe.robot.pseudo_inertia import natural_gain

_HEAVY = 4
"""Of a link's ten parameters, the first ones alone weigh anything: mass and first moments."""


@final
class Regressor(AbstractBlock):
    r"""The matrix in which the robot's dynamics is linear in its dynamic parameters.

    .. math::

        Y_d\, a_d = M(q) \ddot q_{ref} + C(q, \dot q) \dot q_{ref} + B \dot q_{ref}
                    + D\, \phi(\dot q_{ref}) + g(q)   \tag{1}

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

    uses_robot: ClassVar[bool] = True
    inputs: ClassVar[tuple[Port, ...]] = (
        Port("q", "n", "rad"),
        Port("dq", "n", "rad/s"),
        Port("dq_ref", "n", "rad/s"),
        Port("ddq_ref", "n", "rad/s^2", derivative_of="dq_ref"),
    )
    outputs: ClassVar[tuple[Port, ...]] = (
        Port("Y_d", "n p", "N m"),
        Port("a_d_nominal", "p", "", optional=True),
    )
    truth: ClassVar[tuple[Port, ...]] = (
        Port("B", "n", "N m s/rad"),
        Port("D", "n", "N m"),
        Port("tau_bias", "n", "N m"),
        Port("g_share"),
    )

    friction: tuple[Literal["viscous", "coulomb"], ...] = ("viscous",)
    gravity: Literal["together", "apart"] = "together"
    bias: bool = False
    nominal: Scalar | None = NonNegative(default=None)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        """p: ten a link, four more where gravity is apart, and one a joint for each kind of friction."""
        apart = _HEAVY if self.gravity == "apart" else 0
        return {"p": (10 + apart + len(set(self.friction)) + self.bias) * robot.n}

    def prior(self, robot: Any, others: Fraction) -> list[list[Fraction]]:
        """Link by link the natural gain of the nominal inertia; `others`, squared, for each friction and bias.

        The gravity's own masses and first moments, where it is apart, vary like those of the motion, and by themselves.
        """
        links = [natural_gain(row) for row in robot.inertia]
        heavy = [[row[:_HEAVY] for row in link[:_HEAVY]] for link in links] if self.gravity == "apart" else []
        rest = [[[others * others]]] * (self.sizes(robot)["p"] - sum(len(part) for part in links + heavy))
        parts = [*links, *heavy, *rest]
        size, done, rows = sum(map(len, parts)), 0, list[list[Fraction]]()
        for part in parts:
            left, right = [Fraction(0)] * done, [Fraction(0)] * (size - done - len(part))
            rows += [[*left, *row, *right] for row in part]
            done += len(part)
        return rows

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """(1) and, if asked, the nominal parameters."""
        columns = [p.robot.regressor(u.q, u.dq, u.dq_ref, u.ddq_ref)]
        if self.gravity == "apart":
            still = ca.DM.zeros(p.robot.n)
            weight = p.robot.regressor(u.q, still, still, still)
            columns = [columns[0] - weight, heavy(weight)]
        if "viscous" in self.friction:
            columns.append(ca.diag(u.dq_ref))
        if "coulomb" in self.friction:
            columns.append(ca.diag(p.robot.coulomb(u.dq_ref)))
        if self.bias:
            columns.append(ca.DM.eye(p.robot.n))
        outputs = {"Y_d": ca.densify(ca.horzcat(*columns))}
        if "nominal" in p:
            n, frictions = p.robot.n, len(set(self.friction))
            held = [-p.nominal * p.robot.gravity_torque(u.q)] if self.bias else []
            weighing = [heavy(p.robot.inertia)] if self.gravity == "apart" else []
            inertia = p.nominal * ca.vertcat(p.robot.inertia, *weighing)
            outputs["a_d_nominal"] = ca.vertcat(inertia, ca.DM.zeros(frictions * n), *held)
        return Equations(outputs=outputs)

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        """Nothing is stored; the true a_d."""
        parts = [p.robot.inertia]
        if self.gravity == "apart":
            parts.append(truth.g_share * heavy(p.robot.inertia))
        if "viscous" in self.friction:
            parts.append(truth.B)
        if "coulomb" in self.friction:
            parts.append(truth.D)
        if self.bias:
            parts.append(truth.tau_bias)
        return Certificate(truth={"a_d": ca.vertcat(*parts)})

    def conditions(self, p: Signals, truth: Signals) -> tuple[Condition, ...]:
        """Whatever friction the plant has, the regressor has a column for it."""
        kinds = (("viscous", "viscous", "B"), ("coulomb", "Coulomb", "D"))
        lacking = [kind for kind in kinds if kind[0] not in self.friction and kind[2] in truth]
        return tuple(_column_for(key, name, getattr(truth, of)) for key, name, of in lacking)


def _column_for(key: str, name: str, true: SX) -> Inequality:
    """No such friction, or a column for it."""
    owners = ", ".join(dict.fromkeys(re.sub(r"(_\d+)?$", "", str(symbol)) for symbol in ca.symvar(true)))
    return Inequality(
        f"the plant has no {name} friction: {owners} is zero",
        -true * true,
        "eq. (5)",
        strict=False,
        otherwise=f"the plant has {name} friction ({owners}), and the regressor has no column for it: add {key} to "
        "friction",
    )


@operation
def heavy(a: SX) -> SX:
    """Of a link's ten inertial parameters, or of their columns, the four that weigh: mass and first moments."""
    size = a.shape[0] if a.is_column() else a.shape[1]
    places = [place for place in range(size) if place % 10 < _HEAVY]
    return a[places] if a.is_column() else a[:, places]
