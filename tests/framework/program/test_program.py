"""A function's program: one place per value, although CasADi reuses registers."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import dmframe.program
import dmframe.program.program as module
from dmframe.common.errors import EngineError
from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.program import (
    CONST,
    INPUT,
    OPERATIONS,
    TO_READ,
    Node,
    Program,
    by_code,
    codes,
    instructions,
    read,
    run,
    shared,
    sign_of,
)


def number(program: Program, inputs: Sequence[Sequence[float]]) -> list[list[float]]:
    """The stored elements of the outputs, in floating point."""
    values = run(
        program,
        ARITHMETIC | by_code({"sin": math.sin}),
        given=lambda argument, element: inputs[argument][element],
        constant=float,
        refuse=lambda code: AssertionError(code),
    )
    return program.stored(values)


def long_sum(n: int = 40) -> Any:
    """A function that needs few registers for many values."""
    x = ca.SX.sym("x", 3)
    total = x[0]
    for k in range(n):
        total = ca.sin(total * x[k % 3] - k) + 2 * total
    return ca.Function("f", [x], [total, x[1] * total])


def test_a_register_that_is_used_again_is_another_value() -> None:
    f = long_sum()
    program = read(f)
    registers = {targets[0] for _, _, targets, _ in instructions(f)}
    assert len(registers) < 10 < len(program.nodes)
    assert all(operand < place for place, node in enumerate(program.nodes) for operand in node.operands)
    point = [0.3, -0.8, 1.1]
    assert number(program, [point]) == [[float(value)] for value in f(point)]


def test_reading_a_target_before_its_operands_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """A register that counts as written too early would give another value."""
    f = long_sum()
    reused = [(line, read) for line, (_, read, written, _) in enumerate(instructions(f)) if written[0] in read[:1]]
    assert reused
    line, _ = reused[-1]
    found_instructions = list(instructions(f))
    code, arguments, targets, constant = found_instructions[line]
    found_instructions[line] = (code, [found_instructions[0][2][0], *arguments[1:]], targets, constant)
    monkeypatch.setattr(module, "instructions", lambda _: iter(found_instructions))
    assert number(read(f), [[0.3, -0.8, 1.1]]) != [[float(value)] for value in f([0.3, -0.8, 1.1])]


def test_sparse_inputs_and_outputs_keep_their_places() -> None:
    x = ca.SX.sym("x", ca.Sparsity.upper(3))
    y = ca.SX.sym("y", 2, 2)
    f = ca.Function(
        "f", [x, y], [ca.mtimes(x, x), ca.diag(ca.vertcat(x[0, 2], y[1, 0])), ca.SX(2, 1)], ["x", "y"], list("abc")
    )
    program = read(f)
    dense = [np.arange(9.0).reshape(3, 3).ravel(order="F").tolist(), [1.0, 2.0, 3.0, 4.0]]
    stored = program.elements(dense)
    assert [len(part) for part in stored] == [6, 4]
    values = run(
        program, ARITHMETIC, given=lambda i, k: stored[i][k], constant=float, refuse=lambda code: AssertionError(code)
    )
    full = [np.reshape(part, (a.rows, -1), order="F") for part, a in zip(dense, program.inputs, strict=True)]
    expected = [value.full().ravel(order="F").tolist() for value in f(np.triu(full[0]), full[1])]
    assert program.dense(values, 0.0) == expected
    assert [len(part) for part in program.stored(values)] == [6, 2, 0]
    assert [(output.name, output.rows, output.size) for output in program.outputs] == [
        ("a", 3, 9),
        ("b", 2, 4),
        ("c", 2, 2),
    ]


def test_one_value_may_be_several_elements_and_an_input_an_output() -> None:
    x = ca.SX.sym("x")
    double = 2 * x
    f = ca.Function("f", [x], [ca.vertcat(x, double, double, 7.5), x])
    program = read(f)
    assert number(program, [[3.0]]) == [[3.0, 6.0, 6.0, 7.5], [3.0]]
    assert [node.code for node in program.nodes].count(ca.OP_TWICE) == 1


def test_numbers_are_the_doubles_that_the_function_holds() -> None:
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [x * 0.1 + 1e-300, x - math.inf, x + math.nan])
    found = {node.constant for node in read(f).nodes if node.code == CONST}
    assert {0.1, 1e-300} < found
    assert any(math.isinf(value) for value in found)
    assert any(math.isnan(value) for value in found)


def test_every_operation_that_an_sx_function_can_hold_is_known_with_its_arity() -> None:
    held = dict[int, int]()
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    tried = [make(getattr(ca, name), *given) for name in dir(ca) if name.startswith("OP_")
             for make, given in ((ca.SX.unary, (x,)), (ca.SX.binary, (x, y)))]  # fmt: skip
    for expression in (*tried, x**2.5):
        f = ca.Function("f", [x, y], [expression])
        for code, arguments, _, _ in instructions(f):
            held[code] = len(arguments)
    prints, around = {ca.OP_PRINTME}, {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    assert {code: arity for code, arity in held.items() if code not in prints | around} == {
        code: operation.arity for code, operation in OPERATIONS.items()
    }


def test_an_operation_is_named_as_an_author_writes_it() -> None:
    assert [sign_of(code) for code in (ca.OP_LE, ca.OP_IF_ELSE_ZERO, ca.OP_FMAX)] == ["<=", "if_else", "fmax"]
    with pytest.raises(KeyError, match="plus"):
        by_code({"plus": 1})


PLACES = (-1.0, 0.0, 0.365, 0.73, 1.0)
"""Places of switching operations whose other operand is one of these."""


@pytest.mark.parametrize("name", [operation.name for operation in OPERATIONS.values()])
def test_what_is_stated_of_an_operation_shows_in_its_values(name: str) -> None:
    operation = OPERATIONS[getattr(ca, f"OP_{name.upper()}")]
    f = computed(operation.code, operation.arity)
    lines = [(place, other, turned) for place in PLACES for other in (-0.73, 0.0, 0.73) for turned in (False, True)]
    near = [around(f, *line, 1e-9) for line in lines if operation.arity == 2 or not line[2]]
    jumped = max(np.max(np.nan_to_num(np.abs(np.diff(values)))) for values in near) > 1e-2
    assert jumped if operation.jumps else not jumped or operation.domain is not None
    near = [around(f, *line, 1e-6) for line in lines if operation.arity == 2 or not line[2]]
    bends = [np.abs(np.diff(values, 2)).item() for values in near if np.isfinite(values).all()]
    bent = max(bends, default=0.0) > 1e-7
    assert bent if operation.kink else not bent or operation.jumps or operation.edge or operation.domain is not None
    if operation.bounded:
        assert np.max(np.abs(f(np.array([1e6, -1e6, 3.0]), np.array([-1e6, 1e6, 7.0])))) <= 4.0
    if operation.domain is not None:
        operands = np.full((2, 4), 0.73)
        operands[operation.domain] = -3.0, 0.0, 1.0, math.pi / 2
        assert not np.all(np.abs(f(*operands)) < 1e15)


def computed(code: int, arity: int) -> Any:
    """An operation on arrays, by CasADi."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    value = x**0.73 if code == ca.OP_CONSTPOW else ca.SX.unary(code, x) if arity == 1 else ca.SX.binary(code, x, y)
    f = ca.Function("f", [x, y], [value])
    return lambda a, b: np.ravel(f.map(len(a))(a[None, :], b[None, :]).full())


