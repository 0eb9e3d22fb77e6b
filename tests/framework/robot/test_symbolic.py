"""Every quantity compared with Pinocchio, on packaged robots and random chains; structural identities exactly."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dmframe.exact import zero_test
from dmframe.robot.chain import SerialChain, pin_configuration
from dmframe.robot.library import load
from dmframe.robot.symbolic import SymbolicRobot

ROBOTS = {
    "ur3": {},
    "ur5": {},
    "ur10": {},
    "panda": {},
    "xarm7": {},
    "z1": {},
    "ur10 with three joints held": {
        "free": ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"],
        "hold": {"wrist_2_joint": -np.pi / 2},
    },
    "ur10 held at odd angles": {"hold": {"shoulder_lift_joint": 0.3, "wrist_2_joint": -1.2}},
    "panda held at odd angles": {"hold": {"panda_joint2": 0.4, "panda_joint5": 2.2}},
    "arm3": {},
    "pendulum": {},
}


@pytest.fixture(params=ROBOTS, scope="module")
def chain(request):
    return load(request.param.split()[0], **ROBOTS[request.param])


def symbols(n):
    return [ca.SX.sym(name, n) for name in ("q", "dq", "dq_ref", "ddq_ref")]


def evaluate(robot, build, *arguments, extra=()):
    """Value of an expression of (q, dq, dq_ref, ddq_ref) at numbers, with the robot's own constants."""
    given_symbols = symbols(robot.n)[: len(arguments)]
    f = ca.Function("f", [*given_symbols, *(c.symbol for c in robot.constants), *extra], [build(*given_symbols)])
    numbers = robot.values()
    return np.array(f(*arguments, *(numbers[c.name] for c in robot.constants)))


def points(n, seed=0, count=4):
    return np.random.default_rng(seed).normal(size=(count, n))


def close(found, expected, tolerance=1e-10):
    scale = max(float(np.max(np.abs(expected))), 1e-3)
    np.testing.assert_allclose(found.reshape(np.shape(expected)), expected, rtol=0, atol=tolerance * scale)


def oracle_regressor(chain, q, dq, dq_ref, ddq_ref):
    """The Slotine-Li regressor by polarisation of Pinocchio's."""
    configuration, zero = pin_configuration(chain, q), np.zeros(chain.n)

    def Y(velocity, acceleration):
        data = chain.model.createData()
        return np.array(pin.computeJointTorqueRegressor(chain.model, data, configuration, velocity, acceleration))

    return Y(zero, ddq_ref) + (Y(dq + dq_ref, zero) - Y(dq, zero) - Y(dq_ref, zero) + Y(zero, zero)) / 2


def oracle_jacobian(chain, q):
    data, configuration = chain.model.createData(), pin_configuration(chain, q)
    pin.framesForwardKinematics(chain.model, data, configuration)
    tool = data.oMf[chain.model_tool].translation.copy()
    frame = pin.LOCAL_WORLD_ALIGNED
    J = pin.computeFrameJacobian(chain.model, data, configuration, chain.model_tool, frame)
    rows = ["xyz".index(letter) for letter in chain.axes]
    return tool[rows], J[rows]


def oracle_turn(chain, q):
    """Orientation of the tool's frame, and the Jacobian of its angular velocity, in the base's axes."""
    data, configuration = chain.model.createData(), pin_configuration(chain, q)
    pin.framesForwardKinematics(chain.model, data, configuration)
    frame = pin.LOCAL_WORLD_ALIGNED
    J = pin.computeFrameJacobian(chain.model, data, configuration, chain.model_tool, frame)
    return data.oMf[chain.model_tool].rotation.copy(), J[3:]


def oracle_mass(chain, q):
    data = chain.model.createData()
    pin.crba(chain.model, data, pin_configuration(chain, q))
    return np.triu(data.M) + np.triu(data.M, 1).T


