"""Read a study's file into a checked `Study`; all faults at once, each with its line and column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dmframe.catalogue import find_graph
from dmframe.common.errors import DmframeError, UnknownNameError, ValueFault
from dmframe.common.files import expanded
from dmframe.config.document import Document, Steps, read_document, read_file
from dmframe.config.given import document_of
from dmframe.config.grammar import fault_of
from dmframe.graph.graph import Graph
from dmframe.study.grammar import STUDY, StudyFile, is_user_name, keys_at, raise_placed
from dmframe.study.grid import Axis, Given, axis_of, changed, scaled, with_values_of
from dmframe.study.journal import study_name_in
from dmframe.study.plan import Study
from dmframe.study.varied import SETTINGS, Factor, factors_of, set_twice

TEXT = "study"
"""Name of a study without a file."""
KEPT = "study.yaml"
"""The study's file in a folder of results."""
RUNS = 100
"""Robots of the study of a graph's file."""


def load_study(
    source: str | Path | Mapping[str, Any] | Study,
    *,
    runs: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
) -> Study:
    """A study from its file, its text or data.

    Parameters
    ----------
    source
        A path; a text of more than one line; a dictionary with the file's content; a `Study` is returned unchanged. A
        graph's file with the section ``uncertain`` is a study of `RUNS` robots in its intervals.
    runs, seed
        Replace those of the section ``sample``.
    overrides
        Changes of the graph in addition to the section ``set``, in the form of ``--set``.

    Raises
    ------
    DmframeError
        All faults of the file at once, each with its line and column. (`Study.check` finds those that need the closed
        loop, such as faults of wiring.)
    """
    if isinstance(source, Study):
        return source
    document, text, path = _read(source)
    if isinstance(document.data.get("sample", {}), dict):
        data = dict(document.data)
        replaced = {key: value for key, value in (("runs", runs), ("seed", seed)) if value is not None}
        if replaced:
            data["sample"] = {**(data.get("sample") or {}), **replaced}
            text = _written(data)
        document = replace(document, data=data)
    file, faults = _checked(document)
    folder = path.parent if path is not None else Path()
    bases, axes, more = _graphs(file, document, folder, overrides)
    faults += more
    if bases and file.sample.runs > 1 and not file.sample.variations:
        fixed = [*file.set, *(override.partition("=")[0] for override in overrides)]
        fixed += [label for axis in axes for label in axis.labels]
        document = _with_uncertain(document, bases[""], fixed)
        text, file = _written(document.data), StudyFile.model_validate(document.data)
    if bases:
        axes, more = _in_graphs(bases, axes)
        faults += more
    factors = list[Factor]()
    if bases:
        factors, more = _factors(file, bases[""], axes)
        faults += more
    if file.sample.runs > 1 and not file.sample.variations:
        text_ = (
            f"sample.runs: {file.sample.runs} runs, but nothing varies between them; name what varies, or remove runs"
        )
        faults.append(ValueFault(text_, path=("sample", "runs")))
    raise_placed(faults, document)
    return Study(_name(path), path, text, document, file, bases, tuple(axes), tuple(factors))


def _name(path: Path | None) -> str:
    """The file's name without its ending; in a folder of results, the name under which the study was started."""
    if path is None:
        return TEXT
    return (study_name_in(path.parent) if path.name == KEPT else "") or path.stem


def _read(source: Any) -> tuple[Document, str, Path | None]:
    if isinstance(source, Mapping):
        document = document_of(source, TEXT)
        return document, _written(document.data), None
    if isinstance(source, str) and "\n" in source:
        return read_document(source, TEXT, STUDY), source, None
    if not isinstance(source, str | Path):
        found = type(source).__name__
        raise ValueFault(f"load_study: expected a study's path, its text or a dictionary, found {found}")
    path = expanded(source)
    document = read_file(path, STUDY)
    if is_graph(document) and document.data.get("uncertain"):
        data = {"dmframe-study": 1, "graph": path.name, "sample": {"runs": RUNS}}
        return document_of(data, path.name), _written(data), path
    return document, path.read_text(encoding="utf-8"), path


def is_graph(document: Document) -> bool:
    """True for a graph's file instead of a study's."""
    return "dmframe" in document.data and "dmframe-study" not in document.data


def _with_uncertain(document: Document, graph: Graph, fixed: Sequence[str]) -> Document:
    """The study, with the graph's section `uncertain` instead of its empty `sample`.

    Each element is drawn uniformly from its interval, independent of the others, also where the section confines a
    ratio or has one factor for all elements; labels that the study sets are not drawn.
    """
    from dmframe.certify.uncertain import tie_of

    drawn = dict[str, Any]()
    for label, own in graph.intervals().items():
        if tie_of(label) is not None:
            continue
        ends = [[float(each.lower) for each in own], [float(each.upper) for each in own]]
        if label in fixed or ends[0] == ends[1]:
            continue
        drawn[label] = {"uniform": ends, "per": "element"} if len(own) > 1 else {"uniform": [ends[0][0], ends[1][0]]}
    return replace(document, data={**document.data, "sample": {**document.data["sample"], **drawn}})