def around(f: Any, place: float, other: float, turned: bool, step: float) -> np.ndarray:
    """Below, at and above a place of one operand; infinite values as NaN."""
    moved, held = place + step * np.array([-1.0, 0.0, 1.0]), np.full(3, other)
    values = f(held, moved) if turned else f(moved, held)
    return np.where(np.isfinite(values), values, np.nan)


def test_what_is_not_an_operation_is_an_unknown_value() -> None:
    x = ca.SX.sym("x", 2)
    inner = ca.Function("inner", [x], [ca.sumsqr(x), x], {"never_inline": True})
    f = ca.Function("f", [x], [ca.vertcat(*inner(ca.sin(x)))])
    program = read(f)
    called = [node for node in program.nodes if node.code == ca.OP_CALL]
    assert [node.operands for node in called] == [()] * 3
    assert ca.OP_CALL in program.codes
    assert codes(f) == program.codes | {ca.OP_OUTPUT}
    with pytest.raises(EngineError, match="no 48"):
        run(program, by_code({"sin": math.sin}), given=lambda *_: 0.0, constant=float, refuse=refused)
    free = ca.Function("f", [x], [x[0] + ca.SX.sym("z")], {"allow_free": True})
    with pytest.raises(EngineError, match=f"no {ca.OP_PARAMETER}"):
        run(read(free), ARITHMETIC, given=lambda *_: 0.0, constant=float, refuse=refused)


def refused(code: int) -> EngineError:
    return EngineError(f"no {code}")


def test_a_rule_may_refuse_its_operands() -> None:
    x = ca.SX.sym("x")
    program = read(ca.Function("f", [x], [ca.sqrt(x)]))
    rules = by_code({"sqrt": lambda x: NotImplemented if x < 0 else math.sqrt(x)})
    assert run(program, rules, given=lambda *_: 4.0, constant=float, refuse=refused)[-1] == 2.0
    with pytest.raises(EngineError, match=f"no {ca.OP_SQRT}"):
        run(program, rules, given=lambda *_: -4.0, constant=float, refuse=refused)


