"""Export of a controller as a ROS 2 package, for a controller manager of ros2_control."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from io import StringIO
from typing import Final, NamedTuple, final
from xml.etree import ElementTree
from xml.sax.saxutils import escape, unescape

from dmframe.common.errors import EngineError
from dmframe.common.files import made_distinct
from dmframe.common.slices import slices
from dmframe.common.units import plain
from dmframe.common.version import version
from dmframe.config import BaseGraph
from dmframe.export.c import (
    about,
    c_text,
    commented,
    files_of,
    filled,
    origin,
    own_file,
    unit_of,
)
from dmframe.export.program import Member, Program, program_of
from dmframe.runtime.signals import measured_as, velocity_command

_WHOLE: Final = 1e-6


def ros2_files(graph: BaseGraph) -> dict[str, str]:
    """A graph's controller as a ROS 2 package: files by their paths.

    It is a chainable controller of ros2_control around the exported C: an update of the manager is one sample. Its
    reference is its pace, from 0 to 1, and its commands are joint velocities.

    Raises
    ------
    DmframeError
        The graph has no sampled controller that can be separated from the plant, its commands, measurements or clock
        are not supported by a controller manager.
    """
    diagram = graph.diagram
    fields, command = measured_as(diagram), velocity_command(diagram)
    program = program_of(graph)
    rate = _rate(program)
    if diagram.robot is None:
        raise EngineError(f"{graph.name}: expected a graph with a robot, whose joints are exported, found none")
    joints = list(diagram.robot.joint_names)
    package = package_of(program.name)
    rows = list(_rows(program.parameters))
    path = list(zip(_names(program.path), program.path, strict=True))
    by_label = {member.label: member.word for member in program.commanded}
    words = {
        "DM_ABOUT": about(program),
        "DM_GUARD": f"{package.upper()}_CONTROLLER_HPP",
        "DM_PACKAGE": package,
        "DM_FILE": program.name,
        "DM_PERIOD": f"{program.name.upper()}_PERIOD",
        "DM_JOINTS": str(len(joints)),
        "DM_NAMES": ", ".join(map(c_text, joints)),
        "DM_COUNT": str(len(rows)),
        "DM_ROWS": "\n".join(
            f'  {{"{row.name}", {row.first}, {row.item.size}}},  // {unit_of(row.item.unit)}' for row in rows
        ),
        "DM_PARTS": str(len(path)),
        "DM_PATH": "\n".join(f'  {{"{name}", {item.size}}},  // {unit_of(item.unit)}' for name, item in path),
        "DM_MEASURED": "\n".join(_taken(program, fields)),
        "DM_NEEDS_TARGET": str("q_c" in fields.values()).lower(),
        "DM_COMMAND": by_label[command],
        "DM_TITLE": escape(commented(program.title or program.name)),
    }
    c = files_of(graph, program)
    return {
        "package.xml": _read_as_xml(graph.name, "package.xml", words),
        "CMakeLists.txt": _called("CMakeLists.txt", words),
        "controller.xml": _read_as_xml(graph.name, "controller.xml", words),
        f"include/{package}/controller.hpp": _called("controller.hpp", words),
        "src/controller.cpp": _called("controller.cpp", words),
        f"src/{program.name}.c": c[f"{program.name}.c"],
        f"src/{program.name}.h": c[f"{program.name}.h"],
        "test/replay.c": c["replay.c"],
        "test/samples.h": c["samples.h"],
        "config/controllers.yaml": _read_back(
            graph.name, "\n".join(_configuration(package, rate, joints, rows)), package, joints, rows
        ),
        "README.md": _readme(program, package, rate, rows),
        **origin(graph, program.model),
    }


def package_of(name: str) -> str:
    """Package name of ROS 2: lower-case letters, digits and single underscores."""
    return re.sub("_+", "_", f"dmframe_{name.lower()}").strip("_")


def _rate(program: Program) -> int:
    """Sampling rate [Hz]. Raises `EngineError` if it is not a whole number, as a manager's update rate is."""
    rate = 1 / program.period
    if abs(rate - round(rate)) > _WHOLE * rate:
        raise EngineError(
            f"{program.name}: expected a clock with a whole number of samples a second, such as 8 ms for 125, as a "
            f"controller manager requires; found {plain(program.period, 's')}"
        )
    return round(rate)


