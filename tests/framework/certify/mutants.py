"""Faults seeded into equations, each of which the certifier must refute; `python tests/framework/certify/mutants.py`.

The faults are made from the source of whatever the catalogue holds, so that a new block brings its own. Every one ends
as one of `OUTCOMES`; a fault that is proved and not shown to leave dV/dt true is a defect of the certifier.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import inspect
import multiprocessing
import os
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cache, partial
from types import FunctionType
from typing import Any
from unittest import mock

from closed_loops import FULL, Loop, known_blocks, loops, same_field, true_in_numbers

import dmframe.linalg
import dmframe.robot.bodies
import dmframe.robot.symbolic
from dmframe.block import AbstractBlock
from dmframe.block.model import symbols_in
from dmframe.certificate import Certificate
from dmframe.certify import claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError
from dmframe.parameter import specs
from dmframe.port import Side
from dmframe.prove.identity import identity
from dmframe.prove.reals import doubt
from dmframe.robot.bodies import Body
from dmframe.robot.symbolic import SymbolicRobot
from dmframe.text import Text

OUTCOMES = {
    "refuted": "the certifier refutes it",
    "no diagram": "the diagram cannot be built, or is defined nowhere",
    "condition": "the identity is true, and a condition fails",
    "units": "the identity is true, every condition holds, and units do not agree",
    "equivalent": "the identity is true: seen in numbers, independently",
    "survived": "proved, though numbers say that the identity is false",
}
SWAPS: Mapping[type[ast.AST], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
FUNCTIONS = {"sin": "cos", "cos": "sin", "tanh": "sin", "horzcat": "vertcat", "cross": "dot"}


SHARE = 40
"""Faults that a process tries before it tells."""


@dataclass(frozen=True)
class Mutant:
    """A function with one fault: `owner` is a block's type, or the name of a module or class of the library."""

    owner: str
    fault: str
    function: FunctionType
    original: Callable[..., Any]

    def __str__(self) -> str:
        return f"{self.owner}.{self.original.__name__}, {self.fault}"


@dataclass(frozen=True)
class Result:
    mutant: Mutant
    loop: str
    outcome: str
    reason: str