def check_against_pinocchio(chain, seed=0):
    robot = SymbolicRobot(chain)
    q, dq, dq_ref, ddq_ref = points(chain.n, seed)
    configuration, data, zero = pin_configuration(chain, q), chain.model.createData(), np.zeros(chain.n)
    a_d = np.array([float(x) for row in chain.inertia for x in row])
    tool, J = oracle_jacobian(chain, q)
    Y = oracle_regressor(chain, q, dq, dq_ref, ddq_ref)
    M, gravity = oracle_mass(chain, q), np.array(pin.rnea(chain.model, data, configuration, zero, zero))
    velocity_torque = np.array(pin.rnea(chain.model, data, configuration, dq, zero)) - gravity

    close(evaluate(robot, robot.position, q), tool)
    close(evaluate(robot, robot.jacobian, q), J)
    R, J_w = oracle_turn(chain, q)
    close(evaluate(robot, robot.rotation, q), R)
    close(evaluate(robot, robot.angular_jacobian, q), J_w)
    close(evaluate(robot, robot.regressor, q, dq, dq_ref, ddq_ref), Y)
    close(evaluate(robot, robot.inverse_dynamics, q, dq, dq_ref, ddq_ref), Y @ a_d)
    close(evaluate(robot, lambda q, dq, _, ddq: robot.inverse_dynamics(q, dq, dq, ddq), q, dq, zero, ddq_ref),
          np.array(pin.rnea(chain.model, data, configuration, dq, ddq_ref)))  # fmt: skip
    close(evaluate(robot, robot.mass_matrix, q), M)
    close(evaluate(robot, robot.gravity_torque, q), gravity)
    close(evaluate(robot, robot.coriolis, q, dq) @ dq, velocity_torque)
    close(
        evaluate(robot, robot.coriolis, q, dq),
        np.array(pin.computeCoriolisMatrix(chain.model, data, configuration, dq)),
    )


def test_every_quantity_agrees_with_pinocchio_on_packaged_robots(chain):
    check_against_pinocchio(chain)


def unit_vector(rng, kind):
    if kind == "coordinate":
        return rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def joint_model(kind, axis):
    if kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(axis)
    if kind == "continuous":
        return [pin.JointModelRUBX, pin.JointModelRUBY, pin.JointModelRUBZ][int(np.argmax(np.abs(axis)))]()
    return pin.JointModelRevoluteUnaligned(axis)


def random_chain(kinds, axis_kind, seed, axes="xyz"):
    rng = np.random.default_rng(seed)
    model, parent = pin.Model(), 0
    model.name = "random"
    model.gravity.linear = rng.normal(size=3)
    for i, kind in enumerate(kinds):
        axis = unit_vector(rng, axis_kind)
        rotation = pin.exp3(rng.normal(size=3)) if axis_kind == "any" else np.eye(3)[[1, 2, 0]]
        placement = pin.SE3(rotation, rng.normal(size=3))
        parent = model.addJoint(parent, joint_model(kind, axis), placement, f"joint{i + 1}")
        model.addJointFrame(parent)
        inertia = pin.Inertia.FromEllipsoid(rng.uniform(0.5, 5), *rng.uniform(0.05, 0.5, size=3))
        model.appendBodyToJoint(parent, inertia, pin.SE3(np.eye(3), rng.normal(size=3)))
    return SerialChain.from_model(model, tool=list(rng.normal(size=3)), axes=axes)


