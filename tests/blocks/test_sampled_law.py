"""The sampled law's blocks: compared with the hand-written law sample by sample, and the effect of each guard."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import casadi as ca
import numpy as np
import pytest
from sampled_by_hand import Arm, Circle, LeastSquaresLaw, Observer, Plant, SampledLaw, closed_loop, rms
from test_sampled_by_hand import K_D, K_I, K_P, PATH, START, STEP, T, ur10

import dmframe as dm
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.port import Access, Input, Output, Side, State
from dmframe.block.steps import unpacked
from dmframe.catalogue import block_types
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.robot.library import find_robot
from dmframe.robot.parameters import DynamicParameters
from dmframe.simulate import Log, Recording, simulate
from dmframe_blocks._averaged_servo import averaged_servo

BLOCKS = block_types()
SLOW, FAST = "ur10_slow_sampled", "ur10_fast_sampled"
ARM = Graph.read("ur10_slow_sampled").robot
SERVO = averaged_servo(ARM, "pid", frozenset(("viscous", "coulomb")))


class Line(AbstractBlock):
    """Delays each command by some samples."""

    side = Side.PLANT
    inputs = (Input("dq_c", "n", "rad/s"),)
    outputs = (Output("dq_late", "n", "rad/s"),)
    states = (
        State("first", "n", "rad/s", sampled=True),
        State("second", "n", "rad/s", sampled=True),
    )
    samples: Literal[1, 2] = 1

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        late = x.first if self.samples == 1 else x.second
        return Equations(outputs={"dq_late": late}, next={"first": u.dq_c, "second": x.first})


class Encoder(AbstractBlock):
    """Outputs the pose in whole steps."""

    side = Side.PLANT
    inputs = (Input("q", "n", "rad"),)
    outputs = (Output("q_seen", "n", "rad", Access.MEASURED),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"q_seen": ca.floor(u.q / STEP + 0.5) * STEP})


def run(
    name: str = "ur10_slow_sampled",
    duration: float = 100.0,
    *overrides: str,
    delay: int = 0,
    assumed: int | None = None,
    encoder: bool = False,
    start: Mapping[str, Any] | None = None,
    engine: Any = "interpreted",
) -> Recording:
    """A packaged graph with delayed commands, configured delay (`assumed`, or the true one), and quantised pose."""
    graph = Graph.read(name, list(overrides))
    blocks, wires = dict(graph.blocks), dict(graph.file.wires)
    if delay:
        blocks["line"], wires["servo.dq_c"] = Line(samples=delay), "line.dq_late"
    if encoder:
        blocks["encoder"], wires["inverse.q"] = Encoder(), "encoder.q_seen"
    for part in ("task", "inverse"):
        blocks[part] = type(blocks[part])(**{**dict(blocks[part]), "delay": delay if assumed is None else assumed})
    diagram = Diagram.build(blocks, wires, graph.robot)
    given = {**graph.start, **(start or {})}
    return simulate(diagram, duration, clock=graph.file.clock, start=given, engine=engine)


def error(recorded: Recording) -> np.ndarray:
    return np.asarray(recorded["arm.x"] - recorded["path.x_d"])


def by_hand(law: SampledLaw, ticks: int) -> dict[str, np.ndarray]:
    no_integral = 0 * K_I if not law.pid else K_I
    return closed_loop(law, Plant(law.arm, START, K_D, K_P, no_integral), PATH, ticks)


@pytest.mark.parametrize(("tau", "average", "stride"), [(2.0, 1, 1), (None, 1, 1), (2.0, 3, 2)])
def test_tick_by_tick_it_equals_the_law_by_hand(tau: float | None, average: int, stride: int) -> None:
    ticks = 40
    law = SampledLaw(ur10(), T, tau=tau, average=average, stride=stride)
    hand = by_hand(law, ticks)
    options = {"filtered": str(tau is not None).lower(), "average": average, "stride": stride}
    mine = run(SLOW, ticks * T, "task.damping=0", *(f"inverse.{name}={value}" for name, value in options.items()))
    for name, label in (("q", "arm.q"), ("u", "inverse.dq_c"), ("v_des", "task.dq_r"), ("error", None)):
        found = error(mine) if label is None else mine[label]
        np.testing.assert_allclose(found[:ticks], hand[name], atol=1e-8, err_msg=name)
    # the hand-written law stores new estimates at a sample, a state the old ones; zero columns, which the block
    # omits, are not adapted
    learnt = mine["inverse.theta"][ticks]
    for i, part in enumerate(SERVO.joints):
        np.testing.assert_allclose(learnt[part][[0, 1, 2, -2, -1]], hand["theta"][-1, i, [0, 1, 2, -2, -1]], atol=1e-7)
        np.testing.assert_allclose(np.linalg.norm(learnt[part]), np.linalg.norm(hand["theta"][-1, i]), rtol=1e-6)


def test_with_six_joints_and_a_w_0_for_each_it_equals_the_law_by_hand() -> None:
    graph = Graph.read("ur10_full_sampled", ["task.damping=0"])
    maker, arm, ticks = graph.blocks["servo"], graph.blocks["arm"], 12
    hand_arm = Arm.load(str(find_robot("ur10").urdf), "ee_link", {}, arm.viscous, arm.coulomb)  # type: ignore[attr-defined]
    w_0 = np.array(graph.blocks["inverse"].w_0)  # type: ignore[attr-defined]
    start, path = np.array(graph.start["q"]), Circle((-0.07, 0.67, 0.55), 0.15, 0.5)
    law = SampledLaw(hand_arm, T, w_0=w_0, stored=8)
    hand = closed_loop(law, Plant(hand_arm, start, *gains_of(maker)), path, ticks)
    diagram = Diagram.build({name: graph.blocks[name] for name in graph.blocks if name != "posture"}, {}, graph.robot)
    mine = simulate(diagram, ticks * T, clock=T, start=graph.start, engine="interpreted")
    for name, label in (("q", "arm.q"), ("u", "inverse.dq_c")):
        np.testing.assert_allclose(mine[label][:ticks], hand[name], atol=1e-7, err_msg=name)
    other = closed_loop(SampledLaw(hand_arm, T, stored=8), Plant(hand_arm, start, *gains_of(maker)), path, ticks)
    assert np.max(np.abs(other["u"] - hand["u"])) > 5e-6


def gains_of(maker: Any) -> list[np.ndarray]:
    return [np.array(getattr(maker, name)) for name in ("K_D", "K_P", "K_I")]


def test_a_redundant_robot_tracks_as_well_and_keeps_its_posture() -> None:
    found = dm.load("ur10_full_sampled").run("100 s", progress=False)
    assert found.error is not None
    assert found.error.rms_final < 1e-4
    q, q_0 = found.recording["arm.q"], np.array([1.2, -1.2, 1.2, 0, -np.pi / 2, 0])
    assert np.max(np.abs(q - q_0)) < 0.6
    assert not found.recording["inverse.guarded"].any()


@pytest.mark.parametrize(("average", "retention", "inertia"), [(1, 0.98, 20.0), (2, 1.0, 0.5)])
def test_by_least_squares_it_equals_the_law_by_hand(average: int, retention: float, inertia: float) -> None:
    """Also for points on faces of the box, and for a projection that leaves another face."""
    ticks = 40
    law = LeastSquaresLaw(ur10(), T, average=average, retention=retention, heaviest=inertia)
    hand = by_hand(law, ticks)
    options = {"estimator": "least_squares", "average": average, "retention": retention}
    box = f"inverse.inertia_box=[{-inertia}, {inertia}]"
    mine = run(SLOW, ticks * T, "task.damping=0", box, *(f"inverse.{name}={value}" for name, value in options.items()))
    for name, label in (("q", "arm.q"), ("u", "inverse.dq_c"), ("v_des", "task.dq_r"), ("error", None)):
        found = error(mine) if label is None else mine[label]
        np.testing.assert_allclose(found[:ticks], hand[name], atol=1e-8, err_msg=name)
    learnt = mine["inverse.theta"][ticks]
    for i, part in enumerate(SERVO.joints):
        np.testing.assert_allclose(learnt[part][[0, 1, 2, -2, -1]], hand["theta"][-1, i, [0, 1, 2, -2, -1]], atol=1e-7)
    assert law.faces > 5
    assert (law.cuts > 0) is (inertia < 1)


def test_that_agreement_would_miss_a_law_with_another_memory() -> None:
    whole, short = (by_hand(SampledLaw(ur10(), T, stored=stored), 40) for stored in (20, 3))
    assert np.max(np.abs(whole["u"] - short["u"])) > 1e-4


@pytest.mark.parametrize("delay", [1, 2])
def test_behind_a_delay_it_equals_the_law_by_hand(delay: int) -> None:
    ticks = 40
    hand = by_hand(SampledLaw(ur10(), T, delay=delay), ticks)
    mine = run(SLOW, ticks * T, "task.damping=0", delay=delay)
    np.testing.assert_allclose(mine["line.dq_late"][:ticks], hand["u"], atol=3e-4)  # Newton's steps differ
    np.testing.assert_allclose(mine["arm.q"][:ticks], hand["q"], atol=1e-4)
    unknown = run(SLOW, ticks * T, "task.damping=0", delay=delay, assumed=delay - 1)
    assert np.max(np.abs(unknown["arm.q"][:ticks] - hand["q"])) > 3e-3


def test_the_observer_equals_that_by_hand() -> None:
    for delay in (0, 1, 2):
        hand = by_hand(Observer(ur10(), T, delay=delay), 40)
        mine = run("ur10_slow_observer", 40 * T, "task.damping=0", delay=delay)
        np.testing.assert_allclose(mine["arm.q"][:40], hand["q"], atol=1e-8)
    assert rms(error(run("ur10_slow_observer"))) == pytest.approx(0.28, abs=0.01)


def test_it_tracks_to_a_tenth_of_a_millimetre_where_the_kinematic_controller_has_five() -> None:
    law, kinematic = run(SLOW, 100.0), Graph.read("ur10_slow_kinematic")
    diagram, clock = kinematic.diagram, kinematic.file.clock
    other = simulate(diagram, 100.0, clock=clock, start=kinematic.start, engine="interpreted")
    assert rms(error(law)) < 0.04
    assert not law["inverse.guarded"].any()
    assert rms(error(other)) == pytest.approx(5.36, abs=0.02)


def test_behind_a_delay_and_an_encoder_it_stays_below_two_tenths() -> None:
    late = run(SLOW, 100.0, delay=1, encoder=True)
    assert rms(error(late)) < 0.1
    assert rms(error(run("ur10_slow_observer", 100.0, delay=1, encoder=True))) == pytest.approx(0.56, abs=0.02)


def test_a_target_that_is_known_but_for_a_constant_is_as_good_where_rows_are_filtered() -> None:
    off = {"servo.q_c": list(START + 0.01)}
    filtered, plain = (run(SLOW, 40.0, f"inverse.filtered={word}", start=off) for word in ("true", "false"))
    assert rms(error(filtered)) < 0.2
    # z grows without bound
    assert rms(error(plain)) > 3 * rms(error(filtered))


def test_a_pi_servo_has_a_row_of_its_own() -> None:
    graph = Graph.read(SLOW, ["inverse.servo=pi", "inverse.k_I=1.8", "inverse.k_I_box=[0.2, 6]", "task.damping=0"])
    gains = {"K_P": [800, 800, 400], "K_I": [1760, 1760, 880]}
    servo = BLOCKS["pi_servo"](**gains)
    diagram = Diagram.build({**graph.blocks, "servo": servo}, {}, graph.robot)
    law = simulate(diagram, 60.0, clock=T, start=graph.start, engine="interpreted")
    assert rms(error(law)) < 0.1
    hand = by_hand(SampledLaw(ur10(), T, pid=False), 40)
    np.testing.assert_allclose(law["inverse.dq_c"][:40], hand["u"], atol=1e-8)


def inverse(**options: Any) -> Any:
    return BLOCKS["sampled_inverse"](w_0=1 / 800, **options)


def states(**values: Any) -> dict[str, Any]:
    """A sampled inverse at rest at START, in its second sample."""
    n, size = 3, SERVO.size
    return {
        "theta": np.zeros(size),
        "rows": np.zeros((20, size)),
        "goals": np.zeros((20, n)),
        "psi_slow": np.zeros(size),
        "q_before": START,
        "q_aim": START,
        "m_before": START,
        "m_planned": START,
        "plans": np.zeros((n, 1)),
        "queue": np.zeros((n, 1)),
        "count": 1.0,
        **values,
    }


def heavy(scale: float) -> np.ndarray:
    """Parameters with the robot's own inertia, times a scale, and the initial gains."""
    theta = np.zeros(SERVO.size)
    names = [element.name for element in SERVO.elements]
    inertial = [element.name for element in DynamicParameters(ARM).elements]
    body = dict(zip(inertial, np.ravel(np.array(ARM.inertia, dtype=float)), strict=True))
    for place, name in enumerate(names):
        if name.startswith(("k_P", "k_I")):
            theta[place] = 1.8 if name.startswith("k_P") else 1.2
        elif name.partition("_")[2] in body:
            theta[place] = scale * body[name.partition("_")[2]] / 800
    return theta


