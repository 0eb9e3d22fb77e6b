"""Certificates, and their check by `check.py`: packaged graphs, seeded faults, false files, and other sources."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pinocchio as pin
import pytest

import dmframe as dm
from dmframe.catalogue import graphs
from dmframe.certify.published import certificate_schema, certificate_text
from tests.framework.checker.certificates import CHECKER, certificate, checker, outcome, replaced, text_of


@pytest.mark.parametrize("name", sorted(graphs()))
def test_every_proved_graph_is_proved_again(name: str) -> None:
    graph = dm.load(name)
    if not graph.verify().proved:
        pytest.skip("it has no proof")
    data = certificate(name)
    jsonschema.Draft202012Validator(certificate_schema()).validate(data)
    found = checker().check(data)
    assert found["status"] == "re-proved"
    assert found["log2_error"] <= -300
    again = graph.verify().verdict
    texts = [certificate_text(again, {"graph": name}, graph.intervals()) for _ in range(2)]
    assert texts == [text_of(name)] * 2
    if name in ("pendulum", "arm2_joint", "theorem_3", "ur10_fast", "ur10_pose"):
        goals = {f"{item.signal} {item.says}" for item in graph.verify().verdict.statements if item.concludes}
        assert goals
        assert goals <= {*found["conclusions"]}
        assert any("follows from the torque" in text for text in found["robot"])


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

    for text in ("{}", "[]", "not json", "\x00", '{"format": "dmframe-certificate"}', "[" * 100_000, "9" * 10_000):
        path.write_text(text)
        done = run()
        assert (done.returncode, done.stderr) == (2, ""), text[:30]
    path.unlink()
    assert run().returncode == 2


def faults(data: dict[str, Any]) -> Iterator[tuple[str, Callable[[dict[str, Any]], None]]]:
    """Seeded faults of a certificate in continuous time, by name."""
    stored = [term for term in data["terms"] if term["role"] == "stored"]
    read = (
        checker()
        .Certificate(data)
        .reads([k for term in stored for name, k in term["parts"].items() if name in ("vector", "weight", "matrix")])
    )
    for label in read & data["rates"].keys():

        def reversed_(data: dict[str, Any], label: str = label) -> None:
            data["rates"][label] = replaced(data, data["rates"][label])

        yield f"the rate of {label} reversed", reversed_
    of = checker().Certificate(data)
    zero = {label for label, values in of.fixed.items() if not any(values)}
    for k, term in enumerate(data["terms"]):
        if of.reads([term["parts"]["weight"]]) & zero:
            continue  # friction that the plant does not have

        def dropped(data: dict[str, Any], k: int = k) -> None:
            parts = data["terms"][k]["parts"]
            zero = len(data["vectors"])
            rows, elements = data["vectors"][parts["weight"]]
            data["vectors"].append([rows, [-1] * len(elements)])
            parts["weight"] = zero

        def negative(data: dict[str, Any], k: int = k) -> None:
            parts = data["terms"][k]["parts"]
            parts["weight"] = replaced(data, parts["weight"])

        yield f"{term['name']} dropped", dropped
        yield f"{term['name']} negative", negative
    for k, item in enumerate(data["projections"]):

        def outside(data: dict[str, Any], k: int = k) -> None:
            item = data["projections"][k]
            item["lower"], item["upper"] = item["upper"], item["lower"]

        yield f"{item['state']} with its box turned over", outside
    for k in range(len(data["masses"])):

        def turned(data: dict[str, Any], k: int = k) -> None:
            joint = data["masses"][k]["joints"][0]
            joint["axis"] = joint["axis"][1:] + joint["axis"][:1]

        def pulled(data: dict[str, Any], k: int = k) -> None:
            motion = data["masses"][k]["motion"]
            motion["torque"] = replaced(data, motion["torque"])

        yield "another joint axis", turned
        yield "another torque", pulled
    for name in ("robot.inertia", "inverse.K_c"):
        if name in data["numbers"]:

            def negated(data: dict[str, Any], name: str = name) -> None:
                data["numbers"][name] = [str(-checker().rational(x)) for x in data["numbers"][name]]

            yield f"{name} negative", negated


@pytest.mark.parametrize("name", ["pendulum", "arm2_joint", "ur10_fast"])
def test_every_seeded_fault_is_refuted(name: str) -> None:
    seeded = list(faults(certificate(name)))
    assert len(seeded) > 20
    for fault, apply in seeded:
        data = certificate(name)
        apply(data)
        assert outcome(data)[0] == "refuted", fault


def test_faults_over_samples_are_refuted() -> None:
    name = "ur10_slow_sampled"
    assert outcome(certificate(name))[0] == "re-proved"
    data = certificate(name)
    (steps,) = data["steps"]
    for part in ("h0", "y1", "gain", "floor"):
        data = certificate(name)
        parts = data["steps"][0]["parts"]
        parts[part] = replaced(data, parts[part])
        assert outcome(data)[0] == "refuted", part
    for change in ({"rule": "least_squares"}, {"box": False}, {"rows": steps["rows"] - 1}):
        data = certificate(name)
        data["steps"][0].update(change)
        assert outcome(data)[0] in ("refuted", "refused"), change
    for label in data["rates"]:
        data = certificate(name)
        data["rates"][label] = replaced(data, data["rates"][label])
        assert outcome(data)[0] == "refuted", label
    data = certificate(name)
    data["plant"][0]["rest"] = replaced(data, data["plant"][0]["rest"])
    assert outcome(data)[0] == "refuted"


def false_files() -> Iterator[tuple[str, dict[str, Any], str]]:
    """Files that state more than is true, written with the checker's rules at hand."""
    data = certificate("pendulum")
    data["terms"] = [term for term in data["terms"] if term["role"] == "cross"]
    yield "V without a term", data, "refused"

    data = certificate("arm2_joint")
    for term in data["terms"]:
        if term["role"] == "dissipated":
            term["role"] = "residual"
    yield "what is lost stated as a residual", data, "refused refuted"

    data = certificate("arm2_joint")
    data["cross"] = []
    yield "a cross term that nothing dominates", data, "refuted"

    data = certificate("arm2_joint")
    (cross,) = data["cross"]
    cross["by"] = [*cross["by"], cross["by"][0]]
    yield "a square that dominates twice", data, "refused refuted"

    data = certificate("arm2_joint")
    data["projections"] = [*data["projections"], data["projections"][0]]
    yield "a projection that is counted twice", data, "refuted"

    data = certificate("arm2_joint")
    item = data["projections"][0]
    item["correction"] = data["projections"][1]["correction"]
    yield "the correction of another estimate", data, "refused"

    data = certificate("arm2_joint")
    data["conclusions"].append(
        {"signal": "w", "says": "goes to zero", "assumes": [], "vector": data["rates"]["servo.q_c"]}
    )
    yield "a signal that need not vanish", data, "believed"

    data = certificate("pendulum")
    data["rates"]["path.q_d"] = data["rates"]["arm.q"]
    yield "a trajectory that follows the robot", data, "refuted"

    data = certificate("pendulum")
    del data["rates"]["path.q_d"]
    yield "V of a signal without a rate", data, "refused"

    data = certificate("arm2_joint")
    for item in data["conditions"]:
        if "margin" in item and item["strict"]:
            item["margin"] = replaced(data, item["margin"])
            break
    yield "a condition of the other sign", data, "refuted"

    data = certificate("pendulum")
    for symbol in data["symbols"]:
        if symbol["label"] == "arm.dq":
            symbol["kind"] = "constant"
    yield "a state that is declared constant", data, "refused"


