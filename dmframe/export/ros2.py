"""A controller as a package of ROS 2, for a controller manager of ros2_control."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import Final, NamedTuple, final
from xml.sax.saxutils import escape

from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import EngineError
from dmframe.export.c import about, c_text, commented, files_of, new_folder, origin, own_file, unit_of, write_all
from dmframe.export.program import Member, Program, program_of
from dmframe.files import told_apart
from dmframe.runtime.signals import measured_as, velocity_command
from dmframe.units import plain
from dmframe.version import version

_WHOLE: Final = 1e-6


def export_ros2(experiment: Experiment, diagram: Diagram, folder: str | Path) -> list[Path]:
    """Write a graph's controller as a package of ROS 2 into a new folder; returns the files.

    It is a chainable controller of ros2_control around the exported C: an update of the manager is one sample. Its
    reference is its pace, from 0 to 1, and its commands are velocities of joints.

    Raises
    ------
    DmframeError
        The graph has no sampled controller that can stand alone, commands or measures what no manager hands on, or has
        a clock that no manager can have; the folder is there already, or cannot be written.
    """
    place = new_folder(folder)
    fields, command = measured_as(diagram), velocity_command(diagram)
    program = program_of(experiment, diagram)
    rate = _rate(program)
    if diagram.robot is None:
        raise EngineError(f"{experiment.name}: expected a graph with a robot, whose joints a manager knows, found none")
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
    c = files_of(experiment, diagram, program)
    wanted = {
        "package.xml": _called("package.xml", words),
        "CMakeLists.txt": _called("CMakeLists.txt", words),
        "controller.xml": _called("controller.xml", words),
        f"include/{package}/controller.hpp": _called("controller.hpp", words),
        "src/controller.cpp": _called("controller.cpp", words),
        f"src/{program.name}.c": c[f"{program.name}.c"],
        f"src/{program.name}.h": c[f"{program.name}.h"],
        "test/replay.c": c["replay.c"],
        "test/samples.h": c["samples.h"],
        "config/controllers.yaml": _read_back(
            experiment.name, "\n".join(_configuration(package, rate, joints, rows)), package, joints, rows
        ),
        "README.md": _readme(program, package, rate, rows),
        **origin(experiment, program.model),
    }
    return write_all(place, wanted)


def package_of(name: str) -> str:
    """A name as ROS 2 has them: small letters, digits and single underscores."""
    return re.sub("_+", "_", f"dmframe_{name.lower()}").strip("_")


def _rate(program: Program) -> int:
    """Samples a second. Raises `EngineError` where they are no whole number, as a manager's update rate is."""
    rate = 1 / program.period
    if abs(rate - round(rate)) > _WHOLE * rate:
        raise EngineError(
            f"{program.name}: expected a clock of a whole number of samples a second, as a controller manager has, "
            f"8 ms for 125, say; found {plain(program.period, 's')}"
        )
    return round(rate)


@final
class _Row(NamedTuple):
    """A parameter as ROS 2 calls it, and where its numbers begin."""

    name: str
    first: int
    item: Member


def _rows(parameters: Sequence[Member]) -> Iterator[_Row]:
    """All but those of the robot's model, to which the tool's place would not follow."""
    first = 0
    for name, item in zip(_names(parameters), parameters, strict=True):
        if not item.label.startswith("robot."):
            yield _Row(name, first, item)
        first += item.size


def _names(items: Sequence[Member]) -> list[str]:
    """As ROS 2 calls them: by blocks, as the graph does."""
    return told_apart([item.label if _NAME.fullmatch(item.label) else item.word for item in items], "{}_{}".format)


_NAME: Final = re.compile(r"[A-Za-z]\w*(\.[A-Za-z]\w*)*", re.ASCII)


def _taken(program: Program, fields: dict[str, str]) -> Iterator[str]:
    """What is measured, from what the manager hands over."""
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
    """A file of this package with what is told put in; longer words first, since some begin alike."""
    text = own_file(f"ros2/{name}")
    for word in sorted(words, key=len, reverse=True):
        text = text.replace(word, words[word])
    return text


