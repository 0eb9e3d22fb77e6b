"""The regressor's friction: its default, and the notice where the plant has more."""

from __future__ import annotations

import contextlib

import pytest
from faulty import verdict_with

from dmframe.certify import Verdict, verify
from dmframe.certify.uncertain import intervals
from dmframe.cli import main
from dmframe.graph.graph import Graph

COULOMB = (
    "the plant has Coulomb friction (arm.coulomb), and the regressor has no column for it: add coulomb to friction"
)
VISCOUS = (
    "the plant has viscous friction (arm.viscous, arm.maker_viscous), and the regressor has no column for it: "
    "add viscous to friction"
)


def proof(name: str, *overrides: str) -> Verdict:
    return verify(Graph.read(name, overrides).diagram, trials=1)


def test_left_out_the_friction_is_that_of_the_papers_structure() -> None:
    """Eq. (5) contains B dq_ref and no other friction."""
    plain = Graph.read("arm2_joint")
    del plain.data["blocks"]["model"]["friction"]
    blocks = {**plain.blocks, "model": type(plain.blocks["model"])()}
    assert blocks["model"].friction == ("viscous",)  # type: ignore[attr-defined]  # a regressor
    assert blocks["model"].sizes(plain.robot) == {"p": 22}


@pytest.mark.parametrize(
    ("name", "overrides", "blamed"),
    [
        ("arm2_joint", ["arm.coulomb=1"], [f"model: {COULOMB}"]),
        ("arm2_joint", ["arm.coulomb=[0, 0.1]"], [f"model: {COULOMB}"]),
        ("arm2_joint", ["model.friction=[]"], [f"model: {VISCOUS}"]),
        ("arm2_joint", ["model.friction=[coulomb]"], [f"model: {VISCOUS}"]),
        ("arm2_joint", ["model.friction=[]", "arm.coulomb=1"], [f"model: {VISCOUS}", f"model: {COULOMB}"]),
        ("torque_direct_pid", ["arm.coulomb=1"], [f"model: {COULOMB}"]),
        ("ur10_fast", ["model.friction=[viscous]"], [f"model: {COULOMB}"]),
    ],
)
def test_a_friction_without_a_column_is_blamed_by_name(name: str, overrides: list[str], blamed: list[str]) -> None:
    verdict = proof(name, *overrides)
    assert verdict.outcome == "refuted"
    for text in blamed:
        assert text in verdict.reason
    assert verdict.reason.count("the plant has") == len(blamed) + ("torque" in name)  # with it, two blocks share a_d


@pytest.mark.parametrize(
    "overrides",
    [
        ["arm.coulomb=1", "model.friction=[viscous, coulomb]"],
        ["arm.viscous=0", "model.friction=[]"],
        ["arm.viscous=0"],
        ["model.friction=[viscous, coulomb]"],
    ],
)
def test_a_column_for_each_friction_is_enough_and_one_too_many_is_harmless(overrides: list[str]) -> None:
    assert proof("arm2_joint", *overrides).outcome == "proved"


def test_the_condition_reads_as_one_where_it_holds() -> None:
    held = {item.name for item in proof("arm2_joint").conditions if item.name.startswith("model")}
    assert held == {"model: the plant has no Coulomb friction: arm.coulomb is zero [-arm.coulomb^2 >= 0]"}


def test_a_friction_that_may_be_there_is_blamed_too() -> None:
    diagram = Graph.read("arm2_joint").diagram
    verdict = verify(diagram, uncertain=intervals(diagram, {"arm.coulomb": [0, 2]}))
    assert f"model: {COULOMB}" in verdict.reason


def test_without_a_friction_to_blame_the_reason_is_the_usual_one() -> None:
    verdict = verdict_with(Graph.read("arm2_joint"), "dynamics", times=lambda gain, vector: 2 * gain * vector)
    assert verdict.outcome == "refuted"
    assert "friction" not in verdict.reason
    assert "to blame: dynamics" in verdict.reason


def test_the_command_line_states_it(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["dmframe", "verify", "arm2_joint", "--set", "arm.coulomb=1"])
    with contextlib.suppress(SystemExit):
        main()
    assert "add coulomb to friction" in " ".join(capsys.readouterr().out.split())
