"""Graph with overrides applied and defaults written out, as a text that reproduces the run."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dmframe.common.files import made_distinct
from dmframe.common.units import Stated
from dmframe.robot.library import RobotSource, find_robot

if TYPE_CHECKING:
    from dmframe.config.graph import BaseGraph

_AFTER = ("wires", "baseline", "uncertain", "page")
"""Optional keys after the blocks."""


def resolved(graph: BaseGraph) -> dict[str, Any]:
    """Graph as plain data: overrides applied, defaults filled in, quantities as numbers in their declared units.

    User block files and URDF files are named as if they were next to the graph, see `companions`.
    """
    file = graph.file
    data: dict[str, Any] = {"dmframe": file.dmframe}
    if file.title:
        data["title"] = file.title
    if file.robot is not None:
        data["robot"] = _robot(graph)
    data["clock"] = "continuous" if file.clock is None else file.clock
    data |= {key: value for key in ("jitter", "seed", "tolerance") if (value := getattr(file, key))}
    data["duration"] = file.duration
    if graph.start:
        data["start"] = _plain(graph.start)
    data["solver"] = _plain(file.solver.model_dump(exclude_none=True))
    log = _plain(file.log.model_dump(exclude_none=True))
    if log:
        data["log"] = log
    names = _file_names(graph)
    data["blocks"] = {}
    for name, block in graph.blocks.items():
        kind = str(file.blocks[name]["type"])
        path, colon, class_name = kind.rpartition(":")
        kind = f"{names[_located(graph, path)]}:{class_name}" if colon else kind
        values = {key: value for key, value in block.model_dump().items() if value is not None}
        data["blocks"][name] = {"type": kind, **_plain(values)}
    for key in _AFTER:
        if value := getattr(file, key):
            data[key] = _plain(value.model_dump(exclude_defaults=True) if key == "page" else dict(value))
    return data


def resolved_text(graph: BaseGraph) -> str:
    """`resolved` as YAML, one line a block."""
    from ruamel.yaml import YAML
    from ruamel.yaml.comments import CommentedMap

    def mapping(values: dict[str, Any], flow: bool = True) -> Any:
        made = CommentedMap(
            (key, mapping(value) if isinstance(value, dict) else value) for key, value in values.items()
        )
        if flow:
            made.fa.set_flow_style()
        return made

    data = resolved(graph)
    document = mapping({key: value for key, value in data.items() if key not in ("blocks", *_AFTER)}, flow=False)
    document["blocks"] = CommentedMap((name, mapping(values)) for name, values in data["blocks"].items())
    document |= {key: mapping(data[key], flow=False) for key in _AFTER if key in data}
    writer, text = YAML(), io.StringIO()
    writer.width = 10_000
    writer.default_flow_style = None  # lists of numbers on one line
    writer.dump(document, text)
    return text.getvalue()


def companions(graph: BaseGraph) -> dict[str, Path]:
    """Files referenced by the graph, by the name they need next to the resolved graph."""
    return {name: path for path, name in _file_names(graph).items()}


def robot_source(graph: BaseGraph) -> RobotSource | None:
    """Source of the robot of a graph."""
    return find_robot(graph.file.robot.model, _base(graph)) if graph.file.robot else None


def _robot(graph: BaseGraph) -> dict[str, Any]:
    section, source = graph.file.robot, robot_source(graph)
    assert section is not None  # checked by the caller
    assert source is not None
    free = list(graph.robot.joint_names)
    hold = {joint: angle for joint, angle in source.hold.items() if joint not in free} | section.hold
    names = _file_names(graph)
    values = {
        "model": names[source.urdf.resolve()] if section.model.endswith(".urdf") else section.model,
        "free": free,
        "hold": hold or None,
        "tool": section.tool if section.tool is not None else source.tool,
        "axes": graph.robot.axes,
        "friction_velocity": section.friction_velocity,
    }
    return {key: _plain(value) for key, value in values.items() if value is not None}


def _file_names(graph: BaseGraph) -> dict[Path, str]:
    """Files referenced by path, with distinct names."""
    kinds = (str(spec["type"]).rpartition(":") for spec in graph.file.blocks.values())
    files = [_located(graph, path) for path, colon, _ in kinds if colon]
    if graph.file.robot is not None and graph.file.robot.model.endswith(".urdf"):
        files.append(find_robot(graph.file.robot.model, _base(graph)).urdf.resolve())
    paths = list(dict.fromkeys(files))
    names = made_distinct((path.name for path in paths), lambda name, k: f"{Path(name).stem}_{k}{Path(name).suffix}")
    return dict(zip(paths, names, strict=True))


def _base(graph: BaseGraph) -> Path:
    return Path(graph.document.name).parent


def _located(graph: BaseGraph, path: str) -> Path:
    return (_base(graph) / path).resolve()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return float(value) if isinstance(value, Stated) else value
