"""A sample of the faults seeded into equations, certificates and shared functions; ``make mutants`` tries all."""

from __future__ import annotations

import inspect
import json
import random
import textwrap
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import mutants
import numpy as np
import pytest
from closed_loops import (
    Built,
    field_of,
    known_blocks,
    loop_of,
    loops,
    negative_in_numbers,
    same_field,
    states_of,
    true_in_numbers,
)
from judged_faults import (
    SAME_RATES,
    UNCHANGED,
    Result,
    concluded,
    homes,
    judged,
    new_conclusions,
    nothing_printed,
    reusing,
    statement,
    tried,
    verdict_without_faults,
)
from seeded_faults import LAW, LIBRARY, Mutant, all_mutants, block_mutants, library_mutants, mutated_block

from dmframe.block.certificate import Certificate, Square
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.certify import claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.prove.identity import identity
from dmframe.robot.library import load

ACCEPTED = {"refuted", "no diagram", "condition", "units", "equivalent", "unchanged"}
"""All outcomes but ``survived``."""


@cache
def held() -> frozenset[str]:
    """Types of blocks in a closed loop."""
    return frozenset(kind for loop in loops() for kind in loop.types)


LEAST = {"helpers": 2, "adapting": 1, "linalg": 6}
"""Faults refuted of a sample of 20: no proof depends on the paths of sources, which are most of the shared code, and
an adaptation with another group of signals names a signal that this group does not contain."""


def loop(name: str) -> Built:
    """A closed loop by name."""
    (found,) = (each for each in loops() if each.name == name)
    return found


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> tuple[Built, ...]:
    """One closed loop for each number of joints up to three, instead of all."""
    found = tuple(map(loop, ("odd3 joint PI", "arm2 joint PI", "pd_torque")))
    monkeypatch.setattr("judged_faults.loops", lambda: found)
    return found


def sample(mutants: Iterable[Mutant]) -> list[Mutant]:
    """All of a few, half of some, a tenth of more, fewer of many."""
    found = list(mutants)
    return found[:: 1 if len(found) < 5 else 2 if len(found) < 20 else 10 if len(found) < 60 else 24]


def results_of(mutants: Iterable[Mutant]) -> list[Result]:
    """The result of each fault; none may survive."""
    results = [tried(mutant)[0] for mutant in mutants]
    assert [str(result.mutant) for result in results if result.outcome not in ACCEPTED] == []
    return results


def test_no_fault_in_the_equations_of_any_block_is_proved_unless_dv_dt_remains_true() -> None:
    blocks = {kind: block for kind, block in known_blocks().items() if block.side is not Side.SOURCE and kind in held()}
    results = results_of(mutant for kind in blocks for mutant in sample(block_mutants(kind, blocks[kind])))
    assert len(results) >= 100
    # V decreases with any wall, along any goal that an admittance computes from its force, along any reference that
    # limits compute from another one, and at any pace along a path
    free = {"admittance", "wall", "safe_reference", "path_wait"}
    acting = [r for r in results if r.outcome != "no diagram" and r.reason not in (SAME_RATES, UNCHANGED)]
    acting = [r for r in acting if r.mutant.owner not in free]
    outcomes = Counter(result.outcome for result in acting)
    assert outcomes["units"] > 0  # for these the identity is true
    others = [(str(r.mutant), r.loop, r.reason) for r in acting if r.outcome not in ("refuted", "units")]
    assert len(others) < 0.1 * (len(acting) - outcomes["units"]), others
    # V does not depend on a redundant robot's self-motion, nor on the outputs of a payload estimate; without a term
    # in the error V decreases along any reference
    unseen = {"null_space_posture", "joint_feedforward", "payload_estimate"}
    refuted = {result.mutant.owner for result in results if result.outcome == "refuted"}
    for kind in sorted(set(blocks) - unseen - free - refuted):  # the few that were tried were not refuted
        if any(tried(mutant)[0].outcome == "refuted" for mutant in block_mutants(kind, blocks[kind])):
            refuted.add(kind)
    assert refuted - free == set(blocks) - unseen - free


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("kind", ["pi_servo", "pi_inverse", "dynamic_compensator", "joint_tracking"])
def test_a_fault_in_the_equations_of_one_block_of_each_stage_is_refuted(kind: str) -> None:
    outcomes = (tried(fault)[0].outcome for fault in block_mutants(kind, known_blocks()[kind]))
    assert next(outcome for outcome in outcomes if outcome != "no diagram") == "refuted"


