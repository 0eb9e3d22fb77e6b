"""The symbolic robot while a block is read: each quantity prints as one function, J(q), and has the robot's values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, Final, final

import casadi as ca

from dmframe.block.naming import Expression, Operation, as_mx, call, description_of, register
from dmframe.formula import tree
from dmframe.formula.tree import Applied, Node, Number, Shape
from dmframe.robot.symbolic import SymbolicRobot

SIGNS: Final[Mapping[str, str]] = {
    "position": "f",
    "jacobian": "J",
    "rotation": "R_tool",
    "angular_jacobian": "J_turn",
    "kinematic_regressor": "Y_k",
    "position_regressor": "W_k",
    "regressor": "Y_inertia",
    "momentum_regressor": "Y_momentum",
    "kinetic_regressor": "Y_kinetic",
    "gravity_regressor": "Y_gravity",
    "mass_matrix": "M",
    "coriolis": "C",
    "gravity_torque": "g_full",
    "coulomb": "phi",
}
"""Printed symbol of each quantity; the inverse dynamics print as a sum of three. Y_d and g are signals of the blocks:
Y_d has columns for friction, and g excludes the gravity that the manufacturer's servo compensates."""

PAPER: Final[Mapping[str, str]] = {"Y_d": "regressor", "g": "gravity_torque"}
"""The two functions under the names of the paper; a docstring may use these."""

CONSTANTS: Final[Mapping[str, str]] = {
    "inertia": "a_inertia",
    "a_k": "a_k",
    "gravity": "g_0",
    "friction_velocity": "v_0",
    "velocity_limits": "v_max",
    "effort_limits": "tau_max",
    "lower_limits": "q_min",
    "upper_limits": "q_max",
}
"""The robot's numbers that blocks read, by printed name."""

MEANINGS: Final[Mapping[str, str]] = {
    "a_inertia": "ten inertial parameters per link: mass, first moments, inertia about the joint frame",
    "a_k": "the true translations between joints, and to the tool",
    "g_0": "the acceleration of gravity",
    "v_0": "the velocity scale of smoothed Coulomb friction, the robot's friction_velocity",
    "v_max": "the velocity limits of the joints in the robot's URDF",
    "tau_max": "the torque limits of the joints in the robot's URDF",
    "q_min": "the lower position limits of the joints in the robot's URDF",
    "q_max": "the upper position limits of the joints in the robot's URDF",
}
"""Meaning of the numbers, printed with a law that contains them."""

_MOTION: Final = ("q", "dq", "dq_ref", "ddq_ref")


@final
class RobotFunctions:
    """The quantities of a `SymbolicRobot` as CasADi functions, each built when it is first called.

    The robot's constants are the last argument of each, one column. All dynamics are computed from one regressor, in
    which they are linear: one function is built instead of five, and the numbers are computed independently of the
    robot's own functions.
    """

    def __init__(self, robot: SymbolicRobot) -> None:
        self.of, self.n = robot, robot.n
        self.constants = ca.vertcat(*(constant.symbol for constant in robot.constants))
        self.values = ca.vertcat(*(ca.DM(value) for value in robot.values().values()))
        self._built = dict[str, Any]()

    def value(self, name: str) -> Any:
        """The numbers of one of `CONSTANTS`."""
        return ca.Function("value", [self.constants], [ca.densify(getattr(self.of, name))])(self.values)

    def of_method(self, method: str, given: tuple[str, ...]) -> Any:
        """The function of a method with these arguments."""
        label = "_".join(part for part in ("robot", method, *given) for part in part.split("_"))
        if label not in self._built:
            register(label, Operation(method, given))
            self._built[label] = self._build(label, method, given)
        return self._built[label]

    def _build(self, label: str, method: str, given: tuple[str, ...]) -> Any:
        if method in _DYNAMICS:
            symbols = {name: ca.MX.sym(name, self._size(name)) for name in given}
            constants = ca.MX.sym("constants", self.constants.numel())
            inertia = symbols.get("inertia", as_mx(self._inertia(constants)))
            dynamics = _Dynamics(self.of_method("regressor", _MOTION), constants, inertia, self.n)
            return ca.Function(label, [*symbols.values(), constants], [_DYNAMICS[method](dynamics, symbols)])
        arguments = {name: ca.SX.sym(name, self._size(name)) for name in given}
        built = getattr(self.of, method)(**arguments)
        return ca.Function(label, [*arguments.values(), self.constants], [ca.densify(built)])

    def _inertia(self, constants: Any) -> Any:
        return call(ca.Function("inertia", [self.constants], [self.of.inertia]), [constants])

    def _size(self, name: str) -> int:
        sizes: dict[str, int] = {"inertia": self.of.inertia.numel(), "a_k": self.of.k, "gravity_share": 1}
        return sizes.get(name, self.n)