def attacks() -> Iterator[tuple[str, dict[str, Any], str]]:
    """Files that use a side condition which a rule must have."""

    def constant(data: dict[str, Any], *values: str) -> int:
        program, places = data["program"], []
        for value in values:
            program["constants"].append(value)
            program["code"].append(program["operations"].index("const"))
            program["a"].append(len(program["constants"]) - 1)
            program["b"].append(0)
            places.append(len(program["code"]) - 1)
        data["vectors"].append([len(places), places])
        return len(data["vectors"]) - 1

    data = certificate("arm2_joint")
    term = next(
        term
        for term in data["terms"]
        if (term["role"] == "stored" and "q - q_r" in term["name"]) or term["name"] == "task: q - q_d"
    )
    data["vectors"].append([2, data["vectors"][constant(data, "1", "0", "4", "1")][1]])
    term["parts"]["weight"] = len(data["vectors"]) - 1
    yield "a matrix with positive pivots that is not symmetric", data, "refuted"

    data = certificate("arm2_joint")
    data["masses"][0]["joints"][0]["axis"] = ["0", "0", "0"]
    yield "a joint without an axis", data, "refused"

    data = certificate("arm2_joint")
    data["masses"][0]["joints"][1]["rotation"] = ["-1", "0", "0", "0", "1", "0", "0", "0", "1"]
    yield "a reflection", data, "refused"

    data = certificate("arm2_joint")
    data["masses"][0]["motion"] = dict.fromkeys(
        ("velocity", "acceleration", "gravity", "torque"), constant(data, "0", "0")
    )
    data["masses"][0]["motion"]["gravity"] = constant(data, "0", "0", "0")
    yield "a robot at rest", data, "refuted"

    data = certificate("arm2_joint")
    data["steps"] = certificate("ur10_slow_repetitive")["steps"]
    yield "steps in continuous time", data, "refused"

    data = certificate("arm2_joint")
    for term in data["terms"]:
        if term["name"] == "inverse: sigma" or (term["role"] == "stored" and term["rule"] == "square"):
            term["assumed"] = "it is"
            term["parts"]["weight"] = replaced(data, term["parts"]["weight"])
            break
    yield "a negative weight that is assumed to be positive", data, "refuted"

    data = certificate("arm2_joint")
    last = constant(data, "3")
    place = data["vectors"][last][1][0]
    data["program"]["operations"].append("sq")
    for _ in range(60):
        data["program"]["code"].append(len(data["program"]["operations"]) - 1)
        data["program"]["a"].append(place)
        data["program"]["b"].append(place)
        place = len(data["program"]["code"]) - 1
    data["vectors"].append([1, [place]])
    data["conditions"].append({"name": "huge", "margin": len(data["vectors"]) - 1, "strict": True})
    yield "a number of 2^60 digits", data, "refused refuted believed"

    data = certificate("ur10_slow_repetitive")
    data["steps"][0]["rows"] = -1
    yield "a negative number of rows", data, "refused"

    data = certificate("arm2_joint")
    data["ranks"] = [{"name": "R", "matrix": constant(data, "0", "0")}]
    data["conclusions"].append(
        {"signal": "w", "says": "goes to zero", "assumes": [], "vector": data["rates"]["servo.q_c"]}
    )
    yield "a matrix of full rank that is zero", data, "believed"


