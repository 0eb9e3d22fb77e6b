"""A graph with everything said that its file leaves unsaid, as a text that loads again and gives the same run."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from dmframe.config.graph import Graph
from dmframe.robot.library import RobotSource, find_robot


def resolved(graph: Graph) -> dict[str, Any]:
    """The graph as plain data: overrides applied, defaults filled in, quantities as numbers in their own units.

    A user's own block files and URDF files are named as if they lay beside the graph; `companions` says which.
    """
    file = graph.file
    data: dict[str, Any] = {"dmframe": file.dmframe}
    if file.title:
        data["title"] = file.title
    if file.robot is not None:
        data["robot"] = _robot(graph)
    data["clock"] = "continuous" if file.clock is None else file.clock
    data["duration"] = file.duration
    if graph.start:
        data["start"] = _plain(graph.start)
    data["solver"] = _plain(file.solver.model_dump())
    log = _plain(file.log.model_dump(exclude_none=True))
    if log:
        data["log"] = log
    names = _file_names(graph)
    data["blocks"] = {}
    for name, block in graph.blocks.items():
        kind = str(file.blocks[name]["type"])
        path, colon, class_name = kind.rpartition(":")
        kind = f"{names[_beside(graph, path)]}:{class_name}" if colon else kind
        values = {key: value for key, value in block.model_dump().items() if value is not None}
        data["blocks"][name] = {"type": kind, **_plain(values)}
    if file.wires:
        data["wires"] = dict(file.wires)
    return data


def resolved_text(graph: Graph) -> str:
    """`resolved` as YAML, a block a line."""
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
    document = mapping({key: value for key, value in data.items() if key not in ("blocks", "wires")}, flow=False)
    document["blocks"] = CommentedMap((name, mapping(values)) for name, values in data["blocks"].items())
    if "wires" in data:
        document["wires"] = mapping(data["wires"], flow=False)
    writer, text = YAML(), io.StringIO()
    writer.width = 10_000
    writer.default_flow_style = None  # lists of numbers on one line
    writer.dump(document, text)
    return text.getvalue()


def companions(graph: Graph) -> dict[str, Path]:
    """Files that the graph names by path, by the name under which they must lie beside the resolved graph."""
    return {name: path for path, name in _file_names(graph).items()}


def robot_source(graph: Graph) -> RobotSource | None:
    """Where the graph's robot comes from."""
    return find_robot(graph.file.robot.model, _base(graph)) if graph.file.robot else None


def _robot(graph: Graph) -> dict[str, Any]:
    section, source = graph.file.robot, robot_source(graph)
    assert section is not None  # the caller looked
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


def _file_names(graph: Graph) -> dict[Path, str]:
    """Each file that the graph names by path, with a name of its own."""
    kinds = (str(spec["type"]).rpartition(":") for spec in graph.file.blocks.values())
    files = [_beside(graph, path) for path, colon, _ in kinds if colon]
    if graph.file.robot is not None and graph.file.robot.model.endswith(".urdf"):
        files.append(find_robot(graph.file.robot.model, _base(graph)).urdf.resolve())
    names = dict[Path, str]()
    for path in dict.fromkeys(files):
        taken, name, count = set(names.values()), path.name, 2
        while name in taken:
            name, count = f"{path.stem}_{count}{path.suffix}", count + 1
        names[path] = name
    return names


def _base(graph: Graph) -> Path:
    return Path(graph.document.name).parent


def _beside(graph: Graph, path: str) -> Path:
    return (_base(graph) / path).resolve()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
