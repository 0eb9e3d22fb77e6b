"""Instructions that do not give a number everywhere: divisions, and functions that are not defined everywhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import casadi as ca

from dmframe.certificate import SX

DEFINED: Final = {
    getattr(ca, f"OP_{name}"): name.lower()
    for name in "LOG LOG1P ASIN ACOS ACOSH ATANH TAN POW CONSTPOW ERFINV SQRT FMOD REMAINDER".split()
}
"""Functions that are not defined, or not bounded, everywhere."""
DIVISIONS: Final = {ca.OP_DIV: 1, ca.OP_INV: 0}
"""Instructions that divide, with the place of the divisor."""


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
        if code in DIVISIONS:
            yield code, parts[DIVISIONS[code]]
        elif code in DEFINED and not _is_safe(code, parts):
            yield code, parts[1] if code in (ca.OP_FMOD, ca.OP_REMAINDER) else parts[0]
        todo += parts


def _is_safe(code: int, parts: Sequence[SX]) -> bool:
    """A root of max(x, c), c > 0, and a whole power that is not negative, are defined everywhere."""
    if code == ca.OP_SQRT and parts[0].n_dep() == 2 and parts[0].op() == ca.OP_FMAX:
        floors = [parts[0].dep(k) for k in range(2)]
        return any(floor.is_constant() and float(floor) > 0 for floor in floors)
    if code in (ca.OP_POW, ca.OP_CONSTPOW) and parts[1].is_constant():
        return float(parts[1]) >= 0 and float(parts[1]).is_integer()
    return False
