"""Grid of a study: axes whose cases are combined; a case sets values, scales parameters or names a graph."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from dmframe.common.errors import DmframeError, MissingError, UnknownNameError, ValueFault, raise_all
from dmframe.common.files import made_distinct
from dmframe.common.units import shorten
from dmframe.config.document import Document, Node, mapping_of
from dmframe.config.given import node_of
from dmframe.config.grammar import KEYS, shown
from dmframe.config.overrides import put_at
from dmframe.config.reality import names_reality
from dmframe.graph.graph import Graph
from dmframe.study.grammar import is_user_name
from dmframe.study.varied import SETTINGS, Factor

GRAPH: Final = "graph"
"""Name of the axis whose values are graphs."""
_LONGEST: Final = 40  # of a text value in a table
_TIMES: Final = {"clock": "s", "duration": "s", "jitter": "s", "solver.step": "s", "robot.friction_velocity": "rad/s"}


@final
@dataclass(frozen=True)
class Given:
    """Value that the study file sets in a graph; `place` is its position in the file."""

    label: str
    node: Node
    place: str

    @property
    def plain(self) -> Any:
        """The value as plain data."""
        return mapping_of(Node(0, 0, {"value": (self.node, self.node)}))["value"]

    def put(self, document: Document) -> Document:
        """The graph's document with the value. Raises `DmframeError` at the value's place in the study."""
        try:
            return put_at(document, self.label, self.node, self.place, KEYS)
        except DmframeError as error:
            for fault in error.faults:
                if fault.text.startswith(f"{self.place}: "):
                    fault.location, fault.text = self.place, f"{self.label}{fault.text.removeprefix(self.place)}"
            raise


@final
@dataclass(frozen=True)
class Case:
    """One value of an axis.

    Parameters
    ----------
    value
        Value in the table: a number in the axis's unit, or a text.
    sets
        Values to be set in the graph.
    factor
        Factor on the axis's parameters.
    graph
        Name of the graph; empty for the study's graph.
    """

    value: float | str
    sets: tuple[Given, ...] = ()
    factor: float | None = None
    graph: str = ""


@final
@dataclass(frozen=True)
class Axis:
    """One dimension of the grid.

    Parameters
    ----------
    scaled
        Parameters that the factors of its cases multiply; empty if the cases set values.
    """

    name: str
    cases: tuple[Case, ...]
    unit: str = ""
    scaled: tuple[str, ...] = ()

    @property
    def labels(self) -> set[str]:
        """Labels that its cases set."""
        return {given.label for case in self.cases for given in case.sets}


def axis_of(name: str, document: Document) -> Axis:
    """An axis from the study's document; its values are not applied to a graph yet.

    Raises
    ------
    ValueFault, MissingError, UnknownNameError
        It is neither a list, nor factors, nor named cases.
    """
    path = ("grid", name)
    entry = document.node(path).value
    if isinstance(entry, list):
        return Axis(name, tuple(_case(name, item, document, (*path, k)) for k, item in enumerate(_some(name, entry))))
    if isinstance(entry, dict) and "scale" in entry:
        return _scaled(name, entry, path)
    if isinstance(entry, dict) and entry:
        return Axis(name, tuple(_named(name, key, node, document) for key, (_, node) in entry.items()))
    raise ValueFault(
        f"grid.{name}: expected a list of values, {{scale: [...]}} or named cases, found {shown(entry)}", path=path
    )


def _some(name: str, items: list[Node]) -> list[Node]:
    if not items:
        raise MissingError(f"grid.{name}: expected at least one value, found none", path=("grid", name))
    return items


def _case(label: str, node: Node, document: Document, path: tuple[str | int, ...]) -> Case:
    if label == GRAPH:
        if not isinstance(node.value, str):
            raise ValueFault(f"grid.graph: expected names of graphs, found {shown(node.value)}", path=path)
        return Case(node.value, graph=node.value)
    return Case("", (Given(label, node, document.locate(path)),))


def _scaled(name: str, entry: Mapping[str, tuple[Node, Node]], path: tuple[str, str]) -> Axis:
    data = {key: Given(key, node, "").plain for key, (_, node) in entry.items()}
    for key in data:
        if key not in ("scale", "of"):
            raise UnknownNameError(f"grid.{name}.{key}", "key", key, ("scale", "of"), path=(*path, key))
    of = data.get("of", name)
    labels = [of] if isinstance(of, str) else of
    if not isinstance(labels, list) or not labels or not all(isinstance(item, str) for item in labels):
        raise ValueFault(f"grid.{name}.of: expected names of parameters, found {shown(of)}", path=(*path, "of"))
    if "of" not in data and is_user_name(name) and name not in SETTINGS:
        raise MissingError(
            f"grid.{name}: expected block.parameter, or a key of, the parameters that are scaled", path=path
        )
    found = data["scale"]
    for k, value in enumerate(found if isinstance(found, list) else [found]):
        if isinstance(value, bool) or not isinstance(value, int | float):
            text = f"grid.{name}.scale: expected a list of factors, found {shown(value)}"
            raise ValueFault(text, path=(*path, "scale", k) if isinstance(found, list) else (*path, "scale"))
    if not found:
        raise MissingError(f"grid.{name}: expected at least one factor, found none", path=path)
    factors = map(float, found if isinstance(found, list) else [found])
    return Axis(name, tuple(Case(value, factor=value) for value in factors), scaled=tuple(labels))


def _named(name: str, key: str, node: Node, document: Document) -> Case:
    """Named case, which sets several values."""
    path = ("grid", name, key)
    if not isinstance(node.value, dict):
        raise ValueFault(f"grid.{name}.{key}: expected keys with values, found {shown(node.value)}", path=path)
    graph, sets = "", list[Given]()
    for label, (_, item) in node.value.items():
        if label == GRAPH:
            graph = str(item.value)
        else:
            sets.append(Given(label, item, document.locate((*path, label))))
    return Case(key, tuple(sets), graph=graph)


def changed(base: Graph, sets: Sequence[Given]) -> Graph:
    """A graph with values of the study file. Raises `DmframeError`, each fault at its place in the study."""
    if not sets:
        return base
    texts, faults = [f"{given.label}={json.dumps(given.plain)}" for given in sets], list[DmframeError]()
    real, others = ([given.put for given in sets if names_reality(given.label) is first] for first in (True, False))
    document = base.with_steps(real, others, faults)
    try:
        made = base.remade(document, texts)
    except DmframeError as error:
        raise_all([*faults, *error.faults])
        raise
    raise_all(faults)
    return made


def scaled(graph: Graph, factors: Sequence[tuple[Axis, float]]) -> Graph:
    """A graph whose parameters are multiplied by the factors of some axes."""
    if not factors:
        return graph
    values = dict[str, np.ndarray]()
    for axis, factor in factors:
        Factor(axis.name, axis.scaled, "scale", None, None, "").put(values, np.array([[factor]]), graph)
    return changed(graph, given_of(values, f"grid.{', grid.'.join(axis.name for axis, _ in factors)}"))


def given_of(values: Mapping[str, np.ndarray], place: str) -> list[Given]:
    """Values to set in a graph, from one row of numbers each."""
    return [Given(label, node_of(rows[0].tolist(), (label,), place), place) for label, rows in values.items()]


def with_values_of(axis: Axis, graphs: Sequence[Graph]) -> Axis:
    """The axis with the values of its cases in their graphs: numbers in their unit if all are numbers, else texts."""
    own = [case.sets[0].label for case in axis.cases if len(case.sets) == 1 and case.value == ""]
    if len(own) < len(axis.cases):  # factors, graphs and named cases have their values already
        return axis
    found = [_number(label, graph) for label, graph in zip(own, graphs, strict=True)]
    numbers = [value for value, _ in found if value is not None]
    if len(numbers) == len(axis.cases):
        cases = [replace(case, value=value) for case, value in zip(axis.cases, numbers, strict=True)]
        return replace(axis, cases=tuple(cases), unit=found[0][1])
    texts = made_distinct([_text(case.sets[0]) for case in axis.cases], lambda text, k: f"{text} ({k})")
    return replace(axis, cases=tuple(replace(case, value=text) for case, text in zip(axis.cases, texts, strict=True)))


def _number(label: str, graph: Graph) -> tuple[float | None, str]:
    """A value as the graph parses it, and its unit; None if it is not one number."""
    from dmframe.block.parameter import specs

    keys = label.removeprefix("blocks.").split(".")
    if len(keys) == 2 and keys[0] in graph.blocks:
        block = graph.blocks[keys[0]]
        value, spec = getattr(block, keys[1], None), specs(type(block)).get(keys[1])
        unit = spec.unit if spec else ""
    else:
        value, unit = graph.file, _TIMES.get(label, "")
        for key in keys:
            value = getattr(value, key, None)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None, ""
    return float(value), unit


def _text(given: Given) -> str:
    value = given.plain
    if isinstance(value, dict) and "type" in value:
        return str(value["type"])
    return shorten(value if isinstance(value, str) else json.dumps(value), _LONGEST)
