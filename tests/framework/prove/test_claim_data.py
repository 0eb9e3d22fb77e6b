"""A claim as data: the exported object is the one that was checked; it needs neither CasADi nor a diagram."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any, final

import casadi as ca
import pytest

import dmframe as dm
from dmframe.block.certificate import LeastSquaresSteps, NormalisedSteps
from dmframe.certify import claim_of
from dmframe.certify.assemble import assembled
from dmframe.common.errors import ValueFault
from dmframe.exact import Tape, Trial, ZeroDivision, random_prime
from dmframe.exact.balls import ball
from dmframe.prove.claim import Claim, Steps
from dmframe.prove.export import digest, from_json, to_json
from dmframe.prove.faults import inject_faults
from dmframe.prove.identity import Points, bound_of, empty, identity, inputs_at
from dmframe.prove.point import equalities
from dmframe.prove.reals import Balls
from dmframe.prove.rules import inverse_of, step_result


@cache
def claim(name: str) -> Claim:
    return assembled(claim_of(dm.load(name).diagram))


NAMES = ["arm2_joint", "ur10_fast"]


@pytest.mark.parametrize("name", NAMES)
def test_what_is_read_back_is_the_claim_that_was_checked(name: str) -> None:
    own = claim(name)
    again = from_json(to_json(own))
    assert to_json(again) == to_json(own)
    first, second = (identity(each, trials=1, seed=3) for each in (own, again))
    assert first.zero
    assert first == second
    assert inject_faults(own, seed=3) == inject_faults(again, seed=3)


def test_a_shared_claim_has_the_residues_of_the_whole_one_and_its_error_bound_is_not_used() -> None:
    whole, found = claim("ur10_fast"), list[list[list[int]]]()
    assert len(whole.shared.program.nodes) < len(whole.program.nodes) / 2
    for each in (whole, whole.shared):
        rng = random.Random(3)
        trial = Trial(random_prime(rng), rng)
        found.append(each.tape.evaluate(inputs_at(each, trial), trial))
    assert found[0] == found[1]
    assert Points.of(whole, seed=0).degree == bound_of(whole).degree_total > bound_of(whole.shared).degree_total


def test_terms_without_names_are_part_of_dv_dt() -> None:
    own = claim("arm2_joint")
    parts = [replace(part, stored=tuple(replace(term, name="") for term in part.stored)) for part in own.parts]
    assert empty(replace(own, parts=tuple(parts)), seed=0) == empty(own, seed=0) == []


def test_dv_dt_of_storage_that_does_not_move_is_identically_zero() -> None:
    own = claim("arm2_joint")
    assert empty(replace(own, moves={}), seed=0) == ["dV/dt"]


def test_a_file_is_checked_where_casadi_cannot_be_imported(tmp_path: Any) -> None:
    (tmp_path / "claim.json").write_text(to_json(claim("arm2_joint")), encoding="utf-8")
    script = """
import sys
class Refuses:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ("casadi", "pinocchio", "pin") or name.startswith("dmframe.diagram"):
            raise ImportError(name)
sys.meta_path.insert(0, Refuses())
from dmframe.prove.export import from_json
from dmframe.prove.faults import inject_faults
from dmframe.prove.identity import Points, bound_of, empty, identity, inputs_at
found = from_json(open("claim.json").read())
faults = inject_faults(found, seed=0)
print(identity(found, trials=2, seed=0).zero, len(faults), all(fault.refuted for fault in faults))
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"True {len(inject_faults(claim('arm2_joint'), seed=0))} True\n", "")