def test_where_the_momentum_is_no_safe_slope_it_is_left_out_of_the_command() -> None:
    given = {"q": START, "dq_r": [0.1, 0.2, -0.1], "T": 0.02}
    found = {scale: inverse().evaluate(given, states(theta=heavy(scale)), robot=ARM) for scale in (1.0, -3.0, 300.0)}
    # M/(800 T) of the UR10 is about 1: safe; times -3 the slope is not positive, times 300 it exceeds 4
    assert [float(values.outputs["guarded"]) for values in found.values()] == [0.0, 1.0, 1.0]
    steady = inverse().evaluate(given, states(theta=heavy(-3.0), plans=np.array([[0.1], [0.2], [-0.1]])), robot=ARM)
    np.testing.assert_allclose(steady.outputs["dq_c"], found[-3.0].outputs["dq_c"])  # for any previous plan
    moved = inverse().evaluate(given, states(theta=heavy(1.0), plans=np.array([[0.1], [0.2], [-0.1]])), robot=ARM)
    assert np.max(np.abs(moved.outputs["dq_c"] - found[1.0].outputs["dq_c"])) > 0.05


def test_a_joint_whose_command_was_clipped_is_not_adapted_with_that_sample() -> None:
    far = inverse(u_max=0.5).evaluate({"q": START, "dq_r": [0.1, 2.0, -3.0], "T": T}, states(), robot=ARM)
    assert np.all(np.abs(far.outputs["dq_c"]) <= 0.5)
    assert far.outputs["dq_c"][1] == 0.5
    assert far.outputs["dq_c"][2] == -0.5
    moved = {"q": START + 0.01, "dq_r": np.zeros(3), "T": T}
    queue = np.array([[0.2], [0.5], [0.2]])
    learnt = inverse(u_max=0.5).evaluate(moved, states(queue=queue, theta=heavy(1.0)), robot=ARM).next
    change = learnt["theta"] - heavy(1.0)
    changed = [bool(np.any(np.abs(change[part]) > 1e-9)) for part in SERVO.joints]
    assert changed == [True, False, True]
    assert not np.any(learnt["rows"][0, SERVO.joints[1]])
    first = inverse().evaluate(moved, states(queue=queue, theta=heavy(1.0), count=0.0), robot=ARM).next
    np.testing.assert_allclose(first["theta"], heavy(1.0), atol=1e-12)  # no data before the first sample