def test_what_is_kept_stands_for_the_value() -> None:
    x = ca.SX.sym("x")
    program = read(ca.Function("f", [x], [2 * x + 1]))
    lines = list[str]()

    def keep(node: Node, text: str) -> str:
        lines.append(f"v{node.line} = {text}")
        return f"v{node.line}"

    rules = by_code({"add": "{} + {}".format, "twice": "2 {}".format})
    run(program, rules, given="x{}{}".format, constant=str, refuse=refused, keep=keep)
    names = {node.code: f"v{node.line}" for node in program.nodes}
    assert f"{names[ca.OP_TWICE]} = 2 {names[INPUT]}" in lines
    (added,) = [line for line in lines if " + " in line]
    assert set(added.split(" = ")[1].split(" + ")) == {names[ca.OP_TWICE], names[CONST]}


def test_the_example_of_a_new_target_runs() -> None:
    text = dmframe.program.__doc__ or ""
    _, _, block = text.partition(".. code-block:: python\n")
    lines = block.splitlines()
    shown = [line[4:] for line in lines[: next(k for k, line in enumerate(lines) if re.match(r"\S", line))]]
    scope: dict[str, Any] = {}
    exec(compile("\n".join(shown), "example", "exec"), scope)
    x, y = ca.SX.sym("x"), ca.SX.sym("y", 2)
    area = x * y[1]
    f = ca.Function("f", [x, y], [ca.vertcat(area + 0.5, ca.sqrt(area))])
    program = read(f)
    (product,) = [node.line for node in program.nodes if node.code == ca.OP_MUL]
    (root,) = [node.line for node in program.nodes if node.code == ca.OP_SQRT]
    lines = scope["webassembly"](f)
    assert (
        f"(local.set $v{product} (f64.mul (f64.load offset=0 (local.get $a0)) (f64.load offset=8 (local.get $a1))))"
        in lines
    )
    assert any("f64.const 0.5" in line for line in lines)
    assert lines[-1] == f"(f64.store offset=8 (local.get $r0) (local.get $v{root}))"
    with pytest.raises(EngineError, match=f"f holds CasADi's instruction {ca.OP_ERF}"):
        scope["webassembly"](ca.Function("f", [x], [ca.erf(x)]))


def test_instructions_are_read_in_one_place() -> None:
    """No other module reads instructions of CasADi, except their number."""
    root = Path(dmframe.program.__file__).parents[1]
    readers = [
        path.relative_to(root).as_posix()
        for path in sorted(root.rglob("*.py"))
        if re.search(r"instruction_(id|input|output|constant)\b", path.read_text(encoding="utf-8"))
    ]
    assert readers == ["program/program.py"]


def test_a_rational_number_goes_through_the_same_rules() -> None:
    x = ca.SX.sym("x")
    program = read(ca.Function("f", [x], [(x - 0.25) / (1 + x * x)]))
    found = run(program, ARITHMETIC, given=lambda *_: Fraction(1, 3), constant=Fraction, refuse=refused)
    assert program.stored(found) == [[Fraction(3, 40)]]


@pytest.mark.parametrize("seed", range(4))
def test_a_function_made_to_be_read_gives_the_same_program_with_fewer_calls(seed: int) -> None:
    rng, x = np.random.default_rng(seed), ca.SX.sym("x", 5)
    values = [*ca.vertsplit(x), ca.SX(0), ca.SX(2.5)]
    for _ in range(200):
        a, b = (values[k] for k in rng.integers(len(values), size=2))
        values.append([a * b, a + ca.sin(b), ca.fmin(a, b) / 3, -a, ca.if_else(a < b, a, b)][rng.integers(5)])
    given = [x, ca.SX.sym("unused", 2)], [ca.vertcat(*values[-20:]), x[1], ca.SX(0, 1), ca.SX(3, 3), values[-1]]
    plain, made = ca.Function("f", *given), ca.Function("f", *given, TO_READ)
    assert made.sz_w() > plain.sz_w()
    one, other = read(plain), read(made)
    assert one.nodes == other.nodes
    assert [list(item) for item in one.sources] == [list(item) for item in other.sources]


def test_a_shared_program_has_each_value_once_and_the_outputs_of_the_whole_one() -> None:
    def made(x: ca.SX, y: ca.SX) -> ca.SX:  # each call creates its nodes again
        return ca.vertcat((x + y) * 3 - ca.sin(x * y), y / x + (x - y) * ca.sin(x * y), 3 - x)

    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    whole = read(ca.Function("f", [x, y], [made(x, y), made(y, x), made(x, y)], TO_READ))
    once = shared(whole)
    assert once.sources[0] == once.sources[2] != once.sources[1]
    assert once.sources[0][2] != once.sources[1][2]
    assert once.sources[0][1] != once.sources[1][1]  # of a quotient and of a difference the order matters
    assert len({(node.code, node.a, node.b, node.constant) for node in once.nodes}) == len(once.nodes)
    assert sum(node.code == ca.OP_ADD for node in once.nodes) == 3  # x + y is y + x, and two sums of products
    assert sum(node.code == ca.OP_MUL for node in once.nodes) == 4
    assert number(once, [[1.5], [0.25]]) == number(whole, [[1.5], [0.25]])