random_chains = st.builds(
    random_chain,
    st.lists(st.sampled_from(["revolute", "prismatic", "continuous"]), min_size=1, max_size=7),
    st.sampled_from(["any", "coordinate"]),
    st.integers(0, 2**31),
)
moderate = settings(
    max_examples=25,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@moderate
@given(random_chains, st.integers(0, 1000))
def test_every_quantity_agrees_with_pinocchio_on_random_chains(chain, seed):
    check_against_pinocchio(chain, seed)


def jacobian_at(robot, q, a_k):
    symbol_q, symbol_a_k = ca.SX.sym("q", robot.n), ca.SX.sym("a_k", robot.k)
    inputs = [symbol_q, symbol_a_k, *(c.symbol for c in robot.constants)]
    f = ca.Function("J", inputs, [robot.jacobian(symbol_q, symbol_a_k), robot.position(symbol_q, symbol_a_k)])
    J, x = f(q, a_k, *robot.values().values())
    return np.array(J), np.array(x)


@moderate
@given(random_chains)
def test_the_task_velocity_is_linear_in_the_kinematic_parameters(chain):
    robot = SymbolicRobot(chain)
    q, psi = points(chain.n, 1, 2)
    a_k = robot.values()["robot.a_k"] + 0.1 * points(robot.k, 2, 1)[0]
    Y_k = evaluate(robot, lambda q, psi: robot.kinematic_regressor(q, psi), q, psi)
    bare, _ = jacobian_at(robot, q, np.zeros(robot.k))
    J, _ = jacobian_at(robot, q, a_k)
    close(Y_k @ a_k + bare @ psi, J @ psi)
    if all(joint.kind == "revolute" for joint in chain.joints):
        close(Y_k @ a_k, J @ psi)


def test_the_kinematic_regressor_moves_with_perturbed_translations_as_pinocchio_does():
    chain = load("ur10", hold={"wrist_2_joint": 0.7})
    robot = SymbolicRobot(chain)
    q, psi = points(chain.n, 3, 2)
    a_k = robot.values()["robot.a_k"] + 0.1 * points(robot.k, 4, 1)[0]
    moved = chain.model.copy()
    for i in range(chain.n):
        moved.jointPlacements[i + 1].translation = a_k[3 * i : 3 * i + 3]
    moved.frames[chain.model_tool].placement = pin.SE3(np.eye(3), a_k[-3:])
    data = moved.createData()
    J = pin.computeFrameJacobian(moved, data, q, chain.model_tool, pin.LOCAL_WORLD_ALIGNED)[:3]
    close(evaluate(robot, lambda q, psi: robot.kinematic_regressor(q, psi), q, psi) @ a_k, J @ psi)
    close(jacobian_at(robot, q, a_k)[1], data.oMf[chain.model_tool].translation)


def test_the_regressor_times_the_parameters_is_the_torque_for_any_parameters(chain):
    robot = SymbolicRobot(chain)
    arguments, a_d = points(chain.n, 5), points(10 * chain.n, 6, 1)[0]
    names = symbols(chain.n)
    inertia = ca.SX.sym("a_d", 10 * chain.n)
    f = ca.Function(
        "f",
        [*names, inertia, *(c.symbol for c in robot.constants)],
        [robot.regressor(*names) @ inertia, robot.inverse_dynamics(*names, inertia)],
    )
    product, torque = (np.array(x) for x in f(*arguments, a_d, *robot.values().values()))
    close(product, torque, 1e-12)


def identically_zero(robot, expression, *names):
    """True if an expression vanishes for every q, velocity and inertia, with the robot's geometry."""
    fixed = {c.name: c.values for c in robot.constants if not c.name.endswith(("inertia", "friction_velocity"))}
    inputs = [*names, *(c.symbol for c in robot.constants)]
    labels = [*(f"free{i}" for i in range(len(names))), *(c.name for c in robot.constants)]
    safe = [label.replace(".", "_") for label in labels]
    f = ca.Function("residual", inputs, [expression], safe, ["residual"])
    return zero_test(f, values={name.replace(".", "_"): values for name, values in fixed.items()}, trials=2).zero


def skew_residual(robot):
    q, dq, s = (ca.SX.sym(name, robot.n) for name in ("q", "dq", "s"))
    rate = ca.jtimes(robot.mass_matrix(q), q, dq)
    return s.T @ (rate - 2 * robot.coriolis(q, dq)) @ s, (q, dq, s)


@pytest.mark.parametrize("name", ["ur10", "xarm7", "panda", "arm2"])
def test_the_mass_matrix_rate_minus_twice_coriolis_is_exactly_skew(name):
    robot = SymbolicRobot(load(name))
    residual, names = skew_residual(robot)
    assert identically_zero(robot, residual, *names)


@moderate
@given(random_chains)
def test_the_skew_identity_is_exact_on_random_chains(chain):
    robot = SymbolicRobot(chain)
    residual, names = skew_residual(robot)
    assert identically_zero(robot, residual, *names)


def test_rounded_rotations_break_the_skew_identity_that_rational_ones_keep():
    robot = SymbolicRobot(load("xarm7"))
    rotations = next(c for c in robot.constants if c.name == "robot.rotations")
    rounded = tuple(type(x)(float(x)) for x in rotations.values)
    robot.constants = tuple(
        type(c)(c.name, c.symbol, rounded if c is rotations else c.values, c.unit) for c in robot.constants
    )
    residual, names = skew_residual(robot)
    assert not identically_zero(robot, residual, *names)


def test_the_slotine_li_torque_is_exactly_mass_coriolis_and_gravity():
    robot = SymbolicRobot(load("xarm7"))
    q, dq, dq_ref, ddq_ref = symbols(robot.n)
    parts = robot.mass_matrix(q) @ ddq_ref + robot.coriolis(q, dq) @ dq_ref + robot.gravity_torque(q)
    assert identically_zero(robot, robot.inverse_dynamics(q, dq, dq_ref, ddq_ref) - parts, q, dq, dq_ref, ddq_ref)


def test_the_jacobian_is_exactly_the_derivative_of_the_position():
    robot = SymbolicRobot(load("xarm7"))
    q = ca.SX.sym("q", robot.n)
    assert identically_zero(robot, ca.jacobian(robot.position(q), q) - robot.jacobian(q), q)


@pytest.mark.parametrize("name", ["xarm7", "panda"])
def test_the_tools_rotation_is_exactly_orthogonal_and_turns_by_the_angular_jacobian(name):
    robot = SymbolicRobot(load(name))
    q, dq = (ca.SX.sym(name, robot.n) for name in ("q", "dq"))
    R, omega = robot.rotation(q), robot.angular_jacobian(q) @ dq
    assert identically_zero(robot, R.T @ R - ca.SX.eye(3), q)
    assert identically_zero(robot, ca.jtimes(R, q, dq) - ca.skew(omega) @ R, q, dq)
    assert not identically_zero(robot, ca.jtimes(R, q, dq) + ca.skew(omega) @ R, q, dq), "the body's axes"


def test_the_tools_rotation_moves_by_a_small_turn_as_in_pinocchios_logarithm():
    chain, step = load("panda"), 1e-6
    robot = SymbolicRobot(chain)
    q, dq = points(chain.n, 7, 2)
    ends = [evaluate(robot, robot.rotation, q + sign * step * dq) for sign in (1, -1)]
    omega = pin.log3(ends[0] @ ends[1].T) / (2 * step)
    close(evaluate(robot, robot.angular_jacobian, q) @ dq, omega, 1e-8)


def test_a_tool_that_is_an_offset_alone_has_the_last_joints_frame():
    robot, q = SymbolicRobot(load("ur5", tool=[0.1, 0.0, 0.25])), points(6)[0]
    data = robot.chain.model.createData()
    pin.forwardKinematics(robot.chain.model, data, pin_configuration(robot.chain, q))
    close(evaluate(robot, robot.rotation, q), data.oMi[6].rotation)


def test_the_mass_matrix_is_symmetric_entry_by_entry(chain):
    robot = SymbolicRobot(chain)
    q = ca.SX.sym("q", robot.n)
    M = robot.mass_matrix(q)
    assert all(ca.is_equal(M[i, j], M[j, i]) for i in range(robot.n) for j in range(i))


def literals(f):
    return {f.instruction_constant(i) for i in range(f.n_instructions()) if f.instruction_id(i) == ca.OP_CONST}


def test_no_number_of_the_robot_is_folded_into_an_expression(chain):
    robot = SymbolicRobot(chain)
    names = symbols(robot.n)
    q, dq, *_ = names
    everything = [
        robot.position(q),
        robot.jacobian(q),
        robot.inverse_dynamics(*names),
        robot.mass_matrix(q),
        robot.coriolis(q, dq),
        robot.regressor(*names),
        robot.kinematic_regressor(q, dq),
        robot.rotation(q),
        robot.angular_jacobian(q),
    ]
    f = ca.Function("f", [*names, *(c.symbol for c in robot.constants)], everything)
    assert literals(f) <= {0.0, 1.0, -1.0, 0.5, 2.0}
    operations = {f.instruction_id(i) for i in range(f.n_instructions())}
    field = {ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_SIN, ca.OP_COS}
    assert operations <= field | {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT}


def test_expressions_of_the_ur10_stay_lean():
    limits = {3: (360, 170, 350), 6: (930, 580, 1300)}
    for free, counts in ((["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"], 3), (None, 6)):
        robot = SymbolicRobot(load("ur10", free=free))
        names = symbols(robot.n)
        expressions = (robot.inverse_dynamics(*names), robot.mass_matrix(names[0]), robot.regressor(*names))
        for expression, limit in zip(expressions, limits[counts], strict=True):
            f = ca.Function("f", [*names, *(c.symbol for c in robot.constants)], [expression], {"cse": True})
            assert f.n_instructions() <= limit


def test_coulomb_friction_is_a_smooth_sign_with_the_stated_velocity():
    robot = SymbolicRobot(load("arm2", friction_velocity=0.02))
    dq = np.array([0.02, -0.5])
    close(evaluate(robot, lambda _q, dq: robot.coulomb(dq), dq, dq), np.tanh(dq / 0.02), 1e-14)


def test_constants_have_their_names_units_and_rational_values():
    robot = SymbolicRobot(load("ur10"), prefix="model")
    units = {c.name: c.unit for c in robot.constants}
    assert units == {
        "model.inertia": "",
        "model.a_k": "m",
        "model.gravity": "m/s^2",
        "model.friction_velocity": "rad/s",
    }
    assert all(c.symbol.shape == (len(c.values), 1) for c in robot.constants)
    np.testing.assert_array_equal(robot.values()["model.gravity"], [-9.81])
    assert robot.values()["model.inertia"][0] == 7.778
    assert (robot.n, robot.m, robot.k) == (6, 3, 21)


def test_a_translation_of_zero_is_a_literal_zero():
    robot = SymbolicRobot(load("ur10"))
    assert robot.a_k[0].is_zero()
    assert not robot.a_k[2].is_zero()


@pytest.mark.parametrize("name", ["ur10", "panda", "arm3"])
def test_the_kinematic_regressors_are_pinocchios_slopes_in_the_translations(name):
    chain = load(name)
    robot = SymbolicRobot(chain)
    q, psi = points(chain.n, seed=3, count=2)
    step, model, tool = 1e-6, chain.model.copy(), chain.model_tool

    def moved():
        """Position and velocity of the tool, in the base's axes."""
        data = model.createData()
        pin.forwardKinematics(model, data, pin_configuration(chain, q), psi)
        pin.updateFramePlacement(model, data, tool)
        velocity = pin.getFrameVelocity(model, data, tool, pin.LOCAL_WORLD_ALIGNED).linear
        rows = ["xyz".index(axis) for axis in chain.axes]
        return np.concatenate([data.oMf[tool].translation[rows], velocity[rows]])

    slopes = []
    places = [model.jointPlacements[joint] for joint in range(1, chain.n + 1)] + [model.frames[tool].placement]
    for place in places:
        for axis in range(3):
            still = place.translation.copy()
            offset = np.zeros(3)
            offset[axis] = step
            ends = []
            for sign in (1, -1):
                place.translation = still + sign * offset
                ends.append(moved())
            place.translation = still
            slopes.append((ends[0] - ends[1]) / (2 * step))
    W_k, Y_k = np.split(np.array(slopes).T, 2)
    close(evaluate(robot, robot.position_regressor, q), W_k, tolerance=1e-6)
    close(evaluate(robot, robot.kinematic_regressor, q, psi), Y_k, tolerance=1e-6)


def test_the_momentum_and_its_regressor_are_pinocchios(chain):
    robot, model = SymbolicRobot(chain), chain.model
    for q, dq in zip(points(chain.n), points(chain.n, 1), strict=True):
        momentum = evaluate(robot, lambda q, dq: robot.momentum_regressor(q, dq) @ robot.inertia, q, dq)
        M = pin.crba(model, model.createData(), pin_configuration(chain, q))
        close(momentum, (np.triu(M) + np.triu(M, 1).T) @ dq)
        zero = np.zeros(chain.n)
        still, moved = (oracle_regressor(chain, q, zero, zero, v) for v in (zero, dq))
        close(evaluate(robot, robot.momentum_regressor, q, dq), moved - still)


def test_the_kinetic_regressor_is_the_slope_of_pinocchios_kinetic_energy(chain):
    robot, model, step = SymbolicRobot(chain), chain.model, 1e-6

    def energy(q, dq):
        return pin.computeKineticEnergy(model, model.createData(), pin_configuration(chain, q), dq)

    for q, dq in zip(points(chain.n), points(chain.n, 1), strict=True):
        found = evaluate(robot, lambda q, dq: robot.kinetic_regressor(q, dq) @ robot.inertia, q, dq)
        slope = [(energy(q + d, dq) - energy(q - d, dq)) / (2 * step) for d in step * np.eye(chain.n)]
        close(found, np.array(slope), 1e-7)
        zero = np.zeros(chain.n)
        transposed = evaluate(robot, lambda q, dq: robot.coriolis(q, dq).T @ dq, q, dq)
        close(found, transposed)  # C'dq, of Christoffel's C
        assert np.allclose(evaluate(robot, robot.kinetic_regressor, q, zero), 0)


def test_the_gravity_regressor_is_pinocchios(chain):
    robot, zero = SymbolicRobot(chain), np.zeros(chain.n)
    for q in points(chain.n):
        close(evaluate(robot, robot.gravity_regressor, q), oracle_regressor(chain, q, zero, zero, zero))
