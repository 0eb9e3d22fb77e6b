"""Stable linear subsystems of certificates: whether their matrices are stable, at numbers and as a margin."""

from __future__ import annotations

from contextlib import suppress

import casadi as ca

from dmframe.block.certificate import SX, StableLinear
from dmframe.block.model import symbols_in
from dmframe.certify.checked import Numbers
from dmframe.common.errors import ValueFault
from dmframe.diagram.projection import Box
from dmframe.exact.rational import Interval
from dmframe.prove.definite import Number, lower, upper
from dmframe.prove.stability import is_stable_matrix


def is_stable(subsystem: StableLinear, numbers: Numbers) -> bool | None:
    r"""Is :math:`\dot z = A z` stable for each joint, at the graph's numbers, or while A's states move in their boxes?

    None where A holds something else, so that nothing decides it.
    """
    A = [[_values(rate, numbers) for rate in row] for row in subsystem.rates]
    if any(entry is None for row in A for entry in row):
        return None
    rows = [[entry for entry in row if entry is not None] for row in A]
    joints = max(len(entry) for row in rows for entry in row)
    return all(is_stable_matrix([[entry[j % len(entry)] for entry in row] for row in rows]) for j in range(joints))


def stability_margin(subsystem: StableLinear) -> SX:
    """Above zero where A, made of parameters alone, is stable."""
    if len(subsystem.rates) == 1:
        return -ca.SX(subsystem.rates[0][0])
    (a, b), (c, d) = [[ca.SX(rate) for rate in row] for row in subsystem.rates]
    return ca.vertcat(ca.vec(-(a + d)), ca.vec(a * d - b * c))


def _values(rate: SX, numbers: Numbers) -> list[Number] | None:
    """The values of an entry; of a state with a box, all that the box holds. None where it holds anything else."""
    with suppress(ValueFault, ZeroDivisionError):
        for projection in numbers.claim.loop.projections:
            if isinstance(projection.set, Box) and symbols_in([rate]) & symbols_in([projection.state]):
                ends = [numbers.of(end) for end in (projection.set.lower, projection.set.upper)]
                inside = [Interval(lower(low), upper(high)) for low, high in zip(*ends, strict=True)]
                return numbers.with_states(rate, projection.state, inside)
        return numbers.of(rate)
    return None
