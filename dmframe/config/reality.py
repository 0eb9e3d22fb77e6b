"""What stands between controller and robot in reality, put into a graph: its key ``reality``, ``--reality ur``.

The key names a packaged set, or block types with their parameters; `like` takes a set as it is but for what is said
beside it. Each type becomes a block of the graph, before anything else reads the document, so that all of it is seen in
``check``, in drawings, in the ``graph.yaml`` beside results. No wires are needed, since these blocks stand in for what
they read (`dmframe.port.Output.instead_of`). A type that hands out all that a block of the plant does takes its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

from dmframe.block import AbstractBlock
from dmframe.catalogue import block_modules, find_block, find_reality
from dmframe.config.document import Document, Kind, Node, mapping_of, read_file
from dmframe.config.given import node_of
from dmframe.config.places import placed
from dmframe.errors import DmframeError, MissingError, UnknownNameError, ValueFault, raise_all
from dmframe.port import Side

KEY: Final = "reality"
LIKE: Final = "like"
NONE: Final = "none"
"""In the place of a set: the ideal way, to compare with."""
SET: Final = Kind("reality", "title: ...")
Find = Callable[[str, Path, str], type[AbstractBlock]]
Entries = dict[str, tuple[Node, Node]]
Kinds = Mapping[str, type[AbstractBlock]]


@final
@dataclass(frozen=True)
class Expanded:
    """A document without the key, and what to tell the user of what was left out."""

    document: Document
    notices: tuple[str, ...] = ()


def with_reality(document: Document, base: Path, find: Find = find_block) -> Expanded:
    """Put the blocks of the key ``reality`` into a graph; `find` gives the class of a type of the graph's own blocks.

    Raises
    ------
    DmframeError
        A set or block types that there are not, each with its place.
    """
    root = document.root
    if not isinstance(root.value, dict) or KEY not in root.value:
        return Expanded(document)
    entries: Entries = dict(root.value)
    _, asked = entries.pop(KEY)
    try:
        wanted = _wanted(asked)
        key, blocks = entries.get("blocks", (Node(1, 1, "blocks"), Node(1, 1, {})))
        held = dict(blocks.value) if isinstance(blocks.value, dict) else {}
        work = _Work(held, _kinds(held, base, find))
        for name, (at, node) in wanted.items():
            work.put(name, at, node)
        if asked.value == NONE and (own := work.standing_in()):
            work.left_out.append(f"{KEY} {NONE} leaves the graph's own blocks in: {', '.join(own)}")
    except DmframeError as error:
        raise placed(error, document) from None
    if isinstance(blocks.value, dict):
        entries["blocks"] = (key, replace(blocks, value=work.blocks))
    made = replace(root, value=entries)
    place = asked.said or asked.place(document.name)
    notices = tuple(f"{place}: notice: {text}" for text in work.left_out)
    return Expanded(Document(document.name, mapping_of(made), made), notices)


def _wanted(asked: Node) -> Entries:
    """Block types with their parameters; those of a set first, in its order."""
    if asked.value is None or asked.value == NONE:
        return {}
    if isinstance(asked.value, str):
        return _set(asked.value, (KEY,))
    if not isinstance(asked.value, dict):
        text = f"{KEY}: expected the name of a set such as ur, or block types with their parameters"
        raise ValueFault(text, path=(KEY,))
    own: Entries = dict(asked.value)
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
    """The blocks of a packaged set; messages say that they come from it."""
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


def _kinds(blocks: Entries, base: Path, find: Find) -> dict[str, type[AbstractBlock]]:
    """The classes of a graph's blocks; one that cannot be found is told where blocks are made."""
    found = dict[str, type[AbstractBlock]]()
    for name, (_, node) in blocks.items():
        kind = mapping_of(node).get("type")
        try:
            found[name] = find(str(kind), base, "type")
        except DmframeError:
            continue
    return found


@final
class _Work:
    """Puts one type after another into the blocks of a graph."""

    def __init__(self, blocks: Entries, kinds: Kinds) -> None:
        self.blocks, self.kinds, self.left_out = dict(blocks), dict(kinds), list[str]()

    def put(self, name: str, at: Node, node: Node) -> None:
        """Add a block of this type, or let it take the place of one."""
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
            what = f"nothing in the graph hands out {', '.join(lacking)}" if lacking else "it stands in for nothing"
            self.left_out.append(f"{KEY} {name} is left out: {what}")
            return
        own, count = name, 1
        while own in self.blocks:
            own, count = f"{name}_{count + 1}", count + 1
        said = node_of({"type": name, **fitting}, (), node.said).value
        assert isinstance(said, dict)  # it was one
        self.blocks[own] = (replace(at, value=own), replace(node, value={**said, **given}))
        self.kinds[own] = kind

    def standing_in(self) -> list[str]:
        """The blocks that stand in for what they read, whoever put them there."""
        return [name for name, kind in self.kinds.items() if any(port.instead_of for port in kind.outputs)]

    def _replace(self, name: str, kind: type[AbstractBlock], at: Node, node: Node, given: Entries) -> None:
        """Let a type take the place of the block of the plant whose signals it hands out, with its parameters."""
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
            f"{KEY}.{name}: expected a block that stands between controller and robot, or one in the place of one of "
            "the plant's; this one is neither: put it under blocks",
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
        return MissingError(f"{KEY}.{name}: a block of your own stands under blocks, in its place", path=(KEY, name))
    return UnknownNameError(f"{KEY}.{name}", "block type", name, choices, path=(KEY,))


def names_reality(label: str) -> bool:
    """True for an override that speaks of the key, which goes before those of the blocks that it puts in."""
    return label.strip().partition(".")[0] == KEY


def split(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The values of the key ``reality``, and all others."""
    real = {label: value for label, value in values.items() if names_reality(str(label))}
    return real, {label: value for label, value in values.items() if label not in real}
