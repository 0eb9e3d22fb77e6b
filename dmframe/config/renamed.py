"""Former names in graph files: each is read as the new one, with a notice.

A block class declares former names of its parameters, states and ports (`AbstractBlock.renamed`). They are replaced in
the document after ``--set`` values are applied and before it is read further: in blocks and the baseline, in wires,
start values, uncertain parameters and logged signals. The rest of the framework uses new names only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import final

from dmframe.block import AbstractBlock
from dmframe.common.errors import DmframeError, ValueFault, raise_all
from dmframe.config.document import Document, Node
from dmframe.config.places import report
from dmframe.config.sections import kinds_of

Names = Mapping[str, Mapping[str, str]]
"""Former and new names, by block."""
SECTIONS = ("blocks", "baseline")


def with_new_names(document: Document) -> Document:
    """Replace former names, with notices on stderr; raises `DmframeError` where both names are given."""
    base = Path(document.name).parent
    kinds = {section: kinds_of(document.data.get(section), base) for section in SECTIONS}
    if not any(kind.renamed for section in kinds.values() for kind in section.values()):
        return document
    work = _Work(document.name, kinds)
    root = work.graph(document.root)
    raise_all(work.faults)
    report(work.notices)
    return document.with_root(root)


@final
class _Work:
    """Replaces former names in one graph and collects notices."""

    def __init__(self, file: str, kinds: Mapping[str, Mapping[str, type[AbstractBlock]]]) -> None:
        self.file = file
        self.notices, self.faults = list[str](), list[DmframeError]()
        self.sections: dict[str, Names] = {
            section: {name: kind.renamed for name, kind in blocks.items()} for section, blocks in kinds.items()
        }
        self.labels: Names = {**self.sections["baseline"], **self.sections["blocks"]}
        self.states = {
            old: new
            for blocks in kinds.values()
            for kind in blocks.values()
            for old, new in kind.renamed.items()
            if new in {state.name for state in kind.states}
        }

    def graph(self, root: Node) -> Node:
        """All sections of a file."""
        for section, names in self.sections.items():
            blocks = _at(root, section)
            if blocks is not None:
                for block, old in names.items():
                    blocks = _with(blocks, block, self._keys(_at(blocks, block), partial(_renamed, old)))
                root = _with(root, section, blocks)
        root = _with(root, "start", self._keys(_at(root, "start"), self._start))
        root = _with(root, "uncertain", self._keys(_at(root, "uncertain"), self._label))
        wires = self._keys(_at(root, "wires"), self._label)
        if wires is not None and isinstance(wires.value, dict):
            wires = replace(wires, value={key: (at, self._text(node)) for key, (at, node) in wires.value.items()})
        root = _with(root, "wires", wires)
        log = _at(root, "log")
        signals = _at(log, "signals")
        if signals is not None and isinstance(signals.value, list):
            signals = replace(signals, value=[self._text(node) for node in signals.value])
        return root if log is None else _with(root, "log", _with(log, "signals", signals))

    def _label(self, text: str) -> str:
        """``task.alpha`` as ``task.alpha_bar``; any other text as it is."""
        block, dot, name = text.partition(".")
        return f"{block}.{self.labels.get(block, {}).get(name, name)}" if dot else text

    def _start(self, text: str) -> str:
        """A key of ``start``: a label, or a state's name only."""
        return self._label(text) if "." in text else self.states.get(text, text)

    def _keys(self, node: Node | None, new: Callable[[str], str]) -> Node | None:
        """A mapping with new keys."""
        if node is None or not isinstance(node.value, dict):
            return node
        changed = dict[str, tuple[Node, Node]]()
        for key, (at, value) in node.value.items():
            name = new(key)
            other = node.value[name][1] if name != key and name in node.value else None
            if other is not None and bool(other.origin) == bool(value.origin):
                self.faults.append(_both(at.place(self.file), key, name))
                continue
            if name != key:
                self._note(at.place(self.file), key, name)
            if name in changed and changed[name][1].origin:  # an override has precedence under either name
                continue
            changed[name] = (replace(at, value=name), value)
        return replace(node, value=changed)

    def _text(self, node: Node) -> Node:
        """A label as a value."""
        if not isinstance(node.value, str) or (new := self._label(node.value)) == node.value:
            return node
        self._note(node.place(self.file), node.value, new)
        return replace(node, value=new)

    def _note(self, place: str, old: str, new: str) -> None:
        notice = f"{place}: notice: {old} is now called {new}; the former name still works, but write {new}"
        if notice not in self.notices:  # an alias appears in several places
            self.notices.append(notice)


def _renamed(names: Mapping[str, str], key: str) -> str:
    return names.get(key, key)


def _both(place: str, old: str, new: str) -> ValueFault:
    return ValueFault(f"{old} is now called {new}, and both are given; keep only {new}", location=place)


def _at(node: Node | None, key: str) -> Node | None:
    if node is None or not isinstance(node.value, dict) or key not in node.value:
        return None
    return node.value[key][1]


def _with(node: Node, key: str, value: Node | None) -> Node:
    """The mapping with another value under a key that it has."""
    if value is None or not isinstance(node.value, dict) or key not in node.value:
        return node
    return replace(node, value={**node.value, key: (node.value[key][0], value)})
