"""Read a race's file into a checked `Race`; all faults at once, each with its line and column."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from dmframe.block import AbstractBlock, type_name
from dmframe.block.parameter import specs
from dmframe.block.port import Side
from dmframe.catalogue import find_graph, find_race, find_reality
from dmframe.common.errors import DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.common.units import to_unit
from dmframe.config.document import Document, Node, mapping_of, read_file
from dmframe.config.grammar import KEYS as GRAPH_KEYS
from dmframe.config.grammar import fault_of, shown
from dmframe.config.overrides import put_at
from dmframe.config.reality import KEY as REALITY
from dmframe.config.reality import LIKE, NONE, models_of
from dmframe.config.sections import kinds_of
from dmframe.diagram.diagram import doubtful
from dmframe.race.grammar import RACE, LawSection, RaceFile, keys_at, raise_placed
from dmframe.race.plan import PATH, Law, Race, Run, listed
from dmframe.race.sources import Sources

SECTIONS: Final = ("robot", "start", "plants", "paths", "realities")


def load_race(source: str | Path) -> Race:
    """Read a race from a file, or by the name of a packaged race.

    Raises
    ------
    DmframeError
        All faults of the file at once, each with its line and column. (Faults of wiring are found by the runs.)
    """
    path = find_race(str(source))
    document = read_file(path, RACE)
    file = _checked(document)
    faults = [*_unknown_names(file), *_misplaced(file, path.parent)]
    sections = {name: _absolute(_with_origin(_node(document, name), document.name), path.parent) for name in SECTIONS}
    laws, sources = dict[tuple[str, float], Law](), Sources()
    for name, clock in itertools.product(file.laws, file.clocks):
        try:
            laws[name, clock] = _law(name, clock, file.laws[name], document, path.parent, sources)
        except DmframeError as error:
            for fault in error.faults:
                fault.path = fault.path if fault.location or fault.path[:1] == ("laws",) else ("laws", name)
                if fault.text not in [other.text for other in faults]:  # the same at each sampling period
                    faults.append(fault)
    faults += _shared_names(file, laws)
    raise_placed(faults, document)
    text = path.read_text(encoding="utf-8")
    command = f"dmframe race {shlex.quote(str(source))}"
    race = Race(path.stem, command, text, document, file, laws, sections, {}, {})
    race = replace(race, delays=race.transport_delays())
    _check_graphs(race)
    return replace(race, sources=_digests(race, sources, path.parent))


def _digests(race: Race, sources: Sources, folder: Path) -> dict[tuple[str, str], str]:
    """Digests of the code of plants, paths and channel models, and of packaged sets of channel models."""
    found = dict[tuple[str, str], str]()
    for name, plant in race.file.plants.items():
        found["plants", name] = sources.digest(kinds_of(plant.blocks, folder).values())
    for name, path in race.file.paths.items():
        found["paths", name] = sources.digest(kinds_of({name: {"type": path.type}}, folder).values())
    entrant, first = race.file.entrant, race.training[0]
    for name in race.file.realities:
        run = Run(entrant, replace(first, reality=name), race.laws[entrant, first.clock].own, 0)
        node = race.document_of(run).node((REALITY,))
        kinds = kinds_of({model: {"type": model} for model in models_of(node)}, folder)
        like = mapping_of(node).get(LIKE, NONE)
        found["realities", name] = sources.digest(kinds.values(), [] if like == NONE else [find_reality(like)])
    return found


def _checked(document: Document) -> RaceFile:
    try:
        return RaceFile.model_validate(document.data)
    except ValidationError as error:
        raise_placed([fault_of(detail, keys_at) for detail in error.errors(include_url=False)], document)
        raise


def _unknown_names(file: RaceFile) -> Iterable[DmframeError]:
    """Faults of undefined names, and of a race without held-out cells."""
    known: dict[str, Sequence[str]] = {name: list(getattr(file, name)) for name in ("plants", "paths", "realities")}
    for section in ("training", "quick"):
        for kind, names in known.items():
            for name in getattr(getattr(file, section), kind):
                if name not in names:
                    yield UnknownNameError(f"{section}.{kind}", kind[:-1], name, names, path=(section, kind))
    for name in file.quick.laws:
        if name not in file.laws:
            yield UnknownNameError("quick.laws", "law", name, file.laws, path=("quick", "laws"))
    for kind in ("plants", "paths"):
        chosen = getattr(file.quick, kind)
        if chosen and set(chosen) <= set(getattr(file.training, kind)):
            text = f"quick.{kind}: expected at least one of {kind} that is held out, found those of training alone"
            yield ValueFault(text, path=("quick", kind))
    if file.quick.laws and (file.entrant not in file.quick.laws or len(file.quick.laws) < 2):
        text = f"quick.laws: expected {file.entrant}, the entrant, and a rival, found {', '.join(file.quick.laws)}"
        yield ValueFault(text, path=("quick", "laws"))
    for kind in ("plants", "paths"):
        if not set(known[kind]) - set(getattr(file.training, kind)):
            text = f"training.{kind}: expected at least one of {kind} that is held out, found all of them in training"
            yield ValueFault(text, path=("training", kind))
    for clock in file.quick.clocks or ():
        if clock not in file.clocks:
            yield ValueFault(f"quick.clocks: expected some of clocks, found {clock:g} s", path=("quick", "clocks"))
    if file.entrant not in file.laws:
        yield UnknownNameError("entrant", "law", file.entrant, file.laws, path=("entrant",))
    if len(file.laws) < 2:
        yield MissingError(f"laws: expected at least one rival of {file.entrant}, found none", path=("laws",))


def _misplaced(file: RaceFile, folder: Path) -> Iterable[DmframeError]:
    """Faults of plants without blocks, and of blocks on the wrong side for their section."""
    for name, plant in file.plants.items():
        where, at = f"plants.{name}", ("plants", name)
        if not plant.blocks:
            yield MissingError(f"{where}: expected at least one block, found none", path=at)
        if PATH in plant.blocks:
            yield ValueFault(f"{where}.{PATH}: expected another name, the path's block has this one", path=(*at, PATH))
        for block, kind in kinds_of(plant.blocks, folder).items():
            if kind.side is Side.CONTROLLER:
                text = (
                    f"{where}.{block}: expected a block of the plant, found {type_name(kind)} of the {kind.side.value}"
                )
                yield ValueFault(text, path=(*at, block))
    for name, kind in kinds_of({name: {"type": path.type} for name, path in file.paths.items()}, folder).items():
        if kind.side is not Side.SOURCE:
            text = f"paths.{name}: expected a source, found {type_name(kind)} of the {kind.side.value}"
            yield ValueFault(text, path=("paths", name))


def _shared_names(file: RaceFile, laws: Mapping[tuple[str, float], Law]) -> Iterable[DmframeError]:
    """Faults of law blocks with the name of the path block or of a plant block."""
    owners = {
        PATH: "the path's block",
        **{block: f"a block of plants.{name}" for name, plant in file.plants.items() for block in plant.blocks},
    }
    for name in file.laws:
        for block in sorted(
            {block for (law, _), each in laws.items() if law == name for block in each.blocks} & owners.keys()
        ):
            text = f"laws.{name}: expected another name than that of {owners[block]} for its block {block}"
            yield ValueFault(text, path=("laws", name))


def _law(name: str, clock: float, section: LawSection, race: Document, folder: Path, sources: Sources) -> Law:
    """Controller blocks of a law at a sampling period, with the values set by the race."""
    where = f"laws.{name}"
    document = _graph_of(where, section.graph_at(clock), folder, ("laws", name, "graph"))
    for label in section.set:
        document = _set(document, label, race, name)
    kinds = kinds_of(document.data.get("blocks"), Path(document.name).parent)
    mine = {block: kind for block, kind in kinds.items() if kind.side is Side.CONTROLLER}
    for label in section.set:
        words = label.removeprefix("blocks.").partition(".")
        if words[0] in kinds.keys() - mine.keys() or (words[0] in GRAPH_KEYS and words[0] not in ("blocks", "wires")):
            text = (
                f"{where}.set: {label}: expected a parameter of the controller, the race sets {words[0]}; leave it out"
            )
            raise ValueFault(text, path=("laws", name, "set", label))
    blocks = {block: pair for block, pair in _entries(document, "blocks").items() if block in mine}
    values, taken = mapping_of(Node(0, 0, blocks)), set[str]()
    for key in ("tune", "delay", "rate", "seed"):
        for label in getattr(section, key):
            at = ("laws", name, key, label) if key == "tune" else ("laws", name, key)
            _check_parameter(f"{where}.{key}", label, mine, at)
            if label in taken:
                raise ValueFault(
                    f"{where}.{key}: {label}: expected one of tune, delay, rate and seed, found two", path=at
                )
            taken.add(label)
    own = list[tuple[str, float]]()
    for label, searched in section.tune.items():
        at = ("laws", name, "tune", label)
        block, _, parameter = label.partition(".")
        if (searched.between is None) == (searched.per_clock is None):
            raise ValueFault(f"{where}.tune.{label}: expected one of between and per_clock", path=at)
        own.append((label, _own(f"{where}.tune.{label}", mine[block], parameter, values[block], at)))
    stamped = {block: (key, _with_origin(node, document.name)) for block, (key, node) in blocks.items()}
    wires = {end: (key, _with_origin(node, document.name)) for end, (key, node) in _entries(document, "wires").items()}
    return Law(section, document.name, stamped, wires, tuple(own), sources.digest(mine.values()))


def _graph_of(where: str, graph: str, folder: Path, at: tuple[str, ...]) -> Document:
    """Document of the graph of a law: a file (by its ending) or a packaged graph."""
    path = folder / graph
    try:
        document = read_file(path if path.suffix in (".yaml", ".yml") else find_graph(graph))
    except (MissingError, UnknownNameError) as error:
        error.text, error.path, error.location = f"{where}.graph: {error}", at, ""
        raise
    if "dmframe" not in document.data:
        raise ValueFault(f"{where}.graph: {graph}: expected a graph, which has the key dmframe: 1", path=at)
    return document


def _set(document: Document, label: str, race: Document, law: str) -> Document:
    """Document of the law with a value of its key ``set``."""
    at = ("laws", law, "set", label)
    origin = race.locate(at)
    try:
        return put_at(document, label, race.node(at), origin, GRAPH_KEYS)
    except DmframeError as error:
        for fault in error.faults:
            fault.text = f"laws.{law}.set: {fault.text.removeprefix(f'{origin}: ')}"
            fault.path, fault.location = at, origin
        raise


def _check_parameter(where: str, label: str, kinds: Mapping[str, type[AbstractBlock]], path: tuple[str, ...]) -> None:
    block, _, parameter = label.partition(".")
    if block not in kinds:
        raise UnknownNameError(f"{where}: {label}", "block of the controller", block, kinds, path=path)
    if parameter not in kinds[block].model_fields:
        raise UnknownNameError(f"{where}: {label}", "parameter", parameter, kinds[block].model_fields, path=path)


def _own(
    where: str, kind: type[AbstractBlock], parameter: str, values: Mapping[str, Any], path: tuple[str, ...]
) -> float:
    """Value of a searched parameter in the graph, in the unit of the parameter."""
    value, spec = values.get(parameter, kind.model_fields[parameter].default), specs(kind).get(parameter)
    if spec is None:
        raise ValueFault(f"{where}: expected a parameter that is a real number, found a choice or a count", path=path)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        text = f"{where}: expected a parameter with one number in the law's graph, found {shown(value)}; set one"
        raise ValueFault(text, path=path)
    return to_unit(value, spec.unit)


def _check_graphs(race: Race) -> None:
    """Read graphs with each law, plant, path and set of channel models, to report faults before any run.

    One graph of each sampling period is flattened, which also checks the times and the start.
    """
    first, like, faults, flat = race.training[0], None, dict[str, DmframeError](), set[float]()
    file, entrant = race.file, race.file.entrant
    runs = [
        Run(law, replace(first, clock=clock), values, 0, margin)
        for law, clock in race.laws
        for values in race.corners(law, clock)
        for margin in (False, True)
    ]
    cells = [replace(first, plant=name) for name in file.plants]
    cells += [replace(first, path=name) for name in file.paths]
    cells += [replace(first, reality=name) for name in file.realities]
    runs += [Run(entrant, cell, race.laws[entrant, cell.clock].own, 0) for cell in cells]
    for run in runs:
        found, own = list[DmframeError](), race.laws[run.law, run.cell.clock].own
        where = "" if run.values == own else f"with {listed(run.values)}: "
        try:
            like = race.graph(run, like)
            where = f"{run.law} in {run.cell.name}: {where}"
            if run.cell.clock not in flat or doubtful(like.blocks, like.file.wires, like.robot):
                flat.add(run.cell.clock)
                _ = like.diagram
        except DmframeError as error:
            found += error.faults
        for fault in found:
            if (key := f"{fault.location}{fault.text}") not in faults:
                faults[key], fault.text = fault, f"{where}{fault.text}"
    raise_placed(list(faults.values()), race.document)


def _node(document: Document, key: str) -> Node:
    return document.node((key,)) if key in document.data else Node(0, 0, {})


def _entries(document: Document, key: str) -> dict[str, tuple[Node, Node]]:
    value = _node(document, key).value
    return value if isinstance(value, dict) else {}


def _with_origin(node: Node, file: str) -> Node:
    """Node with the file and place of each value, for messages about graphs composed of several files."""
    value = node.value
    if isinstance(value, dict):
        value = {
            key: (replace(at, origin=at.place(file)), _with_origin(item, file)) for key, (at, item) in value.items()
        }
    elif isinstance(value, list):
        value = [_with_origin(item, file) for item in value]
    return replace(node, value=value, origin=node.place(file))


def _absolute(node: Node, folder: Path) -> Node:
    """Node with absolute paths for files of a folder, since the graph is in another folder."""
    value = node.value
    if isinstance(value, dict):
        return replace(node, value={key: (at, _absolute(item, folder)) for key, (at, item) in value.items()})
    if isinstance(value, str) and (folder / value.partition(":")[0]).suffix in (".py", ".urdf"):
        return replace(node, value=str((folder / value).absolute()))
    return node
