"""Text of expressions for messages, from the compiled instructions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dmframe.program import CONST, INPUT, Program, sign_of

_INFIX: Final = {"add": (" + ", 1), "sub": (" - ", 1), "mul": ("*", 2), "div": ("/", 2)}
_MOST: Final = 60  # characters of a quoted expression; a longer one is shortened inside


def expression(program: Program, place: int, names: Mapping[int, str]) -> str:
    """The sub-expression at a place; deeply nested parts are replaced by dots."""
    for depth in range(8, 0, -1):
        text, _ = _written(program, place, names, depth)
        if len(text) <= _MOST:
            return text
    return text


def _written(program: Program, place: int, names: Mapping[int, str], depth: int) -> tuple[str, int]:
    """The text, and its operator precedence."""
    node = program.nodes[place]
    if node.code == INPUT:
        return names[place], 4
    if node.code == CONST:
        return f"{node.constant:.6g}", 4 if node.constant >= 0 else 1
    if not depth:
        return "(...)", 4
    name = sign_of(node.code)
    parts = [_written(program, operand, names, depth - 1) for operand in node.operands]
    if name in _INFIX:
        sign, own = _INFIX[name]
        (left, tight), (right, other) = parts
        right = f"({right})" if other < own or (other == own and name in ("sub", "div")) else right
        return (f"({left})" if tight < own else left) + sign + right, own
    (first, tight), *_ = parts
    inside = first if tight >= 3 else f"({first})"
    if name == "sq":
        return f"{inside}**2", 3
    if name == "neg":
        return f"-{inside}", 1
    if name == "twice":
        return f"2*{inside}", 2
    if name == "inv":
        return f"1/{inside}", 2
    if name in ("<", "<=", "==", "!="):
        return f"{first} {name} {parts[1][0]}", 0
    return f"{name}({', '.join(text for text, _ in parts)})", 4
