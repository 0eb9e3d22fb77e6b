"""Some hundred of the faults in equations, certificates and the plant library, each in the least loop that holds it.

``make mutants`` tries all of them; with ``MUTANTS=--everywhere`` in all loops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import casadi as ca
import numpy as np
import pytest
from closed_loops import Loop, field_of, known_blocks, loops, states_of, true_in_numbers
from mutants import (
    LAW,
    LIBRARY,
    Mutant,
    Result,
    all_mutants,
    block_mutants,
    homes,
    judged,
    library_mutants,
    mutated_block,
    nothing_printed,
)

from dmframe.block.model import symbols_in
from dmframe.certify import claim_of
from dmframe.certify.assemble import assembled
from dmframe.port import Side
from dmframe.prove.identity import identity

CAUGHT = {"refuted", "no diagram", "condition", "units", "equivalent"}


def small(kinds: Iterable[str] = ()) -> list[Loop]:
    """Loops of the planar arm, at its joints where that will do: a third of the time of the odd chain's."""
    found = [loop for loop in loops() if "odd" not in loop.name and all(kind in loop.types for kind in kinds)]
    return [loop for loop in found if "joint" in loop.name] or found


def some(mutants: Iterable[Mutant]) -> list[Mutant]:
    """All of a few, half of some, a tenth of more, fewer of many; `make mutants` tries them all."""
    found = list(mutants)
    return found[:: 1 if len(found) < 5 else 2 if len(found) < 20 else 10 if len(found) < 60 else 24]


def tried(mutants: Sequence[Mutant]) -> list[Result]:
    """The result of each, loop by loop; of a block with few faults in up to three, until one is found."""
    results, faults = [], Counter(mutant.owner for mutant in mutants)
    for turn, mutant in enumerate(mutants):
        blocks = mutant.owner in known_blocks()
        fitting = small([mutant.owner]) if blocks else small()
        for further in range(min(3, len(fitting)) if blocks and faults[mutant.owner] < 4 else 1):
            result = judged(mutant, fitting[(turn + further) % len(fitting)])
            if result.outcome != "equivalent":
                break
        results.append(result)
    return results


def test_of_more_than_100_faults_in_the_equations_of_all_blocks_none_is_proved_unless_dv_dt_is_true_all_the_same() -> (
    None
):
    blocks = {kind: block for kind, block in known_blocks().items() if block.side is not Side.SOURCE}
    provable = [kind for kind in blocks if homes(kind, loops())]
    mutants = [mutant for kind in provable for mutant in some(block_mutants(kind, blocks[kind]))]
    results = tried(mutants)
    assert [str(result.mutant) for result in results if result.outcome not in CAUGHT] == []
    assert len(results) >= 100
    # any wall is an environment, and V falls along any goal that an admittance makes of its force, along any reference
    # that limits make of one, and at any pace along a path
    free = {"admittance", "wall", "safe_reference", "path_wait"}
    acting = [r for r in results if r.outcome != "no diagram" and r.reason != "the rates are unchanged"]
    acting = [r for r in acting if r.mutant.owner not in free]
    outcomes = Counter(result.outcome for result in acting)
    assert outcomes["units"] > 0  # of these the identity is true
    assert outcomes["refuted"] > 0.9 * (len(acting) - outcomes["units"])
    # V does not weigh a redundant robot's self-motion; without a term in the error any reference falls along V
    unseen = {"null_space_posture", "joint_feedforward", "payload_estimate"}  # the last reports, and moves nothing
    refuted = {result.mutant.owner for result in results if result.outcome == "refuted"}
    expected = set(provable) - unseen - free
    for kind in sorted(expected - refuted):  # the few that were tried were not refuted
        if any(tried([mutant])[0].outcome == "refuted" for mutant in block_mutants(kind, blocks[kind])):
            refuted.add(kind)
    assert refuted - free == expected


@pytest.mark.parametrize("kind", ["pi_servo", "pi_inverse", "dynamic_compensator", "joint_tracking"])
def test_a_fault_in_the_equations_of_one_block_of_each_stage_is_refuted(kind: str) -> None:
    (result,) = tried(list(block_mutants(kind, known_blocks()[kind]))[:1])
    assert result.outcome == "refuted"