def test_each_joint_has_its_own_initial_estimate() -> None:
    def learnt(w_0: Any) -> Any:
        law = BLOCKS["sampled_inverse"](w_0=w_0, k_P_box=[0.0, 9.0])
        given = {"q": START + 0.01, "dq_r": np.zeros(3), "T": T}
        queue = np.array([[0.2], [0.5], [0.2]])
        return law.evaluate(given, states(queue=queue, theta=heavy(1.0)), robot=ARM).next["theta"]

    guesses = [1 / 800, 1 / 80, 1 / 8]
    own, alike = learnt(guesses), [learnt(guess) for guess in guesses]
    for i, part in enumerate(SERVO.joints):
        np.testing.assert_allclose(own[part], alike[i][part], atol=1e-12)
        assert all(np.max(np.abs(own[part] - alike[k][part])) > 1e-6 for k in range(3) if k != i)


@pytest.mark.parametrize("name", ["sampled_inverse", "disturbance_observer"])
def test_with_time_stamps_a_sample_that_is_over_was_as_long_as_it_was(name: str) -> None:
    now, before = 1.23, {"q_before": START, "queue": np.array([[0.2], [0.5], [0.2]])}
    options, memory = ({}, before) if name == "disturbance_observer" else ({"w_0": 1 / 800}, states(**before))

    def after(period: float, **stamps: Any) -> Mapping[str, Any]:
        law = BLOCKS[name](time_stamps=bool(stamps), **options)
        given = {"q": START + 0.01, "dq_r": [0.1, 0.2, -0.1], "T": period}
        given |= {"t": now} if stamps else {}
        found = law.evaluate(given, {**memory, **stamps}, robot=ARM)
        return {**found.next, **found.outputs}

    stamped, right, wrong = after(T, t_before=now - 0.08), after(0.08), after(T)
    assert stamped["t_before"] == now
    # the update uses the sample that has ended; the command is for one of length T
    past = {"lag"} if name == "disturbance_observer" else {"theta", "rows", "goals", "z", "psi_slow", "y_slow"}
    for label in past:
        np.testing.assert_allclose(stamped[label], right[label], atol=1e-12, err_msg=label)
    assert max(np.max(np.abs(stamped[label] - wrong[label])) for label in past) > 1e-3


