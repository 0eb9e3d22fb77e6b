"""A graph whose block files are not to be run: what its text and their declarations say of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import final

from dmframe import trust
from dmframe.block import AbstractBlock, type_name
from dmframe.catalogue import find_block, find_graph
from dmframe.config.declared import INHERITED, LISTS, Declared, declared
from dmframe.config.document import Document, read_file
from dmframe.config.experiment import Experiment, experiment_of, with_overrides
from dmframe.config.places import placed
from dmframe.config.renamed import SECTIONS
from dmframe.diagram.diagram import declared_outputs
from dmframe.diagram.wiring import End, Source, Zero, wire_blocks
from dmframe.errors import BlockError, DmframeError, Faults
from dmframe.port import Port


@final
@dataclass(frozen=True)
class States:
    """The names of a block's states."""

    states: tuple[str, ...]


@final
@dataclass(frozen=True)
class Unrun:
    """A graph that was read, with the classes of some of its blocks as their files declare them.

    Parameters
    ----------
    experiment
        The graph; its blocks can tell what they are, and compute nothing.
    files
        Of each block that is not run, what is known of its class.
    why
        Why each is not run, by its section and name.
    """

    experiment: Experiment
    files: Mapping[str, Declared]
    why: Mapping[tuple[str, str], str]

    @property
    def blocks(self) -> Mapping[str, AbstractBlock]:
        """The blocks by name; one whose ports are not known has those that the graph's wires name."""
        return self._wired[0]

    @property
    def sources(self) -> Mapping[End, Source]:
        """What drives each input, as far as names say it."""
        return self._wired[1]

    @property
    def models(self) -> Mapping[str, States]:
        """The states of each block, and those that it may leave out."""
        return {
            name: States(tuple(state.name for state in block.states)) for name, block in self.experiment.blocks.items()
        }

    def type_of(self, name: str) -> str:
        """The type of a block, as a drawing shows it."""
        return type_name(type(self.blocks[name]))

    @property
    def faults(self) -> Sequence[DmframeError]:
        """Why each file is not run, and what is wrong with what it declares and with the wires, each with its place."""
        found = list[DmframeError]()
        for (section, name), why in self.why.items():
            found.append(BlockError(f"{section}.{name}.type: {why}", path=(section, name, "type")))
        for name, item in self.files.items():
            breaches = [] if item.unread else item.kind.contract(name)
            found += [BlockError(breach.text, path=("blocks", name)) for breach in breaches]
        return placed(Faults([*found, *self._wired[2]]), self.experiment.document).faults

    @cached_property
    def unread(self) -> Mapping[str, tuple[str, ...]]:
        """What is not known of the blocks' classes."""
        return {name: item.unread for name, item in self.files.items() if item.unread}

    @cached_property
    def partly(self) -> Sequence[str]:
        """Blocks whose ports may be others than those that are known."""
        return [name for name, unread in self.unread.items() if {*LISTS, INHERITED} & {*unread}]

    @cached_property
    def _wired(self) -> tuple[dict[str, AbstractBlock], dict[End, Source], list[DmframeError]]:
        wires, blocks = self.experiment.file.wires, dict(self.experiment.blocks)
        for name in self.partly:
            blocks[name] = _with_ports(blocks[name], name, wires)
        sources, faults = wire_blocks(blocks, declared_outputs(blocks), wires)
        for name, block in blocks.items():
            for port in block.inputs:
                sources.setdefault((name, port.name), Zero())
        return blocks, sources, [] if self.partly else faults  # a port that nobody knows may be what is missed


def _with_ports(block: AbstractBlock, name: str, wires: Mapping[str, str]) -> AbstractBlock:
    """The block with ports for the wires that end at it or begin there."""
    held = dict[str, tuple[Port, ...]]()
    for key, ends in (("inputs", list(wires)), ("outputs", list(wires.values()))):
        known: tuple[Port, ...] = getattr(block, key)
        pairs = (end.partition(".") for end in dict.fromkeys(ends))
        named = [port for owner, _, port in pairs if owner == name and port not in [item.name for item in known]]
        held[key] = (*known, *map(Port, named))
    made: type[AbstractBlock] = type(type(block).__name__, (type(block),), {"__module__": "unrun", **held})
    return made(**dict(block))


def look_at(source: str, overrides: Sequence[str] = ()) -> Unrun | None:
    """A graph of which some block file is not to be run, looked at; None where all may be run.

    Raises
    ------
    DmframeError
        All faults of the graph's text and of the values in it, each with its place.
    """
    document = with_overrides(read_file(find_graph(source)), overrides)
    base, why = Path(document.name).parent, dict[tuple[str, str], str]()
    for section, name, kind in _own_types(document):
        try:
            _, reason = trust.look(base, kind.rpartition(":")[0], f"{section}.{name}.type")
        except DmframeError:
            continue  # told where the block is made
        if reason:
            why[section, name] = reason
    if not why:
        return None
    known = dict[str, Declared]()

    def find(kind: str, folder: Path, where: str) -> type[AbstractBlock]:
        file, _, class_name = kind.rpartition(":")
        if kind not in known and file.endswith(".py"):
            content, reason = trust.look(folder, file, where)
            if reason:
                known[kind] = declared(content, class_name, f"{where}: {Path(file).name}")
        return known[kind].kind if kind in known else find_block(kind, folder, where)

    experiment = replace(experiment_of(document, find), overrides=tuple(overrides))
    kinds = {name: kind for section, name, kind in _own_types(experiment.document) if section == "blocks"}
    return Unrun(experiment, {name: known[kind] for name, kind in kinds.items() if kind in known}, why)


def _own_types(document: Document) -> Iterator[tuple[str, str, str]]:
    """Section and name of each block whose type names a file, with that type."""
    for section in SECTIONS:
        blocks = document.data.get(section)
        for name, spec in blocks.items() if isinstance(blocks, dict) else ():
            kind = str(spec.get("type")) if isinstance(spec, dict) else ""
            if kind.rpartition(":")[0].endswith(".py"):
                yield section, name, kind
