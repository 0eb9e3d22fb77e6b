"""Units of the packaged blocks: consistent in every packaged graph, and a wrong exponent of a parameter is detected."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import pytest
import yaml

import dmframe as dm
from dmframe.block import AbstractBlock
from dmframe.block.model import model_block
from dmframe.block.parameter import PAIRS, Spec, specs
from dmframe.block.port import ANY
from dmframe.block.sizes import bind_sizes, parameter_arrays
from dmframe.catalogue import block_types, graphs
from dmframe.common.errors import DmframeError, raise_all
from dmframe.diagram import Diagram
from dmframe.dimensions import check as check_module
from dmframe.dimensions.check import Check, declaration_faults, element_units
from dmframe.dimensions.dimension import BASES, ONE

CHEAP: Final = ("pendulum", "arm2_joint", "slotine_li", "computed_torque", "torque_direct_pi", "torque_direct_pid")
PREFERRED: Final = ("known_tracking_composite_pi",)
"""Graphs that contain a block with more of its options."""


RADIANS: Final[Mapping[str, str]] = {
    "adaptive_camera": "Gamma_c leak error_leak",
    "adaptive_kinematics": "start_error leak error_leak dead_zone R forgetting",
    "admittance": "M_a",
    "circle": "radius",
    "command_gain": "gain",
    "consistent_adaptation": "c",
    "consistent_compensator": "c",
    "direct_adaptation": "leak error_leak",
    "dynamic_compensator": "leak error_leak",
    "delay_probe": "probe threshold confidence seed trip",
    "disturbance_observer": "alpha beta",
    "elastic_joints": "inertia",
    "epicycles": "radius rate stop pause",
    "encoder": "step noise window time_constant",
    "filtered_adaptation": "leak error_leak",
    "filtered_regressor": "bandwidth weight Gamma_b",
    "expert_aggregation": "rate memory weight_gain quiet roughness Gamma nu u_max a_max doubt lag_time trial",
    "force_sensor": "noise",
    "image_regulation": "alpha",
    "indirect_adaptation": "leak error_leak",
    "inverse_dynamics": "off",
    "gripper": "mass center inertia",
    "loaded_manipulator": "payload payload_at viscous coulomb rotor K maker_gravity maker_viscous",
    "joint_waypoints": "times q_d dq_d ddq_d",
    "manipulator": "viscous coulomb rotor K maker_gravity maker_viscous",
    "measurement_delay": "share",
    "model_compensation": "share off smoothing",
    "p_pi_inverse": "Lambda_f",
    "p_pi_servo": "feed_forward",
    "path_pace": "u_max share",
    "payload": "mass center inertia",
    "payload_estimate": "least",
    "regressor": "nominal",
    "repetitive_inverse": "rate Gamma nu u_max",
    "reset_compensator": "clearing leak error_leak",
    "sampled_inverse": "tau nu w_0 k_P k_P_size offset_size k_P_box offset_box u_max margin retention k_u_size "
    "k_q_size k_u_box k_q_box settling",
    "sampled_joint_tracking": "gain_margin",
    "sampled_supervisor": "hysteresis trip",
    "sampled_tracking": "gamma Lambda damping gain_margin braking",
    "sinusoid": "amplitude",
    "spiral": "radius lean",
    "stribeck_friction": "sticking uneven per_torque",
    "tool_orientation": "lever",
    "transport_delay": "share late lost",
    "turning": "amplitude",
    "velocity_probe": "seed",
    "wall": "point stiffness damping",
}
"""Parameters with an undetermined power of rad, by the one rule: after a sine, added to a mass or a plain number, in
expressions of the robot's functions of a pose."""

NEVER: Final[Mapping[str, str]] = {
    "consistent_adaptation": "floor",  # used by the projection only
    "consistent_compensator": "floor",
    "wall": "normal",  # normalised to length 1
    "waypoints": "orientations",  # of a tool with three angles, which no graph of this block has
}
"""Parameters that no equation of the packaged graphs compares with another unit."""


@pytest.mark.parametrize("graph", sorted(graphs()))
def test_units_agree_in_every_packaged_graph(graph: str) -> None:
    assert dm.load(graph).diagram.unit_faults == []


