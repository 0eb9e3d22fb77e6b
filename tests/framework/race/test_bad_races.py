"""Faults of race files and their messages, each with its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dmframe.errors import DmframeError
from dmframe.race.plan import Race

Make = Callable[..., Race]

FAULTS = {
    "an unknown key": (("budget: 4", "buget: 4"), "small.yaml:19:1: buget: unknown key; did you mean budget?"),
    "a budget of none": (("budget: 4", "budget: 0"), "small.yaml:19:9: budget: expected a number from 1 to 1000000000"),
    "no entrant": (("entrant: tuned", "entrant: tined"), "small.yaml:6:10: entrant: unknown law; did you mean tuned?"),
    "an unknown plant": (("plants: first", "plants: frist"), "small.yaml:18:20: training.plants: unknown plant"),
    "nothing held out": (
        ("plants: first", "plants: [first, second]"),
        "small.yaml:18:20: training.plants: expected at least one of plants that is held out, found all of them",
    ),
    "one law": (("  weak:  {graph: law.yaml, tune: {task.gamma: [1, 4]}}\n", ""), "laws: expected at least one rival"),
    "no tuning": ((", tune: {task.gamma: [1, 4]}", ""), "small.yaml:17:3: laws.weak.tune: this key is missing"),
    "a range upside down": (("[1, 4]", "[4, 1]"), "expected two numbers above zero, the lower one first, found [4, 1]"),
    "a parameter that is none": (("task.gamma: [1", "task.gama: [1"), "laws.weak.tune: task.gama: unknown parameter"),
    "a block of the plant": (("task.gamma: [1", "arm.viscous: [1"), "unknown block of the controller"),
    "a law without a file": (("weak:  {graph: law", "weak:  {graph: lav"), "lav.yaml: expected a graph file"),
    "a parameter of a plant": (("K_P: [90, 45]", "K_P: [-90, 45]"), "small.yaml:10:41: blocks.servo.K_P"),
    "a path's type": (("other:  {type: epicycles", "other:  {type: epicycle"), "small.yaml:13:18: blocks.path.type"),
    "a reality's type": (("{ideal: {}}", "{ideal: {transport_dely: {}}}"), "unknown block type"),
    "a quick clock": (("budget: 4", "quick: {clocks: [9 ms]}"), "quick.clocks: expected some of clocks, found 0.009 s"),
    "a quick race of one law": (
        ("budget: 4", "quick: {laws: weak}"),
        "quick.laws: expected tuned, the entrant, and a rival",
    ),
    "an unknown quick law": (("budget: 4", "quick: {laws: [tuned, week]}"), "quick.laws: unknown law"),
    "a removed block's wire": (
        ("first:  {servo:", "first:  {drive:"),
        "expected a block servo in each plant or path, found none; name the blocks as the law's graph does",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_bad_race_is_refused_with_the_place_of_the_fault(name: str, race: Make, tmp_path: Path) -> None:
    race()
    if name == "a removed block's wire":
        law = (tmp_path / "law.yaml").read_text(encoding="utf-8")
        (tmp_path / "law.yaml").write_text(f"{law}wires: {{servo.dq_c: inverse.dq_c}}\n", encoding="utf-8")
    change, text = FAULTS[name]
    with pytest.raises(DmframeError) as caught:
        race(change)
    assert text in str(caught.value).replace(f"{tmp_path}/", "")


def test_the_faults_of_several_sections_are_reported_at_once(race: Make) -> None:
    with pytest.raises(DmframeError) as caught:
        race(("entrant: tuned", "entrant: x"), ("plants: first", "plants: y"), ("task.gamma: [1", "task.g: [1"))
    assert len(caught.value.faults) == 3