def mutants_of(function: Callable[..., Any], owner: str, signals: Mapping[str, Mapping[str, str]]) -> Iterator[Mutant]:
    """All single faults in a function's source; `signals` are names with their shapes, by what they are read from."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    first = function.__code__.co_firstlineno - 1
    seen = {ast.dump(tree)}
    for node, put in _places(tree):
        for fault, changed in _faults(node, signals):
            with _placed(node, put, changed):
                dumped = ast.dump(tree)
                made = _compiled(tree, function) if dumped not in seen else None
            if made:
                seen.add(dumped)
                where = f"line {first + node.lineno}: {fault}"  # type: ignore[attr-defined]
                yield Mutant(owner, where, made, function)


def _faults(node: ast.AST, signals: Mapping[str, Mapping[str, str]]) -> Iterator[tuple[str, ast.AST]]:
    """Single faults of one node: what was done, and the node that takes its place."""
    text = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else ""
    match node:
        case ast.BinOp(left=left, op=op, right=right):
            if type(op) in SWAPS:
                swapped = ast.BinOp(left, SWAPS[type(op)](), right)
                yield f"{text} became {ast.unparse(swapped)}", swapped
            if isinstance(op, ast.MatMult):
                yield f"{text}: factors in the wrong order", ast.BinOp(right, op, left)
            else:
                yield f"{text}: only {ast.unparse(left)} left", left
                dropped = ast.UnaryOp(ast.USub(), right) if isinstance(op, ast.Sub) else right
                yield f"{text}: only {ast.unparse(dropped)} left", dropped
            yield f"{text} doubled", ast.BinOp(ast.Constant(2), ast.Mult(), node)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield f"{text} without its sign", operand
        case ast.Attribute(value=value, attr="T"):
            yield f"{text} not transposed", value
        case ast.Attribute(value=ast.Name(id=kind), attr=name, ctx=ast.Load()) if name in signals.get(kind, {}):
            for other, shape in signals[kind].items():
                if other != name and shape == signals[kind][name]:
                    yield f"{text} became {kind}.{other}", ast.Attribute(ast.Name(kind, ast.Load()), other, ast.Load())
        case ast.Call(func=ast.Attribute(value=value, attr=name), args=args):
            if name in FUNCTIONS:
                called = ast.Attribute(value, FUNCTIONS[name], ast.Load())
                yield f"{name} became {FUNCTIONS[name]}", ast.Call(called, args, node.keywords)
            for k in range(len(args) - 1):
                order = [*args[:k], args[k + 1], args[k], *args[k + 2 :]]
                yield f"{text}: arguments {k + 1} and {k + 2} swapped", ast.Call(node.func, order, node.keywords)
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            yield f"{number} became {number + 1}", ast.Constant(number + 1)
            yield f"{number} became {-number - 1}", ast.Constant(-number - 1)
        case ast.AugAssign(target=target, op=op, value=value) if type(op) in SWAPS:
            yield f"{text}: the other sign", ast.AugAssign(target, SWAPS[type(op)](), value)
            yield f"{text} dropped", ast.Pass()
        case ast.Dict(keys=keys, values=values):
            yield from _entries(keys, values)
        case ast.Compare(left=left, ops=[ast.In()], comparators=comparators):
            yield f"{text} negated", ast.Compare(left, [ast.NotIn()], comparators)


def _entries(keys: Sequence[ast.expr | None], values: Sequence[ast.expr]) -> Iterator[tuple[str, ast.AST]]:
    """Faults of what a block states: an output or a rate negated, doubled, or taken for another."""
    for k, (key, value) in enumerate(zip(keys, values, strict=True)):
        name = ast.unparse(key) if key else "**"
        for what, changed in (
            ("negated", ast.UnaryOp(ast.USub(), value)),
            ("doubled", ast.BinOp(ast.Constant(2), ast.Mult(), value)),
        ):
            yield f"{name} {what}", ast.Dict(list(keys), [*values[:k], changed, *values[k + 1 :]])
        for j in range(len(values)):
            if j != k:
                yield (
                    f"{name} is that of {ast.unparse(keys[j] or value)}",
                    ast.Dict(list(keys), [*values[:k], values[j], *values[k + 1 :]]),
                )


def _places(tree: ast.Module) -> Iterator[tuple[ast.AST, Callable[[ast.AST], None]]]:
    """All nodes below the first, each with what puts another into its place."""
    for parent in list(ast.walk(tree)):
        for name, value in ast.iter_fields(parent):
            if isinstance(value, ast.AST):
                yield value, partial(setattr, parent, name)
            elif isinstance(value, list):
                yield from ((item, partial(value.__setitem__, k)) for k, item in enumerate(value))


@contextlib.contextmanager
def _placed(node: ast.AST, put: Callable[[ast.AST], None], changed: ast.AST) -> Iterator[None]:
    """The tree with another node in the place of one: to copy it for every fault would take most of the time."""
    put(ast.fix_missing_locations(ast.copy_location(changed, node)))
    try:
        yield
    finally:
        put(node)


def _compiled(tree: ast.Module, original: Callable[..., Any]) -> FunctionType:
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    space = dict(original.__globals__)
    exec(compile(tree, f"<mutant of {original.__qualname__}>", "exec", dont_inherit=True, flags=FUTURE), space)
    made = space[definition.name]
    assert isinstance(made, FunctionType)
    # the mutant sees the module as it is when it runs, not as it was: other faults may be patched in
    return FunctionType(made.__code__, original.__globals__, made.__name__, made.__defaults__)


FUTURE = __import__("__future__").annotations.compiler_flag


LAW = ("equations", "direction")
"""The methods by which a block states its law, and its law alone."""
SHARED = ("error", "fits")
"""Methods of which both the law and the certificate are made, as of those whose names begin with ``_``."""


def block_mutants(kind: str, block: type[AbstractBlock], methods: Sequence[str] = LAW) -> Iterator[Mutant]:
    """All single faults of some methods of a block."""
    shapes = {"u": {port.name: port.shape for port in block.inputs}}
    shapes["x"] = {state.name: state.shape for state in block.states}
    numbers = {name: spec.shape for name, spec in specs(block).items() if spec.form != "box"}
    shapes["p"] = {name: shape for name, shape in numbers.items() if name not in shapes["x"]}
    shapes["truth"] = {port.name: port.shape for port in block.truth}
    for method in methods:
        if method in vars(block):
            yield from mutants_of(vars(block)[method], kind, shapes)


def mutated_block(block: type[AbstractBlock], mutant: Mutant) -> type[AbstractBlock]:
    """The block with one method replaced; its file is left alone."""
    space = {
        "__module__": block.__module__,
        "__doc__": "What a fault makes of it.",
        mutant.original.__name__: mutant.function,
    }
    return type(block)(block.__name__, (block,), space)


LIBRARY: Mapping[str, Sequence[Callable[..., Any]]] = {
    "linalg": [dmframe.linalg.ldl, dmframe.linalg.solve_spd],
    "gain": [dmframe.linalg.times, dmframe.linalg.metric, dmframe.linalg.inverse_spd, dmframe.linalg.square],
    "symbolic": [
        function
        for module, kind in ((dmframe.robot.symbolic, SymbolicRobot), (dmframe.robot.bodies, Body))
        for holder in (module, kind)
        for name, function in vars(holder).items()
        if isinstance(function, FunctionType)
        and function.__module__ == module.__name__
        and name not in ("__init__", "__eq__", "__hash__", "__repr__", "__replace__", "values", "kinematic_regressor")
        and function.__code__.co_filename == module.__file__
    ],
}


def library_mutants(which: str) -> Iterator[Mutant]:
    """All single faults of the plant library's functions."""
    for function in LIBRARY[which]:
        names = [name for name in inspect.signature(function).parameters if name != "self"]
        yield from mutants_of(function, which, {})
        yield from _renamed(function, which, names)


