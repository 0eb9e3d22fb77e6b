"""What the studio finds in a text: faults with their places, diagram, parameters for a shown page, verdict, page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.catalogue import find_graph
from dmframe.config.document import read_document
from dmframe.graph.graph import Graph
from dmframe.studio.examine import drawn, faults_of, proved

TEXT = find_graph("pendulum").read_text("utf-8")
WRONG = """
from dmframe_blocks.dynamic_compensator import DynamicCompensator


class Wrong(DynamicCompensator):
    def direction(self, u, x, p, sigma):
        return {name: -rate for name, rate in super().direction(u, x, p, sigma).items()}
"""


def stages(text: str, folder: Path, base: str | None = None) -> dict[str, Any]:
    name = str(folder / "mine.yaml")
    return {stage["stage"]: stage for stage in (*drawn(text, name, base), *proved(text, name))}


def edited(old: str, new: str) -> str:
    assert TEXT.count(old) == 1
    return TEXT.replace(old, new)


def test_a_text_has_a_diagram_a_verdict_and_a_page(tmp_path: Path) -> None:
    found = stages(TEXT, tmp_path)
    assert list(found) == ["diagram", "verdict", "page"]
    assert 'data-name="inverse"' in found["diagram"]["svg"]
    assert found["verdict"]["headline"] == Graph.read("pendulum").verify().headline
    assert found["verdict"]["blocks"] == []
    assert "<!doctype html>" in found["page"]["html"]


def test_a_number_of_the_wrong_sign_is_a_fault_at_its_place(tmp_path: Path) -> None:
    found = stages(edited("K_c: 1,", "K_c: -1,"), tmp_path)
    assert list(found) == ["faults"]
    (fault,) = found["faults"]["faults"]
    line = TEXT.splitlines()[fault["line"] - 1]
    assert line[fault["column"] - 1 :].startswith("1, Lambda")
    assert fault["block"] == "inverse"
    assert fault["text"] == "blocks.inverse.K_c: expected a number > 0, found -1"


def test_a_law_of_the_wrong_sign_is_refuted_with_its_block(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(WRONG)
    found = stages(edited("type: dynamic_compensator", "type: own.py:Wrong"), tmp_path)
    assert found["verdict"]["outcome"] == "refuted"
    assert found["verdict"]["blocks"] == ["dynamics"]
    (tmp_path / "own.py").write_text(WRONG.replace("-rate", "rate"))
    assert stages(edited("type: dynamic_compensator", "type: own.py:Wrong"), tmp_path)["verdict"]["outcome"] == "proved"


def test_a_condition_that_fails_names_its_block(tmp_path: Path) -> None:
    found = stages(edited("K_c: 1,", "K_c: 0.01,"), tmp_path)
    assert found["verdict"]["outcome"] == "not_applicable"
    assert found["verdict"]["blocks"] == ["inverse"]
    assert "inverse: M̄ ≥ 0" in [item["name"] for item in found["verdict"]["conditions"] if not item["holds"]]


def test_a_sampled_loop_has_the_restriction_in_its_headline(tmp_path: Path) -> None:
    found = stages(edited("clock: continuous", "clock: 4 ms"), tmp_path)
    assert found["verdict"]["headline"].startswith("proved in continuous time")
    assert found["verdict"]["restriction"] == "The proof does not cover the sampling every 4 ms"


def test_an_implausible_clock_is_a_restriction(tmp_path: Path) -> None:
    found = stages(edited("clock: continuous", "clock: 4"), tmp_path)["verdict"]
    assert found["restriction"].endswith("; clock is 4 s, expected 50 µs to 500 ms; for 4 ms write `clock: 4 ms`")
    assert "notice: clock is 4 s" in found["text"]


def test_an_edit_of_numbers_gives_the_parameters_of_the_shown_page(tmp_path: Path) -> None:
    text = edited("K_c: 1,", "K_c: 2.5,").replace("K_D: 20,", "K_D: 21,")
    found = stages(text, tmp_path, TEXT)
    p = Graph.of(read_document(text, "mine.yaml")).diagram.loop.p_values
    assert np.array_equal(found["numbers"]["p"], p)
    assert not np.array_equal(p, Graph.read("pendulum").diagram.loop.p_values)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("type: regressor, friction: [viscous]", "type: regressor, friction: [viscous, coulomb]"),
        ("duration: 30 s", "duration: 20 s"),
        ("clock: continuous", "clock: 4 ms"),
        ("robot: pendulum", "robot: arm2"),
        (
            "times: [0, 4, 8, 14, 20], q_d: [[0 deg], [90 deg], [45 deg], [-90 deg], [0 deg]]",
            "times: [0], q_d: [[0 deg]]",
        ),
    ],
)
def test_another_loop_or_other_settings_need_another_page(old: str, new: str, tmp_path: Path) -> None:
    found = [stage["stage"] for stage in drawn(edited(old, new), str(tmp_path / "mine.yaml"), TEXT)]
    assert found in (["diagram"], ["faults"])


def test_without_a_page_the_reason_is_given(tmp_path: Path) -> None:
    found = stages(edited("clock: continuous", "clock: 4 ms\njitter: 1 ms"), tmp_path)
    assert "expected a deterministic loop, found jitter" in found["page"]["reason"]


@pytest.mark.parametrize("text", ["", "a", "- 1", "dmframe: 1\n  x: [", "\0", "dmframe: 1\nblocks: 3\n", "a: 1\n" * 3])
def test_every_text_without_a_graph_has_faults_alone(text: str, tmp_path: Path) -> None:
    found = stages(text, tmp_path)
    assert list(found) == ["faults"]
    assert all(fault["text"] for fault in found["faults"]["faults"])


def test_a_block_that_raises_anything_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("raise SystemExit('stop')\n")
    found = stages(edited("type: dynamic_compensator", "type: own.py:Wrong"), tmp_path)
    assert "own.py:1: SystemExit: stop" in found["faults"]["faults"][0]["text"]
    assert "RecursionError" in faults_of(RecursionError("deep"))[0]["text"]
