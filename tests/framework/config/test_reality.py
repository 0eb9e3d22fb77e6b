"""The key ``reality``: the blocks that it adds and omits, and its faults."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.catalogue import find_reality, realities
from dmframe.cli.graphs import graphs_of
from dmframe.common.errors import DmframeError
from dmframe.config.document import read_file
from dmframe.config.given import node_of
from dmframe.config.reality import SET
from dmframe.graph.graph import Graph
from dmframe.study.grid import Given, changed

pytestmark = pytest.mark.usefixtures("without_v")

TEXT = """\
dmframe: 1
robot: arm2
clock: 4 ms
duration: 0.2 s
start: {q: [0.7, 1.1]}
blocks:
  path:    {type: sinusoid, center: [0.8, 1.0], amplitude: [0.5, 0.6], rate: [2.0, 3.0]}
  task:    {type: joint_tracking, alpha_bar: 4}
  command: {type: kinematic_command}
  servo:   {type: pi_servo, K_P: [60, 30], K_I: [240, 120]}
  arm:     {type: manipulator, viscous: [1, 0.5]}
"""
UR = ("transport_delay", "command_limits", "command_ramp", "torque_limits", "joint_stops", "encoder")


def added(graph: dm.Graph) -> dict[str, Any]:
    """The blocks between controller and robot."""
    held = graph.blocks
    return {name: held[name] for name in held if any(port.instead_of or port.notice for port in held[name].outputs)}


def test_a_set_puts_its_blocks_into_a_graph_and_the_graph_that_is_saved_runs_again_alike(tmp_path: Path) -> None:
    real = dm.load(TEXT).reality("ur")
    assert tuple(added(real)) == UR
    assert "reality" not in real.text
    again = dm.load(real.save(tmp_path / "again.yaml"))
    assert again.text == real.text
    one, two = (graph.run().recording for graph in (real, again))
    assert all(np.array_equal(one[label], two[label]) for label in ("arm.q", "encoder.q_m"))
    assert real == dm.load(f"{TEXT}reality: ur\n") == dm.load(TEXT).set(reality={"like": "ur"})


def test_the_set_of_ur_states_what_its_page_states() -> None:
    real = dm.load(TEXT).reality()
    assert real.blocks["encoder"].step == pytest.approx(2 * np.pi / 2**17, rel=1e-4)
    assert real.blocks["transport_delay"].samples == 1
    page = (Path(__file__).parents[3] / "docs/how_to/reality.md").read_text(encoding="utf-8")
    for name, block in read_file(find_reality("ur"), SET).data["blocks"].items():  # type: ignore[union-attr]
        assert f"`{name}`" in page
        assert all(str(value) in page for value in block.values()), name
    assert list(realities()) == ["ur"]


def test_none_is_the_graph_itself_and_both_can_be_requested_together() -> None:
    plain = dm.load(TEXT)
    assert plain.reality("none") == plain == dm.load(f"{TEXT}reality: none\n")
    both = graphs_of(["ur10_slow"], ["reality=none,ur"])
    assert [len(added(graph)) for graph in both] == [0, len(UR)]


@pytest.mark.parametrize(
    ("name", "carries", "left_out"),
    [
        ("ur10_fast_kinematic", "velocity", []),
        ("ur10_fast_position", "position", []),
        ("slotine_li", "torque", ["command_limits", "command_ramp"]),
        ("torque_direct_pid", "velocity", []),
        ("gravity_compensated_servo", "velocity", []),
    ],
)
def test_any_graph_can_be_had_so(
    name: str, carries: str, left_out: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    real = dm.load(name).set(clock="8 ms").reality("ur")
    assert tuple(added(real)) == tuple(kind for kind in UR if kind not in left_out)
    assert real.blocks["transport_delay"].carries == carries
    run = real.run(until=0.1, engine="interpreted")
    assert run.divergence is None
    assert "through transport_delay" in run.notices[0]
    text = capsys.readouterr().err
    why = "no block outputs dq_c"
    assert [kind for kind in UR if f"reality {kind} is left out: {why}" in text] == left_out


def test_a_baseline_goes_the_same_way() -> None:
    text = TEXT + "baseline:\n  task: {type: joint_tracking, alpha_bar: 1}\nreality: ur\n"
    assert tuple(added(dm.load(text).baseline())) == UR


def test_a_set_can_be_changed_in_the_file_and_from_outside() -> None:
    text = f"{TEXT}reality: {{like: ur, encoder: {{step: 1e-4}}, command_ramp: null, measurement_delay: {{}}}}\n"
    graph = dm.load(text)
    assert tuple(added(graph)) == (*(name for name in UR if name != "command_ramp"), "measurement_delay")
    encoder: Any = graph.blocks["encoder"]
    assert (encoder.step, encoder.window) == (1e-4, 0.008)
    outside = Graph.read("ur10_slow", ["encoder.step=2e-4", "reality=ur", "reality.transport_delay.samples=3"])
    assert outside.blocks["encoder"].step == 2e-4
    assert outside.blocks["transport_delay"].samples == 3
    inside = dm.load(TEXT).set({"encoder.window": "2 ms", "reality": "ur"})
    assert inside.blocks["encoder"].window == 0.002
    assert inside.set({"encoder.window": "4 ms"}).blocks["encoder"].window == 0.004


def test_a_load_takes_the_place_of_the_arm_and_keeps_its_friction() -> None:
    real = dm.load(TEXT).reality({"loaded_manipulator": {"payload": [2], "payload_at": ["0.1 s"]}})
    arm: Any = real.blocks["arm"]
    assert (arm.payload, arm.payload_at, arm.viscous) == ((2.0,), (0.1,), (1.0, 0.5))
    run = real.run()
    assert np.array_equal(np.unique(run.recording["arm.load"]), [0, 2])
    assert not np.allclose(run.recording["arm.q"][-1], dm.load(TEXT).run().recording["arm.q"][-1], atol=1e-3)


def test_what_the_graph_has_stays_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    more = "  wheel:   {type: encoder, step: 0.01}\n  joint_stops: {type: torque_limits}\n"
    own = TEXT.replace("  arm: ", f"{more}  arm: ")
    graph = dm.load(own).reality("ur")
    assert graph.blocks["wheel"].step == 0.01
    names = {name: type(block).__name__ for name, block in added(graph).items()}
    assert (names["joint_stops"], names["joint_stops_2"]) == ("TorqueLimits", "JointStops")
    text = capsys.readouterr().err
    assert "notice: reality encoder is left out: the graph has it, wheel" in text
    assert "notice: reality torque_limits is left out: the graph has it, joint_stops" in text
    assert graph.reality("ur") == graph


def test_earlier_channels_are_removed_when_others_are_requested(capsys: pytest.CaptureFixture[str]) -> None:
    plain, filed = dm.load(TEXT), dm.load(f"{TEXT}reality: {{like: ur, command_ramp: null}}\n")
    for graph in (plain.reality(), filed, pickle.loads(pickle.dumps(filed)), plain.reality().reality("ur")):
        assert not added(graph.reality("none"))
        assert not added(graph.set(clock="8 ms").until(1).reality("none"))
        assert graph.set(clock="8 ms").until(1).reality("none").duration == 1
        assert tuple(added(graph.reality({"encoder": {"step": 0.01}}))) == ("encoder",)
    late = filed.set({"reality.transport_delay.samples": 3, "encoder.step": 0.5})
    assert tuple(added(late)) == tuple(name for name in UR if name != "command_ramp")
    assert late.blocks["transport_delay"].samples == 3
    assert late.set(reality="ur").blocks["encoder"].step == 0.5
    assert not capsys.readouterr().err
    with pytest.raises(DmframeError, match=r"encoder\.step.*unknown block"):
        late.reality("none")


def test_a_study_requests_it_again_too(capsys: pytest.CaptureFixture[str]) -> None:
    filed = dm.load(f"{TEXT}reality: {{like: ur, command_ramp: null}}\n")
    sets = {
        "none": [("reality", "none")],
        "ur": [("encoder.step", 0.5), ("reality", "ur")],
    }
    made = {}
    for name, values in sets.items():
        givens = [Given(label, node_of(value, (label,), name), name) for label, value in values]
        made[name] = changed(filed, givens)
    assert [tuple(added(graph)) for graph in made.values()] == [(), UR]
    assert made["ur"].blocks["encoder"].step == 0.5
    assert not capsys.readouterr().err


def test_none_reports_blocks_that_the_graph_has_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    dm.load(TEXT.replace("  arm: ", "  wheel:   {type: encoder, step: 0.01}\n  arm: ")).reality("none")
    assert "notice: reality none leaves the graph's own blocks in: wheel" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("section", "text"),
    [
        ("reality: urr", "graph:12:10: reality urr: unknown set; did you mean ur?"),
        ("reality: 3", "graph:12:10: reality: expected the name of a set such as ur, or block types with their"),
        ("reality: {like: [ur]}", "graph:12:17: reality.like: expected the name of a set such as ur"),
        ("reality: {encodr: {}}", "graph:12:11: reality.encodr: unknown block type; did you mean encoder?"),
        (
            "reality: {encoder: null}",
            "graph:12:20: reality.encoder: null leaves out what a set has, and",
        ),
        ("reality: {encoder: 3}", "graph:12:20: reality.encoder: expected its parameters, {samples: 1}, or null"),
        (
            "reality: {circle: {}}",
            "graph:12:19: reality.circle: expected a block of the plant, found one of the source",
        ),
        (
            "reality: {encoder: {type: transport_delay}}",
            "graph:12:27: reality.encoder.type: the key encoder is",
        ),
        ("reality: {like: ur, encoder: {type: circle, step: 1}}", "reality.encoder.type: the key encoder is the type"),
        ("reality: {mine.py:Mine: {}}", "reality.mine.py:Mine: a block from a file of yours belongs under blocks"),
        (
            "reality: {encoder: {stp: 1, step: 1}}",
            "graph:12:21: blocks.encoder.stp: unknown parameter of encoder; did you",
        ),
        ("reality: {encoder: {step: -1}}", "graph:12:27: blocks.encoder.step: expected a number > 0, found -1"),
        ("reality: {like: ur, transport_delay: {samples: 9}}", "graph:12:48: blocks.transport_delay.samples: expected"),
    ],
)
def test_a_fault_is_reported_with_its_place(section: str, text: str) -> None:
    with pytest.raises(DmframeError) as caught:
        dm.load(f"{TEXT}{section}\n")
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("{encoder: {step: .nan}}", "}}: encoder.step: expected a finite number, found .nan"),
        ("{like: ur, like: none}", "}: like appears twice; keep one of them"),
    ],
)
def test_a_fault_inside_a_value_names_what_was_written(text: str, end: str) -> None:
    with pytest.raises(DmframeError) as caught:
        Graph.read("arm2_joint", [f"reality={text}"])
    assert str(caught.value).endswith(end)


def test_a_block_that_fits_nowhere_is_refused() -> None:
    with pytest.raises(DmframeError, match="expected a channel model between controller and robot, or a"):
        dm.load(f"{TEXT}reality: {{accelerometer: {{}}}}\n")


def test_data_states_it_as_a_file_does() -> None:
    data: Mapping[str, Any] = {**Graph.read("arm2_joint").data, "reality": "ur"}
    assert tuple(added(dm.load(data))) == UR