def _renamed(function: Callable[..., Any], which: str, names: Sequence[str]) -> Iterator[Mutant]:
    """One argument taken for another, at one place."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    first = function.__code__.co_firstlineno - 1
    for node, put in _places(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
            for other in names:
                if other != node.id:
                    with _placed(node, put, ast.Name(other, ast.Load())):
                        made = _compiled(tree, function)
                    yield Mutant(which, f"line {first + node.lineno}: {node.id} became {other}", made, function)


@contextlib.contextmanager
def patched(mutant: Mutant) -> Iterator[None]:
    """The library with one function replaced, wherever it is known."""
    name = mutant.original.__name__

    def holders(of: Any) -> list[Any]:
        modules = [module for module_name, module in sys.modules.items() if module_name.startswith("dmframe")]
        return [holder for holder in (*modules, SymbolicRobot, Body) if vars(holder).get(name) is of]

    found = holders(mutant.original)
    assert found
    try:
        for holder in found:
            setattr(holder, name, mutant.function)
        yield
    finally:
        for holder in holders(mutant.function):  # a module that was imported meanwhile has it too
            setattr(holder, name, mutant.original)


def unlabelled(stated: Mapping[str, Certificate], laws: Any) -> dict[str, Certificate]:
    """Certificates with a number for each name."""
    del laws

    def counted(certificate: Certificate) -> Certificate:
        driven = tuple(
            replace(item, of=tuple(Text(str(k)) for k in range(len(item.bounded)))) for item in certificate.driven
        )
        return replace(certificate, driven=driven)

    return {name: counted(certificate) for name, certificate in stated.items()}


@contextlib.contextmanager
def nothing_printed() -> Iterator[None]:
    """Leave a fault to the exact test, before which the printed laws would tell of some; nor ask what follows."""
    with (
        mock.patch("dmframe.certify.claim.printed_laws", return_value={}),
        mock.patch("dmframe.certify.claim.labelled", unlabelled),
        mock.patch("dmframe.certify.assumed._named", return_value=Text()),
        mock.patch("dmframe.certify.verify.statements_of", return_value=[]),
        mock.patch("dmframe.certify.verify.hypotheses", return_value=[]),
    ):
        yield


def judged(mutant: Mutant, loop: Loop) -> Result:
    """What becomes of a fault in one closed loop."""
    block = mutant.owner in known_blocks()
    with contextlib.nullcontext() if block else patched(mutant), nothing_printed():
        try:
            diagram = loop.build({mutant.owner: mutant} if block else {}, mutated_block)
            if block and known_blocks()[mutant.owner].side is Side.SOURCE and _free_of_sources(diagram):
                return Result(mutant, loop.name, "equivalent", "trajectories and their derivatives are free")
            if _refuted_at_once(diagram):
                return Result(mutant, loop.name, "refuted", "the residual is not zero")
            verdict = verify(diagram, trials=1)
        except DmframeError as error:
            return Result(mutant, loop.name, "no diagram", error.text)
        except Exception as error:  # a fault in the library may raise anything; a block's must be told as its own
            if block:
                raise
            return Result(mutant, loop.name, "no diagram", repr(error))
        outcome = _outcome(diagram, verdict)
        reason = verdict.reason
        if outcome == "equivalent":
            unchanged = same_field(diagram, loop.diagram)
            reason = "the rates are unchanged" if unchanged else "the rates differ, dV/dt is true all the same"
    return Result(mutant, loop.name, outcome, reason)


def _free_of_sources(diagram: Diagram) -> bool:
    """Does nothing of the claim depend on what a source's equations say? Then no fault in them can matter."""
    claim = claim_of(diagram)
    sources = {name for name, block in diagram.blocks.items() if block.side is Side.SOURCE}
    own = {s for p in claim.loop.parameters if p.label.split(".")[0] in sources for s in symbols_in([p.symbol])}
    moves = claim.flow.rates_of(symbols_in([claim.V])) if not claim.over_samples else claim.sample.next
    held = [claim.V, *moves.values(), *(x for part in claim.parts for x in part.certificate.pieces)]
    return not (own | symbols_in([claim.loop.time])) & symbols_in(held)


