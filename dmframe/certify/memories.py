"""Where gathered matrices start: below zero, they stay so for a while, and their form is no storage."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import numpy as np

from dmframe.block.faults import told_by
from dmframe.certificate import SX, Gathered
from dmframe.certify.checked import Checked
from dmframe.certify.claim import Claim
from dmframe.certify.definite import is_semidefinite
from dmframe.diagram.view import view
from dmframe.exact.rational import Interval, evaluate
from dmframe.robot.rational import decimal


def memory_starts(claim: Claim) -> list[Checked]:
    """For each gathered matrix whose start is a number of the graph: whether that is positive semidefinite.

    A start that is not given is zero, and is left out here; one that a block computes is left to the assumption that
    the claim carries.
    """
    found = dict[str, Checked]()
    for part in claim.parts:
        for term in (*part.certificate.storage, *part.certificate.dissipation):
            if isinstance(term, Gathered):
                start = _start_of(claim, part.block, term.memory)
                if start is not None and any(map(any, start)):
                    name = f"{part.block}: start of what G gathers for |{term.of}|_G^2 >= 0"
                    mirrored = [list(column) for column in zip(*start, strict=True)]
                    holds = is_semidefinite(start) and start == mirrored
                    found[name] = Checked(
                        name, "G(0) is symmetric and positive semidefinite", None, holds, "V is positive"
                    )
    return list(found.values())


def _start_of(claim: Claim, block: str, memory: SX) -> list[list[Fraction]] | None:
    """G at the start; None where it depends on more than its block's own states and their given numbers."""
    model, seen = claim.diagram.models[block], view(claim.diagram, block, claim.truths)
    with told_by(block, "start()"):
        said = model.block.composed_start(seen.u, seen.p, seen.truth)
    if set(said) & set(model.states) - set(model.values):
        return None
    own = [np.broadcast_to(model.values.get(name, 0.0), leaf.shape) for name, leaf in model.states.items()]
    leaves = ca.vertcat(ca.SX(0, 1), *(ca.vec(leaf) for leaf in model.states.values()))
    function = ca.Function("G", [leaves], [ca.densify(memory)], {"allow_free": True})
    if function.has_free():
        return None
    flat = [decimal(float(x)) for value in own for x in np.ravel(value, order="F")]
    (values,) = evaluate(function, [flat])
    rows = memory.shape[0]
    return [[Interval.of(values[column * rows + row]).lower for column in range(rows)] for row in range(rows)]