def _circular(*, nominal: str) -> dict[str, Any]:
    """A true identity with two estimates a and b; the rate of a is that of the symbol `nominal`, plus its correction.

    V = (a^2 + b^2 + x^2) / 2, da/dt = nominal + c_a, db/dt = c_a + c_b, dx/dt = -x - (a nominal + b c_a) / x.
    """
    labels = ("a", "b", "x", "a, correction", "b, correction")
    kinds = ("state", "state", "state", "projection", "projection")
    names = ("input", "const", "add", "mul", "div", "neg", "sub")
    one = {label: place for place, label in enumerate(labels)}
    # 0..4 the symbols; 5: 0, 6: 1, 7: -9, 8: 9
    rows = [(0, k, 0) for k in range(5)] + [(1, k, 0) for k in range(4)]
    rows += [(2, one[nominal], 3), (2, 3, 4)]  # 9: da/dt, 10: db/dt
    rows += [(3, 0, one[nominal]), (3, 1, 3), (2, 11, 12), (4, 13, 2), (5, 2, 2), (6, 15, 14)]  # 16: dx/dt
    vectors = [[1, [k]] for k in (0, 1, 2, 5, 6, 7, 8, 9, 10, 16)]

    def term(role: str, vector: int) -> dict[str, Any]:
        parts = {"vector": vector, "weight": 4}
        return {"name": f"{role} {vector}", "level": "", "role": role, "rule": "square", "parts": parts}

    def projection(label: str, place: int) -> dict[str, Any]:
        own = {"state": label, "correction": f"{label}, correction", "set": "box"}
        return {"term": place, **own, "true": 3, "lower": 5, "upper": 6}

    code, a, b = (list(column) for column in zip(*rows, strict=True))
    return {
        "format": "dmframe-certificate",
        "version": 1,
        "about": {},
        "over": "flow",
        "symbols": [{"label": x, "kind": kind, "size": 1} for x, kind in zip(labels, kinds, strict=True)],
        "numbers": {},
        "program": {"operations": names, "code": code, "a": a, "b": b, "constants": ["0", "1", "-9", "9"]},
        "vectors": vectors,
        "rates": {"a": 7, "b": 8, "x": 9},
        "terms": [term("stored", 0), term("stored", 1), term("stored", 2), term("dissipated", 2)],
        "projections": [projection("a", 0), projection("b", 1)],
        "conclusions": [{"signal": "da/dt", "says": "is bounded", "assumes": [], "vector": 7}],
    }