@final
class _Row(NamedTuple):
    """Parameter of ROS 2, and the index of its first number."""

    name: str
    first: int
    item: Member


def _rows(parameters: Sequence[Member]) -> Iterator[_Row]:
    """All parameters except those of the robot's model, on which the exported tool position depends."""
    places = slices(item.size for item in parameters)
    for name, place, item in zip(_names(parameters), places, parameters, strict=True):
        if not item.label.startswith("robot."):
            yield _Row(name, place.start, item)


def _names(items: Sequence[Member]) -> list[str]:
    """Names in ROS 2: by blocks, as in the graph, and none of the controller's own."""
    names = [item.label if _NAME.fullmatch(item.label) else item.word for item in items]
    return made_distinct([*_OWN, *names], "{}_{}".format)[len(_OWN) :]


_OWN: Final = tuple(f"interfaces.{word}" for word in ("position", "velocity", "target", "scaling", "command"))
_NAME: Final = re.compile(r"[A-Za-z]\w*(\.[A-Za-z]\w*)*", re.ASCII)


def _taken(program: Program, fields: dict[str, str]) -> Iterator[str]:
    """C++ statements that fill the measurements from the manager's state interfaces."""
    for item in program.measured:
        match fields[item.label]:
            case "x":
                yield f"  {program.name}_tool(q_, measured_.{item.word});"
            case "dq":
                yield f"  for (std::size_t k = 0; k < n; k++) measured_.{item.word}[k] = dq_[k] / scale;"
            case name:
                yield f"  std::memcpy(measured_.{item.word}, {name}_, sizeof {name}_);"
    if "dq" not in fields.values():
        yield "  static_cast<void>(scale);"


def _called(name: str, words: dict[str, str]) -> str:
    """A template of this package with its words replaced."""
    return filled(own_file(f"ros2/{name}"), words)


def _read_as_xml(name: str, file: str, words: dict[str, str]) -> str:
    """XML file, checked by a parser that must recover the title; raises `EngineError` if it does not."""
    text = _called(file, words)
    try:
        found = "".join(item.text or "" for item in ElementTree.fromstring(text.encode()).iter("description"))
    except (ElementTree.ParseError, UnicodeEncodeError):
        found = ""
    if not found.startswith(unescape(words["DM_TITLE"])):
        raise EngineError(f"{name}: {file} is not recovered by a parser; expected a title of printable characters")
    return text


def _configuration(package: str, rate: int, joints: Sequence[str], rows: Sequence[_Row]) -> Iterator[str]:
    yield "# Configuration of a controller manager; each number is the graph's value, so that a line may be omitted."
    yield from ("controller_manager:", "  ros__parameters:", f"    update_rate: {rate}  # Hz, or a multiple of it")
    yield from (f"    {package}:", f"      type: {package}/Controller", f"      update_rate: {rate}  # Hz")
    yield from ("", f"{package}:", "  ros__parameters:", f"    joints: {_quoted(joints)}")
    yield "    interfaces.position: position  # of each joint [rad]"
    yield "    interfaces.velocity: velocity  # of each joint [rad/s]"
    yield '    interfaces.target: ""          # of each joint, the target of its servo [rad]; empty if not available'
    yield '    interfaces.scaling: ""         # full name of the speed scaling, 0 to 1; empty for none'
    yield "    interfaces.command: velocity   # of each joint [rad/s]"
    yield "    patience: 5                    # largest number of periods without an update"
    for name, _, item in rows:
        if item.size <= _SHOWN:
            yield f"    {name}: [{', '.join(map(repr, item.value))}]  # {unit_of(item.unit)}"
    yield ""


def _quoted(names: Sequence[str]) -> str:
    """YAML list of quoted names: `true` and `1e3` stay texts in YAML 1.1 and 1.2."""
    from ruamel.yaml import YAML
    from ruamel.yaml.scalarstring import DoubleQuotedScalarString

    yaml, text = YAML(), StringIO()
    yaml.default_flow_style, yaml.width = True, 1 << 30
    yaml.dump([DoubleQuotedScalarString(name) for name in names], text)
    return text.getvalue().strip()