def test_a_corrupted_file_is_refused_or_refuted_or_states_the_same() -> None:
    text, rng = to_json(claim("arm2_joint")), random.Random(4)
    outcomes = {"refused": 0, "refuted": 0, "zero": 0}
    for _ in range(60):
        found = json.loads(text)
        nodes = found["program"]["nodes"]
        node = rng.choice([node for node in nodes if node[0] not in ("input", "const")])
        place = rng.randrange(len(node))
        node[place] = rng.choice(["add", "mul", "sub", "neg", "sq"]) if place == 0 else rng.randrange(len(nodes))
        try:
            changed = from_json(json.dumps(found))
        except ValueFault:
            outcomes["refused"] += 1
            continue
        assert digest(changed) != digest(claim("arm2_joint")) or found == json.loads(text)
        outcomes["zero" if identity(changed, trials=1, seed=0).zero else "refuted"] += 1
    assert outcomes["refuted"] > 15
    assert outcomes["refused"] > 10
    assert outcomes["zero"] < 15  # operations exchanged for equal ones, and terms that change equally on both sides


@pytest.mark.parametrize(
    ("change", "reports"),
    [
        (lambda found: found.update(version=2), "expected version 1, found 2"),
        (lambda found: found.pop("symbols"), "symbols: missing or unknown key of a Claim"),
        (lambda found: found["program"]["nodes"].append(["launch", 0]), "KeyError: 'launch'"),
        (lambda found: found["program"]["nodes"].insert(0, ["add", 0, 0]), "the instruction 0, add"),
        (lambda found: found["program"].update(nodes=[]), "ValueError"),
    ],
)
def test_what_is_not_a_claim_is_refused(change: Any, reports: str) -> None:
    found = json.loads(to_json(claim("arm2_joint")))
    change(found)
    with pytest.raises(ValueFault, match=reports):
        from_json(json.dumps(found))
    with pytest.raises(ValueFault, match="a claim: expected the format of `to_json`"):
        from_json("no JSON")


def test_the_derivative_of_v_is_that_of_casadi() -> None:
    """The checker's dV/dt, in dual numbers, and CasADi's expression at the same point of the same field."""
    symbolic = claim_of(dm.load("ur10_fast").diagram)
    data = assembled(symbolic)
    from dmframe.certify.symbols import symbols_of
    from dmframe.prove.identity import inputs_at
    from dmframe.prove.point import Point

    rng = random.Random(8)
    trial = Trial(random_prime(rng), rng)
    inputs = inputs_at(data, trial)
    point = Point(data, trial, inputs, data.tape.values(inputs, trial))
    whole = next(equalities(point, point.moves(data.moved)))
    ours = sum(sum(s.column) for s in whole.summands if ": storage of " in s.name) % trial.prime
    function = symbols_of(symbolic).function("rate", [symbolic.flow.unrecorded(symbolic.V)])
    ((casadis,),) = Tape.from_function(function).evaluate(inputs[: len(data.symbols)], trial)
    assert ours == casadis != 0


def numbers_of(steps: NormalisedSteps | LeastSquaresSteps, rng: random.Random) -> tuple[dict[str, list[Any]], Any, Any]:
    """Random parts of steps, as balls, with CasADi's function of the same symbols and its inputs."""
    named: dict[str, Any] = {"theta": steps.theta, "true": steps.true, "gain": steps.gain, "floor": steps.floor}
    for k, (h, y) in enumerate(steps.rows):
        named |= {f"h{k}": h, f"y{k}": y}
    named |= dict(zip(("lower", "upper"), steps.box, strict=False))
    if isinstance(steps, LeastSquaresSteps):
        named |= {"gathered": steps.gathered, "retention": steps.retention}
    given = {name: [rng.uniform(0.2, 1.0) for _ in range(symbol.numel())] for name, symbol in named.items()}
    if steps.box:
        given["lower"] = [x + 0.05 for x in given["theta"]]  # some elements reach their face
        given["upper"] = [x + 1.0 for x in given["lower"]]
    if isinstance(steps, LeastSquaresSteps):
        given["gathered"] = [0.0] * len(given["gathered"])
    results = [*steps.moves.values(), steps.change / 2, steps.decrease / 2, steps.residual / 2]
    function = ca.Function("steps", list(named.values()), [ca.vec(x) for x in results])
    return {name: [ball(x) for x in values] for name, values in given.items()}, function, list(given.values())


