"""What a block's file does beside declaring a class: it could make another class of what is written there."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from typing import Final

_DECORATORS: Final = {"final", "typing.final"}
_OF_METHODS: Final = {"property", "classmethod", "staticmethod", "abstractmethod", "cached_property", "override"}


def is_plain(tree: ast.Module, node: ast.ClassDef, calls: Collection[str], names: Collection[str]) -> bool:
    """True for a class that is what its declarations say, whatever else the file holds.

    Parameters
    ----------
    calls
        Functions of this framework that may be called in declarations.
    names
        Other names that declarations use; they, too, have to be this framework's.
    """
    protected = {*calls, *names, node.name}
    return all(_harmless(item, protected, node) for item in tree.body) and not any(_doings(node, calls, protected))


def _harmless(item: ast.stmt, protected: Collection[str], node: ast.ClassDef) -> bool:
    """True for a statement of the module that leaves the class and what it is made of alone."""
    match item:
        case ast.Import(names=aliases):
            return not any((alias.asname or alias.name) in protected for alias in aliases)
        case ast.ImportFrom(module=module, names=aliases):
            own = (module or "").split(".")[0] == "dmframe"
            return own or not any((alias.asname or alias.name) in {*protected, "*"} for alias in aliases)
        case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
            return item is node or (name not in protected and _inert(item))
        case ast.Assign(targets=targets, value=value):
            return all(isinstance(to, ast.Name) and to.id not in protected for to in targets) and not _calls(value)
        case ast.AnnAssign(target=ast.Name(id=name), value=value):
            return name not in protected and (value is None or not _calls(value))
        case ast.Expr(value=ast.Constant()):
            return True
    return False


def _inert(item: ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """True for a definition that runs nothing when it is made."""
    if isinstance(item, ast.ClassDef):
        return not item.decorator_list and not item.keywords and all(map(_quiet, item.body))
    known = {ast.unparse(each).rpartition(".")[2] for each in item.decorator_list} <= _OF_METHODS
    return known and not any(map(_calls, [*item.args.defaults, *filter(None, item.args.kw_defaults)]))


def _quiet(item: ast.stmt) -> bool:
    if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
        return _inert(item)
    return isinstance(item, ast.Assign | ast.AnnAssign | ast.Expr | ast.Pass) and not _calls(item)


def _doings(node: ast.ClassDef, calls: Collection[str], protected: Collection[str]) -> Iterator[ast.AST]:
    """What a class does that is no plain declaration."""
    yield from (each for each in node.decorator_list if ast.unparse(each) not in _DECORATORS)
    yield from node.keywords
    seen = set[str]()
    for item in node.body:
        match item:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                if name in seen or name in protected or name.startswith("__") or not _inert(item):
                    yield item
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                if name in seen or name in protected or any(_foreign(value, calls)):
                    yield item
            case ast.AnnAssign(target=ast.Name(id=name), value=value, annotation=annotation):
                if name in seen or name in protected or _calls(annotation) or (value and any(_foreign(value, calls))):
                    yield item
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                continue
            case _:
                yield item
                continue
        seen.add(getattr(item, "name", "") or name)


def _foreign(value: ast.expr, calls: Collection[str]) -> Iterator[ast.AST]:
    """Calls of anything but the framework's own functions, and names that are set on the way."""
    for each in ast.walk(value):
        if isinstance(each, ast.NamedExpr | ast.Await | ast.Yield | ast.YieldFrom | ast.comprehension):
            yield each
        if isinstance(each, ast.Call) and ast.unparse(each.func).rpartition(".")[2] not in calls:
            yield each


def _calls(value: ast.AST) -> bool:
    return any(isinstance(each, ast.Call | ast.NamedExpr | ast.comprehension) for each in ast.walk(value))
