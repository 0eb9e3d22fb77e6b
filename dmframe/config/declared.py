"""A block's class as its file declares it, read without running the file: what is written out is known, no more.

Ports, states and parameters are calls with constants, ``Port("q", "n", "rad")``; those calls are made here, by this
framework's own functions. Whatever is computed is left out, and told.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, final

from pydantic import ConfigDict

from dmframe import parameter
from dmframe.block import AbstractBlock
from dmframe.config.plain import is_plain
from dmframe.errors import BlockError, DmframeError, UnknownNameError
from dmframe.port import ANY, PERIOD, TIME, Access, Port, Side, State

LISTS: Final = ("inputs", "outputs", "states", "truth")
INHERITED: Final = "what it inherits"
DONE: Final = "what the file's code does to the class beside declaring it"
_BASES: Final = ("AbstractBlock", "AdaptingBlock")
CONSTANTS: Final = (*LISTS, "side", "uses_robot", "renamed")
CALLS: Final[Mapping[str, Callable[..., Any]]] = {"Port": Port, "State": State} | {
    name: getattr(parameter, name)
    for name in ("Real", "Positive", "PositiveDefinite", "NonNegative", "Interval", "Around", "Rows")
}
NAMES: Final[Mapping[str, Any]] = {"TIME": TIME, "PERIOD": PERIOD, "ANY": ANY}
ENUMS: Final = {"Access": Access, "Side": Side}
TYPES: Final = {"bool": bool, "str": str, "int": int, "float": float}


@final
@dataclass(frozen=True)
class Declared:
    """A class with what its file writes out, and what of it is not known: `CONSTANTS`, parameters, `INHERITED`."""

    kind: type[AbstractBlock]
    unread: tuple[str, ...]


def declared(source: bytes, class_name: str, where: str) -> Declared:
    """The class of that name. Raises `BlockError` where the file is no Python, or has no such name."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f"{error.lineno}: " if isinstance(error, SyntaxError) and error.lineno else ""
        raise BlockError(f"{where}: {line}{type(error).__name__}: not readable as Python") from None
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    if class_name in classes:
        own = classes[class_name]
        found = _read(own, where)
        names = (*NAMES, *ENUMS, *_BASES)
        plain = is_plain(tree, own, CALLS, names) and list(classes).count(class_name) == 1
        return found if plain else Declared(found.kind, (*found.unread, DONE))
    nested = {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    if class_name in {*_brought_in(tree), *nested}:
        return Declared(_made(class_name, {}, known=False), (*CONSTANTS, "parameters"))
    raise UnknownNameError(f"{where}:{class_name}", "class", class_name, classes)


def _brought_in(tree: ast.Module) -> set[str]:
    """Names that a file has from elsewhere, or computes."""
    imported = (alias for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom) for alias in node.names)
    stored = (node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    return {*stored, *((alias.asname or alias.name) for alias in imported)}


def _read(node: ast.ClassDef, where: str) -> Declared:
    held, kinds = dict[str, Any](), dict[str, Any]()
    known = [ast.unparse(base).rpartition(".")[2] for base in node.bases] == ["AbstractBlock"]
    unread = [] if known else [INHERITED]
    for item in node.body:
        if isinstance(item, ast.Assign):
            targets, annotation = item.targets, None
        elif isinstance(item, ast.AnnAssign):
            targets, annotation = [item.target], item.annotation
        else:
            continue
        for name in (target.id for target in targets if isinstance(target, ast.Name)):
            constant = name in CONSTANTS
            if not constant and (annotation is None or _class_var(annotation)):
                continue  # the class's own
            if name.startswith("_") or (not constant and hasattr(AbstractBlock, name)):
                unread.append(name)
                continue
            try:
                if item.value is not None:
                    held[name] = _value(item.value)
                if annotation is not None and not constant:
                    kinds[name] = _type(annotation)
            except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):  # what literal_eval may raise
                unread.append(name)
                if not constant:
                    held[name], kinds[name] = None, Any  # it may be needed, and may be anything
    try:
        said = {"__doc__": ast.get_docstring(node, clean=False), "__annotations__": kinds}
        kind = _made(node.name, {**said, **held}, known=known)
    except DmframeError as error:
        raise BlockError(f"{where}: {error.faults[0].text}") from None
    except Exception as error:  # whatever pydantic says of annotations and defaults that do not go together
        raise BlockError(f"{where}: its declarations make no class: {type(error).__name__}") from None
    return Declared(kind, tuple(unread))


def _made(name: str, held: Mapping[str, Any], *, known: bool) -> type[AbstractBlock]:
    """A class of these attributes; unless all its parameters are `known`, it takes others too."""

    def equations(self: Any, u: Any, x: Any, p: Any) -> Any:
        raise BlockError(f"{name}: its code is not run")

    constants = {key: ClassVar[Any] for key in held if key in CONSTANTS}
    given = {**held, "__annotations__": {**held.get("__annotations__", {}), **constants}}
    config = {} if known else {"model_config": ConfigDict(extra="allow")}
    return type(name, (AbstractBlock,), {"__module__": "unrun", "equations": equations, **config, **given})


def _class_var(annotation: ast.expr) -> bool:
    outer = annotation.value if isinstance(annotation, ast.Subscript) else annotation
    return ast.unparse(outer).rpartition(".")[2] == "ClassVar"


def _value(node: ast.expr) -> Any:
    """A constant, or a call of `CALLS` with constants. Raises `ValueError` for anything else."""
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in CALLS:
            if any(keyword.arg is None for keyword in node.keywords):
                raise ValueError(name)
            given = {str(keyword.arg): _value(keyword.value) for keyword in node.keywords}
            return CALLS[name](*map(_value, node.args), **given)
        case ast.Tuple(elts=items):
            return tuple(map(_value, items))
        case ast.List(elts=items):
            return list(map(_value, items))
        case ast.Name(id=name) if name in NAMES:
            return NAMES[name]
        case ast.Attribute(value=ast.Name(id=owner), attr=name) if owner in ENUMS and name in ENUMS[owner].__members__:
            return ENUMS[owner][name]
        case _:
            return ast.literal_eval(node)


def _type(annotation: ast.expr) -> Any:
    """What values an option may have, where constants say it; a number's own declaration says the rest."""
    match annotation:
        case ast.Subscript(value=ast.Name(id="Literal"), slice=choices):
            items = choices.elts if isinstance(choices, ast.Tuple) else [choices]
            return Literal[tuple(map(ast.literal_eval, items))]
        case ast.Name(id=name) if name in TYPES:
            return TYPES[name]
        case _:
            return Any