def test_every_block_that_has_equations_of_motion_and_a_certificate_is_in_a_loop_that_is_proved() -> None:
    answering = {k: b for k, b in known_blocks().items() if b.side is not Side.SOURCE}
    continuous = {k: b for k, b in answering.items() if not any(s.sampled for s in b.states)}
    without = {kind for kind in continuous if not homes(kind, loops())}
    stand_ins = {kind for kind, block in continuous.items() if any(port.instead_of for port in block.outputs)}
    # they have no certificate
    assert without - stand_ins == {"kinematic_command", "sampled_tracking", "extended_state_observer"}


def test_a_fault_in_the_kinematic_baseline_changes_nothing_since_it_claims_nothing() -> None:
    block = known_blocks()["kinematic_command"]
    assert "certificate" not in vars(block)
    assert len(list(block_mutants("kinematic_command", block))) > 0


def test_faults_in_certificates_are_refuted_or_leave_a_claim_that_is_true() -> None:
    mutants = [m for m in all_mutants(certificates=True, library=False) if m.original.__name__ not in LAW]
    provable = [mutant for mutant in mutants if homes(mutant.owner, loops())]
    results = tried([m for m in provable if not m.original.__name__.startswith("_one")][::150])
    assert [str(result.mutant) for result in results if result.outcome not in CAUGHT] == []
    assert Counter(result.outcome for result in results)["refuted"] > 0.6 * len(results)


@pytest.mark.parametrize("which", LIBRARY)
def test_faults_in_the_plant_library_are_refuted_or_make_another_robot(which: str) -> None:
    mutants = list(library_mutants(which))
    results = tried(mutants[:: max(1, len(mutants) // 25)])
    assert [str(result.mutant) for result in results if result.outcome not in CAUGHT] == []
    assert Counter(result.outcome for result in results)["refuted"] >= 7


def test_a_source_has_no_part_in_the_claim() -> None:
    claim = claim_of(small(["waypoints"])[0].diagram)
    own = {s for p in claim.loop.parameters if p.label.startswith("path.") for s in symbols_in([p.symbol])}
    assert own
    assert not own & symbols_in([claim.V, *claim.flow.rates_of(symbols_in([claim.V])).values()])


def test_the_independent_look_at_dv_dt_sees_a_false_claim() -> None:
    loop = small()[0]
    claim = claim_of(loop.diagram)
    assert true_in_numbers(loop.diagram, claim)
    faults = {
        mutant.fault.split(": ", 1)[1]: mutant for mutant in block_mutants("pi_servo", known_blocks()["pi_servo"])
    }
    broken = loop.build({"pi_servo": faults["'i' doubled"]}, mutated_block)
    assert not true_in_numbers(broken, claim_of(broken))


def test_the_field_of_a_run_is_the_rate_of_every_state() -> None:
    diagram = small()[1].diagram
    loop = diagram.loop
    joined = loop.joined([ca.vertcat(*(variable.own_rate for variable in loop.variables))])[0]
    exact = ca.Function("F", [loop.state, loop.time, loop.p], [loop.on_path(joined)])
    rates = field_of(diagram)
    for state, t in states_of(diagram, 3, 0):
        np.testing.assert_allclose(rates(state, t), exact(state, t, loop.p_values).full().ravel(), rtol=1e-8, atol=1e-8)


def test_every_loop_that_faults_are_put_into_is_true_without_them() -> None:
    for loop in loops():
        with nothing_printed():
            claim = claim_of(loop.diagram)
        assert identity(assembled(claim), trials=1, seed=0).zero, loop.name


def test_a_fault_is_refuted_where_no_random_point_gives_v_a_value() -> None:
    """V holds the logarithm of a determinant that random numbers do not make positive; dV/dt does not hold it."""
    (loop,) = (each for each in loops() if each.name == "torque_consistent_pi")
    (fault,) = (
        mutant
        for mutant in block_mutants("accelerometer", known_blocks()["accelerometer"])
        if mutant.fault.endswith("'ddq_m' negated")
    )
    assert judged(fault, loop).outcome == "refuted"
