"""Claim files with false or empty statements: each is refused before the test."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import dmframe as dm
from dmframe.certify import claim_of
from dmframe.certify.assemble import assembled
from dmframe.common.errors import ValueFault
from dmframe.prove.__main__ import main
from dmframe.prove.export import from_json, to_json

Change = Callable[[dict[str, Any]], Any]


@cache
def text() -> str:
    return to_json(assembled(claim_of(dm.load("arm2_joint").diagram)))


def changed(change: Change) -> str:
    found = json.loads(text())
    change(found)
    return json.dumps(found)


def symbol(found: dict[str, Any], label: str) -> dict[str, Any]:
    return next(item for item in found["symbols"] if item["label"] == label)


def part(found: dict[str, Any], block: str) -> dict[str, Any]:
    return next(item for item in found["parts"] if item["block"] == block)


def output(found: dict[str, Any], name: str) -> list[Any]:
    return next(item for item in found["program"]["outputs"] if item[0] == name)


def swap_moves(found: dict[str, Any]) -> None:
    one, other, *_ = found["moves"]
    found["moves"][one], found["moves"][other] = found["moves"][other], found["moves"][one]


def jumping_storage(found: dict[str, Any]) -> None:
    """V contains the floor of a state, whose derivative is zero wherever it exists."""
    nodes, own = found["program"]["nodes"], output(found, "task.stored of q - q_d.vector")
    nodes.append(["floor", own[4][0]])
    own[4][0] = len(nodes) - 1


def copied_gain(found: dict[str, Any]) -> None:
    nodes, own = found["program"]["nodes"], output(found, "task.stored of q - q_d.vector")
    nodes.append(["input", len(found["symbols"]), 0])
    own[4][0] = len(nodes) - 1


def time_stands_still(found: dict[str, Any]) -> None:
    found["program"]["nodes"].append(["const", "0"])
    found["program"]["outputs"].append(["move of t", 1, 1, [0], [len(found["program"]["nodes"]) - 1]])
    found["moves"]["t"] = "move of t"


FALSE: dict[str, tuple[Change, str]] = {
    "a state of V without a move": (lambda f: f["moves"].pop(next(iter(f["moves"]))), "used 0 times"),
    "a state of V called a projection": (
        lambda f: symbol(f, "arm.q").update(kind="projection"),
        "expected moves of .*, found one of arm.q",
    ),
    "a move of a parameter": (
        lambda f: f["moves"].update({"task.alpha_bar": "task.supply"}),
        "found one of task.alpha",
    ),
    "a move of no symbol": (lambda f: f["moves"].update({"task.nothing": "task.supply"}), "found one of task.nothing"),
    "time that stands still": (time_stands_still, "expected t to have the rate 1"),
    "V that jumps": (jumping_storage, "contains floor, which is discontinuous"),
    "V with a copy of a gain": (copied_gain, "V depends on .*changed, which has no rate|changed only in rates"),
    "a state with a value": (
        lambda f: symbol(f, "arm.q").update(values=["0"] * symbol(f, "arm.q")["size"]),
        "expected values of a parameter alone",
    ),
    "a kind that is unknown": (lambda f: symbol(f, "arm.q").update(kind="x"), "arm.q: expected one of"),
    "two symbols of one label": (lambda f: symbol(f, "arm.q").update(label="arm.dq"), "found arm.dq twice"),
    "two outputs of one name": (
        lambda f: f["program"]["outputs"][1].__setitem__(0, f["program"]["outputs"][0][0]),
        "a unique name",
    ),
    "a gain that is no parameter": (lambda f: f["gains"].append("arm.q"), "expected gains to be parameters"),
    "a gain that is no symbol": (lambda f: f["gains"].append("task.x"), "expected gains to be parameters"),
    "a weight that is no weight": (
        lambda f: part(f, "task").update(weight="x"),
        "expected a symbol of the kind weight",
    ),
    "a weight that is a state": (
        lambda f: part(f, "task").update(weight="arm.q"),
        "expected a symbol of the kind weight",
    ),
    "a rule that is unknown": (lambda f: part(f, "task")["stored"][0].update(rule="x"), "stored: expected terms"),
    "a rule of another role": (lambda f: part(f, "task")["stored"][0].update(rule="clipped"), "stored: expected terms"),
    "a rule of other parts": (
        lambda f: part(f, "task")["stored"][0].update(rule="potential"),
        "stored: expected terms",
    ),
    "an output that is read twice": (lambda f: part(f, "task").update(lemma=part(f, "task")["supply"]), "used 2 times"),
    "an output that is unknown": (lambda f: part(f, "task").update(supply="x"), "expected an output of the program"),
    "no parts": (lambda f: f.update(parts=[], composed=[]), "expected a part with a stored term"),
    "a block twice": (lambda f: f["parts"].append(part(f, "task")), "expected one part per block|used 2"),
    "samples of a flow": (lambda f: f.update(operator="sample"), ""),
    "no operator": (lambda f: f.update(operator="flaw"), "expected one of flow, sample, found 'flaw'"),
    "an unknown key": (lambda f: f.update(more=1), "more: missing or unknown key of a Claim"),
    "an unknown key of a term": (
        lambda f: part(f, "task")["stored"][0].update(sign=1),
        "sign: missing or unknown key of a Term",
    ),
    "a missing key": (lambda f: f.pop("reversed"), "reversed: missing"),
    "true as the version": (lambda f: f.update(version=True), "expected version 1"),
    "a negative size": (lambda f: symbol(f, "arm.q").update(size=-2), "at least 0, found -2"),
    "a size beyond memory": (
        lambda f: (symbol(f, "arm.q").update(size=10**15), f["program"]["inputs"][1].__setitem__(2, 10**15)),
        "",
    ),
    "a negative place": (lambda f: f["program"]["outputs"][0][3].__setitem__(0, -1), "at least 0, found -1"),
    "a place twice": (lambda f: f["program"]["outputs"][0][3].__setitem__(1, 0), "element once"),
    "a place beyond": (lambda f: f["program"]["outputs"][0][3].__setitem__(0, 10**9), "element once"),
    "a negative source": (lambda f: f["program"]["outputs"][0][4].__setitem__(0, -1), "at least 0, found -1"),
    "a negative operand": (lambda f: f["program"]["nodes"].append(["neg", -1]), "at least 0, found -1"),
    "a negative input": (lambda f: f["program"]["nodes"].append(["input", -1, 0]), "at least 0, found -1"),
    "a fraction as operand": (lambda f: f["program"]["nodes"].append(["neg", 0.0]), "at least 0, found 0.0"),
    "no denominator": (lambda f: f["program"]["nodes"].append(["const", "1/0"]), "ZeroDivisionError"),
    "a number with an exponent": (
        lambda f: f["program"]["nodes"].append(["const", "1e99"]),
        "a whole number or a frac",
    ),
    "a number that is long": (
        lambda f: f["program"]["nodes"].append(["const", "9" * 5000]),
        "a whole number or a frac",
    ),
    "a reversed state that does not move": (lambda f: f["reversed"].append("arm.x"), "expected a state that moves"),
}


@pytest.mark.parametrize("fault", FALSE)
def test_a_false_file_is_refused(fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, reports = FALSE[fault]
    with pytest.raises(ValueFault, match=f"a claim: .*({reports})"):
        from_json(changed(change))
    path = tmp_path / "claim.json"
    path.write_text(changed(change), encoding="utf-8")
    assert main([str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"{path}: a claim: ")


@pytest.mark.parametrize(
    "content",
    [b"", b"null", b"[]", b"{}", b"\xff", b'"x"', b"[" * 10**5, b'{"version": 1, "version": 1}', b'{"version": 1e999}'],
)
def test_a_file_that_is_not_a_claim_is_refused_without_a_traceback(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "claim.json"
    path.write_bytes(content)
    assert main([str(path)]) == 2
    assert main([str(tmp_path)]) == 2
    reported = capsys.readouterr()
    assert reported.out == ""
    assert reported.err.count("\n") == 2


def test_a_file_whose_moves_are_exchanged_does_not_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "claim.json"
    path.write_text(changed(swap_moves), encoding="utf-8")
    assert main([str(path)]) == 1
    assert "the identity does not hold: dV/dt" in capsys.readouterr().out


def test_a_key_that_a_reader_might_read_otherwise_is_refused() -> None:
    twice = text().replace('"operator":"flow"', '"operator":"sample","operator":"flow"')
    with pytest.raises(ValueFault, match="a repeated key among"):
        from_json(twice)


def steep(found: dict[str, Any], squares: int) -> None:
    """A position, squared repeatedly, that an equation adds and subtracts."""
    nodes, own = found["program"]["nodes"], output(found, "task.supply")
    nodes.append(["input", 1, 0])
    for _ in range(squares):
        nodes.append(["sq", len(nodes) - 1])
    nodes.append(["sub", len(nodes) - 1, len(nodes) - 1])
    nodes.append(["add", own[4][0], len(nodes) - 1])
    own[4][0] = len(nodes) - 1


def test_an_identity_of_a_degree_without_an_error_bound_is_not_decided(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "claim.json"
    path.write_text(changed(lambda f: steep(f, 140)), encoding="utf-8")
    assert main([str(path)]) == 0
    path.write_text(changed(lambda f: steep(f, 600)), encoding="utf-8")
    assert main([str(path)]) == 2
    assert "the degree of the claim is too high" in capsys.readouterr().err
