"""``dmframe verify`` of a graph with a false block: status, text, and an exact point that can be checked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dmframe.catalogue import graphs

LIAR = '''
from dmframe.block.certificate import Certificate, TrueValue
from dmframe_blocks.dynamic_compensator import DynamicCompensator


class Liar(DynamicCompensator):
    """Adapts, and claims to store twice as much as it does."""

    def certificate(self, u, x, p, truth):
        honest = super().certificate(u, x, p, truth)
        twice = {name: TrueValue(own.value, 2 * own.weight) for name, own in honest.estimates.items()}
        return Certificate(estimates=twice, supply=honest.supply)
'''


@pytest.fixture
def liar(tmp_path: Path) -> str:
    text = graphs()["pendulum"].read_text(encoding="utf-8")
    (tmp_path / "liar.py").write_text(LIAR, encoding="utf-8")
    (tmp_path / "lie.yaml").write_text(text.replace("dynamic_compensator", "liar.py:Liar"), encoding="utf-8")
    return "lie.yaml"


def test_a_refuted_graph_gives_status_1_and_names_the_block(dmframe: Any, liar: str) -> None:
    reported = dmframe("verify", liar)
    assert (reported.status, reported.err) == (1, "")
    lines = reported.out.splitlines()
    assert lines[0] == "lie: refuted"
    assert any("to blame: dynamics" in line for line in lines)
    assert any(line.startswith("  smallest set of non-zero signals: ") for line in lines)


def test_json_of_a_refutation_holds_every_symbol_of_the_point(dmframe: Any, liar: str) -> None:
    data = json.loads(dmframe("verify", liar, "--json").out)
    assert (data["verdict"], data["residual_zero"], data["log2_error_bound"]) == ("refuted", False, None)
    assert data["mutants"] == {"tried": 0, "refuted": 0, "faults": []}
    refutation = data["refutation"]
    assert refutation["blame"] == ["dynamics"]
    assert 0 < int(refutation["residue"]) < int(refutation["prime"])
    states = {"dynamics.a_d_hat", "inverse.q_r", "inverse.z", "inverse.w", "servo.i", "arm.q", "arm.dq"}
    assert states <= set(refutation["point"])
    assert set(refutation["signals"]) <= set(refutation["point"])


def test_one_refuted_graph_among_several_gives_status_1(dmframe: Any, liar: str) -> None:
    reported = dmframe("verify", "pendulum", liar, "--json")
    assert reported.status == 1
    assert [data["verdict"] for data in json.loads(reported.out)] == ["proved", "refuted"]


def test_the_same_seed_gives_the_same_primes_and_the_same_point(dmframe: Any, liar: str) -> None:
    first, again, other = (
        json.loads(dmframe("verify", liar, "--json", "--seed", seed).out) for seed in ("5", "5", "6")
    )
    for data in (first, again, other):  # the two entries with the time and the duration
        del data["time"], data["proved_at"]
    assert first == again
    assert first["refutation"]["point"] != other["refutation"]["point"]


def test_an_uncertain_gain_is_judged_at_its_worst(dmframe: Any, tmp_path: Path) -> None:
    text = graphs()["pendulum"].read_text(encoding="utf-8")
    (tmp_path / "sure.yaml").write_text(text + "uncertain: {servo.K_I: [10, 30]}\n", encoding="utf-8")
    (tmp_path / "unsure.yaml").write_text(text + "uncertain: {servo.K_I: [10, 200]}\n", encoding="utf-8")
    (tmp_path / "wrong.yaml").write_text(text + "uncertain: {servo.K_J: [10, 200]}\n", encoding="utf-8")
    assert dmframe("verify", "sure.yaml").status == 0
    unsure = dmframe("verify", "unsure.yaml")
    assert unsure.status == 1
    assert "M̄" in unsure.out.splitlines()[1]
    wrong = dmframe("verify", "wrong.yaml")
    assert wrong.status == 2
    assert "uncertain.servo.K_J: unknown parameter of the plant; did you mean servo.K_" in wrong.err