TOGETHER: Final[Mapping[str, Sequence[Mapping[str, Any]]]] = {
    "adaptive_kinematics": [{"R": 0.5, "forgetting": 0.5}],
    "expert_aggregation": [{"weighting": "projection"}],
    "gripper": [
        {
            "at": (1.0, 2.0),
            "mass": (1.0, 2.0),
            "center": ((0.1, 0.1, 0.1), (0.1, 0.1, 0.1)),
            "inertia": ((0.1, 0.0, 0.1, 0.0, 0.0, 0.1), (0.1, 0.0, 0.1, 0.0, 0.0, 0.1)),
        }
    ],
    "joint_waypoints": [
        {
            "times": (0.0, 1.0, 2.0),
            "q_d": ((0.1, 0.1), (0.2, 0.2), (0.3, 0.3)),
            "dq_d": ((0.0, 0.0), (0.1, 0.1), (0.0, 0.0)),
            "ddq_d": ((0.0, 0.0), (0.1, 0.1), (0.0, 0.0)),
        }
    ],
    "loaded_manipulator": [{"payload": (1.0, 2.0), "payload_at": (0.0, 1.0)}],
    "payload": [
        {
            "mass": (1.0, 2.0),
            "at": (1.0, 2.0),
            "center": ((0.1, 0.1, 0.1), (0.1, 0.1, 0.1)),
            "inertia": ((0.1, 0.0, 0.1, 0.0, 0.0, 0.1), (0.1, 0.0, 0.1, 0.0, 0.0, 0.1)),
        }
    ],
    "sampled_joint_tracking": [{"Lambda": 0.5}, {"gain_margin": 1.5}],
    "sampled_tracking": [
        {"gamma": None, "Lambda": 0.5, "gain_margin": None},
        {"gamma": 0.5, "Lambda": None, "gain_margin": None, "braking": None},
    ],
    "setpoint": [{"x_d": None, "q_d": (0.5, 0.5, 0.5)}],
    "waypoints": [
        {
            "times": (0.0, 1.0, 2.0),
            "q_d": ((0.1,), (0.2,), (0.3,)),
            "dq_d": ((0.0,), (0.1,), (0.0,)),
            "ddq_d": ((0.0,), (0.1,), (0.0,)),
        },
        {
            "times": (0.0, 1.0, 2.0),
            "q_d": None,
            "x_d": ((0.1,), (0.2,), (0.3,)),
            "dx_d": ((0.0,), (0.1,), (0.0,)),
            "ddx_d": ((0.0,), (0.1,), (0.0,)),
        },
    ],
}
"""Options that apply together with others only."""


@functools.cache
def holders() -> dict[str, tuple[str, str]]:
    """For each type of block the first packaged graph that contains it, fast ones first, and its name there."""
    found = dict[str, tuple[str, str]]()
    order = sorted(
        graphs(), key=lambda name: (name not in PREFERRED, name not in CHEAP, not name.startswith("torque"), name)
    )
    for graph in order:
        blocks = yaml.safe_load(graphs()[graph].read_text(encoding="utf-8"))["blocks"]
        for name, reported in blocks.items():
            found.setdefault(reported["type"], (graph, name))
    return found


@functools.cache
def built(graph: str) -> Diagram:
    return dm.load(graph).diagram


def of_one(spec: Spec, size: Any) -> Any:
    """A value of this shape."""
    if spec.form in PAIRS:
        return (0.5, 1.5)
    if spec.form == "table":
        return ((1.0,) * size(spec.shape.split()[1]), (2.0,) * size(spec.shape.split()[1]))
    if spec.form == "vector":
        return tuple(1.0 + k for k in range(2 if spec.shape == "*" else size(spec.shape)))
    return 0.5


def variants(kind: str) -> Iterator[Check]:
    """The block as in a graph, and with each option that the graph omits; with all options if it is in no graph."""
    block_type = block_types()[kind]
    graph, name = holders().get(kind, ("arm2_joint", ""))
    diagram = built(graph)

    def size(letter: str) -> int:
        return int(letter) if letter.isdigit() else diagram.sizes.bound[letter][0]

    if name:
        yield check_of(kind, diagram.blocks[name], diagram)
    for choice in choices(kind, diagram.blocks[name].model_dump() if name else None, size):
        try:
            yield check_of(kind, block_type(**choice), diagram)
        except (DmframeError, ValueError):
            continue


def choices(kind: str, own: Mapping[str, Any] | None, size: Any) -> list[dict[str, Any]]:
    """Parameters of a block besides its own in a graph, if there is one; a block may refuse some of them."""
    values = {key: of_one(spec, size) for key, spec in specs(block_types()[kind]).items()}
    if own is None:
        return [values, *map(dict, TOGETHER.get(kind, ()))]
    reported = {key: value for key, value in own.items() if value is not None}
    given = [{**reported, key: value} for key, value in values.items() if key not in reported]
    return given + [{**reported, **more} for more in TOGETHER.get(kind, ())]


