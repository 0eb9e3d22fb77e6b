"""Plan of a race: laws, cells, candidates, and the graph of each run."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, final

import scipy

from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.units import plain, to_unit
from dmframe.config.document import Document, Node, mapping_of
from dmframe.config.given import node_of
from dmframe.graph.graph import Graph
from dmframe.race.grammar import LawSection, RaceFile
from dmframe.study.identity import key_of

Entries = Mapping[str, tuple[Node, Node]]
Values = tuple[tuple[str, float], ...]
"""Labels ``block.parameter`` and their values."""

SEEDS: Final = 1_000_000
"""Number of seeds for laws with a parameter `seed`; the seeds start at 1."""
PATH: Final = "path"
"""Name of the source in each graph."""
REPEATS: Final = "repeats"
"""Key of a path: the angular frequency with which it repeats."""
DELAY: Final = "transport_delay"
GAIN: Final = "command_gain"
"""Channel models of the margins."""
DIGITS: Final = 5
"""Significant digits of a candidate's value."""


@final
@dataclass(frozen=True, order=True)
class Cell:
    """Cell of a race: sampling period [s], path, plant and set of channel models."""

    clock: float
    path: str
    plant: str
    reality: str

    @property
    def name(self) -> str:
        """``90 ms, circle, stiff, ur``."""
        return ", ".join([plain(self.clock, "s"), self.path, self.plant, self.reality])


@final
@dataclass(frozen=True)
class Run:
    """Run of a law with parameter values in a cell; `margin`: with the perturbations of the margins."""

    law: str
    cell: Cell
    values: Values
    seed: int
    margin: bool = False


@final
@dataclass(frozen=True)
class Law:
    """Control law: controller blocks and wires of its graph.

    Parameters
    ----------
    document
        Name of the graph's file, in whose folder its blocks are searched.
    own
        The graph's own values of the searched parameters.
    sources
        Digest of the blocks' code.
    """

    section: LawSection
    document: str
    blocks: Entries
    wires: Entries
    own: Values
    sources: str


