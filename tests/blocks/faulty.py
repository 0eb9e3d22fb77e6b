"""Seeded faults of blocks: a subclass in which a function that its methods call is replaced."""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

from dmframe.certify import Verdict, verify
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph


def faulty(block: type[Any], **functions: Callable[..., Any]) -> type[Any]:
    """The class with `functions` under the names that its methods call, including those that compose its law."""
    members: dict[str, Any] = {"__module__": block.__module__, "__doc__": "With a fault, and without printed laws."}
    for name in ("equations", "certificate", "_with_rates", "_with_terms", "_weighed"):
        method = getattr(block, name, None)
        if method is None:
            continue
        members[name] = FunctionType(method.__code__, {**method.__globals__, **functions}, name, method.__defaults__)
    return type(block)(block.__name__, (block,), members)


def verdict_with(graph: Graph, name: str, **functions: Callable[..., Any]) -> Verdict:
    """The graph with a fault in one of its blocks."""
    block = graph.blocks[name]
    chosen = {key: value for key, value in block.model_dump().items() if value is not None}
    blocks = {**graph.blocks, name: faulty(type(block), **functions)(**chosen)}
    return verify(Diagram.build(blocks, graph.file.wires, graph.robot))