def check_of(kind: str, block: AbstractBlock, diagram: Diagram) -> Check:
    blocks = {**{name: other for name, other in diagram.blocks.items() if type(other) is not type(block)}, kind: block}
    sizes, faults = bind_sizes(blocks, diagram.robot)
    numbers, wrong = parameter_arrays(kind, block, sizes, blocks, diagram.robot)
    raise_all([*faults, *wrong])
    robot = next((model.robot for model in diagram.models.values() if model.robot is not None), None)
    model = model_block(kind, block, numbers, sizes, robot)
    return Check.of(model, sizes, element_units({**diagram.models, kind: model}, diagram.robot))


def inferred(block: type[AbstractBlock], name: str, spec: Spec) -> bool:
    """Parameters whose unit is inferred: several units, a gain without a unit, elements without one."""
    gains = {item.gain for item in block.estimates}
    if getattr(block, "driven_by", "") in {port.name for port in block.inputs if port.unit == ANY}:
        gains |= {"error_leak", "dead_zone"}
    mixed = any(word not in ("n", "m") for word in spec.shape.split())
    return spec.several or (not spec.unit and (name in gains or mixed))


def compared_by_name(block: type[AbstractBlock]) -> set[str]:
    """Initial values, boxes and balls of states."""
    return {name for state in block.states for name in (state.name, state.box, state.ball)} & specs(block).keys()


def checked(kind: str) -> dict[str, Spec]:
    """The parameters with a declared unit that equations compare."""
    block = block_types()[kind]
    by_name = compared_by_name(block)
    return {
        name: spec for name, spec in specs(block).items() if not inferred(block, name, spec) and name not in by_name
    }


def missed(kind: str) -> dict[str, set[str]]:
    """The base units of each parameter whose power can be one larger without a contradiction."""
    left = {name: {"g", "m", "s", "rad"} for name in checked(kind)}
    for check in variants(kind):
        assert check.fault() is None
        for name in left.keys() & set(check.parameters):
            for base in sorted(left[name]):
                more = check.times(ONE._replace(powers=tuple(int(base == other) for other in BASES)))
                if check.disagreement(name, more) is not None:
                    left[name].remove(base)
    return {name: bases for name, bases in left.items() if bases}


@pytest.mark.parametrize("kind", sorted(block_types()))
def test_a_wrong_exponent_of_any_parameter_is_found(kind: str) -> None:
    radians = {name: {"rad"} for name in RADIANS.get(kind, "").split()}
    assert missed(kind) == {**radians, **{name: {"g", "m", "s", "rad"} for name in NEVER.get(kind, "").split()}}


def untabled(kind: str, own: Mapping[str, Any] | None) -> set[str]:
    """Parameters that no variant has, or that have no unit, of which rad is never found, and are not in the tables."""
    block, found = block_types()[kind], set[str]()
    for choice in [*([] if own is None else [own]), *choices(kind, own, lambda x: int(x) if x.isdigit() else 2)]:
        try:
            made = block(**choice)
        except (DmframeError, ValueError):
            continue
        found |= {name for name in checked(kind) if getattr(made, name) is not None}
    without = {name for name, spec in checked(kind).items() if not spec.unit} - {*RADIANS.get(kind, "").split()}
    return (checked(kind).keys() - found | without) - {*NEVER.get(kind, "").split()}


def stated(kind: str) -> dict[str, Any] | None:
    """The parameters of a block as the file of its graph states them; None if it is in no graph."""
    graph, name = holders().get(kind, ("", ""))
    if not graph:
        return None
    own = yaml.safe_load(graphs()[graph].read_text(encoding="utf-8"))["blocks"][name]
    return {key: value for key, value in own.items() if key != "type"}


def test_the_tables_hold_every_block() -> None:
    """Without a diagram, so that `make test` finds a new block or option without its entry."""
    assert {kind: missing for kind in block_types() if (missing := untabled(kind, stated(kind)))} == {}
    for kind, names in (*RADIANS.items(), *NEVER.items()):
        assert {*names.split()} <= checked(kind).keys(), kind


@pytest.mark.parametrize(
    ("table", "kind", "missing"),
    [("RADIANS", "command_gain", {"gain"}), ("TOGETHER", "joint_waypoints", {"times", "q_d", "dq_d", "ddq_d"})],
)
def test_a_block_without_its_entry_is_found(
    table: str, kind: str, missing: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(globals()[table], kind)
    assert untabled(kind, stated(kind)) == missing


@pytest.mark.parametrize("kind", sorted(block_types()))
def test_a_start_and_a_box_have_the_unit_of_their_state(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    block = block_types()[kind]
    assert list(declaration_faults(block)) == []
    for name in compared_by_name(block):
        own = specs(block)
        other = {**own, name: replace(own[name], unit=f"A {own[name].unit}")}
        monkeypatch.setattr(check_module, "specs", lambda _, other=other: other)
        (text,) = declaration_faults(block)
        assert text.startswith(f"expected {name}, the ")
        monkeypatch.undo()
