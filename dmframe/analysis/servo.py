"""Transfer functions of the closed joint servo and of the adaptive inverse, by joint."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.additional_friction import AdditionalFriction, additional_friction
from dmframe.analysis.rational import Passivity, Rational, passivity, transfer
from dmframe.analysis.rounding import unrounded
from dmframe.analysis.set_point import computable, equilibrium, frozen
from dmframe.block import AbstractBlock
from dmframe.block.model import BlockModel
from dmframe.block.port import Access, Side
from dmframe.certify.true_values import true_values
from dmframe.common.errors import EngineError, MissingError
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.view import view
from dmframe.diagram.wiring import Wire

Array = NDArray[np.float64]

TORQUE: Final = "tau_dc"
FREE: Final = "dq_r"
REFERENCE: Final = "dq_ref"
SPEED: Final = "dq"
COMMAND: Final = "dq_c"
VOLTAGE: Final = "u"


@final
@dataclass(frozen=True)
class Margins:
    """Gain margin (a factor) and phase margin [deg] of a loop gain, with their crossover frequencies [rad/s]."""

    gain: float
    phase: float
    phase_crossover: float
    gain_crossover: float


@final
@dataclass(frozen=True)
class JointLoop:
    r"""One joint with its servo at a set-point; the other joints do not move.

    Parameters
    ----------
    inertia, viscous, motor
        :math:`M_{jj}` [kg m^2], B [N m s/rad] and K [N m/V].
    servo
        :math:`K C(s)`: torque per velocity error dq_c - dq [N m s/rad].
    loop
        :math:`L = K C / (M_{jj} s + B)`.
    tracking
        From dq_c to dq: L / (1 + L).
    margins
        Stability margins of L.
    passive_servo
        Passivity of K C; a PID servo alone is not passive.
    inverse
        From tau_dc to dq_c for the inverse at its true values: 1 / (K C). None without an adaptive inverse.
    port
        The servo with the inverse at its true values: from sigma = dq - dq_ref to the braking torque
        B sigma + tau_dc - K u. None without an adaptive inverse.
    passive_port
        Passivity of `port`, required by the certificate: M_bar >= 0 for a PID servo.
    """

    joint: str
    inertia: float
    viscous: float
    motor: float
    servo: Rational
    loop: Rational
    tracking: Rational
    margins: Margins
    passive_servo: Passivity
    inverse: Rational | None
    port: Rational | None
    passive_port: Passivity | None


def servo_transfer(
    diagram: Diagram, state: Array | None = None, *, start: Mapping[str, Any] | None = None
) -> tuple[JointLoop, ...]:
    """Transfer functions of the joint servos of a diagram at a state, by default its equilibrium.

    The servo is the plant block from dq_c to u; friction in between that depends on the velocity alone is left out, see
    `left_out`; the arm is the block with input u. M is the inverse of the slope of ddq
    in the torque, from the arm's equations.

    Raises
    ------
    MissingError
        The diagram has no such servo and arm.
    EngineError
        Transfer functions overflow.
    """
    still = unrounded(frozen(diagram))
    point = equilibrium(still, start=start) if state is None else np.asarray(state, dtype=float)
    servo, arm = _servo_and_arm(diagram)
    M, B, K = _arm(still, arm, point)
    names = diagram.robot.joint_names if diagram.robot is not None else tuple(f"joint {j + 1}" for j in range(len(M)))
    inverse = _inverse(diagram, servo)
    found = list[JointLoop]()
    for j, name in enumerate(names):
        try:
            with np.errstate(all="ignore"):  # overflow is reported below
                found.append(_joint(diagram, servo, inverse, name, j, (float(M[j, j]), float(B[j]), float(K[j]))))
        except (np.linalg.LinAlgError, OverflowError):
            raise EngineError(f"servo: the transfer functions of {name} overflow; take gains nearer to 1") from None
    return tuple(found)


def _joint(
    diagram: Diagram, servo: str, inverse: str | None, name: str, j: int, arm: tuple[float, float, float]
) -> JointLoop:
    inertia, viscous, motor = arm
    system = _system(diagram.models[servo], [COMMAND], [VOLTAGE], diagram.models[servo].states, {}, j)
    KC = transfer(system.A, system.B[:, 0], system.C[0], system.D[0, 0]).scaled(motor)
    loop = _over(KC, np.array([inertia, viscous]))
    tracking = _closed(loop)
    port = None if inverse is None else _port(diagram, servo, inverse, j, motor, viscous)
    return JointLoop(
        joint=name,
        inertia=inertia,
        viscous=viscous,
        motor=motor,
        servo=KC,
        loop=loop,
        tracking=tracking,
        margins=margins(loop),
        passive_servo=passivity(KC),
        inverse=None if inverse is None else _inverse_transfer(diagram, inverse, j),
        port=port,
        passive_port=None if port is None else passivity(port),
    )


def _over(C: Rational, den: Array) -> Rational:
    return Rational(C.num / den[0], np.polymul(C.den, den / den[0]))


def _closed(L: Rational) -> Rational:
    den = np.polyadd(L.den, L.num)
    return Rational(L.num / den[0], den / den[0])


def margins(loop: Rational) -> Margins:
    """Gain and phase margins by python-control."""
    import control

    with warnings.catch_warnings():  # python-control enables NumPy warnings of underflow
        warnings.simplefilter("ignore", RuntimeWarning)
        gain, phase, phase_crossover, gain_crossover = control.margin(loop.system())
    return Margins(float(gain), float(phase), float(phase_crossover), float(gain_crossover))


def _servo_and_arm(diagram: Diagram) -> tuple[str, str]:
    """Names of the servo (from dq_c to u) and of the arm (with input u)."""
    for (arm, port), source in diagram.sources.items():
        if port == VOLTAGE and isinstance(source, Wire) and diagram.blocks[arm].side is Side.PLANT:
            servo, _ = _through(diagram, source.block)
            shown = diagram.models[arm].equations.outputs.keys()
            if COMMAND in diagram.models[servo].inputs and {"dq", "ddq"} <= shown:
                return servo, arm
            if between := _between(diagram, servo):
                raise MissingError(
                    f"servo: expected one that drives {arm} itself, found {' and '.join(between)} in between, which "
                    "transfer functions of the servo would leave out; analyse the graph without"
                )
    raise MissingError(
        f"servo: expected a plant block with input {COMMAND} whose output {VOLTAGE} drives an arm with dq and ddq, "
        "found none; transfer functions need one"
    )


def left_out(diagram: Diagram) -> tuple[AdditionalFriction, ...]:
    """Friction between servo and arm that the transfer functions leave out."""
    for (arm, port), source in diagram.sources.items():
        if port == VOLTAGE and isinstance(source, Wire) and "ddq" in diagram.models[arm].equations.outputs:
            return _through(diagram, source.block)[1]
    return ()


def _through(diagram: Diagram, block: str) -> tuple[str, tuple[AdditionalFriction, ...]]:
    """The block before those that only add friction, from the arm's side, and their friction."""
    found, passed = list[AdditionalFriction](), block
    while (friction := additional_friction(passed, diagram.models[passed])) is not None:
        source = diagram.sources.get((passed, VOLTAGE))
        if not isinstance(source, Wire):
            break
        found.append(friction)
        passed = source.block
    return (passed, tuple(found)) if COMMAND in diagram.models[passed].inputs else (block, ())


