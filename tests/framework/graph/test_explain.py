"""The text of `Graph.explain` is true: each kind of sentence is tested with a graph for which it would be false."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

import dmframe as dm
from dmframe.certify import Verdict
from dmframe.certify.claim import claim_of
from dmframe.common.text import Text
from dmframe.diagram import Diagram
from dmframe.report.exchange import exchange_of
from dmframe.report.explanation import Explanation
from dmframe.report.flow import order

BLOCK = """
from dmframe.block import AbstractBlock, Equations
from dmframe.block.port import Access, Input, Output


class Plain(AbstractBlock):
    {doc}
    inputs = (Input("dq_r", "n", "rad/s"),)
    outputs = (Output("dq_c", "n", "rad/s", Access.COMMANDED),)

    def equations(self, u, x, p):
        return Equations(outputs={{"dq_c": u.dq_r}})
"""


PROVED = ("pendulum", "ur10_fast", "ur10_slow_kinematic")
"""Graphs whose verdicts these tests use; for others, only the claim is needed."""


@cache
def explained(name: str) -> Explanation:
    graph = dm.load(name)
    if name in PROVED:
        return graph.explain()
    return Explanation(graph, Verdict("not_applicable", Text(), claim_of(graph.diagram)))


def reported(name: str, block: str = "") -> str:
    """The section of a block, or the last one, of one graph, in one line."""
    sections = explained(name).sections
    (found,) = [section for section in sections if f" {block} (" in section.heading] if block else sections[-1:]
    return " ".join([found.heading, *(item.text for item in found.sentences)])


@pytest.mark.parametrize("name", ["ur10_fast", "torque_direct_pi", "theorem_3", "ur10_fast_position"])
def test_a_block_follows_those_whose_outputs_its_own_need(name: str) -> None:
    diagram = dm.load(name).diagram
    places = {block: place for place, block in enumerate(order(diagram))}
    sides = [diagram.blocks[block].side.value for block in order(diagram)]
    assert sides == sorted(sides, key=["source", "controller", "plant"].index)
    assert places["path"] == 0
    assert places["task"] < places["inverse"] < places["servo"] < places["arm"]
    assert "dynamics" not in places or places["model"] < places["dynamics"] < places["inverse"]
    assert "torque" not in places or places["command"] < places["torque"] < places["inverse"]


def test_the_order_is_that_of_the_signals_and_not_that_of_the_file() -> None:
    experiment = dm.load("pendulum")
    backwards = dict(reversed(list(experiment.blocks.items())))
    assert next(iter(backwards)) == "arm"
    found = order(Diagram.build(backwards, robot=experiment.robot))
    assert found == ["path", "task", "model", "dynamics", "inverse", "servo", "arm"]


def test_signals_are_listed_with_unit_origin_and_reader() -> None:
    inverse = reported("ur10_fast", "inverse")
    assert "q_c [rad], measured at servo; q̇_r [rad/s] from task; and τ_dc [N m] from dynamics." in inverse
    assert "Outputs: q̇_c [rad/s] to servo, q̇_ref [rad/s] to model and σ [rad/s] to dynamics." in inverse
    assert "ẋ_d [m/s], the time derivative of x_d" in reported("ur10_fast", "task")
    assert "q̇_c [rad/s], commanded by inverse" in reported("ur10_fast", "servo")
    model = reported("torque_direct_pi", "model")
    assert "q̇ [rad/s] as q̇_ref, measured at arm; and q̈_m [rad/s^2] as q̈_ref, measured at sensor" in model
    assert "ε [rad^2/(N m s^3)] from adaptation" in reported("torque_direct_pi", "inverse")  # its port accepts any unit


def test_unconnected_inputs_and_unread_outputs_depend_on_the_graph() -> None:
    assert "Unconnected, so zero: q̇_null." in reported("ur10_fast", "task")
    assert "Unconnected, so zero: τ_task, τ_known, a_d,nominal, Y_f and e_f." in reported("ur10_fast", "dynamics")
    assert "Unconnected" not in reported("torque_direct_pi", "adaptation")  # it takes a_d_nominal from its model
    assert "No block reads w or w_I." in reported("theorem_3", "inverse")
    assert "No block reads" not in reported("torque_indirect_filtered_pi", "inverse")


def test_roles_follow_from_what_a_block_does_in_its_graph() -> None:
    roles = {block.name: block.roles for name in ("ur10_fast", "theorem_3") for block in explained(name).blocks}
    assert roles["path"] == ("source",)
    assert roles["task"] == ("controller",)
    assert roles["observer"] == ("controller", "has a memory")
    assert roles["dynamics"] == ("controller", "adapts")
    assert roles["inverse"] == ("controller", "adapts", "commands the plant")
    assert (roles["servo"], roles["arm"]) == (("plant", "takes the commands"), ("plant", "the robot"))
    kinematic = {block.name: block.roles for block in explained("ur10_slow_kinematic").blocks}
    assert kinematic["inverse"] == ("controller", "commands the plant")


def test_estimates_have_true_and_initial_values_of_the_graph() -> None:
    assert "It estimates K_P/K_D by w_P [1/s], initially 2; true value 2.2." in reported("ur10_fast", "inverse")
    changed = dm.load("pendulum").set({"servo.K_P": 50, "inverse.w_P": 7}).explain()
    text = str(changed)
    assert "It estimates K_P/K_D by w_P [1/s], initially 7; true value 2.5." in " ".join(text.split())
    assert "the true value depends on signals" in reported("torque_direct_pi", "adaptation")  # on servo.i


def test_required_robot_parameters_are_listed_at_the_block_that_uses_them() -> None:
    known = "Its equations contain the link lengths, the joint axes and the tool offset of the true robot"
    assert known in reported("ur10_fast", "geometry")
    assert "Its equations contain the joint axes of the true robot" in reported("theorem_3", "geometry")
    assert "Its equations contain" not in reported("ur10_fast", "task")


def test_storage_dissipation_supply_rate_and_cross_term_are_those_of_the_block() -> None:
    task = reported("ur10_fast", "task")
    assert "S = ½ |x − x_d|²" in task
    assert "Its cross term in dV/dt is |s|²/γ; the dissipation of inverse must dominate it." in task
    assert "−σᵀ Y_d (â_d − a_d)" in reported("ur10_fast", "dynamics")
    assert "It has no term in V and dV/dt." in reported("ur10_fast", "servo")
    assert "It has no term" not in reported("ur10_fast", "arm")
    robust = dm.load("pendulum").set({"dynamics.leak": 0.1}).explain()
    assert "Residual of the robust adaptation, which may increase dV/dt:" in str(robust)
    assert "robust adaptation" not in str(explained("pendulum"))


def test_what_is_hidden_from_the_controller_is_what_no_wire_may_carry() -> None:
    seen = explained("ur10_fast").sections[-2]
    read, hidden, unknown = (item.text for item in seen.sentences)
    assert read == "Measured and read: q_c [rad] of servo; q [rad], q̇ [rad/s] and x [m] of arm."
    assert "u, i, K_D, K_P and K_I of servo" in hidden
    assert "viscous, coulomb" in hidden
    assert unknown == "No block of the controller contains these robot parameters: the masses and inertias."
    assert explained("theorem_3").sections[-2].sentences[2].text.endswith("the tool offset, the masses and inertias.")
    assert "q̈_m [rad/s^2] of sensor" in explained("torque_direct_pi").sections[-2].sentences[0].text


def test_unread_measurements_are_listed_separately() -> None:
    read, unread = (item.text for item in explained("pendulum").sections[-2].sentences[:2])
    assert read == "Measured and read: q_c [rad] of servo; q [rad] and q̇ [rad/s] of arm."
    assert unread == "Measured, but read by no block of the controller: x [m] of arm."


def test_the_command_of_a_graph_without_a_file_names_the_file_to_write(tmp_path: Path) -> None:
    text = dm.load("ur10_slow_kinematic").text
    reported = " ".join(str(dm.load(text, name="mine").explain()).split())
    assert "Verdict: not applicable (dmframe verify mine.yaml, with the graph's text in mine.yaml)." in reported
    (tmp_path / "mine").write_text(text)
    found = str(dm.load(tmp_path / "mine").explain())
    wanted = f"Verdict: not applicable (dmframe verify {tmp_path / 'mine'})."
    assert "".join(wanted.split()) in "".join(found.split())  # lines may break at a hyphen of the path


def test_supplies_cancel_in_the_groups_in_which_they_do() -> None:
    text = reported("theorem_3")
    assert "The supply rates of dynamics, inverse and arm sum to zero" in text
    assert "The supply rates of geometry, observer and task sum to zero" in text
    assert "The supply rates of geometry, filter, task, dynamics, inverse and arm sum to zero" in reported("theorem_1")


def test_a_supply_rate_that_is_zero_by_itself_is_listed() -> None:
    assert "The supply rate of task is zero." in reported("computed_torque")
    assert " is zero." not in reported("ur10_fast")
    inverse = " ".join(reported("computed_torque", "torque").split())
    assert "gravity and the masses and inertias of the true robot" in inverse


def test_the_robot_and_the_clock_are_the_graphs_own() -> None:
    whole = [
        " ".join(item.text for item in explained(name).sections[0].sentences) for name in ("pendulum", "ur10_fast")
    ]
    assert "The robot is pendulum; 1 joint moves: joint1." in whole[0]
    assert "The controller runs in continuous time." in whole[0]
    assert "3 joints move: shoulder_pan_joint, shoulder_lift_joint and elbow_joint." in whole[1]
    assert "The controller runs every 8 ms." in whole[1]
    assert "the controller reads measurements of arm and servo" in whole[1]
    kinematic = " ".join(item.text for item in explained("ur10_slow_kinematic").sections[0].sentences)
    assert "the controller reads measurements of arm" in kinematic


def test_a_cross_term_without_a_dominating_block_is_reported(tmp_path: Path) -> None:
    """A tracking loop with a command and an empty certificate, whose dissipation dominates no cross term."""
    certificate = "    def certificate(self, u, x, p, truth):\n        return Certificate()\n"
    source = BLOCK.format(doc='"""Sends on."""')
    (tmp_path / "plain.py").write_text(f"from dmframe.block.certificate import Certificate\n{source}\n{certificate}")
    text = dm.load("ur10_slow_kinematic").text.replace("kinematic_command", "plain.py:Plain")
    (tmp_path / "own.yaml").write_text(text)
    found = dm.load(tmp_path / "own.yaml").explain()
    (task,) = [section for section in found.sections if " task (" in section.heading]
    assert "Its cross term in dV/dt is |s|²/γ; no block dominates it." in [item.text for item in task.sentences]
    assert found.verdict.outcome != "proved"


def test_supply_rates_that_do_not_cancel_are_reported(tmp_path: Path) -> None:
    """A block with a valid certificate whose supply rate is not cancelled: sigma'Y counted twice."""
    path = tmp_path / "twice.py"
    path.write_text(
        "from typing import ClassVar\n"
        "from dmframe.block.certificate import Certificate, Square\n"
        "from dmframe.block import AbstractBlock, Equations\n"
        "from dmframe.block.port import Input, Output, State\n\n\n"
        "class Twice(AbstractBlock):\n"
        '    """Gathers the sliding variable."""\n\n'
        '    inputs = (Input("sigma", "n", "rad/s"),)\n'
        '    states = (State("c", "n", "rad"),)\n\n'
        "    def equations(self, u, x, p):\n"
        '        return Equations(rates={"c": u.sigma})\n\n'
        "    def certificate(self, u, x, p, truth):\n"
        "        return Certificate(storage=(Square(x.c),), supply=x.c.T @ u.sigma)\n"
    )
    graph = dm.load("pendulum")
    text = graph.text.replace("blocks:\n", "blocks:\n  extra: {type: 'twice.py:Twice'}\n", 1)
    (tmp_path / "own.yaml").write_text(text)
    found = dm.load(tmp_path / "own.yaml").explain()
    assert found.verdict.claim is not None
    assert exchange_of(found.verdict.claim).left == ("extra",)
    page = " ".join(str(found).split())
    assert "The supply rates of dynamics, inverse and arm sum to zero" in page
    assert "The supply rate of extra is not cancelled by any other block." in page
    assert "Verdict: refuted (" in page