def test_time_stamps_spare_a_predictor_the_clock_that_is_not_exact() -> None:
    def tracked(**options: bool) -> float:
        overrides = [f"inverse.{key}={str(value).lower()}" for key, value in options.items()]
        graph = Graph.read("ur10_slow_observer", overrides)
        found = simulate(graph.diagram, 50.0, clock=T, start=graph.start, engine="interpreted", jitter=0.03)
        return rms(error(found))

    assert tracked(time_stamps=True) < 0.3
    assert tracked() > 0.8


def test_what_a_row_teaches_never_raises_the_storage_but_by_its_residual() -> None:
    rng = np.random.default_rng(4)
    Gamma, truth, theta, nu = rng.uniform(0.5, 2, SERVO.size), *rng.normal(size=(2, SERVO.size)), 1e-5

    def storage(estimate: Any) -> float:
        return float(np.sum((np.asarray(estimate).ravel() - truth) ** 2 / Gamma))

    for eta in (0.0, 0.3):
        h = rng.normal(size=SERVO.size)
        sums = np.array([h[part] @ truth[part] for part in SERVO.joints]) + eta
        weights = [nu + h[part] @ (Gamma[part] * h[part]) for part in SERVO.joints]
        after = SERVO.projected(ca.DM(theta), ca.DM(h), ca.DM(sums), ca.DM(Gamma), nu)
        allowed = sum(eta**2 / weight for weight in weights)
        assert storage(after) <= storage(theta) + allowed
        # a gain of 2.5 instead of one below 1 makes it unstable
        beyond = theta + 2.5 * (np.asarray(after).ravel() - theta)
        assert storage(beyond) > storage(theta) + (allowed if eta == 0 else -np.inf)


