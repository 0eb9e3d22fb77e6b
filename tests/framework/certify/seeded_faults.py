"""Single faults of functions, generated from their sources and compiled into the functions' own modules.

The sources are those of all blocks in the catalogue, so new blocks have faults too.
"""

from __future__ import annotations

import ast
import contextlib
import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import CodeType, FunctionType
from typing import Any

from closed_loops import known_blocks

import dmframe.block.adapting
import dmframe.block.linalg
import dmframe.robot.bodies
import dmframe.robot.symbolic
from dmframe.block import AbstractBlock
from dmframe.block.adapting import AdaptingBlock
from dmframe.block.parameter import specs
from dmframe.robot.bodies import Body
from dmframe.robot.symbolic import SymbolicRobot
from dmframe_blocks import _bodies, _friction, _image, _loads, _quaternions

SWAPS: Mapping[type[ast.AST], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
FUNCTIONS = {"sin": "cos", "cos": "sin", "tanh": "sin", "horzcat": "vertcat", "cross": "dot"}
SKIPPED = ("annotation", "returns", "decorator_list")
"""Fields of a syntax tree that do not affect results."""


@dataclass(frozen=True)
class Mutant:
    """A function with one fault.

    `owner` is a block's type, or the name of a group of the library; `source` is the function's text with the fault.
    """

    owner: str
    fault: str
    source: str
    original: FunctionType

    def __str__(self) -> str:
        return f"{self.owner}.{self.original.__name__}, {self.fault}"

    @cached_property
    def function(self) -> Callable[..., Any]:
        """The function, with the decorators, globals and closure of the original."""
        return compiled(self.source, self.original)


class CompileError(Exception):
    """The source of a function does not reproduce it: its faults would be faults of the harness."""


FUTURE = __import__("__future__").annotations.compiler_flag


def compiled(source: str, original: Callable[..., Any]) -> Callable[..., Any]:
    """The function of a text, with the decorators, globals and closure of the original.

    Names are looked up in the module when the function runs, as in the original: other faults may be patched in.
    """
    inner = _inner(original)
    factory = ast.parse(f"def factory({', '.join(inner.__code__.co_freevars)}):\n    return {inner.__name__}")
    (definition,) = ast.parse(source).body
    factory.body[0].body.insert(0, definition)  # type: ignore[attr-defined]
    code = compile(factory, f"<fault in {inner.__qualname__}>", "exec", dont_inherit=True, flags=FUTURE)
    space = dict[str, Any]()
    exec(code, inner.__globals__, space)
    made: Callable[..., Any] = space["factory"](*(cell.cell_contents for cell in inner.__closure__ or ()))
    return made


def check_compiled(source: str, original: Callable[..., Any]) -> None:
    """Raise `CompileError` unless the unchanged source gives the original code, names, defaults and decorators."""
    made = compiled(source, original)
    if (_inner(made) is made) != (_inner(original) is original):
        raise CompileError(f"{original.__qualname__}: its source gives other decorators")
    for what, ours, own in zip(("names or constants", "defaults"), _facts(made), _facts(original), strict=True):
        if ours != own:
            raise CompileError(f"{original.__qualname__}: its source gives other {what}")


def _inner(function: Callable[..., Any]) -> FunctionType:
    """The function without its decorators."""
    inner = inspect.unwrap(function)
    if not isinstance(inner, FunctionType):
        raise CompileError(f"{function}: expected a function, found {type(inner).__name__}")
    return inner


def _facts(function: Callable[..., Any]) -> tuple[Any, ...]:
    inner = _inner(function)
    defaults = (*(inner.__defaults__ or ()), *(inner.__kwdefaults__ or {}).items())
    plain = (int, float, str, tuple, type(None))  # an object is created again
    return _parts(inner.__code__), [item if isinstance(item, plain) else type(item) for item in defaults]


def _parts(code: CodeType) -> tuple[Any, ...]:
    """Names and constants of a function and of its inner functions, with the indentation of texts removed.

    The instructions depend on the imports above a function: they are shorter for a module's name.
    """
    constants = [
        _parts(item) if isinstance(item, CodeType) else repr(item.split() if isinstance(item, str) else item)
        for item in code.co_consts
    ]
    return code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, constants


def mutants_of(
    function: FunctionType, owner: str, signals: Mapping[str, Mapping[str, str]], arguments: Sequence[str] = ()
) -> Iterator[Mutant]:
    """All single faults in a function's source.

    Parameters
    ----------
    signals
        Names with their shapes, by the object from which they are read.
    arguments
        Names, each of which is replaced by another.

    Raises
    ------
    CompileError
        If the unchanged source does not reproduce the function.
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    unchanged = ast.unparse(tree)
    deleted = {name.id for node in ast.walk(tree) if isinstance(node, ast.Delete) for name in node.targets}  # type: ignore[attr-defined]
    arguments = [name for name in arguments if name not in deleted]
    check_compiled(unchanged, function)
    first, seen = _inner(function).__code__.co_firstlineno - 1, {unchanged}
    for node, put in _places(tree.body[0]):
        for fault, changed in (*_faults(node, signals), *_renamed(node, arguments)):
            with _placed(node, put, changed):
                source = ast.unparse(tree)
            if source not in seen:
                seen.add(source)
                yield Mutant(owner, f"line {first + node.lineno}: {fault}", source, function)  # type: ignore[attr-defined]


def _faults(node: ast.AST, signals: Mapping[str, Mapping[str, str]]) -> Iterator[tuple[str, ast.AST]]:
    """Single faults of one node: description, and the node that replaces it."""
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
    """Faults of a block's statements: an output or a rate negated, doubled, or replaced by another."""
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


def _renamed(node: ast.AST, names: Sequence[str]) -> Iterator[tuple[str, ast.AST]]:
    """One argument replaced by another."""
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
        yield from ((f"{node.id} became {other}", ast.Name(other, ast.Load())) for other in names if other != node.id)


def _places(parent: ast.AST) -> Iterator[tuple[ast.AST, Callable[[ast.AST], None]]]:
    """All nodes below a node that can affect a result, each with a function that replaces it."""
    for name, value in list(ast.iter_fields(parent)):
        if name in SKIPPED or isinstance(parent, ast.Raise):
            continue
        if isinstance(value, ast.AST):
            yield value, partial(setattr, parent, name)
            yield from _places(value)
        elif isinstance(value, list):
            for k, item in enumerate(value):
                if isinstance(item, ast.AST):
                    yield item, partial(value.__setitem__, k)
                    yield from _places(item)


@contextlib.contextmanager
def _placed(node: ast.AST, put: Callable[[ast.AST], None], changed: ast.AST) -> Iterator[None]:
    """The tree with one node replaced: copying it for every fault would take most of the time."""
    put(ast.fix_missing_locations(ast.copy_location(changed, node)))
    try:
        yield
    finally:
        put(node)


LAW = ("equations", "direction")
"""The methods in which a block states its law only."""
SHARED = ("error", "fits")
"""Methods from which both the law and the certificate are built, as those whose names begin with ``_``."""


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
    """The block with one method replaced; its file is unchanged."""
    space = {
        "__module__": block.__module__,
        "__doc__": "What a fault makes of it.",
        mutant.original.__name__: mutant.function,
    }
    return type(block)(block.__name__, (block,), space)


NO_LAW = ("__init__", "__eq__", "__hash__", "__repr__", "__replace__")
"""Methods that every class may have."""


def functions_of(*holders: Any, leave_out: Sequence[str] = ()) -> list[FunctionType]:
    """The functions that modules and classes define in their own files."""
    return [
        function
        for holder in holders
        for name, function in vars(holder).items()
        if isinstance(function, FunctionType)
        and function.__module__ == getattr(holder, "__module__", holder.__name__)
        and name not in {*NO_LAW, *leave_out}
        and not function.__code__.co_filename.startswith("<")
    ]


LIBRARY: Mapping[str, Sequence[FunctionType]] = {
    "linalg": functions_of(
        dmframe.block.linalg, leave_out=("inverting", "nodes", "times", "metric", "inverse_spd", "square")
    ),
    "gain": [
        dmframe.block.linalg.times,
        dmframe.block.linalg.metric,
        dmframe.block.linalg.inverse_spd,
        dmframe.block.linalg.square,
    ],
    "symbolic": functions_of(
        dmframe.robot.symbolic, SymbolicRobot, dmframe.robot.bodies, Body, leave_out=("values", "kinematic_regressor")
    ),
    "adapting": functions_of(AdaptingBlock),
    "helpers": functions_of(_bodies, _friction, _image, _loads, _quaternions, leave_out=("check_bodies",)),
}
"""Functions that all blocks or robots share."""


def library_mutants(which: str) -> Iterator[Mutant]:
    """All single faults of a group of the library's functions."""
    for function in LIBRARY[which]:
        names = [name for name in inspect.signature(function).parameters if name != "self"]
        yield from mutants_of(function, which, {}, names)


def all_mutants(*, certificates: bool, library: bool) -> Iterator[Mutant]:
    """Faults of the blocks' equations, of their certificates and helpers, and of the library."""
    for kind, block in known_blocks().items():
        validators = {*block.__pydantic_decorators__.model_validators, *block.__pydantic_decorators__.field_validators}
        methods = [name for name, item in vars(block).items() if isinstance(item, FunctionType)]
        private = [name for name in methods if name.startswith("_") and name[:2] != "__" and name not in validators]
        yield from block_mutants(kind, block, (*LAW, *("certificate", *SHARED, *private) * certificates))
    if library:
        for which in LIBRARY:
            yield from library_mutants(which)