def test_the_verdict_is_that_of_verify_and_so_are_the_failing_conditions() -> None:
    assert "Verdict: proved (dmframe verify ur10_fast)." in reported("ur10_fast")
    assert "With any κ above 0.003109, the dissipation of inverse dominates the cross term of task." in reported(
        "ur10_fast"
    )
    assert "the effect of sampling every 8 ms is not proved" in reported("ur10_fast")
    assert "the effect of sampling" not in reported("pendulum")
    weak = dm.load("pendulum").set({"inverse.K_c": 0.1}).explain()
    text = " ".join(item.text for item in weak.sections[-1].sentences)
    assert "Verdict: not applicable (dmframe verify pendulum --set inverse.K_c=0.1)." in text
    assert "Conditions that fail: inverse: M̄ ≥ 0" in text
    assert "- geometry (kinematics) uses exact values of the link lengths" in reported("ur10_fast")


def test_a_graph_without_a_certificate_has_no_energy() -> None:
    text = str(explained("ur10_slow_kinematic"))
    assert "It has no certificate, so a graph with it cannot be proved." in text
    assert "dV/dt" not in text
    assert "inverse: a kinematic_command has no certificate" in " ".join(text.split())


@pytest.mark.parametrize(
    ("doc", "does"),
    [
        ("pass", "Its docstring has no summary."),
        ('"""Sends on."""', "Sends on."),
        (r'"""Sends \x1b[31m on."""', r"Sends \x1b[31m on."),
    ],
)
def test_user_blocks_are_described_by_their_ports(tmp_path: Path, doc: str, does: str) -> None:
    (tmp_path / "plain.py").write_text(BLOCK.format(doc=doc))
    graph = dm.load("ur10_slow_kinematic")
    text = graph.text.replace("kinematic_command", "plain.py:Plain")
    (tmp_path / "own.yaml").write_text(text)
    own = {section.heading: section for section in dm.load(tmp_path / "own.yaml").explain().sections}
    (found,) = [section for heading, section in own.items() if " inverse (" in heading]
    assert [item.text for item in found.sentences] == [
        does,
        "Inputs: q̇_r [rad/s] from task.",
        "Outputs: q̇_c [rad/s] to servo.",
        "It has no certificate, so a graph with it cannot be proved.",
    ]


