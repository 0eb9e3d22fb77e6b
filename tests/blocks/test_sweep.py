"""Properties of every block of the catalogue and of every packaged graph."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from dmframe.block import AbstractBlock, type_name
from dmframe.block.parameter import specs
from dmframe.block.port import Access, Side, Signal, State
from dmframe.block.prose import about
from dmframe.catalogue import block_types, graphs
from dmframe.common.units import compatible
from dmframe.graph.graph import Graph
from dmframe.simulate import simulate

BLOCKS = block_types()
GRAPHS = sorted(graphs())
LETTERS = set("nmpkhcdrWANGEHFwCBS")

# blocks that no packaged graph uses are run in one of these
EXAMPLES = {
    "setpoint": """
dmframe: 1
robot: arm2
clock: 4 ms
duration: 2 s
start: {q: [0.5, 0.9]}
blocks:
  goal:     {type: setpoint, x_d: [0.5, 0.4]}
  geometry: {type: kinematics}
  task:     {type: known_tracking, gamma: 1}
  inverse:  {type: kinematic_command}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator}
""",
}
BETWEEN = """
  encoder:  {type: encoder, step: 47.94 urad}
  readings: {type: measurement_delay}
  way:      {type: transport_delay}
  error:    {type: command_gain, gain: 1.1}
  limits:   {type: command_limits}
  ramp:     {type: command_ramp, acceleration: 4}
  friction: {type: friction_compensation, coulomb: 0.1}
  rubbing:  {type: stribeck_friction, sticking: 0.2, uneven: 0.1, per_torque: 0.1}
  model_ff: {type: model_compensation, share: 0.8, off: 0.1}
  drive:    {type: torque_limits}
  stops:    {type: joint_stops}
  gears:    {type: elastic_joints, stiffness: 4000, damping: 10, inertia: 0.1}