@final
class _Dynamics:
    """Torques and matrices from the regressor."""

    def __init__(self, regressor: Any, constants: Any, inertia: Any, n: int) -> None:
        self._regressor, self._constants, self._inertia = regressor, constants, inertia
        self.zero, self.units = ca.DM.zeros(n), ca.horzsplit(ca.DM.eye(n))

    def torque(self, q: Any, dq: Any, dq_ref: Any, ddq_ref: Any) -> Any:
        """M(q) ddq_ref + C(q, dq) dq_ref + g(q)."""
        return call(self._regressor, [q, dq, dq_ref, ddq_ref, self._constants]) @ self._inertia

    def gravity(self, q: Any) -> Any:
        """g(q)."""
        return self.torque(q, self.zero, self.zero, self.zero)

    def inverse_dynamics(self, a: Mapping[str, Any]) -> Any:
        """Inverse dynamics with a fraction of gravity."""
        torque = self.torque(*(a[name] for name in _MOTION))
        return torque if "gravity_share" not in a else torque - (1 - a["gravity_share"]) * self.gravity(a["q"])

    def mass_matrix(self, a: Mapping[str, Any]) -> Any:
        """M(q), column by column."""
        still = self.gravity(a["q"])
        return ca.horzcat(*(self.torque(a["q"], self.zero, self.zero, unit) - still for unit in self.units))

    def coriolis(self, a: Mapping[str, Any]) -> Any:
        """C(q, dq), column by column."""
        still = self.gravity(a["q"])
        return ca.horzcat(*(self.torque(a["q"], a["dq"], unit, self.zero) - still for unit in self.units))

    def gravity_torque(self, a: Mapping[str, Any]) -> Any:
        """g(q)."""
        return self.gravity(a["q"])


_DYNAMICS: Final[Mapping[str, Callable[[_Dynamics, Mapping[str, Any]], Any]]] = {
    "inverse_dynamics": _Dynamics.inverse_dynamics,
    "mass_matrix": _Dynamics.mass_matrix,
    "coriolis": _Dynamics.coriolis,
    "gravity_torque": _Dynamics.gravity_torque,
}