def _configuration(package: str, rate: int, joints: Sequence[str], rows: Sequence[_Row]) -> Iterator[str]:
    yield "# What a controller manager is told; each number is the graph's own, so that a line may be left out."
    yield from ("controller_manager:", "  ros__parameters:", f"    update_rate: {rate}  # Hz, or a multiple of it")
    yield from (f"    {package}:", f"      type: {package}/Controller", f"      update_rate: {rate}  # Hz")
    yield from ("", f"{package}:", "  ros__parameters:", f"    joints: {_quoted(joints)}")
    yield "    interfaces.position: position  # of each joint [rad]"
    yield "    interfaces.velocity: velocity  # of each joint [rad/s]"
    yield '    interfaces.target: ""          # of each joint, the target of its servo [rad]; empty for one not told'
    yield '    interfaces.scaling: ""         # in full, what a speed slider is at, 0 to 1; empty for none'
    yield "    interfaces.command: velocity   # of each joint [rad/s]"
    yield "    patience: 5                    # periods without an update at most"
    for name, _, item in rows:
        if item.size <= _SHOWN:
            yield f"    {name}: [{', '.join(map(repr, item.value))}]  # {unit_of(item.unit)}"
    yield ""


def _quoted(names: Sequence[str]) -> str:
    """Names as a list of YAML in quotes, whatever they look like: `true` and `1e3` are texts, in YAML 1.1 and 1.2."""
    from ruamel.yaml import YAML
    from ruamel.yaml.scalarstring import DoubleQuotedScalarString

    yaml, text = YAML(), StringIO()
    yaml.default_flow_style, yaml.width = True, 1 << 30
    yaml.dump([DoubleQuotedScalarString(name) for name in names], text)
    return text.getvalue().strip()


def _read_back(name: str, text: str, package: str, joints: Sequence[str], rows: Sequence[_Row]) -> str:
    """The configuration, if a parser reads from it what was written. Raises `EngineError` where it does not."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    shown = {name: list(item.value) for name, _, item in rows if item.size <= _SHOWN}
    try:
        found = YAML(typ="safe").load(text)[package]["ros__parameters"]
        same = found["joints"] == list(joints) and all(found[name] == value for name, value in shown.items())
    except (YAMLError, KeyError, TypeError):
        same = False
    if not same:
        raise EngineError(f"{name}: controllers.yaml reads back as something else; give joints names of plain letters")
    return text


_SHOWN: Final = 12
"""Numbers of a parameter that the example shows at most."""


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
compiled and run against stand-ins of ROS 2, in simulation; **it was never run in ROS 2, nor on a robot**. Set the
maintainer in `package.xml`, build the package in a workspace with colcon, and load it by a controller manager with
`config/controllers.yaml`. `colcon test` holds your compiler to the samples of a simulation. It is written for the
interfaces of ROS 2 Jazzy and later.

## What goes in and out

| interface | is | unit |
|---|---|---|
| `JOINT/position`, `JOINT/velocity` | state, of each joint | rad, rad/s |
| `JOINT/TARGET`, where `interfaces.target` names one | state: where its servo is told to be | rad |
| what `interfaces.scaling` names, in full | state: by how much a speed slider slows it down, 0 to 1 | 1 |
| `JOINT/velocity` | command, of each joint, held until the next update | rad/s |
| `NAME/pace` | reference: how fast time goes for it, 0 to 1; 1 without a controller before it | 1 |
{path}

NAME is what the manager calls it. Joints are those of `joints`, in the order of the graph. Where no target is told, it
is taken as the measured start plus all that was commanded: right for a servo that integrates its commands from there,
wrong by a constant for one that starts beside where it stands, by more for one that does not do as it is told. Where
the tool is follows from the joints, with the lengths of the graph's own model.

The path is the graph's own, as a function of time from the first update on; its numbers are parameters. A controller
before this one may give another: all numbers of the path, with their rates, and what they are later where the law asks
for that; or none of them (NaN). They are those of the controller's own time. At a pace s the controller's time runs s
times as fast, velocities are s times as large, and the path stays where it is. Raise it from 0 over a second or so: the
first command of a path that is entered at full pace is a step.

## What it does

- It starts from what is measured at the first update after it was activated; estimates begin as in the graph.
- An update is one sample, and must come at {rate} Hz; configuring it at another rate fails. Where updates were lost,
  time goes on by as many periods; after more than `patience` of them it is an error.
- A state that is not finite or cannot be read, a pace or a scaling outside of 0 to 1, and what is not finite after
  them: zeros are commanded, the update returns ERROR, and so do those after it, until it is activated anew.
  Deactivating it says why, and commands zeros.
- An update asks for no memory.

Nothing in it limits joints, forces or the workspace, and it is not a safety function: use the limits of the manager and
the safety configuration of the robot's maker.

## Parameters

Read when it is configured, and held to nothing but their count: what the graph says of a gain's sign or size is not
asked for again. The robot's lengths and its gravity are those of the graph; export it anew for another robot. A matrix
is given column by column, boxes as all least numbers and then all largest.

| name | numbers | unit |
|---|---|---|
{rows}

Written by dmframe {version}; `provenance.json` says from what.
"""
