"""Faults of race files and their messages, each with its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import jsonschema
import pytest

from dmframe.catalogue import find_race
from dmframe.common.errors import DmframeError
from dmframe.config.document import read_file
from dmframe.race.grammar import RACE, race_schema
from dmframe.race.plan import Race

Make = Callable[..., Race]

FAULTS = {
    "an unknown key": (("budget: 4", "buget: 4"), "small.yaml:19:1: buget: unknown key; did you mean budget?"),
    "a budget of none": (("budget: 4", "budget: 0"), "small.yaml:19:9: budget: expected a number from 1 to 10000"),
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
    "a law without a file": (
        ("weak:  {graph: law", "weak:  {graph: lav"),
        "small.yaml:17:18: laws.weak.graph: lav.yaml: expected a graph file, found none; did you mean law.yaml?",
    ),
    "a parameter of a plant": (("K_P: [90, 45]", "K_P: [-90, 45]"), "small.yaml:10:41: blocks.servo.K_P"),
    "a path's type": (("other:  {type: epicycles", "other:  {type: epicycle"), "small.yaml:13:18: blocks.path.type"),
    "a reality's type": (("{ideal: {}}", "{ideal: {transport_dely: {}}}"), "unknown block type"),
    "a quick clock": (("budget: 4", "quick: {clocks: [9 ms]}"), "quick.clocks: expected some of clocks, found 0.009 s"),
    "a quick race of one law": (
        ("budget: 4", "quick: {laws: weak}"),
        "quick.laws: expected tuned, the entrant, and a rival",
    ),
    "no robot": (("robot: arm2", "robot:"), "robot: expected keys with values, found nothing"),
    "a clock twice": (("[20 ms]", "[20 ms, 0.02]"), "small.yaml:7:9: clocks: expected each once, found 20 ms twice"),
    "a clock longer than the run": (("[20 ms]", "[2 s]"), "small.yaml:7:9: tuned in 2 s, circle, first, ideal: clock:"),
    "an unknown state": (("{near: [0.5, 0.5]}", "{qq: 1}"), "start.qq: unknown state"),
    "a limit of zero": (("budget: 4", "limit: 0"), "limit: expected a length or an angle above zero"),
    "the last seed": (("budget: 4", f"seed: {2**64 - 1}"), "seed: expected at most 2^64 - 2, since held-out cells use"),
    "no training": (("realities: ideal}", "realities: []}"), "training.realities: expected at least 1, found []"),
    "a training plant twice": (("plants: first", "plants: [first, first]"), "expected each once, found first twice"),
    "too large a bound": (("[1, 4]", f"[1, 1{'0' * 400}]"), "expected two numbers above zero"),
    "a tuned count": (
        ("law.yaml, tune: {task.gamma: [1", "ur10_slow_observer, tune: {task.delay: [1"),
        "laws.weak.tune.task.delay: expected a parameter that is a real number, found a choice or a count",
    ),
    "a bound outside": (
        ("law.yaml, tune: {task.gamma: [1, 4]", "ur10_slow_sampled, tune: {inverse.retention: [0.9, 4]"),
        "with inverse.retention = 4: blocks.inverse: expected a retention of 1 at most",
    ),
    "no bounds": (("task.gamma: [1, 4]", "task.gamma: 4"), "expected bounds, [0.1, 100] or {per_clock: [0.01, 1]}"),
    "a parameter tuned and known": (
        ("task.gamma: [1, 4]}", "task.gamma: [1, 4]}, delay: task.gamma"),
        "laws.weak.delay: task.gamma: expected one of tune, delay, rate and seed, found two",
    ),
    "a value of the plant": (
        ("task.gamma: [1, 4]}", "task.gamma: [1, 4]}, set: {servo.K_P: 3}"),
        "laws.weak.set: servo.K_P: expected a parameter of the controller, the race sets servo; leave it out",
    ),
    "a key that the race sets": (
        ("task.gamma: [1, 4]}", "task.gamma: [1, 4]}, set: {clock: 3 ms}"),
        "small.yaml:17:69: laws.weak.set: clock: expected a parameter of the controller",
    ),
    "a label without a parameter": (
        ("task.gamma: [1, 4]}", "task.gamma: [1, 4]}, set: {task: 3}"),
        "small.yaml:17:68: laws.weak.set: expected a parameter of a block, task.parameter=value",
    ),
    "a law that is a race": (
        ("weak:  {graph: law", "weak:  {graph: small"),
        "expected a graph, which has the key dmframe",
    ),
    "an empty plant": (("second: {servo", "second: {}\n  third: {servo"), "plants.second: expected at least one block"),
    "a controller in a plant": (
        ("arm: {type: manipulator}}\npaths", "arm: {type: manipulator}, goal: {type: kinematic_command}}\npaths"),
        "plants.second.goal: expected a block of the plant, found kinematic_command of the controller",
    ),
    "a plant with a block of a law": (
        ("second: {servo", "second: {task: {type: pi_servo, K_P: 1, K_I: 1}, servo"),
        "laws.tuned: expected another name than that of a block of plants.second for its block task",
    ),
    "a plant with a path": (
        ("second: {servo", "second: {path: {type: pi_servo, K_P: 1, K_I: 1}, servo"),
        "plants.second.path: expected another name, the path's block has this one",
    ),
    "a plant without an arm": (
        ("[360, 180]}, arm: {type: manipulator}}", "[360, 180]}}"),
        "tuned in 20 ms, circle, second, ideal: geometry.q: expected an output of that name in another block",
    ),
    "a plant as path": (
        ("other:  {type: epicycles", "other:  {type: manipulator"),
        "paths.other: expected a source, found",
    ),
    "a negative rate": (("phase: [1]}", "phase: [1], repeats: -1}"), "paths.other.repeats: expected a positive number"),
    "a name with a comma": (("second:", '"a, b":'), "plants: expected names without commas and spaces around them"),
    "a gain in quotes": (("budget: 4", 'margins: {gain: "1.3"}'), "margins.gain: expected a number, found '1.3'"),
    "a negative gain": (("budget: 4", "margins: {gain: -1}"), "margins.gain: expected a number above 0, found -1"),
    "a long delay": (
        ("budget: 4", "margins: {delay: 9}"),
        "small.yaml:19:18: blocks.transport_delay.samples: expected",
    ),
    "a period of zero": (
        ("graph: law.yaml, tune: {task.gamma: [1", "graph: {-1 s: law.yaml}, tune: {task.gamma: [1"),
        "laws.weak.graph: expected different sampling periods above zero, found -1 s",
    ),
    "a quick race without held-out plants": (
        ("budget: 4", "quick: {plants: first}"),
        "quick.plants: expected at least one of plants that is held out, found those of training alone",
    ),
    "an unknown quick law": (("budget: 4", "quick: {laws: [tuned, week]}"), "quick.laws: unknown law"),
    "a removed block's wire": (
        ("first:  {servo:", "first:  {drive:"),
        "expected a block servo in plants.first, found none; name the blocks as the law's graph does",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_bad_race_is_refused_with_the_place_of_the_fault(name: str, race: Make, tmp_path: Path) -> None:
    if name == "a removed block's wire":
        race()
        law = (tmp_path / "law.yaml").read_text(encoding="utf-8")
        (tmp_path / "law.yaml").write_text(f"{law}wires: {{servo.dq_c: inverse.dq_c}}\n", encoding="utf-8")
    change, text = FAULTS[name]
    with pytest.raises(DmframeError) as caught:
        race(change)
    assert text in str(caught.value).replace(f"{tmp_path}/", "")


def test_the_schema_takes_what_the_grammar_takes_and_refuses_a_wrong_key(race: Make) -> None:
    validator = jsonschema.Draft202012Validator(race_schema())
    for data in (race().document.data, read_file(find_race("packaged"), RACE).data):
        assert list(validator.iter_errors(data)) == []
        for wrong in ({"budgt": 3}, {"laws": {"a": {"graph": "x"}}}, {"training": {}}, {"plants": {}}, {"margins": 1}):
            assert list(validator.iter_errors({**data, **wrong})), wrong


def test_the_faults_of_several_sections_are_reported_at_once(race: Make) -> None:
    with pytest.raises(DmframeError) as caught:
        race(("entrant: tuned", "entrant: x"), ("plants: first", "plants: y"), ("task.gamma: [1", "task.g: [1"))
    assert len(caught.value.faults) == 3