def _between(diagram: Diagram, block: str) -> list[str]:
    """Blocks between the servo and the arm, from the servo's side; `block` is the last of them."""
    found = list[str]()
    while any(port.instead_of == VOLTAGE for port in diagram.blocks[block].outputs) and block not in found:
        found.insert(0, block)
        source = diagram.sources.get((block, VOLTAGE))
        if not isinstance(source, Wire):
            break
        block = source.block
    return found


def _inverse(diagram: Diagram, servo: str) -> str | None:
    """Controller block that commands the servo, if it adapts to it and has a sliding variable's torque as input.

    In the torque-based framework the inverse has no sliding variable, so no passive port.
    """
    source = diagram.sources[servo, COMMAND]
    if not isinstance(source, Wire):
        return None
    block: AbstractBlock = diagram.blocks[source.block]
    commands = any(port.name == source.port and port.access is Access.COMMANDED for port in block.outputs)
    adapts = any(label.startswith(f"{source.block}.") for label in true_values(diagram))
    model = diagram.models[source.block]
    passive = {TORQUE, FREE} <= model.inputs.keys() and REFERENCE in model.equations.outputs
    return source.block if commands and adapts and passive else None


def _arm(still: Diagram, arm: str, point: Array) -> tuple[Array, Array, Array]:
    """M, B and K at a state, from the arm's equations and its outputs of these names."""
    loop, model = still.loop, still.models[arm]
    seen = view(still, arm)
    n = model.inputs[VOLTAGE].numel()
    given = {
        name: still.resolver.output(arm, name) if name in model.equations.outputs else default
        for name, default in (("K", ca.SX.ones(n)), ("B", ca.SX.zeros(n)))
    }
    slope = ca.jacobian(model.equations.outputs["ddq"], model.inputs[VOLTAGE])
    read = [ca.vec(symbol) for symbol in model.inputs.values()]  # includes a load, which changes M
    meant = [ca.vec(ca.densify(getattr(seen.u, name))) for name in model.inputs]
    slope = loop.on_path(ca.substitute([slope], [ca.vertcat(*read)], [ca.vertcat(*meant)])[0])
    slope = ca.substitute(slope, loop.time, 0)
    values = ca.Function("arm", [loop.state, loop.p], [slope, *given.values()], {"allow_free": True})
    inverse_mass, K, B = (result.full() for result in values(point, loop.p_values))
    try:
        M = np.diag(K.ravel()) @ np.linalg.inv(computable(loop, "servo", inverse_mass))
    except np.linalg.LinAlgError:
        raise EngineError("servo: expected a mass matrix that is not singular at the set-point, found one") from None
    return M, B.ravel(), K.ravel()