def test_corrections_that_depend_on_one_another_have_no_bound() -> None:
    assert checker().check(_circular(nominal="a"))["conclusions"] == ["da/dt is bounded"]
    found = checker().check(_circular(nominal="b, correction"))
    assert found["conclusions"] == []
    assert "da/dt is bounded" in found["believed"]


def test_side_conditions_are_checked() -> None:
    for what, data, expected in attacks():
        found, reason = outcome(data)
        if expected == "believed":
            assert found == "re-proved", (what, reason)
            assert "w goes to zero" in checker().check(data)["believed"]
        elif "believed" in expected:
            assert found != "re-proved" or "condition: huge" in checker().check(data)["believed"]
        else:
            assert found in expected.split(), (what, found, reason)


def test_false_files_are_not_accepted() -> None:
    for what, data, expected in false_files():
        if expected == "believed":
            found = checker().check(data)
            assert "w goes to zero" in found["believed"]
            assert "w goes to zero" not in found["conclusions"]
        else:
            assert outcome(data)[0] in expected.split(), (what, outcome(data))


class _Reals:
    """The ring of floating-point numbers."""

    def number(self, value: Any) -> float:
        return float(value)

    def add(self, a: float, b: float) -> float:
        return a + b

    def sub(self, a: float, b: float) -> float:
        return a - b

    def mul(self, a: float, b: float) -> float:
        return a * b

    def call(self, place: object, name: str, a: float) -> float:
        return float({"cos": np.cos, "sin": np.sin}[name](a))


class _Given:
    """A point whose vectors are given."""

    def __init__(self, vectors: dict[str, list[float]]) -> None:
        self.ring, self._vectors = _Reals(), vectors

    def vector(self, name: str) -> list[float]:
        return self._vectors[name]


@pytest.mark.parametrize("name", ["arm2_joint", "ur10_pose", "panda_full"])
def test_the_recursion_agrees_with_pinocchio(name: str) -> None:
    robot = dm.load(name).diagram.robot
    model, rng = robot.model, np.random.default_rng(0)
    data, n = model.createData(), robot.n
    item = {
        "position": "q",
        "translations": "r",
        "inertia": "I",
        "rotors": None,
        "joints": [
            {"kind": j.kind, "axis": [str(x) for x in j.axis], "rotation": [str(x) for row in j.rotation for x in row]}
            for j in robot.joints
        ],
    }
    moves = [float(x) for joint in robot.joints for x in joint.translation]
    for _ in range(3):
        q, dq, ddq = rng.uniform(-2, 2, (3, n))
        point = _Given({"q": list(q), "r": moves, "I": [float(x) for row in robot.inertia for x in row]})
        found = checker().Chain(point, item).forces(list(dq), list(ddq), [float(x) for x in robot.gravity])
        expected = pin.rnea(model, data, q, dq, ddq)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * float(np.max(np.abs(expected))))


def test_the_degree_bound_of_a_known_polynomial() -> None:
    ring = checker().Degrees()
    x = ring.random()
    product = ring.mul(ring.add(x, ring.number(3)), ring.mul(x, x))  # (x + 3) x^2: degree 3, coefficients 1 and 3
    assert product[0] == 3
    assert product[1] >= np.log2(4)
    inverse = ring.inverse(product)
    assert (inverse[0], inverse[2]) == (0, 3)
    assert ring.total([inverse]) >= 3


def test_intervals_and_pivots_decide_signs() -> None:
    check = checker()
    ring, number = check.Intervals(), check.Intervals().number
    a = (check.Fraction(-1), check.Fraction(2))
    assert ring.mul(a, a) == (0, 4)
    assert ring.mul(a, (check.Fraction(3), check.Fraction(4))) == (-4, 8)
    with pytest.raises(check.Again):
        ring.inverse(a)
    assert check.definite([[number(2), number(1)], [number(1), number(1)]])
    assert not check.definite([[number(1), number(2)], [number(2), number(1)]])
    assert not check.definite([[(check.Fraction(1), check.Fraction(2)), number(1)], [number(1), number(1)]])
