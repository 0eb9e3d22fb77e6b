"""A false certificate is refuted alone and in a diagram; the verdict names its block and an exact point."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest
from closed_loops import Loop, known_blocks, loop_of

from dmframe.block import AbstractBlock, Signals
from dmframe.block.certificate import Certificate, Square
from dmframe.certify import claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.certify.summary import summary
from dmframe.diagram import Diagram
from dmframe.prove.refute import failing, refute, replay
from dmframe.robot.library import load

PROVABLE = {
    "PI": ["kinematics", "known_tracking"],
    "joint PI": ["joint_tracking", "regressor", "dynamic_compensator", "pi_inverse", "pi_servo", "manipulator"],
    "joint PID": ["pid_inverse", "pid_servo"],
}
FALSE = [(kind, loop, how) for loop, kinds in PROVABLE.items() for kind in kinds for how in ("storage", "dissipation")]
FALSE.append(("dynamic_compensator", "joint PI", "supply"))


def loop(which: str) -> Loop:
    return loop_of(load("arm2"), "joint" if "joint" in which else "task", which.split()[-1])


def with_false(block: type[AbstractBlock], how: str, factor: float = 1.0) -> type[AbstractBlock]:
    """The block with a further square in its storage, its dissipation or its supply rate."""

    def certificate(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        honest = block.certificate(self, u, x, p, truth)
        assert honest is not None
        column = next((u.__getattr__(port.name) for port in block.inputs if port.shape in ("n", "m")), None)
        column = x.__getattr__(block.states[0].name) if column is None else column
        added = Square(column, ca.SX(factor))
        return Certificate(
            storage=(*honest.storage, added) if how == "storage" else honest.storage,
            dissipation=(*honest.dissipation, added) if how == "dissipation" else honest.dissipation,
            supply=honest.supply + (added.value if how == "supply" else 0),
            consumes=honest.consumes,
            dominates=honest.dominates,
            truth=honest.truth,
            estimates=honest.estimates,
        )

    return type(block)(block.__name__, (block,), {"__module__": block.__module__, "certificate": certificate})


def diagram_with(which: str, changed: dict[str, type[AbstractBlock]]) -> Diagram:
    return loop(which).build(changed, lambda _, mutant: mutant)


@pytest.mark.parametrize(("kind", "which", "how"), FALSE)
def test_a_false_certificate_of_any_block_is_refuted_alone_and_in_the_diagram_with_its_name(
    kind: str, which: str, how: str
) -> None:
    diagram = diagram_with(which, {kind: with_false(known_blocks()[kind], how)})
    (false,) = (name for name in diagram.blocks if diagram.type_of(name) == kind)
    claim = assembled(claim_of(diagram))
    # no supply rate is part of dV/dt of the diagram, where they cancel: a false one fails its own block's claim only
    whole = [] if how == "supply" else ["dV/dt"]
    assert [label for label, _ in failing(claim, seed=0)] == [*whole, f"{false}: dS/dt"]

    verdict = verify(diagram, trials=1)
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert verdict.refutation.blame == (false,)
    assert verdict.reason.endswith(f"to blame: {false}")
    assert replay(claim, verdict.refutation) == verdict.refutation.residue != 0


def test_two_false_certificates_that_cancel_in_the_sum_are_refuted_by_their_sign() -> None:
    changed = {"regressor": with_false(known_blocks()["regressor"], "storage", 1.0)}
    changed["pi_inverse"] = with_false(known_blocks()["pi_inverse"], "storage", -1.0)
    verdict = verify(diagram_with("PI", changed), trials=1)
    assert verdict.outcome == "refuted"
    assert verdict.refutation is not None
    assert set(verdict.refutation.blame) == {"model", "inverse"}


def test_a_refutation_has_the_fewest_signals() -> None:
    diagram = diagram_with("PI", {"pi_inverse": with_false(known_blocks()["pi_inverse"], "dissipation")})
    claim = assembled(claim_of(diagram))
    found = refute(claim, seed=0)
    # the further square is |q|^2: q alone is sufficient, and without q the residual vanishes
    assert found.signals == ("arm.q",)
    point = dict(found.point)
    zero = {s.label for s in claim.symbols if s.kind in ("state", "trajectory", "projection")} - set(found.signals)
    assert zero
    assert all(not any(point[label]) for label in zero)


def test_the_exact_point_of_a_refutation_replays_after_json() -> None:
    diagram = diagram_with("PID", {"pid_inverse": with_false(known_blocks()["pid_inverse"], "storage")})
    claim = assembled(claim_of(diagram))
    verdict = verify(diagram)
    stated = json.loads(json.dumps(summary("false", verdict)))["refutation"]
    assert verdict.refutation is not None
    labels = [label for label, _ in verdict.refutation.point]
    assert len(set(labels)) == len(labels)
    functions = [label for label in labels if label.startswith(("cos, sin of ", "tanh of "))]
    assert functions
    again = type(verdict.refutation)(
        blame=tuple(stated["blame"]),
        signals=tuple(stated["signals"]),
        prime=int(stated["prime"]),
        point=tuple((label, tuple(int(x) for x in values)) for label, values in stated["point"].items()),
        residue=int(stated["residue"]),
        statement=verdict.refutation.statement,
    )
    assert replay(claim, again) == again.residue != 0


def test_a_false_statement_of_how_sigma_is_composed_is_refuted_and_blamed() -> None:
    block = known_blocks()["pid_inverse"]

    def certificate(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        honest = block.certificate(self, u, x, p, truth)
        assert honest is not None
        return replace(honest, dominates=(ca.SX(1), 2 * p.K_c), linear=())

    false = type(block)(block.__name__, (block,), {"__module__": block.__module__, "certificate": certificate})
    verdict = verify(diagram_with("PID", {"pid_inverse": false}))
    assert verdict.outcome == "refuted"
    assert verdict.reason.startswith(
        "inverse: the vector that it dominates is that of task is not what the block claims"
    )
    assert verdict.refutation is not None
    assert verdict.refutation.blame == ("inverse",)
    claim = assembled(claim_of(diagram_with("PID", {"pid_inverse": false})))
    assert replay(claim, verdict.refutation) == verdict.refutation.residue != 0


def test_a_square_that_is_identically_zero_is_no_proof() -> None:
    block = known_blocks()["joint_tracking"]

    def certificate(self: Any, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        honest = block.certificate(self, u, x, p, truth)
        assert honest is not None
        idle = Square(u.q - 2 * u.q_d / 2 - u.q + u.q_d, ca.SX(1))
        return Certificate((*honest.storage, idle), honest.dissipation, honest.supply, consumes=honest.consumes)

    false = type(block)(block.__name__, (block,), {"__module__": block.__module__, "certificate": certificate})
    verdict = verify(diagram_with("joint PI", {"joint_tracking": false}), trials=1)
    assert verdict.outcome == "not_applicable"
    assert verdict.reason.startswith("identically zero, so that nothing would be proved: task: ")