@final
@dataclass(frozen=True)
class Race:
    """A race; immutable.

    Parameters
    ----------
    command
        The command that runs it.
    document
        The file with lines and columns.
    laws
        By name and sampling period.
    sections
        Nodes of the sections ``robot``, ``start``, ``plants``, ``paths`` and ``realities``, which name their places.
    sources
        Digests of the code of plants, paths and realities, by section and name; empty until they are read.
    delays
        Whole samples of transport delay, by reality; empty until they are read.
    """

    name: str
    command: str
    text: str
    document: Document
    file: RaceFile
    laws: Mapping[tuple[str, float], Law]
    sections: Mapping[str, Node]
    sources: Mapping[tuple[str, str], str]
    delays: Mapping[str, int]

    @property
    def training(self) -> list[Cell]:
        """Cells on which the laws are tuned."""
        chosen = self.file.training
        return self._cells(chosen.paths, chosen.plants, chosen.realities)

    @property
    def held_out(self) -> list[Cell]:
        """Cells on which the laws are judged: plants and paths that no training cell has."""
        file = self.file
        paths = [path for path in file.paths if path not in file.training.paths]
        plants = [plant for plant in file.plants if plant not in file.training.plants]
        return self._cells(paths, plants, list(file.realities))

    def _cells(self, paths: Sequence[str], plants: Sequence[str], realities: Sequence[str]) -> list[Cell]:
        return [Cell(*item) for item in itertools.product(self.file.clocks, paths, plants, realities)]

    @property
    def quick(self) -> Race:
        """Subset of the race in its section ``quick``, with all training cells."""
        file, chosen = self.file, self.file.quick
        plants = {name: file.plants[name] for name in (*file.training.plants, *(chosen.plants or file.plants))}
        paths = {name: file.paths[name] for name in (*file.training.paths, *(chosen.paths or file.paths))}
        changes: dict[str, Any] = {"plants": plants, "paths": paths, "clocks": chosen.clocks or file.clocks}
        changes["realities"] = {name: file.realities[name] for name in chosen.realities or file.realities}
        changes["laws"] = {name: file.laws[name] for name in chosen.laws or file.laws}
        changes["budget"] = chosen.budget or file.budget
        name, command = f"{self.name}_quick", f"{self.command} --quick"
        return replace(self, name=name, command=command, file=file.model_copy(update=changes))

    def corners(self, law: str, clock: float) -> list[Values]:
        """Values of the graph, lower bounds and upper bounds."""
        bounds = [(label, section.at(clock)) for label, section in self.file.laws[law].tune.items()]
        return [self.laws[law, clock].own, *(tuple((label, ends[k]) for label, ends in bounds) for k in (0, 1))]

    def candidates(self, law: str, clock: float) -> list[Values]:
        """Candidates: the values of the graph, then a Halton sequence, log-uniform over the ranges."""
        own, tune = self.laws[law, clock].own, self.file.laws[law].tune
        halton = scipy.stats.qmc.Halton(len(tune), scramble=False)
        halton.fast_forward(1)  # the first point is the lower corner
        points = halton.random(self.file.budget - 1) if self.file.budget > 1 else []
        found = [own]
        for point in points:
            values = list[tuple[str, float]]()
            for (label, section), share in zip(tune.items(), point, strict=True):
                lower, upper = map(math.log, section.at(clock))
                values.append((label, float(f"{math.exp(lower + (upper - lower) * share):.{DIGITS}g}")))
            found.append(tuple(values))
        return found

    def trials(self, law: str, clock: float, values: Values) -> Iterator[Run]:
        """Runs that score a candidate: each training cell, without and with the margins."""
        for cell in self.training:
            if cell.clock == clock:
                yield Run(law, cell, values, self.file.seed)
                yield Run(law, cell, values, self.file.seed, margin=True)

    def structure(self, run: Run) -> str:
        """Key of the loop structure: runs with the same key differ in numbers and share compiled code."""
        plant = mapping_of(self._entry("plants", run.cell.plant))
        kinds = [block.get("type") for block in plant.values() if isinstance(block, dict)]
        path = mapping_of(self._entry("paths", run.cell.path)).get("type")
        law = self.laws[run.law, run.cell.clock].document
        return repr((run.law, law, kinds, path, run.cell.reality))

    def key(self, run: Run) -> str:
        """Digest of all inputs of a run."""
        cell = run.cell
        parts = (("plants", cell.plant), ("paths", cell.path), ("realities", cell.reality))
        sources = [self.laws[run.law, cell.clock].sources, *(self.sources[part] for part in parts)]
        return key_of({"graph": self.document_of(run).data, "sources": sources})

    def graph(self, run: Run, like: Graph | None = None) -> Graph:
        """Graph of a run; `like` is a graph with the same robot, which is then shared."""
        return Graph.of(self.document_of(run), like)

    def document_of(self, run: Run) -> Document:
        """Document of a run's graph, with the place of each value in the race file or in the file of the law."""
        law, plant = self.laws[run.law, run.cell.clock], dict(_entries(self._entry("plants", run.cell.plant)))
        wires = {**law.wires, **_entries(plant.pop("wires", (None, _node({})))[1])}
        plant.pop(DELAY, None)
        node = self._entry("paths", run.cell.path)
        path = dict(_entries(node))
        rate = path.pop(REPEATS, None)
        blocks = {PATH: (_node(PATH), replace(node, value=path)), **law.blocks, **plant}
        known: list[tuple[str, str, Any]] = [(f"tune.{label}", label, value) for label, value in run.values]
        late = self.delays.get(run.cell.reality, 0) + math.floor(self._late(run) + 0.5)
        known += [("delay", label, late) for label in law.section.delay]
        known += [("seed", label, 1 + run.seed % SEEDS) for label in law.section.seed]
        known += [("rate", label, rate[1].value) for label in law.section.rate if rate is not None]
        for key, label, value in known:
            name, _, parameter = label.partition(".")
            at, block = blocks[name]
            node_at = self._stamped(value, "laws", run.law, *key.split(".", 1))
            blocks[name] = at, replace(block, value={**_entries(block), parameter: (node_at, node_at)})
        keys: dict[str, Any] = {"dmframe": 1, "title": f"{run.law}: {run.cell.name}"}
        entries = {key: (_node(key), _node(value)) for key, value in keys.items()}
        times = {"seed": ("seed", run.seed), "clock": ("clocks", run.cell.clock)}
        for key, (place, value) in (times | {"duration": ("duration", self.file.duration)}).items():
            entries[key] = (_node(key), self._stamped(value, place))
        parts = {"robot": self.sections["robot"], "start": self.sections["start"]}
        parts |= {"blocks": _node({}, blocks), "wires": _node({}, self._fitting(wires, blocks, run.cell.plant))}
        parts["reality"] = self._reality(run)
        entries |= {key: (_node(key), part) for key, part in parts.items() if part.value}
        root = _node({}, entries)
        return Document(law.document, mapping_of(root), root)

    def transport_delays(self) -> dict[str, int]:
        """Whole samples of transport delay of each set of channel models, read from a graph with it."""
        law, first, found = self.file.entrant, self.training[0], dict[str, int]()
        like: Graph | None = None
        for reality in self.file.realities:
            like = self.graph(Run(law, replace(first, reality=reality), self.laws[law, first.clock].own, 0), like)
            blocks = [like.blocks[name] for name, fact in like.blocks.facts.items() if fact["type"] == DELAY]
            found[reality] = sum(int(getattr(block, "samples", 0)) for block in blocks)
        return found

    def _late(self, run: Run) -> float:
        """Transport delay of the plant itself [samples]."""
        return self.file.plants[run.cell.plant].transport_delay

    def _entry(self, section: str, name: str) -> Node:
        return _entries(self.sections[section])[name][1]

    def _reality(self, run: Run) -> Node:
        """Channel models of a run; a delay and a gain have the values of the margins, or no effect.

        The margins then differ in numbers only, and need no machine code of their own.
        """
        name = run.cell.reality
        node = self._entry("realities", name)
        if name not in self.delays:
            return node
        models = dict(_entries(node))
        if isinstance(node.value, str):
            models["like"] = (_node("like"), node)
        late = dict(_entries(models[DELAY][1])) if DELAY in models else {}
        more, own = self.file.margins.delay if run.margin else 0, mapping_of(_node({}, late)).get("share", 0)
        if "late" in late or not isinstance(own, int | float):  # a sample that is late by chance excludes a share
            whole = more + math.ceil(self._late(run))
        else:
            own += self._late(run)
            whole = max(math.ceil(more + own) - 1, 0)
            late["share"] = (_node("share"), _node(more + own - whole))
        late["samples"] = (_node("samples"), self._stamped(self.delays[name] + whole, "margins", "delay"))
        models[DELAY] = (_node(DELAY), _node({}, late))
        gain = dict(_entries(models[GAIN][1])) if GAIN in models else {}
        if run.margin:
            with suppress(DmframeError):  # a gain that is no number is reported by the graph
                factor = to_unit(mapping_of(_node({}, gain)).get("gain", 1), "") * self.file.margins.gain
                gain["gain"] = (_node("gain"), self._stamped(factor, "margins", "gain"))
        models[GAIN] = (_node(GAIN), _node({}, {"gain": (_node("gain"), _node(1)), **gain}))
        return _node({}, models)

    def _stamped(self, value: Any, *path: str) -> Node:
        """Value set by the race, with its place in the race file."""
        return node_of(value, (), self.document.locate(path))

    def _fitting(self, wires: Entries, blocks: Entries, plant: str) -> Entries:
        """Wires between blocks of the graph, without those of the plant in the graph of the law."""
        found = dict[str, tuple[Node, Node]]()
        for end, (at, node) in wires.items():
            names = [str(label).partition(".")[0] for label in (end, node.value)]
            absent = [name for name in names if name not in blocks]
            if len(absent) == 1:
                raise ValueFault(
                    f"wires.{end}: {node.value}: expected a block {absent[0]} in plants.{plant}, found none; name the "
                    "blocks as the law's graph does",
                    location=node.origin,
                )
            if not absent:
                found[end] = at, node
        return found


def listed(values: Values) -> str:
    """``task.Lambda = 3, inverse.nu = 10``."""
    return ", ".join(f"{label} = {value:g}" for label, value in values)


def _node(value: Any, entries: Entries | None = None) -> Node:
    """Document node of plain data or of entries."""
    return node_of(value, ()) if entries is None else Node(0, 0, dict(entries))


def _entries(node: Node) -> dict[str, tuple[Node, Node]]:
    return node.value if isinstance(node.value, dict) else {}
