"""Regressor as a CasADi function and as C source, and its comparison with Pinocchio."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.common.errors import ShapeError
from dmframe.common.files import write_text
from dmframe.common.version import version
from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.full import KINEMATIC_SIGNALS, SIGNALS, full_regressor
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.symbolic import SymbolicRobot

# A fixed, prefixed name: a function called y0, exp or read would collide with the C library's.
_INNER: Final = "dmframe_regressor_casadi"

_DYNAMIC: Final = """
/* Y_d: {n} x {p}, row-major, dense: Y_d[i * {p} + j] is joint i's torque per unit of parameter j.
   Reentrant; allocates nothing but {w} doubles on the stack. */
{export}void dmframe_regressor(const double *q, const double *dq, const double *dq_ref, const double *ddq_ref,
                       double *Y_d)
{{
  const casadi_real *arg[{arg}] = {{q, dq, dq_ref, ddq_ref}};
  casadi_real *res[{res}] = {{Y_d}};
"""

_KINEMATIC: Final = """
/* Y_k: {n} x {p}, row-major, dense: Y_k[i * {p} + j] is task coordinate i's velocity per unit of parameter j.
   Reentrant; allocates nothing but {w} doubles on the stack. */
{export}void dmframe_kinematic_regressor(const double *q, const double *psi, double *Y_k)
{{
  const casadi_real *arg[{arg}] = {{q, psi}};
  casadi_real *res[{res}] = {{Y_k}};
"""

_BODY: Final = """\
  casadi_int iw[{iw}];
  casadi_real w[{w}];
  {inner}(arg, res, iw, w, 0);
}}
"""


def regressor_function(chain: SerialChain, friction: Collection[str] = (), base: bool = False) -> ca.Function:
    """Y_d (n, p) as a function with inputs q, dq, dq_ref, ddq_ref, all (n), the robot's constants bound to floats.

    With `base`, only the columns of the base parameters (`base_parameters(...).independent`). Units: N m per unit of
    each parameter. Raises `UnknownNameError` for another kind of friction.
    """
    full = full_regressor(chain, friction)
    signals = [ca.SX.sym(name, chain.n) for name in SIGNALS]
    Y_d = full.function(*signals, *(ca.DM([float(x) for x in values]) for values in full.values))
    if base:
        Y_d = Y_d[:, list(base_parameters(chain, friction, symbolic=False).independent)]
    return ca.Function("Y_d", signals, [Y_d], list(SIGNALS), ["Y_d"])


def kinematic_function(chain: SerialChain) -> ca.Function:
    """Y_k (m, k) as a function with inputs q and psi, both (n): J(q) psi = Y_k a_k, and what prismatic joints add.

    Columns are named by `kinematic_names`. Units: m/s per m.
    """
    robot = SymbolicRobot(chain)
    q, psi = (ca.SX.sym(name, chain.n) for name in KINEMATIC_SIGNALS)
    symbols = [constant.symbol for constant in robot.constants]
    inner = ca.Function("inner", [q, psi, *symbols], [ca.densify(robot.kinematic_regressor(q, psi))])
    Y_k = inner(q, psi, *(ca.DM(value) for value in robot.values().values()))
    return ca.Function("Y_k", [q, psi], [Y_k], list(KINEMATIC_SIGNALS), ["Y_k"])


def kinematic_names(chain: SerialChain) -> tuple[str, ...]:
    """The elements of a_k: p_y3 is the y component of joint 3's position in the frame of joint 2; n + 1 is the tool."""
    return tuple(f"p_{axis}{place}" for place in range(1, chain.n + 2) for axis in "xyz")


def kinematic_values(chain: SerialChain) -> tuple[float, ...]:
    """The values of a_k [m], in the order of `kinematic_names`."""
    return tuple(float(x) for joint in chain.joints for x in joint.translation) + tuple(map(float, chain.tool))


def export_c(
    chain: SerialChain,
    path: str | Path,
    friction: Collection[str] = (),
    base: bool = False,
    kinematic: bool = False,
) -> tuple[str, ...]:
    """Write the regressor of a robot as C source; returns the parameters' names, in the order of its columns."""
    if kinematic:
        write_c(kinematic_function(chain), path, robot=chain.name, parameters=kinematic_names(chain))
        return kinematic_names(chain)
    names, robot = full_regressor(chain, friction).parameters.names, chain.name
    if base:
        names = base_parameters(chain, friction, symbolic=False).kept
        robot += " in base parameters, each named after its kept parameter"
    write_c(regressor_function(chain, friction, base), path, robot=robot, parameters=names)
    return names


def write_c(function: ca.Function, path: str | Path, *, robot: str = "", parameters: Sequence[str] = ()) -> None:
    """Write a function of `regressor_function`, or of `kinematic_function`, as self-contained C99, atomically.

    The file defines ``void dmframe_regressor(q, dq, dq_ref, ddq_ref, Y_d)`` with Y_d row-major, and needs only the
    mathematics library. Its header comment names the robot, the sizes, the order of the arguments, and the parameters.

    Raises `ShapeError` for a function with other inputs or for another number of parameters, `OutputError` for a file
    that cannot be written.
    """
    found = tuple(function.name_in())
    if found not in (SIGNALS, KINEMATIC_SIGNALS) or function.n_out() != 1:
        raise ShapeError(
            f"C source of {function.name()}: expected inputs {', '.join(SIGNALS)} and one output, found "
            f"{', '.join(found)} and {function.n_out()}; use regressor_function"
        )
    n, p = function.size_out(0)
    if parameters and len(parameters) != p:
        raise ShapeError(f"C source of {function.name()}: expected {p} parameter names, found {len(parameters)}")
    about = _dynamic_about(robot, n, p) if found == SIGNALS else _kinematic_about(robot, function.numel_in(0), n, p)
    write_text(path, _header(about, parameters) + _source(function, n, p))


def _source(function: ca.Function, n: int, p: int) -> str:
    signals = [ca.SX.sym(function.name_in(i), function.numel_in(i)) for i in range(function.n_in())]
    # CasADi's matrices are column-major, so the transpose is the row-major matrix that C expects.
    inner = ca.Function(_INNER, signals, [ca.densify(function(*signals).T)])
    generator = ca.CodeGenerator(_INNER, {"with_header": False, "verbose": False})
    generator.add(inner)
    sizes = {"arg": inner.sz_arg(), "res": inner.sz_res(), "iw": max(1, inner.sz_iw()), "w": max(1, inner.sz_w())}
    wrapper = (_DYNAMIC if len(signals) == len(SIGNALS) else _KINEMATIC) + _BODY
    return str(generator.dump()) + wrapper.format(
        n=n,
        p=p,
        inner=_INNER,
        export='#ifdef __cplusplus\nextern "C"\n#endif\n',
        **sizes,
    )


def _dynamic_about(robot: str, n: int, p: int) -> list[str]:
    return [
        f"Dynamic regressor Y_d(q, dq, dq_ref, ddq_ref) of {_plain(robot) or 'a robot'}, written by dmframe "
        f"{version()}.",
        "",
        "M(q) ddq_ref + C(q, dq) dq_ref + g(q) [+ friction] = Y_d a_d, C the Christoffel matrix.",
        f"q, dq, dq_ref, ddq_ref: {n} doubles each, joints from the base to the tool; rad, rad/s, rad/s^2, N m.",
        f"Y_d: {n} x {p} doubles, row-major.",
        "Compile as C99 and link the mathematics library (-lm).",
    ]


def _kinematic_about(robot: str, n: int, m: int, k: int) -> list[str]:
    return [
        f"Kinematic regressor Y_k(q, psi) of {_plain(robot) or 'a robot'}, written by dmframe {version()}.",
        "",
        "J(q) psi = Y_k a_k, except for the travel of prismatic joints, which no parameter scales.",
        f"q, psi: {n} doubles each, joints from the base to the tool; rad, rad/s.",
        f"Y_k: {m} x {k} doubles, row-major.",
        "Compile as C99 and link the mathematics library (-lm).",
    ]


def _header(about: Sequence[str], parameters: Sequence[str]) -> str:
    lines = list(about)
    if parameters:
        lines += ["", "Parameters, the columns from 0 on:"]
        lines += ["  " + ", ".join(map(_plain, parameters[k : k + 10])) for k in range(0, len(parameters), 10)]
    return "/*\n" + "".join(f" * {line}".rstrip() + "\n" for line in lines) + " */\n\n"


def _plain(name: str) -> str:
    """A name that cannot end a C comment."""
    return name.replace("*/", "* /").replace("\n", " ")


@final
@dataclass(frozen=True)
class SelfTest:
    """Largest difference of the symbolic regressors from Pinocchio, relative to the largest entry at each point."""

    Y_d: float
    Y_k: float
    points: int


def self_test(chain: SerialChain, *, points: int = 10, seed: int = 0) -> SelfTest:
    r"""Compare Y_d and Y_k with Pinocchio at random points.

    The oracle of Y_d is the standard regressor Y polarised, Y(q, 0, ddq_ref) +
    1/2 [Y(q, dq + dq_ref, 0) - Y(q, dq, 0) - Y(q, dq_ref, 0) + Y(q, 0, 0)]; that of Y_k a_k the tool frame's Jacobian.
    """
    rng = np.random.default_rng(seed)
    Y_d, travel = regressor_function(chain), _travel_function(chain)
    dynamic, kinematic = 0.0, 0.0
    for _ in range(points):
        q, dq, dq_ref, ddq_ref = rng.uniform(-2, 2, (4, chain.n))
        expected = polarised_regressor(chain, q, dq, dq_ref, ddq_ref)
        dynamic = max(dynamic, _difference(Y_d(q, dq, dq_ref, ddq_ref), expected))
        kinematic = max(kinematic, _difference(travel(q, dq), tool_velocity(chain, q, dq)))
    return SelfTest(dynamic, kinematic, points)


def _difference(found: Any, expected: NDArray[np.float64]) -> float:
    values = np.asarray(found, dtype=float).reshape(expected.shape)
    return float(np.max(np.abs(values - expected)) / max(float(np.max(np.abs(expected))), 1e-300))


def _travel_function(chain: SerialChain) -> Callable[..., Any]:
    """Y_k(q, psi) a_k, and the part of a prismatic joint's travel that no parameter scales."""
    Y_k, free, a_k = kinematic_function(chain), travel_of_prismatic_joints(chain), ca.DM(kinematic_values(chain))
    return lambda q, psi: (Y_k(q, psi) @ a_k).full().ravel() + free(q, psi)


def travel_of_prismatic_joints(chain: SerialChain) -> Callable[..., NDArray[np.float64]]:
    """The part of J(q) psi that is independent of the kinematic parameters, as a function of q and psi."""
    robot = SymbolicRobot(chain)
    q, psi = (ca.SX.sym(name, chain.n) for name in KINEMATIC_SIGNALS)
    free = ca.densify(robot.jacobian(q, ca.SX(chain.k, 1)) @ psi)
    function = ca.Function("free", [q, psi, *(c.symbol for c in robot.constants)], [free])
    values = [ca.DM(value) for value in robot.values().values()]
    return lambda q, psi: np.asarray(function(q, psi, *values).full().ravel())


def polarised_regressor(
    chain: SerialChain,
    q: NDArray[np.float64],
    dq: NDArray[np.float64],
    dq_ref: NDArray[np.float64],
    ddq_ref: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Pinocchio's joint torque regressor in Slotine and Li's form, (n, 10 n): the oracle of Y_d."""
    import pinocchio as pin

    data = chain.model.createData()
    configuration = pin_configuration(chain, q)
    zero = np.zeros(chain.n)

    def standard(v: NDArray[np.float64], a: NDArray[np.float64]) -> NDArray[np.float64]:
        found = pin.computeJointTorqueRegressor(chain.model, data, configuration, v, a)
        return np.array(found).reshape(chain.n, -1)  # for one joint, Pinocchio returns a row without the first axis

    products = standard(dq + dq_ref, zero) - standard(dq, zero) - standard(dq_ref, zero) + standard(zero, zero)
    return standard(zero, ddq_ref) + products / 2


def tool_velocity(chain: SerialChain, q: NDArray[np.float64], dq: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pinocchio's velocity of the tool point in the base frame, (m): the oracle of Y_k."""
    import pinocchio as pin

    data = chain.model.createData()
    J = pin.computeFrameJacobian(
        chain.model, data, pin_configuration(chain, q), chain.model_tool, pin.LOCAL_WORLD_ALIGNED
    )
    return np.array(J.reshape(6, chain.n)[["xyz".index(axis) for axis in chain.axes], :] @ dq)