@pytest.mark.parametrize("box", [False, True])
@pytest.mark.parametrize("squares", [False, True])
def test_the_checkers_steps_are_those_of_the_symbolic_lemma(squares: bool, box: bool) -> None:
    parts, size = (2, 3), 5
    symbols = {name: ca.SX.sym(name, size) for name in ("theta", "true", "gain", "h0", "h1", "lower", "upper")}
    rows = ((symbols["h0"], ca.SX.sym("y0", 2)), (symbols["h1"], ca.SX.sym("y1", 2)))
    ends = (symbols["lower"], symbols["upper"]) if box else ()
    common = symbols["theta"], symbols["true"], symbols["gain"], parts, ca.SX.sym("floor")
    steps: NormalisedSteps | LeastSquaresSteps
    if squares:
        theta, true, gain, parts, floor = common
        gathered = ca.SX.sym("gathered", 9)
        steps = LeastSquaresSteps(
            "w", "G", theta, gathered, true, gain, parts, floor, ca.SX.sym("retention"), rows, ends
        )
    else:
        steps = NormalisedSteps("w", *common, rows, ends)
    given, function, inputs = numbers_of(steps, random.Random(6))
    rule = Steps("least_squares" if squares else "normalised", "w", "G" if squares else "", parts, 2, box, {})
    found = step_result(Balls(), rule, given)
    ours = [*found.moves.values(), [found.moved], [found.lost], [found.gained]]
    theirs = [out.full().ravel().tolist() for out in function(*inputs)]
    for one, other in zip(ours, theirs, strict=True):
        assert [float(x) for x in one] == pytest.approx(other, rel=1e-9, abs=1e-12)


def test_a_matrix_times_its_inverse_is_one() -> None:
    rng = random.Random(1)
    trial = Trial(random_prime(rng), rng)
    W = [[trial.random() for _ in range(4)] for _ in range(4)]
    inverse = inverse_of(trial, W)
    product = [[sum(W[i][k] * inverse[k][j] for k in range(4)) % trial.prime for j in range(4)] for i in range(4)]
    assert product == [[int(i == j) for j in range(4)] for i in range(4)]


@final
class _Eliminating:
    """The ring of a trial without its own inverse of a matrix."""

    def __init__(self, trial: Trial) -> None:
        self.number, self.reduced, self.inverse = trial.number, trial.reduced, trial.inverse


@pytest.mark.parametrize("size", [1, 2, 7])
def test_a_matrix_has_the_inverse_that_elimination_finds(size: int) -> None:
    rng = random.Random(size)
    trial = Trial(random_prime(rng), rng)
    W = [[trial.random() - trial.random() for _ in range(size)] for _ in range(size)]
    assert inverse_of(trial, W) == inverse_of(_Eliminating(trial), W)
    with pytest.raises(ZeroDivision, match="singular"):
        inverse_of(trial, [*W[1:], [5 * x + trial.prime for x in W[-1]]] if size > 1 else [[trial.prime]])


def test_a_real_point_inside_its_box_is_known_to_be_there() -> None:
    ring, third, fifth = Balls(), ball(Fraction(1, 3)), ball(Fraction(1, 5))
    inside = ring.call("fmin", ring.call("fmax", third, ball(0)), ball(1))
    assert third.rad() > 0
    assert [ring.call(name, third, inside) for name in ("eq", "le", "ne", "lt")] == [1, 1, 0, 0]
    assert ring.call("eq", third, ring.call("fmax", third, fifth)) == 1
    assert ring.call("eq", third, ring.call("fmin", third, fifth)) == 0
    assert not ring.call("eq", third, fifth + (third - fifth)).is_finite()  # equal, although no object states it
    nothing = ball(1) / ball(0)
    assert not ring.call("eq", nothing, nothing).is_finite()
