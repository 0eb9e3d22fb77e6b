"""Robot files of any supported format as a URDF tree: URDF, xacro, and MJCF of MuJoCo.

MJCF files are read by Pinocchio's parser. A URDF has no rotor inertia, so an armature is returned separately.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from dmframe.common.errors import MissingError, RobotError
from dmframe.common.version import installing
from dmframe.robot.reduction import motion_subspace
from dmframe.robot.urdf_numbers import INERTIA
from dmframe.robot.xml_tree import Lines, parse_xml

Element = ElementTree.Element

BASE: Final = "mjcf_world"
"""Link of an MJCF file's world."""


@final
@dataclass(frozen=True)
class RobotFile:
    """A robot's URDF tree, the lines of a URDF file, and the armature [kg m^2, or kg], which a URDF cannot state."""

    root: Element
    lines: Lines = field(default_factory=Lines)
    armature: dict[str, float] = field(default_factory=dict)
    converted: bool = False


def read_any(path: Path) -> RobotFile:
    """The URDF tree of a robot file.

    Raises
    ------
    MissingError
        No such file, or the package that reads its format is not installed.
    RobotError
        The file cannot be read as a robot.
    """
    where = f"robot {path.name}"
    if not path.is_file():
        raise MissingError(f"{where}: expected a robot file, found none at {path}")
    try:
        root, lines = parse_xml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, expat.ExpatError) as fault:
        raise RobotError(f"{where}: expected a URDF, xacro or MJCF file, found broken XML: {fault}") from None
    if root.tag == "mujoco":
        return _from_mjcf(path, where)
    if root.tag != "robot":
        raise RobotError(f"{where}: expected <robot> of a URDF or <mujoco> of an MJCF file, found <{root.tag}>")
    if path.suffix == ".xacro" or any("xacro" in str(element.tag) for element in root.iter()):
        return RobotFile(parse_xml(_expanded(path, where))[0], converted=True)
    return RobotFile(root, lines)


def _expanded(path: Path, where: str) -> str:
    """Text of the URDF that a xacro file defines with the defaults of its arguments."""
    try:
        import xacro
        from xacrodoc import packages  # finds ROS packages without ROS, from the file's folder upwards
    except ModuleNotFoundError:
        raise MissingError(
            f"{where}: xacro files need the package xacrodoc, which is not installed; {installing('xacro')}"
        ) from None
    try:
        packages.walk_up_from(path.resolve())
        text = xacro.process_file(str(path.resolve())).toxml()
    except Exception as fault:  # xacro evaluates expressions of the file, which may raise anything
        reason = re.sub(r"<class '[\w.]+'>: ", "", " ".join(str(fault).split())) or type(fault).__name__
        command = f"xacro {path.name} name:=value > {path.name.partition('.')[0]}.urdf"
        raise RobotError(f"{where}: xacro cannot expand it: {_once(reason)}; {_remedy(fault, command)}") from None
    return str(text)


def _once(reason: str) -> str:
    """A reason without its repetition: xacro appends the text of the error that it passes on."""
    half = len(reason) // 2
    if reason[:half] == reason[half + 1 :]:
        return reason[:half]
    return re.sub(r"^(No such file or directory: (\S+)) .*$", r"\1", reason)


def _remedy(fault: Exception, command: str) -> str:
    if "Package not found" in str(fault):
        return f"expand it where ROS has this package: {command}"
    if "No such file" in str(fault):
        return "it includes this file; put it there"
    return f"if it needs arguments or packages, expand it there: {command}"


def _from_mjcf(path: Path, where: str) -> RobotFile:
    """URDF tree of an MJCF file; each body is the link of its joint, and sites are massless links."""
    import pinocchio as pin

    try:
        found = pin.buildModelFromMJCF(str(path))
    except Exception as fault:  # Pinocchio lets errors of its parser through, such as of a missing default class
        reason = " ".join(str(fault).rpartition("message:")[2].split()).rstrip(".")  # without lines of its source
        if isinstance(fault, IndexError):
            reason = "a name in it refers to nothing, such as a default class or a file that is not included"
        raise RobotError(f"{where}: Pinocchio cannot read this MJCF file: {reason}") from None
    model = found[0] if isinstance(found, tuple) else found
    root = Element("robot", name=path.stem)
    # Pinocchio names the link of a joint by its body, and merges bodies without a joint into it
    bodies = {frame.parentJoint: frame.name for frame in reversed(model.frames) if frame.type == pin.FrameType.BODY}
    links = {index: bodies.get(index, f"link_{index}") if index else BASE for index in range(model.njoints)}
    ElementTree.SubElement(root, "link", name=links[0])
    for index in range(1, model.njoints):
        _add_joint(root, model, index, links, where)
    taken = set(links.values())
    for frame in model.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and frame.name not in {*taken, "universe"}:
            taken.add(frame.name)
            ElementTree.SubElement(root, "link", name=frame.name)
            fixed = _joint(root, f"{frame.name}_fixed", "fixed", links[frame.parentJoint], frame.name)
            fixed.append(_origin(frame.placement))
    names = list(model.names)
    armature = {names[i]: float(model.armature[model.joints[i].idx_v]) for i in range(1, model.njoints)}
    return RobotFile(root, armature={name: value for name, value in armature.items() if value}, converted=True)