"""
LOADED = EXAMPLES["setpoint"].replace("manipulator}", "loaded_manipulator, payload: [1], payload_at: [1]}")
EXAMPLES |= dict.fromkeys(re.findall(r"type: (\w+)", BETWEEN), LOADED + BETWEEN[1:])
EXAMPLES["loaded_manipulator"] = LOADED
EXAMPLES["epicycles"] = EXAMPLES["setpoint"].replace(
    "setpoint, x_d: [0.5, 0.4]",
    "epicycles, center: [0.5, 0.4], radius: [0.05, 0.02], rate: [1, -2], phase: [0, 1], stop: 1, every: 1 s",
)
EXAMPLES["turning"] = (
    EXAMPLES["setpoint"] + "  attitude: {type: turning, orientation: [0, 90 deg, 0], axis: [1, 0, 0]}\n"
)
EXAMPLES["velocity_steps"] = (
    EXAMPLES["setpoint"]
    .replace("setpoint, x_d: [0.5, 0.4]", "velocity_steps, times: [0.1, 0.6], speeds: [[-0.3, 0.2], [0, 0]]")
    .replace("  geometry: {type: kinematics}\n  task:     {type: known_tracking, gamma: 1}\n", "")
)
EXAMPLES["sampled_joint_tracking"] = (
    EXAMPLES["setpoint"]
    .replace("setpoint, x_d: [0.5, 0.4]", "waypoints, times: [0, 1], q_d: [[0.5, 0.9], [0.02, 1.41]]")
    .replace("  geometry: {type: kinematics}\n", "")
    .replace("known_tracking, gamma: 1", "sampled_joint_tracking, gain_margin: 3")
    .replace("kinematic_command", "disturbance_observer, alpha: 0")
)
EXAMPLES["joint_waypoints"] = EXAMPLES["sampled_joint_tracking"].replace(
    "waypoints, times: [0, 1], q_d: [[0.5, 0.9], [0.02, 1.41]]",
    "joint_waypoints, times: [0, 0.5, 1], q_d: [[0.5, 0.9], [0.3, 1.1], [0.02, 1.41]], "
    "dq_d: [[0, 0], [-0.4, 0.5], [0, 0]], after: returns",
)
EXAMPLES["force_sensor"] = (
    EXAMPLES["setpoint"]
    + "  wall:     {type: wall, point: [0, 0.45], normal: [0, -1], stiffness: 100}\n"
    + "  sensor:   {type: force_sensor, noise: 0.1}\n"
)
EXAMPLES["reset_compensator"] = (
    EXAMPLES["setpoint"]
    .replace("manipulator", "loaded_manipulator, viscous: 1")
    .replace("kinematic_command", "pi_inverse, Lambda: 0.01, Lambda_I: 1, w_I: 4, w_I_box: [1, 10]")
    + "  model:    {type: payload_regressor}\n"
    + "  dynamics: {type: reset_compensator, Gamma: 1}\n"
    + "  load:     {type: payload, mass: [1], at: [1]}\n"
    + "  gripper:  {type: gripper, at: [1]}\n"
)
EXAMPLES["expert_aggregation"] = """
dmframe: 1
robot: arm2
clock: 40 ms
duration: 2 s
start: {q: [0.5, 0.9]}
blocks:
  goal:     {type: setpoint, x_d: [0.5, 0.4]}
  task:     {type: sampled_tracking, Lambda: 3}
  inverse:  {type: sampled_inverse, servo: pi, w_0: 0.02, estimator: least_squares, supervised: true, aggregated: true}
  mix:      {type: expert_aggregation}
  servo:    {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:      {type: manipulator}
wires:
  mix.dq_model: inverse.dq_c
  mix.q_model: inverse.q_start
  task.q_start: mix.q_start
  servo.dq_c: mix.dq_sent
"""
EXAMPLES["gripper"] = EXAMPLES["reset_compensator"]
EXAMPLES["path_pace"] = EXAMPLES["setpoint"] + "  pace:     {type: path_pace}\n"

# no proof in continuous time includes channel models between controller and robot
UNPROVED = {
    "kinematic_command",
    "velocity_probe",
    "delay_probe",
    "sampled_supervisor",
    "sampled_tracking",
    "sampled_joint_tracking",
    "disturbance_observer",
    "extended_state_observer",
    "path_pace",
    *(name for name, kind in BLOCKS.items() if any(port.instead_of for port in kind.outputs)),
} - {"joint_stops"}  # which may only print


def types_in(file: Path) -> set[str]:
    return set(re.findall(r"type: (\w+)", file.read_text()))


def test_the_catalogue_is_not_empty() -> None:
    assert len(BLOCKS) >= 15
    assert len(GRAPHS) >= 7


@pytest.mark.parametrize("name", BLOCKS)
def test_a_block_is_one_final_frozen_class_in_a_file_of_its_name(name: str) -> None:
    kind = BLOCKS[name]
    assert type_name(kind) == name
    assert Path(inspect.getfile(kind)).stem == name
    assert getattr(kind, "__final__", False)
    assert kind.model_config.get("frozen") is True
    assert kind.model_config.get("extra") == "forbid"
    assert "__init__" not in vars(kind)
    module = inspect.getmodule(kind)
    here = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == kind.__module__]
    assert here == [kind]


@pytest.mark.parametrize("name", BLOCKS)
def test_a_blocks_page_has_its_parameters_and_source(name: str) -> None:
    kind = BLOCKS[name]
    page = inspect.getdoc(kind) or ""
    parameters = page.partition("Parameters\n----------\n")[2].partition("\n\n")[0]
    for field in kind.model_fields:
        assert about(kind).parameters.get(field), f"{field} is not documented"
    assert parameters.startswith("None") == (not kind.model_fields)
    assert "References\n----------\n" in page or kind.side is Side.SOURCE, f"{name} has no References"


@pytest.mark.parametrize("name", BLOCKS)
def test_a_blocks_equations_are_numbered_as_its_methods_cite_them(name: str) -> None:
    kind = BLOCKS[name]
    known = set(re.findall(r"\\tag\{(\d+)\}", inspect.getdoc(kind) or ""))
    laws = [getattr(kind, name) for name in ("direction", "error", "fits") if hasattr(kind, name)]
    for method in (kind.equations, kind.certificate, kind.conditions, *laws):
        cited = set(re.findall(r"\((\d+)\)", method.__doc__ or ""))
        assert cited <= known, f"{method.__name__} cites {cited - known}"
    assert not known or "(1)" in (kind.equations.__doc__ or "")


@pytest.mark.parametrize("name", BLOCKS)
def test_a_blocks_ports_have_shapes_and_units_and_keep_to_their_side(name: str) -> None:
    kind = BLOCKS[name]
    assert kind.contract(name) == []
    for item in (*kind.inputs, *kind.outputs, *kind.states, *kind.truth):
        assert isinstance(item, Signal | State)
        assert {word for word in item.shape.split() if not word.isdigit()} <= LETTERS
        compatible(item.unit, "")
    for port in kind.outputs:
        allowed = (
            {Access.MEASURED, Access.HIDDEN, Access.INTERNAL}
            if kind.side is Side.PLANT
            else {
                Access.INTERNAL,
                Access.COMMANDED,
            }
        )
        assert port.access in allowed
    for spec in specs(kind).values():
        compatible(spec.unit, "")


@pytest.mark.parametrize("name", BLOCKS)
def test_a_certificate_is_stated_by_all_but_sources_and_those_that_are_not_proved(name: str) -> None:
    kind: type[AbstractBlock] = BLOCKS[name]
    states_one = kind.certificate is not AbstractBlock.certificate
    assert states_one == (kind.side is not Side.SOURCE and name not in UNPROVED)


@pytest.mark.parametrize("name", BLOCKS)
def test_a_block_runs_in_a_packaged_graph_or_an_example(name: str, tmp_path: Path) -> None:
    if any(name in types_in(path) for path in graphs().values()):
        return
    file = tmp_path / "example.yaml"
    file.write_text(EXAMPLES[name])
    assert name in types_in(file)
    graph = Graph.read(file)
    run = simulate(graph.diagram, graph.file.duration, clock=graph.file.clock, start=graph.start)
    assert run.divergence is None
    assert np.linalg.norm(run["arm.x"][-1] - [0.5, 0.4]) < np.linalg.norm(run["arm.x"][0] - [0.5, 0.4])


@pytest.mark.parametrize("name", GRAPHS)
def test_a_packaged_graph_builds_and_stays_finite(name: str) -> None:
    graph = Graph.read(name)
    run = simulate(graph.diagram, 2.0, clock=graph.file.clock, solver=graph.solver, start=graph.start)
    assert graph.file.title
    assert run.divergence is None
    assert run.time[-1] == pytest.approx(2.0, abs=0.1)
    assert all(np.all(np.isfinite(rows)) for rows in (*run.states.values(), *run.outputs.values()))
    assert np.ptp(run["arm.q"], axis=0).max() > 1e-3  # a signal changes