@final
@dataclass(frozen=True)
class _System:
    """Linear equations of a block at one joint: dx/dt = A x + B v, y = C x + D v."""

    A: Array
    B: Array
    C: Array
    D: Array


def _system(
    model: BlockModel,
    inputs: Sequence[str],
    outputs: Sequence[str],
    states: Sequence[str] | Mapping[str, Any],
    fixed: Mapping[str, Array],
    j: int,
) -> _System:
    """Linear equations of one joint of a block with its other states fixed; signals are deviations from equilibrium."""
    x, v = stack(model.states[s][j] for s in states), stack(model.inputs[i][j] for i in inputs)
    rates = stack(model.equations.rates[s][j] for s in states)
    y = stack(model.equations.outputs[o][j] for o in outputs)
    blocks = [ca.jacobian(rates, x), ca.jacobian(rates, v), ca.jacobian(y, x), ca.jacobian(y, v)]
    everything = {**model.states, **model.inputs, **model.parameters}
    values = {**{name: np.zeros(symbol.shape) for name, symbol in everything.items()}, **model.values, **fixed}
    robot = [] if model.robot is None else [(c.symbol, model.robot.values()[c.name]) for c in model.robot.constants]
    pairs = [*((symbol, values[name]) for name, symbol in everything.items()), *robot]
    function = ca.Function("joint", [symbol for symbol, _ in pairs], blocks)
    return _System(*(np.asarray(ca.densify(part).full()) for part in function(*(value for _, value in pairs))))


def _inverse_transfer(diagram: Diagram, inverse: str, j: int) -> Rational:
    """Transfer function from tau_dc to dq_c, with q_c the integral of dq_c."""
    moving, truth = _inverse_states(diagram, inverse)
    part = _system(diagram.models[inverse], ["q_c", TORQUE], [COMMAND], moving, truth, j)
    size = len(moving) + 1
    A = np.block([[part.A, part.B[:, :1]], [part.C, part.D[:, :1]]])
    b = np.concatenate([part.B[:, 1], part.D[0, 1:]])
    return transfer(A, b, np.concatenate([part.C[0], part.D[0, :1]]).reshape(size), float(part.D[0, 1]))


def _inverse_states(diagram: Diagram, inverse: str) -> tuple[list[str], dict[str, Array]]:
    """States of the inverse that are not estimates, and true values of its estimates."""
    pairs = ((label.split(".", 1), value) for label, value in true_values(diagram).items())
    truth = {state: value for (block, state), value in pairs if block == inverse}
    return [state for state in diagram.models[inverse].states if state not in truth], truth


def _port(diagram: Diagram, servo: str, inverse: str, j: int, motor: float, viscous: float) -> Rational:
    """B + (tau_dc - K u) / sigma with dq_ref = 0, tau_dc = 0: servo, inverse at its true values, and dq/dt = sigma."""
    moving, truth = _inverse_states(diagram, inverse)
    model, plant = diagram.models[inverse], diagram.models[servo]
    maker = list(plant.states)
    top = _held(_system(model, ["q", "q_c", FREE], [COMMAND, REFERENCE], moving, truth, j))
    low = _system(plant, ["q", SPEED, COMMAND], [VOLTAGE], maker, {}, j)
    n, m = len(moving), len(maker)
    size = n + m + 1  # the inverse's states, the servo's, q
    q_c = np.zeros(size)
    q_c[n + maker.index("q_c")] = 1
    q = np.zeros(size)
    q[-1] = 1
    command = _rows(top.C, 0, size) + top.D @ np.vstack([q, q_c])
    A, b = np.zeros((size, size)), np.zeros(size)
    A[:n] = _rows(top.A, 0, size) + top.B @ np.vstack([q, q_c])
    A[n : n + m] = _rows(low.A, n, size) + low.B[:, :1] * q + low.B[:, 2:] @ command
    b[n : n + m] = low.B[:, 1]
    b[-1] = 1
    c = (_rows(low.C, n, size) + low.D[:, :1] * q + low.D[:, 2:] @ command)[0]
    H = transfer(A, b, c, float(low.D[0, 1])).scaled(-motor)
    return Rational(np.asarray(np.polyadd(H.num, viscous * H.den), dtype=float), H.den)


def _held(free: _System) -> _System:
    """System with its last output held at zero by its last input."""
    scale = -1 / free.D[-1, -1]
    row, feed = scale * free.C[-1:], scale * free.D[-1:, :-1]
    return _System(
        free.A + free.B[:, -1:] @ row,
        free.B[:, :-1] + free.B[:, -1:] @ feed,
        free.C[:-1] + free.D[:-1, -1:] @ row,
        free.D[:-1, :-1] + free.D[:-1, -1:] @ feed,
    )


def _rows(block: Array, first: int, size: int) -> Array:
    """Rows of full length with a block of columns inserted."""
    wide = np.zeros((block.shape[0], size))
    wide[:, first : first + block.shape[1]] = block
    return wide
