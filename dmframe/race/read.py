"""Read a race's file into a checked `Race`; all faults at once, each with its line and column."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from dmframe.block import AbstractBlock
from dmframe.catalogue import find_graph, find_race, packages
from dmframe.config.document import Document, Node, mapping_of, read_file
from dmframe.config.grammar import KEYS as GRAPH_KEYS
from dmframe.config.grammar import fault_of, shown
from dmframe.config.overrides import put_at
from dmframe.config.sections import kinds_of
from dmframe.errors import DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.parameter import specs
from dmframe.port import Side
from dmframe.race.grammar import RACE, LawSection, RaceFile, keys_at, raise_placed
from dmframe.race.plan import Law, Race, Run
from dmframe.units import to_unit

SECTIONS: Final = ("robot", "start", "plants", "paths", "realities")


def load_race(source: str | Path) -> Race:
    """A race from its file, or from the name of a packaged one.

    Raises
    ------
    DmframeError
        All faults of the file at once, each with its line and column. (Faults of wiring are found by the runs.)
    """
    path = find_race(str(source))
    document = read_file(path, RACE)
    file = _checked(document)
    faults = [*_unknown_names(file)]
    sections = {name: _absolute(_said(_node(document, name), document.name), path.parent) for name in SECTIONS}
    laws = dict[tuple[str, float], Law]()
    for name, clock in itertools.product(file.laws, file.clocks):
        try:
            laws[name, clock] = _law(name, clock, file.laws[name], document, path.parent)
        except DmframeError as error:
            for fault in error.faults:
                fault.path = fault.path if fault.location or fault.path[:1] == ("laws",) else ("laws", name)
                if fault.text not in [other.text for other in faults]:  # the same at each sampling period
                    faults.append(fault)
    raise_placed(faults, document)
    text = path.read_text(encoding="utf-8")
    files = [file for law in laws.values() for file in _files(_nodes(law.blocks), Path(law.document).parent)]
    files += _files([node for node in sections.values() if node.value], path.parent)
    race = Race(path.stem, text, document, file, laws, sections, _digest(files), {})
    race = replace(race, delays=race.transport_delays())
    _check_graphs(race)
    return race


def _checked(document: Document) -> RaceFile:
    try:
        return RaceFile.model_validate(document.data)
    except ValidationError as error:
        raise_placed([fault_of(detail, keys_at) for detail in error.errors(include_url=False)], document)
        raise


def _unknown_names(file: RaceFile) -> Iterable[DmframeError]:
    """Faults of names that are not defined, and of a race that holds out nothing."""
    known: dict[str, Sequence[str]] = {name: list(getattr(file, name)) for name in ("plants", "paths", "realities")}
    for section in ("training", "quick"):
        for kind, names in known.items():
            for name in getattr(getattr(file, section), kind):
                if name not in names:
                    yield UnknownNameError(f"{section}.{kind}", kind[:-1], name, names, path=(section, kind))
    for name in file.quick.laws:
        if name not in file.laws:
            yield UnknownNameError("quick.laws", "law", name, file.laws, path=("quick", "laws"))
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


def _law(name: str, clock: float, section: LawSection, race: Document, folder: Path) -> Law:
    """The controller's blocks of a law's graph at a sampling period, with the values that the race sets."""
    path = folder / section.graph_at(clock)
    document = read_file(path if path.suffix in (".yaml", ".yml") else find_graph(section.graph_at(clock)))
    for label in section.set:
        place = ("laws", name, "set", label)
        document = put_at(document, label, race.node(place), race.locate(place), GRAPH_KEYS)
    kinds = kinds_of(document.data.get("blocks"), Path(document.name).parent)
    mine = {block: kind for block, kind in kinds.items() if kind.side is Side.CONTROLLER}
    blocks = {block: pair for block, pair in _entries(document, "blocks").items() if block in mine}
    where, values = f"laws.{name}", mapping_of(Node(0, 0, blocks))
    for key, labels in (("delay", section.delay), ("rate", section.rate)):
        for label in labels:
            _check_parameter(f"{where}.{key}", label, mine, ("laws", name, key))
    own = list[tuple[str, float]]()
    for label, searched in section.tune.items():
        at = ("laws", name, "tune", label)
        block, _, parameter = label.partition(".")
        _check_parameter(f"{where}.tune", label, mine, at)
        if (searched.between is None) == (searched.per_clock is None):
            raise ValueFault(f"{where}.tune.{label}: expected one of between and per_clock", path=at)
        own.append((label, _own(f"{where}.tune.{label}", mine[block], parameter, values[block], at)))
    stamped = {block: (key, _said(node, document.name)) for block, (key, node) in blocks.items()}
    wires = {end: (key, _said(node, document.name)) for end, (key, node) in _entries(document, "wires").items()}
    return Law(section, document.name, stamped, wires, tuple(own))


def _check_parameter(where: str, label: str, kinds: Mapping[str, type[AbstractBlock]], path: tuple[str, ...]) -> None:
    block, _, parameter = label.partition(".")
    if block not in kinds:
        raise UnknownNameError(f"{where}: {label}", "block of the controller", block, kinds, path=path)
    if parameter not in kinds[block].model_fields:
        raise UnknownNameError(f"{where}: {label}", "parameter", parameter, kinds[block].model_fields, path=path)


def _own(
    where: str, kind: type[AbstractBlock], parameter: str, values: Mapping[str, Any], path: tuple[str, ...]
) -> float:
    """The graph's own value of a searched parameter, in the parameter's unit."""
    value, spec = values.get(parameter, kind.model_fields[parameter].default), specs(kind).get(parameter)
    if spec is None or isinstance(value, bool) or not isinstance(value, int | float | str):
        text = f"{where}: expected a parameter with one number in the law's graph, found {shown(value)}; set one"
        raise ValueFault(text, path=path)
    return to_unit(value, spec.unit)


def _check_graphs(race: Race) -> None:
    """Read a graph of each law, plant, path and reality, to find the faults of their blocks before any run."""
    first, like, faults = race.training[0], None, dict[str, DmframeError]()
    file, entrant = race.file, race.file.entrant
    cells = [(name, replace(first, clock=clock)) for name, clock in race.laws]
    cells += [(entrant, replace(first, plant=name)) for name in file.plants]
    cells += [(entrant, replace(first, path=name)) for name in file.paths]
    cells += [(entrant, replace(first, reality=name)) for name in file.realities]
    for law, cell in cells:
        for margin in (False, True):
            try:
                like = race.graph(Run(law, cell, race.laws[law, cell.clock].own, 0, margin), like)
            except DmframeError as error:
                faults |= {f"{fault.location}{fault.text}": fault for fault in error.faults}
    raise_placed(list(faults.values()), race.document)


def _node(document: Document, key: str) -> Node:
    return document.node((key,)) if key in document.data else Node(0, 0, {})


def _entries(document: Document, key: str) -> dict[str, tuple[Node, Node]]:
    value = _node(document, key).value
    return value if isinstance(value, dict) else {}


def _said(node: Node, file: str) -> Node:
    """The node, each value of which names its place in a file, so that a graph made of several files names it too."""
    value = node.value
    if isinstance(value, dict):
        value = {key: (replace(at, said=at.place(file)), _said(item, file)) for key, (at, item) in value.items()}
    elif isinstance(value, list):
        value = [_said(item, file) for item in value]
    return replace(node, value=value, said=node.place(file))


def _absolute(node: Node, folder: Path) -> Node:
    """The node, in which texts that name files of a folder have their absolute paths: a graph is in another folder."""
    value = node.value
    if isinstance(value, dict):
        return replace(node, value={key: (at, _absolute(item, folder)) for key, (at, item) in value.items()})
    if isinstance(value, str) and (folder / value.partition(":")[0]).suffix in (".py", ".urdf"):
        return replace(node, value=str((folder / value).absolute()))
    return node


def _nodes(blocks: Mapping[str, tuple[Node, Node]]) -> list[Node]:
    return [node for _, node in blocks.values()]


def _files(nodes: Iterable[Node], folder: Path) -> list[Path]:
    """Python files that are named in some nodes."""
    found = list[Path]()
    for node in nodes:
        if isinstance(node.value, dict):
            found += _files(_nodes(node.value), folder)
        elif isinstance(node.value, str) and node.value.partition(":")[0].endswith(".py"):
            found.append(folder / node.value.partition(":")[0])
    return found


def _digest(files: Iterable[Path]) -> str:
    """Digest of the code of the registered block packages and of some files."""
    packaged = [path for package in packages() for folder in package.__path__ for path in Path(folder).glob("*.py")]
    digest = hashlib.sha256()
    for path in sorted({*packaged, *(path for path in files if path.is_file())}):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()
