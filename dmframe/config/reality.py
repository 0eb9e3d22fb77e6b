"""Insert channel models between controller and robot into a graph: the key ``reality``, or ``--reality ur``.

The key names a packaged set, or block types with their parameters; `like` takes a set with the given changes. Each type
becomes a block of the graph before the document is read further, so that ``check``, drawings and the ``graph.yaml``
next to results contain it. No wires are needed, since these blocks replace the signals that they read
(`dmframe.block.port.Output.instead_of`). A type that has all outputs of a block of the plant replaces that block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

from dmframe.block import AbstractBlock
from dmframe.block.port import Side
from dmframe.catalogue import block_modules, find_block, find_reality
from dmframe.common.errors import DmframeError, MissingError, UnknownNameError, ValueFault, raise_all
from dmframe.config.document import Document, Kind, Node, mapping_of, read_file
from dmframe.config.given import node_of
from dmframe.config.places import placed, report
from dmframe.config.sections import kinds_of

KEY: Final = "reality"
LIKE: Final = "like"
NONE: Final = "none"
"""Instead of a set: the ideal channel, for comparison."""
SET: Final = Kind("reality", "title: ...")
Entries = dict[str, tuple[Node, Node]]
Kinds = Mapping[str, type[AbstractBlock]]


Step = Callable[[Document], Document]
"""A function that sets a value in a document; it can be pickled."""


@final
@dataclass(frozen=True)
class Stating:
    """A document that still has its key ``reality``, and the later changes, so that the key can be changed again."""

    document: Document
    later: tuple[Step, ...] = ()

    def then(self, *steps: Step) -> Stating:
        """The same with further changes."""
        return replace(self, later=(*self.later, *steps))


def expanded(document: Document) -> Document:
    """The document with the blocks of its key ``reality``; blocks that are left out are reported on stderr.

    Raises
    ------
    DmframeError
        Unknown sets or block types, each with its place.
    """
    root = document.root
    if not isinstance(root.value, dict) or KEY not in root.value:
        return document
    entries: Entries = dict(root.value)
    _, requested = entries.pop(KEY)
    try:
        wanted = models_of(requested)
        key, blocks = entries.get("blocks", (Node(1, 1, "blocks"), Node(1, 1, {})))
        held = dict(blocks.value) if isinstance(blocks.value, dict) else {}
        work = _Work(held, kinds_of(mapping_of(blocks), Path(document.name).parent))
        for name, (at, node) in wanted.items():
            work.put(name, at, node)
        if requested.value == NONE and (own := work.replacing()):
            work.left_out.append(f"{KEY} {NONE} leaves the graph's own blocks in: {', '.join(own)}")
    except DmframeError as error:
        raise placed(error, document) from None
    if isinstance(blocks.value, dict):
        entries["blocks"] = (key, replace(blocks, value=work.blocks))
    place = requested.place(document.name)
    report(f"{place}: notice: {text}" for text in work.left_out)
    return document.with_root(replace(root, value=entries))


def models_of(requested: Node) -> Entries:
    """Block types with their parameters; those of a set first, in its order."""
    if requested.value is None or requested.value == NONE:
        return {}
    if isinstance(requested.value, str):
        return _set(requested.value, (KEY,))
    if not isinstance(requested.value, dict):
        text = f"{KEY}: expected the name of a set such as ur, or block types with their parameters"
        raise ValueFault(text, path=(KEY,))
    own: Entries = dict(requested.value)
    like = own.pop(LIKE, None)
    if like is not None and not isinstance(like[1].value, str):
        raise ValueFault(f"{KEY}.{LIKE}: expected the name of a set such as ur", path=(KEY, LIKE))
    found = _set(str(like[1].value), (KEY, LIKE)) if like is not None else {}
    faults = list[DmframeError]()
    for name, (at, node) in own.items():
        if isinstance(node.value, dict) and "type" in node.value:
            text = f"{KEY}.{name}.type: the key {name} is the type already; leave type out"
            faults.append(ValueFault(text, path=(KEY, name, "type")))
        elif node.value is not None and not isinstance(node.value, dict):
            text = f"{KEY}.{name}: expected its parameters, {{samples: 1}}, or null to leave it out"
            faults.append(ValueFault(text, path=(KEY, name)))
        elif node.value is None:
            if found.pop(name, None) is None:
                text = f"{KEY}.{name}: null leaves out what a set has, and {_of(like)} has none"
                faults.append(ValueFault(f"{text}; give its parameters, {{}} for none", path=(KEY, name)))
        else:
            below = found[name][1].value if name in found else {}
            merged = {**(below if isinstance(below, dict) else {}), **node.value}
            found[name] = (at, replace(node, value=merged))
    raise_all(faults)
    return found


def _of(like: tuple[Node, Node] | None) -> str:
    return f"{LIKE}: {like[1].value}" if like is not None else f"a graph without {LIKE}"


def _set(name: str, path: tuple[str, ...]) -> Entries:
    """The blocks of a packaged set; messages name the set."""
    if name == NONE:
        return {}
    try:
        file = find_reality(name)
    except UnknownNameError as fault:
        fault.path = path
        raise
    blocks = read_file(file, SET).data.get("blocks")
    node = node_of(blocks if isinstance(blocks, dict) else {}, (), f"{KEY} {name}")
    return dict(node.value) if isinstance(node.value, dict) else {}


@final
class _Work:
    """Inserts types into the blocks of a graph."""

    def __init__(self, blocks: Entries, kinds: Kinds) -> None:
        self.blocks, self.kinds, self.left_out = dict(blocks), dict(kinds), list[str]()

    def put(self, name: str, at: Node, node: Node) -> None:
        """Add a block of this type, or replace a block of the plant by it."""
        kind = self._kind(name)
        if kind in self.kinds.values():
            held = next(block for block, other in self.kinds.items() if other is kind)
            self.left_out.append(f"{KEY} {name} is left out: the graph has it, {held}")
            return
        given = dict(node.value) if isinstance(node.value, dict) else {}
        if not any(port.instead_of or port.notice for port in kind.outputs):
            self._replace(name, kind, at, node, given)
            return
        signals = {port.name for other in self.kinds.values() for port in other.outputs}
        fitting = kind.fitting(signals)
        if fitting is None:
            lacking = [port.name for port in kind.inputs if port.name not in signals and _must(port)]
            what = f"no block outputs {', '.join(lacking)}" if lacking else "it replaces no signal of the graph"
            self.left_out.append(f"{KEY} {name} is left out: {what}")
            return
        own, count = name, 1
        while own in self.blocks:
            own, count = f"{name}_{count + 1}", count + 1
        entry = node_of({"type": name, **fitting}, (), node.origin).value
        assert isinstance(entry, dict)  # node_of keeps the type
        self.blocks[own] = (replace(at, value=own), replace(node, value={**entry, **given}))
        self.kinds[own] = kind

    def replacing(self) -> list[str]:
        """The blocks that replace signals that they read, whether inserted or written in the graph."""
        return [name for name, kind in self.kinds.items() if any(port.instead_of for port in kind.outputs)]

    def _replace(self, name: str, kind: type[AbstractBlock], at: Node, node: Node, given: Entries) -> None:
        """Replace the block of the plant with the same outputs by this type, with its parameters."""
        outputs = {port.name for port in kind.outputs}
        for block, other in self.kinds.items():
            alike = {port.name for port in other.outputs} <= outputs and other.outputs
            if alike and other.side is Side.PLANT and not any(port.instead_of for port in other.outputs):
                key, held = self.blocks[block]
                values = dict(held.value) if isinstance(held.value, dict) else {}
                values["type"] = (at, replace(node, value=name))
                self.blocks[block] = (key, replace(held, value={**values, **given}))
                self.kinds[block] = kind
                return
        raise ValueFault(
            f"{KEY}.{name}: expected a channel model between controller and robot, or a replacement for a block of "
            "the plant; this one is neither: put it under blocks",
            path=(KEY, name),
        )

    def _kind(self, name: str) -> type[AbstractBlock]:
        if name not in block_modules():
            raise _unknown(name, block_modules())
        kind = find_block(name, Path(), f"{KEY}.{name}")
        if kind.side is not Side.PLANT:
            text = f"{KEY}.{name}: expected a block of the plant, found one of the {kind.side.value}'s"
            raise ValueFault(text, path=(KEY, name))
        return kind


def _must(port: Any) -> bool:
    return not (port.optional or port.drawn)


def _unknown(name: str, choices: Mapping[str, Any]) -> DmframeError:
    if name.rpartition(":")[0].endswith(".py"):
        return MissingError(f"{KEY}.{name}: a block from a file of yours belongs under blocks", path=(KEY, name))
    return UnknownNameError(f"{KEY}.{name}", "block type", name, choices, path=(KEY,))


def names_reality(label: str) -> bool:
    """True for an override of the key; it is applied before those of the blocks that the key inserts."""
    return label.strip().partition(".")[0] == KEY


def split(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The values of the key ``reality``, and all others."""
    real = {label: value for label, value in values.items() if names_reality(str(label))}
    return real, {label: value for label, value in values.items() if label not in real}


def after(document: Document, steps: Sequence[Step], faults: list[DmframeError]) -> Document:
    """The document after some steps; the faults of each are added to `faults`."""
    for step in steps:
        try:
            document = step(document)
        except DmframeError as error:
            faults += error.faults
    return document