def _written(data: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    writer, text = YAML(typ="safe", pure=True), StringIO()
    writer.default_flow_style = None
    writer.dump(dict(data), text)
    return text.getvalue()


def _checked(document: Document) -> tuple[StudyFile, list[DmframeError]]:
    """Validate the file against the grammar, and find unknown keys; names of parameters are checked later."""
    faults, data = list[DmframeError](), dict(document.data)
    if is_graph(document):
        raise ValueFault(
            f"{document.name}: expected a study, found a graph without a section uncertain; write a study with the key "
            f"graph: {Path(document.name).name}"
        )
    for section in ("sample", "tune"):
        found = document.data.get(section)
        entries = found if isinstance(found, dict) else {}
        for key in entries:
            known = [*keys_at((section,))]
            if is_user_name(key) and key not in (*known, *SETTINGS) and not _is_group(entries[key]):
                faults.append(UnknownNameError(f"{section}.{key}", "key", key, known, path=(section, key)))
                data[section] = {other: value for other, value in data[section].items() if other != key}
    try:
        return StudyFile.model_validate(data), faults
    except ValidationError as error:
        faults += [fault_of(detail, keys_at) for detail in error.errors(include_url=False)]
    raise_placed(faults, document)
    raise AssertionError("a file that is not valid left a fault")


def _is_group(value: Any) -> bool:
    return isinstance(value, dict) and "of" in value


def _graphs(
    file: StudyFile, document: Document, folder: Path, overrides: Sequence[str]
) -> tuple[dict[str, Graph], list[Axis], list[DmframeError]]:
    """The graphs that the study names with the section ``set`` applied, and the axes of the grid."""
    faults, axes = list[DmframeError](), list[Axis]()
    for name in file.grid:
        try:
            axes.append(axis_of(name, document))
        except DmframeError as error:
            faults += error.faults
    names: dict[str, tuple[str, Steps]] = {"": (file.graph, ("graph",))}
    for axis in axes:
        for k, case in enumerate(axis.cases):
            if case.graph:
                place: Steps = ("grid", axis.name, k)
                if axis.name != "graph":
                    place = ("grid", axis.name, str(case.value), "graph")
                names.setdefault(case.graph, (case.graph, place))
    sets = [Given(label, document.node(("set", label)), document.locate(("set", label))) for label in file.set]
    bases = dict[str, Graph]()
    for key, (name, place) in names.items():
        try:
            bases[key] = changed(_graph(name, folder, overrides), sets)
        except DmframeError as error:
            for fault in error.faults:
                fault.path = fault.path if fault.location else place
                faults.append(fault)
    return (bases if "" in bases and len(bases) == len(names) else {}), axes, faults


def _graph(name: str, folder: Path, overrides: Sequence[str]) -> Graph:
    path = folder / name
    found = path if name.endswith((".yaml", ".yml")) and not Path(name).is_absolute() else find_graph(name)
    return Graph.read(found, overrides)


def _in_graphs(bases: Mapping[str, Graph], axes: Sequence[Axis]) -> tuple[list[Axis], list[DmframeError]]:
    """The axes with the values of their cases: each applied to the graph, the other axes at their first."""
    faults, found = list[DmframeError](), list[Axis]()
    for k, axis in enumerate(axes):
        graphs = list[Graph]()
        for case in axis.cases:
            cases = [case if j == k else other.cases[0] for j, other in enumerate(axes)]
            base = bases[next((each.graph for each in reversed(cases) if each.graph), "")]
            try:
                made = changed(base, [given for each in cases for given in each.sets])
                if case.factor is not None:
                    made = scaled(made, [(axis, case.factor)])
                graphs.append(made)
            except DmframeError as error:
                for fault in error.faults:
                    fault.path = fault.path if fault.location else ("grid", axis.name)
                    if fault.text not in [other.text for other in faults]:  # a wrong name recurs in each case
                        faults.append(fault)
        found.append(with_values_of(axis, graphs) if len(graphs) == len(axis.cases) else axis)
    return found, faults


def _factors(file: StudyFile, base: Graph, axes: Sequence[Axis]) -> tuple[list[Factor], list[DmframeError]]:
    """What is sampled, bound to the graph."""
    found, faults = factors_of("sample", file.sample.variations, base, lambda: base.diagram)
    faults += set_twice(found, {label for axis in axes for label in axis.labels})
    columns = [axis.name for axis in axes] + [name for each in found for name in each.columns]
    for name in {name for name in columns if columns.count(name) > 1}:
        faults.append(ValueFault(f"sample.{name}: the grid has an axis of that name; keep one", path=("sample", name)))
    return found, faults