def test_a_page_keeps_to_the_terminal_and_a_unit_to_its_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    lines = str(explained("torque_indirect_filtered_pi")).splitlines()
    assert max(len(line) for line in lines if " = " not in line and "|" not in line) <= 60 + 12  # accents have no width
    assert not [line for line in lines if line.rstrip().endswith(("[N", "[rad/(N", "(N m"))]


def test_the_notebooks_page_states_the_same_and_escapes_it() -> None:
    found = dm.load("pendulum").set(title="a <b> & c").explain()
    html = found._repr_html_()
    assert "<b>pendulum: a &lt;b&gt; &amp; c</b>" in html
    assert all(section.heading.partition(":")[0] in html for section in found.sections)
    assert "<code>S = ½ |q − q_d|²</code>" in html


def test_the_summary_is_plain_data() -> None:
    data = json.loads(json.dumps(explained("ur10_fast").summary))
    blocks = {block["name"]: block for block in data["blocks"]}
    assert data["order"] == list(blocks)
    estimate = {"name": "w_P", "unit": "1/s", "of": "K_P/K_D", "true": [2.2, 2.2, 2.2], "start": [2, 2, 2]}
    assert blocks["inverse"]["estimates"][1] == estimate
    command = {"name": "dq_c", "printed": "q̇_c", "unit": "rad/s", "how": "commanded", "from": "inverse.dq_c"}
    assert command in blocks["servo"]["takes"]
    assert blocks["task"]["consumes"] == "|s|^2/gamma"
    assert (data["verdict"], data["command"]) == ("proved", "dmframe verify ur10_fast")


def test_the_printed_truth_of_an_estimate_is_the_one_that_is_proved() -> None:
    from dmframe.formula.law import PrintedLaw

    laws = {block.name: block.law for block in explained("ur10_fast").blocks}
    assert isinstance(laws["inverse"], PrintedLaw)
    assert [line.whole.text for line in laws["inverse"].estimates] == ["w = 1/K_star", "w_P = K_P/K_D", "w_I = K_I/K_D"]