@final
class ReadRobot:
    """The object ``p.robot`` while a block is read: the methods and numbers of `SymbolicRobot` with a printed symbol.

    With `symbolic` its arguments and results are MX and its numbers are symbols; else they are SX.
    """

    def __init__(self, functions: RobotFunctions, *, symbolic: bool) -> None:
        robot = functions.of
        self.chain, self.n, self.m, self.k = robot.chain, robot.n, robot.m, robot.k
        self._functions, self._symbolic = functions, symbolic
        self.constants = ca.MX.sym("constants", functions.constants.numel()) if symbolic else functions.constants
        self.numbers = {
            name: ca.MX.sym(printed, getattr(robot, name).numel()) if symbolic else getattr(robot, name)
            for name, printed in CONSTANTS.items()
        }
        self.inertia, self.a_k = self.numbers["inertia"], self.numbers["a_k"]
        self.gravity, self.friction_velocity = self.numbers["gravity"], self.numbers["friction_velocity"]
        self.velocity_limits, self.effort_limits = self.numbers["velocity_limits"], self.numbers["effort_limits"]
        self.lower_limits, self.upper_limits = self.numbers["lower_limits"], self.numbers["upper_limits"]

    def _call(self, method: str, **arguments: Expression) -> Any:
        given = {name: value for name, value in arguments.items() if value is not None}
        function = self._functions.of_method(method, tuple(given))
        values = [as_mx(value) for value in given.values()] if self._symbolic else list(given.values())
        return call(function, [*values, self.constants])

    def position(self, q: Any, a_k: Any = None) -> Any:
        """The position of the tool."""
        return self._call("position", q=q, a_k=a_k)

    def jacobian(self, q: Any, a_k: Any = None) -> Any:
        """The Jacobian of the tool's position; a second argument gives other translations."""
        return self._call("jacobian", q=q, a_k=a_k)

    def rotation(self, q: Any) -> Any:
        """The orientation of the tool, its frame's axes in those of the base."""
        return self._call("rotation", q=q)

    def angular_jacobian(self, q: Any) -> Any:
        """The Jacobian of the tool's angular velocity, in the axes of the base."""
        return self._call("angular_jacobian", q=q)

    def kinematic_regressor(self, q: Any, psi: Any) -> Any:
        """The kinematic regressor: J(`q`) `psi` is Y_k(`q`, `psi`) `a_k`, except for prismatic joints."""
        return self._call("kinematic_regressor", q=q, psi=psi)

    def position_regressor(self, q: Any) -> Any:
        """The regressor of the position: it is W_k(`q`) `a_k`, except for prismatic joints."""
        return self._call("position_regressor", q=q)

    def inverse_dynamics(
        self, q: Any, dq: Any, dq_ref: Any, ddq_ref: Any, inertia: Any = None, gravity_share: Any = None
    ) -> Any:
        """M(q) ddq_ref + C(q, dq) dq_ref + g(q)."""
        motion = dict(zip(_MOTION, (q, dq, dq_ref, ddq_ref), strict=True))
        return self._call("inverse_dynamics", **motion, inertia=inertia, gravity_share=gravity_share)

    def regressor(self, q: Any, dq: Any, dq_ref: Any, ddq_ref: Any) -> Any:
        """The regressor of the torque of this motion, without friction, in ten inertial parameters per link."""
        return self._call("regressor", q=q, dq=dq, dq_ref=dq_ref, ddq_ref=ddq_ref)

    def momentum_regressor(self, q: Any, dq: Any) -> Any:
        """The regressor of the joints' momentum M(`q`) `dq`, in ten inertial parameters per link."""
        return self._call("momentum_regressor", q=q, dq=dq)

    def kinetic_regressor(self, q: Any, dq: Any) -> Any:
        """The regressor of the gradient of the kinetic energy in `q`, in ten inertial parameters per link."""
        return self._call("kinetic_regressor", q=q, dq=dq)

    def gravity_regressor(self, q: Any) -> Any:
        """The regressor of the gravity torque, in ten inertial parameters per link."""
        return self._call("gravity_regressor", q=q)

    def mass_matrix(self, q: Any, inertia: Any = None) -> Any:
        """The mass matrix; a second argument gives other inertial parameters."""
        return self._call("mass_matrix", q=q, inertia=inertia)

    def coriolis(self, q: Any, dq: Any, inertia: Any = None) -> Any:
        """The Coriolis and centrifugal matrix of the Christoffel symbols."""
        return self._call("coriolis", q=q, dq=dq, inertia=inertia)

    def gravity_torque(self, q: Any, inertia: Any = None) -> Any:
        """The complete gravity torque."""
        return self._call("gravity_torque", q=q, inertia=inertia)

    def coulomb(self, dq: Any) -> Any:
        """The smooth sign tanh(`dq`/`v_0`) of Coulomb friction; `v_0` is the robot's friction_velocity."""
        return self._call("coulomb", dq=dq)


def written(called: Operation, arguments: Sequence[Node], shape: Shape) -> Node:
    """A quantity of the robot in the notation of the paper, without the last argument, the constants."""
    given = dict(zip(called.given, arguments, strict=False))
    if called.sign == "inverse_dynamics":
        return _inverse_dynamics(given, shape)
    return quantity(called.sign, tuple(given.values()), shape)


def quantity(method: str, arguments: tuple[Node, ...], shape: Shape) -> Applied:
    """A method of the robot as its symbol."""
    return Applied(SIGNS[method], arguments, shape, symbol=True, description=description_of(getattr(ReadRobot, method)))


def _inverse_dynamics(given: Mapping[str, Node], shape: Shape) -> Node:
    """M ddq_ref + C dq_ref + g, without zero terms."""
    square, more = (shape[0], shape[0]), (given["inertia"],) if "inertia" in given else ()

    def sign(method: str, *arguments: Node, of: Shape = square) -> Node:
        return quantity(method, (*arguments, *more), of)

    q, dq, dq_ref, ddq_ref = (given[name] for name in _MOTION)
    gravity = sign("gravity_torque", q, of=shape)
    if "gravity_share" in given:
        gravity = tree.multiply(given["gravity_share"], gravity, shape)
    inertial = tree.matrix_multiply(sign("mass_matrix", q), ddq_ref, shape)
    turning = tree.matrix_multiply(sign("coriolis", q, dq), dq_ref, shape)
    if Number(Fraction(0), dq.shape) == dq:
        turning = dq
    return tree.add(tree.add(inertial, turning, shape), gravity, shape)