def test_every_block_with_equations_of_motion_and_a_certificate_is_in_a_closed_loop() -> None:
    answering = {k: b for k, b in known_blocks().items() if b.side is not Side.SOURCE}
    continuous = {k: b for k, b in answering.items() if not any(s.sampled for s in b.states)}
    channels = {kind for kind, block in continuous.items() if any(port.instead_of for port in block.outputs)}
    # they have no certificate
    assert continuous.keys() - held() - channels == {
        *("kinematic_command", "sampled_tracking", "sampled_joint_tracking", "extended_state_observer"),
    }


def test_the_kinematic_baseline_has_no_certificate_that_a_fault_could_falsify() -> None:
    block = known_blocks()["kinematic_command"]
    assert "certificate" not in vars(block)
    assert len(list(block_mutants("kinematic_command", block))) > 0


def test_faults_in_certificates_are_refuted_or_leave_a_true_claim() -> None:
    faults = [m for m in all_mutants(certificates=True, library=False) if m.original.__name__ not in LAW]
    results = results_of([m for m in faults if m.owner in held() and not m.original.__name__.startswith("_one")][::150])
    assert Counter(result.outcome for result in results)["refuted"] > 0.6 * len(results)


@pytest.mark.parametrize("which", LIBRARY)
def test_faults_in_shared_functions_are_refuted_or_leave_a_true_claim(which: str) -> None:
    faults = list(library_mutants(which))
    results = results_of(faults[:: max(1, len(faults) // (60 if which == "adapting" else 20))])
    refuted = Counter(result.outcome for result in results)["refuted"]
    assert refuted >= LEAST.get(which, 7), refuted
    lost = ("NameError", "UnboundLocalError", "ImportError")  # of the harness, since no fault creates a name
    assert [result.reason for result in results if any(word in result.reason for word in lost)] == []


def test_no_source_is_part_of_the_claim() -> None:
    claim = claim_of(loop("arm2 joint PID").diagram)
    own = {s for p in claim.loop.parameters if p.label.startswith("path.") for s in symbols_in([p.symbol])}
    assert own
    assert not own & symbols_in([claim.V, *claim.flow.rates_of(symbols_in([claim.V])).values()])


def faulty(kind: str, ending: str) -> Mutant:
    """The last fault of a block's equations whose description ends so: rates follow outputs."""
    return [mutant for mutant in block_mutants(kind, known_blocks()[kind]) if mutant.fault.endswith(ending)][-1]


def test_the_independent_dv_dt_shows_a_false_claim() -> None:
    of = loop("arm2 task PI")
    assert true_in_numbers(of.diagram, claim_of(of.diagram))
    broken = of.build({"pi_servo": faulty("pi_servo", "'i' doubled")}, mutated_block)
    assert not true_in_numbers(broken, claim_of(broken))
    assert not same_field(broken, of.diagram)


def test_a_term_below_zero_is_seen_in_numbers() -> None:
    block = known_blocks()["joint_tracking"]

    def certificate(self: Any, u: Any, x: Any, p: Any, truth: Any) -> Certificate:
        honest = block.certificate(self, u, x, p, truth)
        assert honest is not None
        return Certificate(honest.storage, (*honest.dissipation, Square(u.q, ca.SX(-3))), honest.supply)

    negative = type(block)(block.__name__, (block,), {"__module__": block.__module__, "certificate": certificate})
    of = loop_of(load("arm2"), "joint", "PI").build({"joint_tracking": negative}, lambda _, mutant: mutant)
    assert negative_in_numbers(of, claim_of(of)) == ["task, dissipation 3"]  # the last one
    assert negative_in_numbers(loop("arm2 joint PI").diagram, claim_of(loop("arm2 joint PI").diagram)) == []


def test_the_field_of_a_run_is_the_rate_of_every_state() -> None:
    diagram = loop("arm2 task PID").diagram
    of = diagram.loop
    joined = of.joined([ca.vertcat(*(variable.own_rate for variable in of.variables))])[0]
    exact = ca.Function("F", [of.state, of.time, of.p], [of.on_path(joined)])
    rates = field_of(diagram)
    for state, t in states_of(diagram, 3, 0):
        np.testing.assert_allclose(rates(state, t), exact(state, t, of.p_values).full().ravel(), rtol=1e-8, atol=1e-8)


def test_every_closed_loop_is_proved_without_faults_as_the_harness_builds_it() -> None:
    for of in loops():
        with reusing(of.diagram), nothing_printed():
            verdict = verify(of.build(), trials=1)
        assert verdict.outcome == "proved", (of.name, verdict.reason)


def test_every_closed_loop_is_true_without_faults() -> None:
    for of in loops():
        with nothing_printed():
            claim = claim_of(of.diagram)
        assert identity(assembled(claim), trials=1, seed=0).zero, of.name
        assert true_in_numbers(of.diagram, claim), of.name


def test_a_fault_is_refuted_where_v_is_undefined_at_random_points() -> None:
    """V depends on the logarithm of a determinant that random numbers do not make positive; dV/dt does not."""
    fault = faulty("accelerometer", "'ddq_m' negated")
    assert judged(fault, loop("torque_consistent_pi")).outcome == "refuted"


def test_reused_models_give_the_verdicts_of_new_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    of = loop("arm2 joint PI")
    chosen = random.Random(2).sample(
        [m for k in ("pi_inverse", "pi_servo") for m in block_mutants(k, known_blocks()[k])], 5
    )
    reused = [judged(mutant, of).outcome for mutant in chosen]
    monkeypatch.setattr("judged_faults.reusing", lambda diagram: nothing_printed())
    assert [judged(mutant, of).outcome for mutant in chosen] == reused
    assert len(set(reused)) > 1


def test_two_statements_of_a_block_are_equal_exactly_if_no_expression_changes() -> None:
    of, block = loop("arm2 joint PI"), known_blocks()["pi_servo"]
    doubled = faulty("pi_servo", "'i' doubled")
    unchanged = replace(doubled, source=textwrap.dedent(inspect.getsource(doubled.original)))
    own = statement(of, "pi_servo", block)
    assert own is not None
    assert statement(of, "pi_servo", mutated_block(block, unchanged)) == own
    assert statement(of, "pi_servo", mutated_block(block, doubled)) not in (own, None)


def test_a_conclusion_that_a_fault_adds_is_found_and_one_that_it_takes_is_not() -> None:
    of, block = loop("torque_direct_pi"), known_blocks()["pi_torque_inverse"]
    certificates = block_mutants("pi_torque_inverse", block, ("certificate",))
    fault = next(mutant for mutant in certificates if mutant.fault.endswith("u.q_c - u.q: only -u.q left"))
    assert concluded(fault, of).reason == "only conclusions depend on it, and none is new"
    fewer, before = verify(of.build({"pi_torque_inverse": fault}, mutated_block)), verdict_without_faults(of)
    assert new_conclusions(fewer, before) == []
    assert {"q - q_d goes to zero", "servo.q_c is bounded"} < set(new_conclusions(before, fewer))


def test_a_fault_of_a_shared_function_is_put_into_robots_of_several_sizes(few: tuple[Built, ...]) -> None:
    fault = next(m for m in library_mutants("symbolic") if m.fault.endswith("omega * dq[i]: only omega left"))
    assert [of.robot.n for of in homes(fault, few)] == [1, 2, 3]
    assert tried(fault)[0].outcome == "refuted"  # not with parallel axes


def row(outcome: str, reason: str = "", sources: str = "here") -> dict[str, str | float]:
    return {"fault": "f", "loop": "l", "outcome": outcome, "reason": reason, "seconds": 0.5, "sources": sources}


def test_a_survivor_or_a_lost_name_is_an_error_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    refused = row("no diagram", "arm: equations(), a.py:3: RuntimeError: incompatible dimensions")
    assert mutants.reported([row("refuted"), refused, row("equivalent", SAME_RATES)], every=False) == 0
    assert "1 no diagram: RuntimeError in the function" in capsys.readouterr().out
    for bad in (row("survived"), row("no diagram", "NameError: name '_factors' is not defined")):
        assert mutants.reported([row("refuted"), bad], every=False) == 1
        assert f"{bad['outcome']}: f [l]:" in capsys.readouterr().out


def test_results_of_other_sources_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutants, "sources", lambda: "here")
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps(row("refuted", sources=of)) + "\n" for of in ("here", "before")))
    assert mutants.read_results(file) == [row("refuted")]
    assert mutants.read_results(tmp_path / "none.jsonl") == []