def _refuted_at_once(diagram: Diagram) -> bool:
    """What `verify` finds, without its search for whom to blame."""
    claim = assembled(claim_of(diagram))
    return not identity(claim, trials=1, seed=0).zero and not doubt(claim, 0)


def _outcome(diagram: Diagram, verdict: Any) -> str:
    if verdict.outcome == "refuted":
        return "refuted"
    if verdict.claim is None or verdict.test is None:
        return "no diagram"
    if not true_in_numbers(diagram, verdict.claim):
        return "survived"
    if diagram.unit_faults and verdict.test.zero and all(item.holds for item in verdict.conditions):
        return "units"
    return "equivalent" if verdict.outcome == "proved" or not verdict.test.zero else "condition"


def homes(kind: str, available: Sequence[Loop]) -> list[Loop]:
    """The closed loops that hold a block of this type, or where these functions of the library matter."""
    if kind == "gain":
        return [loop for loop in available if FULL in loop.name]
    return [loop for loop in available if kind in loop.types] if kind in known_blocks() else list(available)


Trial = tuple[Mutant, Loop]
"""A fault and the closed loop that it is put into."""


@cache
def trials(scope: str, everywhere: bool) -> tuple[Trial, ...]:
    """Every fault of `scope` in one closed loop that it can touch, taken in turn, or in all of them."""
    available, found = loops(), list[Trial]()
    for turn, mutant in enumerate(all_mutants(certificates=scope != "equations", library=scope == "all")):
        fitting = homes(mutant.owner, available)
        chosen = fitting if everywhere else fitting[turn % len(fitting) :][:1] if fitting else []
        found += [(mutant, loop) for loop in chosen]
    return tuple(found)


def share(scope: str, everywhere: bool, first: int, last: int) -> list[tuple[str, str]]:
    """The outcomes of some trials, each with what a reader should know; a process builds the list for itself."""
    results = [judged(*trial) for trial in trials(scope, everywhere)[first:last]]
    return [(result.outcome, f"{result.mutant} [{result.loop}]: {result.reason}") for result in results]


def all_mutants(*, certificates: bool, library: bool) -> Iterator[Mutant]:
    for kind, block in known_blocks().items():
        yield from block_mutants(kind, block)
        if certificates:
            helpers = [name for name, item in vars(block).items() if isinstance(item, FunctionType)]
            private = [name for name in helpers if name.startswith("_") and "model" not in name]
            for method in ("certificate", *SHARED, *private):
                if not method.startswith("__"):
                    yield from block_mutants(kind, block, (method,))
    if library:
        for which in LIBRARY:
            yield from library_mutants(which)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--everywhere", action="store_true", help="each fault in every closed loop that holds its place"
    )
    parser.add_argument("--scope", choices=["equations", "blocks", "all"], default="all", help="whose faults")
    parser.add_argument("--list", action="store_true", help="print every fault that was not refuted")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    options = parser.parse_args()
    count, counts = len(trials(options.scope, options.everywhere)), Counter[str]()
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        shares = [
            pool.submit(share, options.scope, options.everywhere, first, first + SHARE)
            for first in range(0, count, SHARE)
        ]
        for done in as_completed(shares):
            for outcome, text in done.result():
                counts[outcome] += 1
                if outcome == "survived" or (options.list and outcome != "refuted"):
                    print(f"{outcome}: {text}")  # noqa: T201
            print(f"{counts.total()} of {count} faults tried, {counts['survived']} survived", file=sys.stderr)  # noqa: T201
    for outcome, meaning in OUTCOMES.items():
        print(f"{counts[outcome]:6d} {outcome:12s} {meaning}")  # noqa: T201
    return 1 if counts["survived"] else 0


if __name__ == "__main__":
    sys.exit(main())
