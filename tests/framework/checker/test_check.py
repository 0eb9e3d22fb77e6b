"""Certificates, and their check by `check.py`: packaged graphs, seeded faults, false files, and other sources."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import jsonschema
import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.block.model import SYMBOLIC
from dmframe.catalogue import graphs
from dmframe.certify import Verdict, verify
from dmframe.certify.published import certificate_of, certificate_schema, certificate_text
from dmframe.certify.small_gain import Kappa
from dmframe.certify.unfolded import energy
from dmframe.robot.pseudo_inertia import pseudo_inertia
from dmframe.robot.symbolic import SymbolicRobot
from tests.framework.checker.attacks import Attack, holes, more
from tests.framework.checker.certificates import (
    CHECKER,
    MISSING,
    certificate,
    checker,
    in_node,
    outcome,
    replaced,
    result,
    text_of,
)
from tests.framework.checker.false_theorems import false_theorems
from tests.framework.checker.hidden import hidden
from tests.framework.checker.readings import equals, readings, texts
from tests.framework.checker.written import circular, dominated, sampled, stable


def said(verdict: Verdict, data: dict[str, Any]) -> set[str]:
    """What a verdict and its certificate say that a checker must list: shown, not checked, or assumed."""
    statements = {f"{item.signal} {item.says}" for item in verdict.statements if not item.estimate}
    conditions = {f"condition: {item['name']}" for item in data["conditions"] if item["margin"] is None}
    return statements | conditions | {str(item.text) for item in verdict.assumptions}


@pytest.mark.parametrize("name", sorted(graphs()))
def test_every_proved_graph_is_proved_again(name: str) -> None:
    graph = dm.load(name)
    with SYMBOLIC:
        again = verify(graph.diagram, uncertain=graph.intervals(), start=graph.start)
    if again.outcome != "proved":
        pytest.skip("it has no proof")
    data = certificate(name)
    jsonschema.Draft202012Validator(certificate_schema()).validate(data)
    found = result(data)
    if name in MISSING:
        assert found["status"] == "refused"
        assert MISSING[name] in found["reason"]
    else:
        assert found["status"] == "re-proved"
        assert found["log2_error"] <= -300
        listed = {*found["conclusions"], *found["not_checked"], *found["assumed"]}
        assert said(again, data) <= listed
    texts = [certificate_text(again, {"graph": name}, graph.intervals()) for _ in range(2)]
    assert texts == [text_of(name)] * 2
    if name in ("pendulum", "arm2_joint", "theorem_3", "ur10_fast", "ur10_pose"):
        goals = {f"{item.signal} {item.says}" for item in again.statements if item.concludes}
        assert goals
        assert goals <= {*found["conclusions"]}
        torques = [text.partition("from a torque of ")[2].split(", ") for text in found["robot"]]
        assert any("arm.dq" in read and "robot.inertia" not in read for read in torques)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("torque_direct_pid", "i is bounded"),  # by a common Lyapunov function of a box
        ("ur10_admittance", "v_a is bounded"),  # by an assumption on the input of a linear equation
        ("ur10_safe", "arm.q stays between 1.3, -2, 0 and 1.75, 0, 2 rad at all times"),  # by barriers
    ],
)
def test_what_it_does_not_derive_is_listed_by_name(name: str, text: str) -> None:
    verdict = dm.load(name).verify().verdict
    assert text in {f"{item.signal} {item.says}" for item in verdict.statements}
    data = certificate(name)
    for found in (result(data), *in_node([data])):
        assert text in found["not_checked"]
        assert text not in found["conclusions"]
        assert said(verdict, data) <= {*found["conclusions"], *found["not_checked"], *found["assumed"]}


def test_a_position_feedback_is_proved_again_and_needs_its_gain() -> None:
    settings = {"inverse.K_c": 2, "model.bias": True, "dynamics.a_d_hat_box": None}
    verdict = dm.load("joint_tracking_bounded").set(settings).verify().verdict
    wanted = ["q - q_tie is square-integrable", "q - q_tie goes to zero"]
    for gain, shown, status in (("2", wanted, "re-proved"), ("0", [], "re-proved"), ("-1", [], "refuted")):
        data = certificate_of(verdict, {})
        (item,) = (item for item in data["symbols"] if item["label"] == "inverse.K_c")
        item["numbers"] = [[gain, gain]] * item["size"]
        for found in (result(data), *in_node([data])):
            assert found["status"] == status
            assert [text for text in wanted if text in found.get("conclusions", [])] == shown


def test_other_letters_than_ascii_are_escaped_in_names() -> None:
    verdict = dm.load("pendulum").verify().verdict
    first, *others = verdict.conditions
    named = replace(verdict, conditions=(replace(first, name="\u03b1 > 0"), *others))
    data = certificate_of(named, {"graph": "\u03b1"})
    assert (data["conditions"][0]["name"], data["about"]) == (r"\u03b1 > 0", {"graph": "\u03b1"})
    assert [found["status"] for found in (result(data), *in_node([data]))] == ["re-proved"] * 2


def test_the_weight_of_a_cascade_must_exceed_the_least_kappa() -> None:
    """The file contains a matrix in place of the small gain; its pivots decide the same bound of kappa."""
    verdict = dm.load("arm2_joint").verify().verdict
    assert verdict.kappa is not None
    least = verdict.kappa.least
    for share, status in ((Fraction(99, 100), "refuted"), (Fraction(101, 100), "re-proved")):
        data = certificate_of(replace(verdict, kappa=Kappa(least, share * least)), {})
        for found in (result(data), *in_node([data])):
            assert found["status"] == status


def test_it_runs_without_the_framework_and_its_exit_status_is_the_outcome(tmp_path: Path) -> None:
    path, data = tmp_path / "file.json", certificate("pendulum")

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-I", "-S", str(CHECKER), str(path), *words]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    path.write_text(json.dumps(data))
    done = run("--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["status"] == "re-proved"
    assert "conclusions:\n" in run().stdout

    state = next(label for label in data["rates"] if label == "arm.dq")
    path.write_text(json.dumps({**data, "rates": {**data["rates"], state: replaced(data, data["rates"][state])}}))
    done = run()
    assert (done.returncode, done.stderr) == (1, "")
    assert "does not hold" in done.stdout


def faults(data: dict[str, Any]) -> Iterator[tuple[str, Callable[[dict[str, Any]], None]]]:
    """Seeded faults of a certificate in continuous time, by name."""
    check = checker()
    of = check.Certificate(data)
    stored = [node for term in of.terms if term.role == "stored" for node in (*term.parts.vector, *term.parts.weight)]
    for label in {node.value[0] for node in check.symbols(stored)} & data["rates"].keys():

        def reversed_(data: dict[str, Any], label: str = label) -> None:
            data["rates"][label] = replaced(data, data["rates"][label])

        yield f"the rate of {label} reversed", reversed_
    for k, term in enumerate(of.terms):
        if any(of.fixed.get(node) == 0 for node in check.symbols(term.parts.weight)):
            continue  # friction that the plant does not have

        def dropped(data: dict[str, Any], k: int = k) -> None:
            parts = data["terms"][k]["parts"]
            data["vectors"].append([-1] * len(data["vectors"][parts["weight"]]))
            parts["weight"] = len(data["vectors"]) - 1

        def negative(data: dict[str, Any], k: int = k) -> None:
            parts = data["terms"][k]["parts"]
            parts["weight"] = replaced(data, parts["weight"])

        yield f"{term.name} dropped", dropped
        yield f"{term.name} negative", negative
        if term.rule == "projected":

            def outside(data: dict[str, Any], k: int = k) -> None:
                parts = data["terms"][k]["parts"]
                parts["lower"], parts["upper"] = parts["upper"], parts["lower"]

            yield f"{term.name} with its box turned over", outside
    for k in range(len(data["robots"])):

        def turned(data: dict[str, Any], k: int = k) -> None:
            axis = data["vectors"][data["robots"][k]["joints"][0]["axis"]]
            data["vectors"].append(axis[1:] + axis[:1])
            data["robots"][k]["joints"][0]["axis"] = len(data["vectors"]) - 1

        def pulled(data: dict[str, Any], k: int = k) -> None:
            robot = data["robots"][k]
            robot["torque"] = replaced(data, robot["torque"])

        yield "another joint axis", turned
        yield "another torque", pulled
    for name in ("robot.inertia", "inverse.K_c"):
        if any(item["label"] == name and item["numbers"] for item in data["symbols"]):

            def negated(data: dict[str, Any], name: str = name) -> None:
                (item,) = (x for x in data["symbols"] if x["label"] == name)
                item["numbers"] = [[str(-checker().rational(x)) for x in reversed(pair)] for pair in item["numbers"]]

            yield f"{name} negative", negated


@pytest.mark.parametrize("name", ["pendulum", "arm2_joint", "ur10_fast"])
def test_every_seeded_fault_is_refuted(name: str) -> None:
    seeded = list(faults(certificate(name)))
    assert len(seeded) > 20
    for fault, apply in seeded:
        data = certificate(name)
        apply(data)
        assert outcome(data)[0] == "refuted", fault


@pytest.mark.parametrize("name", ["ur10_slow_repetitive", "ur10_slow_sampled"])
def test_faults_over_samples_are_refuted(name: str) -> None:
    data = certificate(name)
    assert outcome(data)[0] == "re-proved"
    terms = {(term["role"], term["rule"]): k for k, term in enumerate(data["terms"])}  # the last of each
    for k in terms.values():
        data = certificate(name)
        parts = data["terms"][k]["parts"]
        part = "correction" if "correction" in parts else "weight"
        parts[part] = replaced(data, parts[part])
        assert outcome(data)[0] == "refuted", (k, part)
    for label in ("inverse.theta",):
        data = certificate(name)
        data["rates"][label] = replaced(data, data["rates"][label])
        assert outcome(data)[0] == "refuted", label


def allows(found: dict[str, Any], allowed: str) -> bool:
    """True if a result is one that an attack may have."""
    word, _, text = allowed.partition(" ")
    if word == "unshown":
        return found["status"] == "re-proved" and text not in found["conclusions"]
    if word in ("assumes", "robot"):
        return any(text in line for line in found.get({"assumes": "assumed"}.get(word, word), []))
    if found["status"] != "re-proved" or "re-proved" in allowed:
        return found["status"] in allowed.split()
    if allowed == "open":
        return "condition: open" in found["assumed"]
    shown = any(text.startswith("w ") for text in found["conclusions"])
    return word == "w" and not shown and any(text.startswith("w ") for text in found["not_checked"])


@pytest.mark.parametrize("attacks", [holes, more, false_theorems, readings, hidden])
def test_a_file_that_states_more_than_is_true_is_not_accepted(attacks: Callable[[], Iterator[Attack]]) -> None:
    accepted = [(what, found) for what, data, allowed in attacks() if not allows(found := result(data), allowed)]
    assert accepted == []


def test_the_true_files_next_to_the_false_ones_are_accepted() -> None:
    assert result(stable().data)["conclusions"] == ["x goes to zero"]
    assert result(dominated("1/5").data)["conclusions"] == ["w goes to zero"]
    assert result(circular(nominal="a"))["conclusions"] == ["w is bounded"]
    assert result(sampled().data)["conclusions"][-1] == "theta is bounded"
    for what, data, concluded in equals():
        assert result(data)["conclusions"] == concluded, what


def test_conclusions_use_a_prime_with_a_smaller_error_than_the_identity() -> None:
    """Hole 12: one prime of 149 bits has a larger error than the identity."""
    check = checker()
    of = check.Certificate(stable().data)
    check.signs(of)
    assert check.Conclusions(of).p.bit_length() == 269


def test_texts_that_are_no_certificate_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, text = tmp_path / "file.json", json.dumps(stable().data)
    for wrong in (
        text.replace('"about": {}', '"about": {}, "about": {}'),
        text.replace('"version": 4', '"version": NaN'),
        text.replace('"version": 4', '"version": 4e0'),
        text[:-1],
        '{"a":' * 100_000,
        "\ud800",
    ):
        path.write_bytes(wrong.encode("utf-8", "surrogatepass"))
        assert checker().main([str(path)]) == 2, wrong[:60]
    for what, content in texts():
        path.write_bytes(content)
        assert checker().main([str(path)]) == 2, what
    path.write_text(text)
    assert checker().main([str(path)]) == 0
    monkeypatch.setattr(checker(), "LONGEST", len(text))
    assert checker().main([str(path)]) == 2


def _real(node: Any, *given: float) -> float:
    """The value of a node in floating-point numbers."""
    if node.name in checker().ARITHMETIC:
        return float(checker().ARITHMETIC[node.name](*given))
    return float(node.value) if node.name == "number" else float({"cos": np.cos, "sin": np.sin}[node.name](*given))


@pytest.mark.parametrize("name", ["arm2_joint", "ur10_pose", "panda_full"])
def test_the_equation_of_motion_agrees_with_pinocchio(name: str) -> None:
    robot, check = dm.load(name).diagram.robot, checker()
    model, rng = robot.model, np.random.default_rng(0)
    data, n = model.createData(), robot.n
    q, dq, ddq = ([check.Node("symbol", value=(key, k)) for k in range(n)] for key in ("q", "dq", "ddq"))
    moves = dict(zip([*q, *dq], [*dq, *ddq], strict=True))

    def numbers(*values: Any) -> list[Any]:
        return [check.number(check.Fraction(str(x))) for x in values]

    def flat(rows: Any) -> list[Any]:
        return [x for row in rows for x in row]

    def rate(nodes: list[Any]) -> list[Any]:
        found: list[Any] = check.rates(nodes, lambda node: moves.get(node, check.ZERO), {})
        return found

    joints = []
    for joint, row, x in zip(robot.joints, robot.inertia, q, strict=True):
        S = pseudo_inertia([check.Fraction(float(value)) for value in row])
        R, axis, r = ([*map(check.number, own)] for own in (flat(joint.rotation), joint.axis, joint.translation))
        R, (a, b, c), (cos, sin) = [R[k : k + 3] for k in (0, 3, 6)], axis, (check.Node("cos", x), check.Node("sin", x))
        minus = check.ZERO - check.ONE
        skew = [[check.ZERO, minus * c, b], [c, check.ZERO, minus * a], [minus * b, a, check.ZERO]]
        turn = [
            [
                (cos if i == k else check.ZERO) + sin * skew[i][k] + (check.ONE - cos) * axis[i] * axis[k]
                for k in range(3)
            ]
            for i in range(3)
        ]
        rotation = check.product(R, turn) if joint.kind == "revolute" else R
        place = [rotation[i][k] for k in range(3) for i in range(3)] + r
        body = [numbers(*row) for row in S]
        joints.append(SimpleNamespace(kind=joint.kind, axis=axis, place=place, body=body))
    torque = [check.Node("symbol", value=("tau", k)) for k in range(n)]
    gravity = numbers(*(check.Fraction(float(x)) for x in robot.gravity))
    item = SimpleNamespace(position="q", joints=joints, rotors=numbers(*[0] * n), gravity=gravity, torque=torque)
    of = SimpleNamespace(symbols={"q": q}, sure_rate=rate, kind=lambda node: "state", kinds_in=lambda nodes: set())
    found = list(check.robot(of, item))
    motion = [node for text, own in found if text == "the robot's equation of motion" for node in own]
    constraints = [node for text, own in found if text != "the robot's equation of motion" for node in own]
    angles = dict(zip(q, rng.uniform(-2, 2, n).tolist(), strict=True))
    assert max(map(abs, check.evaluate(constraints, _real, angles))) < 1e-12
    for _ in range(3):
        moving = rng.uniform(-2, 2, (3, n))
        values = dict(zip([*q, *dq, *ddq], map(float, moving.ravel()), strict=True)) | dict.fromkeys(torque, 0.0)
        force = np.array(check.evaluate(motion, _real, values))
        expected = pin.rnea(model, data, *moving)
        np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9 * float(np.max(np.abs(expected))))


@pytest.mark.parametrize("name", ["arm2_joint", "ur10_pose", "panda_full"])
def test_the_energy_of_the_bodies_is_that_of_the_mass_matrix(name: str) -> None:
    """`unfolded.energy` against the mass matrix of Pinocchio."""
    robot, rng = dm.load(name).diagram.robot, np.random.default_rng(0)
    symbolic, model, n = SymbolicRobot(robot), robot.model, robot.n
    q, speeds = ca.SX.sym("q", n), ca.SX.sym("e", n)
    terms = list(energy("T", symbolic, q, speeds, symbolic.inertia, ca.SX.zeros(n)))
    assert len(terms) == n
    total = sum(ca.dot(term.parts["vector"], term.parts["weight"] @ term.parts["vector"]) for term in terms)
    constants = ca.veccat(*(constant.symbol for constant in symbolic.constants))
    numbers = ca.veccat(*map(ca.DM, symbolic.values().values()))
    function = ca.Function("T", [q, speeds, constants], [total])
    for _ in range(3):
        at, e = rng.uniform(-2, 2, (2, n))
        pin.crba(model, data := model.createData(), at)
        M = np.triu(data.M) + np.triu(data.M, 1).T
        assert float(function(at, e, numbers)) == pytest.approx(float(e @ M @ e), rel=1e-9)