def test_the_task_law_takes_the_tool_to_its_goal_at_the_end_of_the_sample() -> None:
    arm, q, goal = ur10(), START + 0.02, PATH(T)
    path = {"x_d": PATH(0), "x_d_1": goal, "x_d_2": PATH(2 * T), "x_d_3": PATH(3 * T), "T": T}
    off = arm.position(q) - PATH(0)
    for options, expected in (
        ({"gamma": 1.0}, goal + off - T * arm.jacobian(q) @ arm.jacobian(q).T @ off),
        ({"Lambda": 3.0}, goal + (1 - 3 * T) * off),
        ({"Lambda": 3.0, "delay": 1}, PATH(2 * T) + (1 - 3 * T) * (arm.position(q) - goal)),
    ):
        task = BLOCKS["sampled_tracking"](damping=0.0, **options)
        v = task.evaluate({"q_start": q, **path}, robot=ARM).outputs["dq_r"]
        np.testing.assert_allclose(arm.position(q + T * v), expected, atol=1e-7)
    straight = BLOCKS["sampled_tracking"](gamma=1.0).evaluate({"q_start": [START[0], START[1], 0.0], **path}, robot=ARM)
    assert np.all(np.abs(straight.outputs["dq_r"]) < 50)  # a stretched arm: the damping limits its velocity
    for wrong in ({}, {"gamma": 1.0, "Lambda": 3.0}):
        with pytest.raises(
            DmframeError, match="expected one of gamma, by J', and Lambda or gain_margin, by the inverse of J"
        ):
            BLOCKS["sampled_tracking"](**wrong)


