"""Instructions that do not give a number everywhere: divisions, and functions that are not defined everywhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

from dmframe.certificate import SX
from dmframe.program import OPERATIONS, POWERS


def risky(outputs: Sequence[SX]) -> Iterator[tuple[int, SX]]:
    """Instructions that divide or are not defined everywhere, with what must keep away from a bad value."""
    todo = [element for output in outputs for element in ca.vertsplit(ca.vec(ca.densify(output)))]
    seen = set[int]()
    while todo:
        x = todo.pop()
        if x.element_hash() in seen or not x.n_dep():
            continue
        seen.add(x.element_hash())
        code, parts = x.op(), [x.dep(k) for k in range(x.n_dep())]
        domain = OPERATIONS[code].domain if code in OPERATIONS else None
        if domain is not None and not _is_safe(code, parts):
            yield code, parts[domain]
        todo += parts


def _is_safe(code: int, parts: Sequence[SX]) -> bool:
    """A root of max(x, c), c > 0, and a whole power that is not negative, are defined everywhere."""
    if code == ca.OP_SQRT and parts[0].n_dep() == 2 and parts[0].op() == ca.OP_FMAX:
        floors = [parts[0].dep(k) for k in range(2)]
        return any(floor.is_constant() and float(floor) > 0 for floor in floors)
    if code in POWERS and parts[1].is_constant():
        return float(parts[1]) >= 0 and float(parts[1]).is_integer()
    return False
