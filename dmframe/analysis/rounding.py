r"""Loop with declared quantisers, such as encoders, replaced by their mean.

A quantiser step floor(z / step + 1/2) has the mean z if z is uniformly distributed over a step, so fine steps are
assumed. Only quantisers that a block declares (`Output.rounded_by`) are replaced. Any other rounding, such as the
wrapping of an angle, is a switch with pieces (`dmframe.analysis.switches`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import casadi as ca

from dmframe.analysis.switches import APPLY, unknown
from dmframe.block.certificate import SX
from dmframe.block.model import BlockModel, symbols_in
from dmframe.block.port import Output
from dmframe.common.errors import BlockError
from dmframe.diagram import Diagram
from dmframe.program import CONST, INPUT, Node, Program, read, run

_FLOOR: Final = ca.OP_FLOOR


def unrounded(diagram: Diagram) -> Diagram:
    """Diagram with declared quantisers replaced by their mean.

    Raises `BlockError` for a block whose declaration does not match its equations.
    """
    steps = _steps(diagram)
    if not steps:
        return diagram
    return replace(diagram, loop=diagram.loop.mapped(lambda expression: _mean(expression, steps)))


def averaged(diagram: Diagram) -> dict[str, float]:
    """Outputs that are replaced by their mean, ``block.port``, each with its largest step."""
    values = {parameter.label: parameter.value for parameter in diagram.loop.parameters}
    return {
        f"{name}.{port.name}": float(abs(values[f"{name}.{port.rounded_by}"]).max()) for name, port in _all(diagram)
    }


def _all(diagram: Diagram) -> list[tuple[str, Output]]:
    return [
        (name, port)
        for name, block in diagram.blocks.items()
        for port in block.outputs
        if port.rounded_by and port.name in diagram.models[name].equations.outputs
    ]


def _steps(diagram: Diagram) -> set[int]:
    """Elements of the declared steps, by identity."""
    found, declared = set[int](), _all(diagram)
    for name, port in declared:
        model = diagram.models[name]
        _check(model, port)
        found |= symbols_in([model.parameters[port.rounded_by]])
    return found


def _check(model: BlockModel, port: Output) -> None:
    """Check that the output is the replaced input, with random terms added, rounded to whole steps."""
    expression, step = model.equations.outputs[port.name], model.parameters[port.rounded_by]
    measured = model.inputs[port.instead_of]
    drawn = symbols_in([model.inputs[each.name] for each in model.block.inputs if each.drawn])
    known = drawn | symbols_in(model.parameters.values())
    symbols, program = _program(expression)
    values = _values(program, symbols)
    (places,) = program.stored(range(len(program.nodes)))
    wanted = ca.vertsplit(ca.vec(ca.densify(measured)))
    good = len(places) == len(wanted) == expression.numel()
    for place, signal in zip(places, wanted, strict=False):
        inner = _rounded_at(program, place, symbols, symbols_in([step]))
        if inner is None:
            good = False
            continue
        z = values[inner]
        slope, rest = ca.jacobian(z, signal), ca.substitute(z, signal, 0)
        good &= slope.is_constant() and float(slope) == 1 and not symbols_in([rest]) - known
    if not good:
        rounding = f"{port.rounded_by} floor({port.instead_of} / {port.rounded_by} + 1/2)"
        raise BlockError(
            f"{model.name}: declares that {port.name} is rounded by {port.rounded_by}, expected {rounding}, found "
            "another expression; without rounded_by it is a switch, which is analysed piece by piece"
        )


def _rounded_at(program: Program, place: int, symbols: Sequence[SX], steps: set[int]) -> int | None:
    """Node of z in a value p floor(z / p + 1/2) with p one of the steps; None for any other value."""
    node = program.nodes[place]
    if node.code != ca.OP_MUL:
        return None
    for step, floor in ((node.a, node.b), (node.b, node.a)):
        if program.nodes[floor].code == _FLOOR and (found := _inner(program, floor, symbols, steps)) is not None:
            return found[1] if _same(program, found[0], step) else None
    return None


def _inner(program: Program, floor: int, symbols: Sequence[SX], steps: set[int]) -> tuple[int, int] | None:
    """Nodes of p and z in floor(z / p + 1/2)."""
    total = program.nodes[program.nodes[floor].a]
    if total.code != ca.OP_ADD:
        return None
    for half, quotient in ((total.a, total.b), (total.b, total.a)):
        one, other = program.nodes[half], program.nodes[quotient]
        if one.code == CONST and one.constant == 0.5 and other.code == ca.OP_DIV:
            p = program.nodes[other.b]
            if p.code == INPUT and symbols[p.a].element_hash() in steps:
                return other.b, other.a
    return None


def _same(program: Program, one: int, other: int) -> bool:
    a, b = program.nodes[one], program.nodes[other]
    return one == other or (a.code == b.code == INPUT and (a.a, a.b) == (b.a, b.b))


def _mean(expression: SX, steps: set[int]) -> SX:
    """Expression with each declared rounding replaced by its mean."""
    symbols, program = _program(expression)
    if _FLOOR not in program.codes:
        return expression
    users = dict[int, list[int]]()
    for place, node in enumerate(program.nodes):
        for operand in node.operands:
            users.setdefault(operand, []).append(place)
    fine = {
        place
        for place, node in enumerate(program.nodes)
        if node.code == _FLOOR
        and all(_rounded_at(program, user, symbols, steps) is not None for user in users.get(place, [-1]))
    }
    (found,) = program.dense(_values(program, symbols, fine), ca.SX(0))
    return ca.reshape(ca.vertcat(*found), *expression.shape)


def _program(expression: SX) -> tuple[list[SX], Program]:
    symbols = ca.symvar(expression)
    return symbols, read(ca.Function("f", symbols, [expression]))


def _values(program: Program, symbols: Sequence[SX], fine: Iterable[int] = ()) -> list[SX]:
    """Values of all nodes, with x - 1/2 for each floor(x) to be averaged."""
    seen, means = list[SX](), set(fine)

    def keep(node: Node, value: SX) -> SX:
        seen.append(seen[node.a] - 0.5 if len(seen) in means else value)
        return seen[-1]

    return run(
        program,
        APPLY,
        given=lambda argument, element: symbols[argument],
        constant=ca.SX,
        refuse=unknown,
        keep=keep,
    )


__all__ = ["averaged", "unrounded"]