def _add_joint(root: Element, model: Any, index: int, links: dict[int, str], where: str) -> None:
    joint, name = model.joints[index], model.names[index]
    if joint.nv != 1:
        raise RobotError(
            f"{where}: joint {name} is of type {joint.shortname().removeprefix('JointModel')}; expected joints with "
            "one axis each, on a fixed base"
        )
    subspace = motion_subspace(joint)
    revolute, bounded = bool(np.any(subspace[3:])), joint.nq == 1
    ends = model.lowerPositionLimit, model.upperPositionLimit
    lower, upper = (float(limit[joint.idx_q]) if bounded else np.inf for limit in ends)
    bounded = bounded and bool(np.isfinite([lower, upper]).all()) and max(abs(lower), abs(upper)) < 1e100
    kind = ("revolute" if bounded else "continuous") if revolute else "prismatic"
    link = ElementTree.SubElement(root, "link", name=links[index])
    _add_inertial(link, model.inertias[index])
    made = _joint(root, name, kind, links[model.parents[index]], links[index])
    made.append(_origin(model.jointPlacements[index]))
    ElementTree.SubElement(made, "axis", xyz=_numbers(subspace[3:] if revolute else subspace[:3]))
    speed, effort = (_limit(limit[joint.idx_v]) for limit in (model.velocityLimit, model.effortLimit))
    limits = {"lower": _number(lower), "upper": _number(upper)} if bounded else {}
    ElementTree.SubElement(made, "limit", {"velocity": speed, "effort": effort, **limits})


def _add_inertial(link: Element, body: Any) -> None:
    if body.mass <= 0:
        return
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_numbers(body.lever))
    ElementTree.SubElement(inertial, "mass", value=_number(body.mass))
    upper = np.asarray(body.inertia)[np.triu_indices(3)]
    ElementTree.SubElement(inertial, "inertia", dict(zip(INERTIA, map(_number, upper), strict=True)))


def _joint(root: Element, name: str, kind: str, parent: str, child: str) -> Element:
    made = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(made, "parent", link=parent)
    ElementTree.SubElement(made, "child", link=child)
    return made


def _origin(placement: Any) -> Element:
    import pinocchio as pin

    return Element("origin", xyz=_numbers(placement.translation), rpy=_numbers(pin.rpy.matrixToRpy(placement.rotation)))


def _limit(value: float) -> str:
    return _number(value) if np.isfinite(value) and abs(value) < 1e100 else _number(1e9)


def _numbers(values: Any) -> str:
    return " ".join(map(_number, values))


def _number(value: float) -> str:
    return f"{float(value):.17g}" if abs(value) > 1e-16 else "0"


def written(root: Element, notes: list[str]) -> str:
    """Text of a URDF tree without shapes, its assumptions as comments."""
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for other in [child for child in root if child.tag not in ("link", "joint")]:
        root.remove(other)
    ElementTree.indent(root)
    comments = "".join(f"<!-- {note.replace('--', '- -')} -->\n" for note in notes)
    return f'<?xml version="1.0"?>\n{comments}{ElementTree.tostring(root, encoding="unicode")}\n'


def children(root: Element) -> dict[str, list[Element]]:
    """Joints by the link that carries them."""
    found: dict[str, list[Element]] = {}
    for joint in root.findall("joint"):
        found.setdefault(_end(joint, "parent"), []).append(joint)
    return found


def joints_to(root: Element, link: str) -> list[Element]:
    """Joints from the base to a link."""
    above = {_end(joint, "child"): joint for joint in root.findall("joint")}
    return list(reversed(list(_upwards(above, link))))


def _upwards(above: dict[str, Element], link: str) -> Iterator[Element]:
    seen = set[str]()
    while link in above and link not in seen:
        seen.add(link)
        yield above[link]
        link = _end(above[link], "parent")


def _end(joint: Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")
