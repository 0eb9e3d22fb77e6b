"""The matrix A of a linearly implicit step: the Jacobian of a rate, or its cheap part that can be stiff."""

from __future__ import annotations

from typing import Any, Final, NamedTuple, final

import casadi as ca

from dmframe.program import CONST, INPUT, OPERATIONS, read

EXPENSIVE: Final = 3
"""An exact Jacobian with more than this many times the instructions of the rate is replaced by a cheaper one."""

_CONSTANT_OPERATIONS: Final = frozenset(
    code
    for code, row in OPERATIONS.items()
    if row.name in {"sin", "cos", "sq", "inv", "sqrt", "pow", "constpow", "atan2", "hypot", "tan", "asin", "acos"}
)
_FACTORS: Final = frozenset((ca.OP_MUL, ca.OP_DIV))


@final
class Slopes(NamedTuple):
    """(x, u, w, p) -> the approximate Jacobian that a linearly implicit method uses, and the exact one.

    Both are the same object if the exact Jacobian is cheap. The approximate one treats sines, cosines, powers, and
    products of moving values as constants. It contains the exact derivatives of servos and friction, which can be
    stiff, and omits those of inertia, gravity and Coriolis forces, which are not.
    """

    used: Any
    exact: Any

    @classmethod
    def of(cls, rate: Any, explicit: int) -> Slopes:
        """Jacobians of (x, u, w, p) -> dx without the first `explicit` rows and columns."""
        given = x, u, w, p = [ca.SX.sym(name, rate.numel_in(i)) for i, name in enumerate("xuwp")]
        fast, others = x[explicit:], ca.vertcat(x[:explicit], u, w, p)
        (rates,) = ca.cse([rate(*given)[explicit:]])
        slopes = ca.sparsify(ca.jacobian(rates, fast))
        exact = ca.Function("exact", given, [slopes])
        if _instructions([rates, slopes], given) <= (1 + EXPENSIVE) * _instructions([rates], given):
            return cls(exact, exact)
        moving = ca.SX.sym("moving", fast.numel())
        (cheap,) = ca.substitute([ca.jacobian(_with_constants(rates, fast, others, moving), moving)], [moving], [fast])
        return cls(ca.Function("used", given, [ca.sparsify(cheap)]), exact)


def _with_constants(rate: Any, x: Any, others: Any, moving: Any) -> Any:
    """The same values, with `moving` for x in the operations whose derivative is used."""
    program = read(ca.Function("rate", [x, others], [ca.densify(rate)]))
    still, live = list[Any](), list[Any]()  # each value, and the same with `moving`; None if it does not depend on x
    for node in program.nodes:
        if node.code == INPUT:
            still.append((x, others)[node.a].nz[node.b])
            live.append(moving.nz[node.b] if node.a == 0 else None)
            continue
        if node.code == CONST:
            still.append(ca.SX(node.constant))
            live.append(None)
            continue
        build = ca.SX.unary if len(node.operands) == 1 else ca.SX.binary
        still.append(build(node.code, *(still[place] for place in node.operands)))
        move = [place for place in node.operands if live[place] is not None]
        divides = node.code == ca.OP_DIV and live[node.b] is not None
        held = node.code in _CONSTANT_OPERATIONS or divides or (node.code in _FACTORS and len(move) == 2)
        values = [still[place] if live[place] is None else live[place] for place in node.operands]
        live.append(None if held or not move else build(node.code, *values))
    (places,) = program.stored(range(len(program.nodes)))
    return ca.vertcat(*(still[place] if live[place] is None else live[place] for place in places))


def _instructions(expressions: list[Any], given: list[Any]) -> int:
    return int(ca.Function("counted", given, ca.cse(expressions)).n_instructions())
