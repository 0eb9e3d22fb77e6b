"""Stability of the matrices of linear subsystems in certificates, at numbers and as a margin."""

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
    r"""Stability of :math:`\dot z = A z` for each joint, at numbers or for all states in their boxes.

    None if A contains other signals, so that its stability is not decided.
    """
    A = [[_values(rate, numbers) for rate in row] for row in subsystem.rates]
    if any(entry is None for row in A for entry in row):
        return None
    rows = [[entry for entry in row if entry is not None] for row in A]
    joints = max(len(entry) for row in rows for entry in row)
    return all(is_stable_matrix([[entry[j % len(entry)] for entry in row] for row in rows]) for j in range(joints))


def stability_margin(subsystem: StableLinear) -> SX:
    """An expression that is positive if A, made of parameters only, is stable."""
    if len(subsystem.rates) == 1:
        return -ca.SX(subsystem.rates[0][0])
    (a, b), (c, d) = [[ca.SX(rate) for rate in row] for row in subsystem.rates]
    return ca.vertcat(ca.vec(-(a + d)), ca.vec(a * d - b * c))


def _values(rate: SX, numbers: Numbers) -> list[Number] | None:
    """Values of an entry; of a state with a box, its interval. None if it contains other signals."""
    with suppress(ValueFault, ZeroDivisionError):
        for projection in numbers.claim.loop.projections:
            if isinstance(projection.set, Box) and symbols_in([rate]) & symbols_in([projection.state]):
                ends = [numbers.of(end) for end in (projection.set.lower, projection.set.upper)]
                inside = [Interval(lower(low), upper(high)) for low, high in zip(*ends, strict=True)]
                return numbers.with_states(rate, projection.state, inside)
        return numbers.of(rate)
    return None
