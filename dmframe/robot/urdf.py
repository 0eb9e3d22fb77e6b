"""Reading a URDF with faults that name the file, the line and the element."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from dmframe.errors import MissingError, RobotError

URDF_PATH = ("robot", "model")


def read_urdf(path: Path) -> tuple[Any, frozenset[str]]:
    """The `pin.Model` of a URDF file, and the names of its joints that mimic another one.

    Raises
    ------
    MissingError
        No such file.
    RobotError
        Not readable, not XML (with line and column), not a URDF, or a number in it that is none.
    """
    import pinocchio as pin

    where = f"robot {path.name}"
    if not path.is_file():
        raise MissingError(f"{where}: expected a URDF file, found none at {path}", path=URDF_PATH)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as fault:
        raise RobotError(f"{where}: expected a readable URDF file in UTF-8: {fault}", path=URDF_PATH) from None
    root = _parse(text, where)
    _check_inertials(root, where)
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as fault:
        reason = str(fault).strip().rstrip(".")
        raise RobotError(f"{where}: expected a valid URDF; the parser says: {reason}", path=URDF_PATH) from None
    mimics = (joint.get("name", "") for joint in root.iter("joint") if joint.find("mimic") is not None)
    return model, frozenset(mimics)


def _parse(text: str, where: str) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as fault:
        line, column = fault.position
        reason = str(fault).split(":")[0]
        raise RobotError(
            f"{where}:{line}:{column + 1}: expected a valid URDF, found broken XML: {reason}", path=URDF_PATH
        ) from None
    if root.tag != "robot":
        raise RobotError(f"{where}: expected a valid URDF, <robot>; found <{root.tag}>", path=URDF_PATH)
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise RobotError(f"{where}: expected a URDF, found a xacro file; expand it with xacro first", path=URDF_PATH)
    if root.find("link") is None:
        raise RobotError(f"{where}: expected a valid URDF, found no link in it", path=URDF_PATH)
    return root


def _check_inertials(root: ElementTree.Element, where: str) -> None:
    """Check masses and inertias here, because the URDF parser drops a link's whole inertia where one number is bad."""
    for link in root.iter("link"):
        for inertial in link.findall("inertial"):
            for element in inertial:
                for key, value in element.attrib.items():
                    if key in ("xyz", "rpy"):
                        continue
                    _check_number(value, element.tag, key, f"{where}: link {link.get('name', '')}")


def _check_number(value: str, tag: str, key: str, where: str) -> None:
    name = "mass" if tag == "mass" else key
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise RobotError(f"{where}: expected a finite {name}, found {value!r}", path=URDF_PATH)
    if tag == "mass" and number < 0:
        raise RobotError(f"{where}: expected a mass >= 0, found {value}", path=URDF_PATH)