def test_the_inverse_of_the_jacobian_alone_is_five_times_better_than_its_transpose() -> None:
    graph = Graph.read("ur10_slow_kinematic_inverse")
    found = simulate(graph.diagram, 60.0, clock=T, start=graph.start, engine="interpreted")
    assert 0.9 < rms(error(found)) < 1.2


def test_on_a_fast_clock_an_encoder_requires_the_mean_of_several_rows() -> None:
    assert rms(error(run(FAST, 16.0, delay=1, encoder=True))) < 0.3
    alone = run(FAST, 16.0, "inverse.average=1", "inverse.stride=1", delay=1, encoder=True)
    assert rms(error(alone)) > 0.5
    assert alone["inverse.guarded"].mean() > 0.2


def test_what_an_estimator_does_not_have_is_refused() -> None:
    for options, reports in (
        ({"estimator": "least_squares", "replay": 5}, "expected no replay with estimator least_squares"),
        ({"estimator": "least_squares", "stride": 2}, "expected no stride with estimator least_squares"),
        ({"retention": 0.9}, "expected no retention with estimator projection"),
        ({"estimator": "least_squares", "retention": 1.1}, "expected a retention of 1 at most"),
    ):
        with pytest.raises(DmframeError, match=reports):
            inverse(**options)


def test_least_squares_goes_with_a_delay_and_an_encoder() -> None:
    squares = ("inverse.estimator=least_squares", "inverse.average=2")
    assert rms(error(run(SLOW, 20.0, *squares, delay=1, encoder=True))) < 0.4


def test_least_squares_goes_with_a_supervisor() -> None:
    squares = ("inverse.estimator=least_squares", "inverse.average=2")
    graph = Graph.read("ur10_slow_supervised", list(squares))
    found = simulate(graph.diagram, 8.0, clock=T, start=graph.start, engine="interpreted")
    assert float(found["supervisor.predictor"][-1].item()) == 2.0
    assert rms(error(found)) < 3


def test_over_2000_s_behind_an_encoder_least_squares_stays_and_its_memory_positive() -> None:
    log = Log(signals=("inverse.gathered", "inverse.guarded", "arm.x", "path.x_d"))
    squares = ("inverse.estimator=least_squares", "inverse.average=2")
    graph = Graph.read("ur10_slow_sampled_delay", list(squares))
    found = simulate(graph.diagram, 2000.0, clock=T, start=graph.start, log=log)
    assert rms(error(found)) < 0.03
    assert not found["inverse.guarded"].any()
    for triangles in found["inverse.gathered"][::500]:
        for matrix in unpacked(SERVO.parts, ca.DM(triangles)):
            values = np.linalg.eigvalsh(ca.evalf(matrix).full())
            assert values[0] >= -1e-12 * values[-1]


def test_results_hold_the_estimate_and_leave_its_memory_out() -> None:
    recorded = run(SLOW, 10 * T, "inverse.replay=2")
    assert recorded["inverse.theta"].shape == (11, SERVO.size)
    assert "inverse.rows" not in recorded.states
    graph = Graph.read(SLOW, ["inverse.replay=2"])
    logged = simulate(
        graph.diagram, 3 * T, clock=T, start=graph.start, engine="interpreted", log=Log(signals=("inverse.rows",))
    )
    assert logged["inverse.rows"].shape == (4, 2 * SERVO.size)
    assert "inverse.theta" not in logged.states
