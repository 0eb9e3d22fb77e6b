"""``dmframe verify`` at the command line; its computations have their own tests."""

from __future__ import annotations

import json
from typing import Any

import pytest

CONTRACT = {
    "graph",
    "verdict",
    "residual_zero",
    "trials",
    "primes",
    "degree_bound",
    "log2_error_bound",
    "dissipation",
    "conditions",
    "assumptions",
    "mutants",
    "time",
}


def strict(text: str) -> Any:
    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


def test_a_proved_graph_gives_status_0_and_the_assumptions(dmframe: Any) -> None:
    reported = dmframe("verify", "arm2_joint")
    assert (reported.status, reported.err) == (0, "")
    assert reported.out.startswith("arm2_joint: proved\n")
    assert "  assumptions\n" in reported.out
    assert "time is continuous" in reported.out


def test_a_graph_with_a_block_without_a_certificate_gives_status_1_and_the_reason(dmframe: Any) -> None:
    reported = dmframe("verify", "ur10_fast_kinematic")
    assert (reported.status, reported.err) == (1, "")
    assert reported.out == "ur10_fast_kinematic: not applicable\n  inverse: a kinematic_command has no certificate\n"


def test_a_condition_that_fails_gives_status_1_and_is_marked(dmframe: Any) -> None:
    reported = dmframe("verify", "pendulum", "--set", "servo.K_I=2000")
    assert reported.status == 1
    assert "not applicable" in reported.out.splitlines()[0]
    assert any("M̄" in line and line.endswith("FAILS") for line in reported.out.splitlines())


def test_verify_json_has_the_keys_of_the_contract(dmframe: Any) -> None:
    reported = dmframe("verify", "arm2_joint", "--json")
    assert (reported.status, reported.err) == (0, "")
    data = strict(reported.out)
    assert set(data) >= CONTRACT
    assert (data["graph"], data["verdict"], data["residual_zero"]) == ("arm2_joint", "proved", True)
    assert data["mutants"]["tried"] == data["mutants"]["refuted"] > 0
    assert {"name", "expression", "value", "holds", "source"} <= set(data["conditions"][0])
    assert set(data["time"]) == {"build", "check"}
    assert data["log2_error_bound"] < -200


def test_verify_json_is_valid_where_nothing_was_proved(dmframe: Any) -> None:
    reported = dmframe("verify", "ur10_fast_kinematic", "--json")
    assert reported.status == 1
    data = strict(reported.out)
    assert set(data) >= CONTRACT
    assert data["verdict"] == "not_applicable"


def test_verify_of_several_graphs_is_a_list_and_one_failure_decides_the_status(dmframe: Any) -> None:
    reported = dmframe("verify", "pendulum", "ur10_fast_kinematic", "--json")
    assert reported.status == 1
    assert [data["verdict"] for data in strict(reported.out)] == ["proved", "not_applicable"]


def test_the_seed_changes_the_primes_and_nothing_else(dmframe: Any) -> None:
    first, other = (strict(dmframe("verify", "pendulum", "--json", "--seed", seed).out) for seed in ("1", "2"))
    assert first["primes"] != other["primes"]
    assert (first["verdict"], first["conditions"]) == (other["verdict"], other["conditions"])


@pytest.mark.parametrize("words", [("verify", "pendulm"), ("verify",), ("verify", "pendulum", "--seed", "x")])
def test_bad_calls_of_verify_give_status_2(words: tuple[str, ...], dmframe: Any) -> None:
    reported = dmframe(*words)
    assert (reported.status, reported.out) == (2, "")
    assert reported.err
