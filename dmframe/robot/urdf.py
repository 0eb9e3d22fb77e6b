"""URDF reader whose faults name the file, the line and the element.

Pinocchio's reader drops elements that it cannot parse, such as a link's inertia with a letter O in its digits, with
only a message on the terminal. All numbers are therefore checked first (`dmframe.robot.urdf_numbers`), the reader gets
the file with normalised numbers, and its inertias are compared with the file.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from dmframe.common.errors import MissingError, RobotError, raise_all
from dmframe.robot.convert import children, joints_to
from dmframe.robot.mimics import Mimic
from dmframe.robot.urdf_numbers import INERTIA, faults_of, normalise_numbers, numbers, part_faults
from dmframe.robot.xml_tree import Lines, parse_xml

URDF_PATH = ("robot", "model")


def read_urdf(
    path: Path, *, free: Sequence[str] | None = None, hold: Collection[str] = (), tool: object = None
) -> tuple[Any, dict[str, Mimic]]:
    """The `pin.Model` of a URDF file, and its joints that follow another one.

    Parameters
    ----------
    path : the file
    free, hold, tool : as of :meth:`dmframe.robot.chain.SerialChain.from_model`
        An invalid inertia of a link that none of the free joints moves is left out, since it has no effect.

    Raises
    ------
    MissingError
        There is no such file, or Pinocchio is not installed.
    RobotError
        The file is not readable, not XML (with line and column), not a URDF, its joints are not a tree, a number is
        malformed, or an inertial element is incomplete; several of the latter as `Faults`.
    """
    where = f"robot {path.name}"
    try:
        import pinocchio as pin
    except ModuleNotFoundError:
        raise MissingError(
            f"{where}: robots need the package pin (Pinocchio), which is not installed; pip install pin; it has no "
            "wheel for Windows: install pinocchio from conda-forge, or use WSL",
            path=URDF_PATH,
        ) from None
    if not path.is_file():
        raise MissingError(f"{where}: expected a URDF file, found none at {path}", path=URDF_PATH)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as fault:
        raise RobotError(f"{where}: expected a readable URDF file in UTF-8: {fault}", path=URDF_PATH) from None
    root, lines = _parse(text, where)
    check_parts(root, lines, where, free=free, hold=hold, tool=tool)
    normalise_numbers(root)
    try:
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
        _check_read(model, root, lines, where)
    except (ValueError, RuntimeError) as fault:
        reason = str(fault).strip().rstrip(".")
        raise RobotError(f"{where}: expected a valid URDF; the parser reports: {reason}", path=URDF_PATH) from None
    return model, _mimics(root, lines, where)


def check_parts(
    root: ElementTree.Element,
    lines: Lines,
    where: str,
    *,
    free: Sequence[str] | None = None,
    hold: Collection[str] = (),
    tool: object = None,
) -> None:
    """Remove invalid inertias of links that do not move, and raise `RobotError` or `Faults` for all other faults."""
    _leave_out(root, lines, where, _moved(root, free, hold, tool))
    raise_all([RobotError(text, path=URDF_PATH) for text in faults_of(root, lines, where)])


def _moved(root: ElementTree.Element, free: Sequence[str] | None, hold: Collection[str], tool: object) -> set[str]:
    """Links that the free joints may move: all of them where the free joints are not known yet."""
    links = {link.get("name", "") for link in root.findall("link")}
    if free is not None:
        first = [joint for joint in root.findall("joint") if joint.get("name") in free]
    elif isinstance(tool, str) and tool in links:
        way = [joint for joint in joints_to(root, tool) if joint.get("type") != "fixed"]
        first = [joint for joint in way if joint.get("name") not in hold]
    else:
        return links
    below, moved = children(root), set[str]()
    waiting = first
    while waiting:
        ends = {child.get("link", "") for joint in waiting for child in joint.findall("child")} - moved
        moved |= ends
        waiting = [joint for link in ends for joint in below.get(link, [])]
    return moved


def _leave_out(root: ElementTree.Element, lines: Lines, where: str, moved: set[str]) -> None:
    """Remove invalid inertias of links that do not move."""
    for link in root.findall("link"):
        if link.get("name", "") not in moved and part_faults(link, lines, where):
            for inertial in link.findall("inertial"):
                link.remove(inertial)


def _mimics(root: ElementTree.Element, lines: Lines, where: str) -> dict[str, Mimic]:
    """Laws of mimic joints; a fixed joint, for which some files have one too, follows none."""
    names, found = {joint.get("name", "") for joint in root.findall("joint")}, dict[str, Mimic]()
    for joint in root.findall("joint"):
        if (mimic := joint.find("mimic")) is None:
            continue
        leader = mimic.get("joint", "")
        if leader not in names:
            raise RobotError(
                f"{where}:{lines[mimic]}: joint {joint.get('name', '')} mimics {leader or 'no joint'}: expected the "
                "name of a joint of this file",
                path=URDF_PATH,
            )
        if joint.get("type") == "fixed":
            continue
        scale, offset = (numbers(mimic.get(key, rest))[0] for key, rest in (("multiplier", "1"), ("offset", "0")))
        found[joint.get("name", "")] = Mimic(leader, scale, offset)
    return found


def _parse(text: str, where: str) -> tuple[ElementTree.Element, Lines]:
    """The tree of a URDF, and the line of each element."""
    try:
        root, lines = parse_xml(text)
    except expat.ExpatError as fault:
        reason = expat.ErrorString(fault.code)
        raise RobotError(
            f"{where}:{fault.lineno}:{fault.offset + 1}: expected a valid URDF, found broken XML: {reason}",
            path=URDF_PATH,
        ) from None
    if root.tag != "robot":
        raise RobotError(f"{where}: expected a valid URDF, <robot>; found <{root.tag}>", path=URDF_PATH)
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise RobotError(f"{where}: expected a URDF, found a xacro file; expand it with xacro first", path=URDF_PATH)
    if root.find("link") is None:
        raise RobotError(f"{where}: expected a valid URDF, found no link in it", path=URDF_PATH)
    return root, lines


def _check_read(model: Any, root: ElementTree.Element, lines: Lines, where: str) -> None:
    """Check that the inertia behind each joint is that of the file."""
    import pinocchio as pin

    frames = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    behind, links = [pin.Inertia.Zero() for _ in model.inertias], dict[int, ElementTree.Element]()
    for link in root.findall("link"):
        inertial, frame = link.find("inertial"), frames.get(link.get("name", ""))
        if inertial is not None and frame is not None:
            behind[frame.parentJoint] += frame.placement.act(_inertia(inertial))
            links.setdefault(frame.parentJoint, link)
    for joint, link in links.items():
        expected, found = (item.toDynamicParameters() for item in (behind[joint], model.inertias[joint]))
        if not np.allclose(found, expected, rtol=1e-9, atol=1e-9 * (1 + np.max(np.abs(expected)))):
            raise RobotError(
                f"{where}:{lines[link]}: link {link.get('name', '')}: Pinocchio's inertia of this link and of links "
                f"fixed to it differs from the file: expected a mass of {expected[0]:g}, found {found[0]:g}",
                path=URDF_PATH,
            )


def _inertia(inertial: ElementTree.Element) -> Any:
    """Inertia of the file as a `pin.Inertia` in the link's frame."""
    import pinocchio as pin

    origin, mass, inertia = (inertial.find(tag) for tag in ("origin", "mass", "inertia"))
    assert mass is not None  # it was checked
    assert inertia is not None
    place = {} if origin is None else origin.attrib
    roll, pitch, yaw = numbers(place.get("rpy", "0 0 0"))
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "")) for key in INERTIA)
    about = pin.Inertia(float(mass.get("value", "")), np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    at = pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array(numbers(place.get("xyz", "0 0 0"))))
    return at.act(about)