def _read_back(name: str, text: str, package: str, joints: Sequence[str], rows: Sequence[_Row]) -> str:
    """Check that a parser reads back the configuration. Raises `EngineError` if it does not."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    shown = {name: list(item.value) for name, _, item in rows if item.size <= _SHOWN}
    try:
        found = YAML(typ="safe").load(text)[package]["ros__parameters"]
        same = found["joints"] == list(joints) and all(found[name] == value for name, value in shown.items())
    except (YAMLError, KeyError, TypeError):
        same = False
    if not same:
        raise EngineError(f"{name}: controllers.yaml does not read back as written; use plain letters in joint names")
    return text


_SHOWN: Final = 12
"""Largest size of a parameter in the example configuration."""


def _readme(program: Program, package: str, rate: int, rows: Sequence[_Row]) -> str:
    return _README.format(
        name=program.name,
        package=package,
        period=plain(program.period, "s"),
        rate=rate,
        path="\n".join(
            f"| `NAME/{name}.0` to `.{item.size - 1}` | reference: part of the path | {unit_of(item.unit)} |"
            for name, item in zip(_names(program.path), program.path, strict=True)
        ),
        rows="\n".join(f"| `{name}` | {item.size} | {unit_of(item.unit)} |" for name, _, item in rows),
        version=version(),
    )


_README: Final = """\
# {name} for ros2_control

The controller of `graph.yaml` as a chainable controller, `{package}/Controller`, sampled every {period}. It was
compiled and tested with mock interfaces of ROS 2, in simulation; **it was not tested in ROS 2, nor on a robot**. Set
the maintainer in `package.xml`, build the package in a workspace with colcon, and load it by a controller manager with
`config/controllers.yaml`. `colcon test` compares the compiled code with samples of a simulation. It is written for the
interfaces of ROS 2 Jazzy and later.

## Inputs and outputs

| interface | meaning | unit |
|---|---|---|
| `JOINT/position`, `JOINT/velocity` | state, of each joint | rad, rad/s |
| `JOINT/TARGET`, if `interfaces.target` names one | state: target of its servo | rad |
| the full name in `interfaces.scaling` | state: speed scaling, 0 to 1 | 1 |
| `JOINT/velocity` | command of each joint, constant until the next update | rad/s |
| `NAME/pace` | reference: rate of the controller's time, 0 to 1; 1 without a preceding controller | 1 |
{path}

NAME is the name of the controller in the manager. Joints are those of `joints`, in the order of the graph. Without a
target interface, the target is the measured start plus the integral of the commands. This is right for a servo that
integrates its commands from the measured start; the error is constant for a servo that starts from another target, and
grows for one that does not follow its commands. The tool position is computed from the joints with the lengths of the
graph's model.

The default path is the graph's, as a function of time from the first update on; its numbers are parameters. A preceding
controller may provide another path: all its numbers, with their rates, and future values if the law reads them; or none
(NaN). They refer to the controller's time. At a pace s the controller's time runs s times as fast, velocities are s
times as large, and the path is unchanged. Increase the pace from 0 within about a second: the first command of a path
at full pace is a step.

## Behaviour

- States are initialised from the measurements of the first update after activation; estimates start as in the graph.
- An update is one sample at {rate} Hz; configuration at another rate fails. After lost updates time advances by as many
  periods; more than `patience` of them are an error.
- If a state is not finite or cannot be read, a pace or a scaling is outside 0 to 1, or a result is not finite, the
  update commands zeros and returns ERROR, as do all further updates until the next activation. Deactivation reports
  the reason, and commands zeros.
- An update does not allocate memory.

The controller does not limit joints, forces or the workspace, and is not a safety function: use the limits of the
manager and the safety configuration of the robot's maker.

## Parameters

They are read at configuration, and only their count is checked, not the signs and bounds of the graph's gains. The
robot's lengths and gravity are those of the graph; export again for another robot. Matrices are column-major; boxes
have all lower bounds first, then all upper bounds.

| name | numbers | unit |
|---|---|---|
{rows}

Written by dmframe {version}; see `provenance.json`.
"""
