"""Checks of all numbers of a URDF, element by element."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Final
from xml.etree import ElementTree

import numpy as np

from dmframe.robot.urdf_tree import tree_faults
from dmframe.robot.xml_tree import Lines, place_of

Element = ElementTree.Element

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
"""Number in the URDF reader's syntax: no thousands separators, no hexadecimal digits, no names."""

PLACE: Final = {"xyz": 3, "rpy": 3}
INERTIA: Final = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
SHAPES: Final[Mapping[str, Mapping[str, int]]] = {
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}
OF_JOINT: Final[Mapping[str, Mapping[str, int]]] = {
    "origin": PLACE,
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": dict.fromkeys(("damping", "friction"), 1),
    "mimic": dict.fromkeys(("multiplier", "offset"), 1),
    "calibration": dict.fromkeys(("rising", "falling"), 1),
    "safety_controller": dict.fromkeys(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1),
}
"""Numeric attributes, with their counts, by the element in a joint."""
LIMITED: Final = ("revolute", "prismatic")
POINTED: Final = (*LIMITED, "continuous", "planar")
"""Types of joints with limits, and with an axis."""
LARGEST: Final = 1e100
"""Size of lengths, masses, inertias and axes at which products overflow. [SI units]"""
SIZED: Final = ("origin", "mass", "inertia")
"""Elements whose numbers must be below `LARGEST`."""
ROUNDING: Final = 1e-6
"""Tolerance of a negative principal moment due to rounded digits, relative to the largest."""


def numbers(text: str) -> list[float]:
    """Parse the numbers of a checked attribute."""
    return [float(word) for word in text.split()]


def faults_of(root: Element, lines: Lines, where: str) -> Iterator[str]:
    """Faults of the tree, and of the numbers of links and joints, with their lines."""
    yield from faults_of_tree(root, lines, where)
    for kind in CHECKS:
        for element in root.findall(kind):
            yield from part_faults(element, lines, where)


def faults_of_tree(root: Element, lines: Lines, where: str) -> Iterator[str]:
    """Faults of the tree with their lines, and the link or joint that contains the element."""
    for element, text in tree_faults(root):
        name = next((e for e in (element, *_parents(root, element)) if e.tag in ("link", "joint")), element)
        yield f"{place_of(where, lines, element)}: {name.tag} {name.get('name') or 'without a name'}: {text}"


def part_faults(element: Element, lines: Lines, where: str) -> list[str]:
    """Faults of the numbers of a link or a joint."""
    kind, name = element.tag, element.get("name", "")
    return [f"{place_of(where, lines, culprit)}: {kind} {name}: {text}" for culprit, text in CHECKS[kind](element)]


def _parents(root: Element, element: Element) -> Iterator[Element]:
    return (parent for parent in root if element in list(parent))


def normalise_numbers(root: Element) -> None:
    """Rewrite each checked number with single blanks, since the reader accepts no other white space."""
    for element, key, _ in _every(root):
        if key in element.attrib:
            element.set(key, " ".join(element.attrib[key].split()))


Found = Iterator[tuple[Element, str]]


def _link(link: Element) -> Found:
    yield from _single(link, "inertial")
    for inertial in link.findall("inertial"):
        for tag in ("origin", "mass", "inertia"):
            yield from _single(inertial, tag)
        for tag, keys in (("mass", ("value",)), ("inertia", INERTIA)):
            element = inertial.find(tag)
            if element is None:
                yield inertial, f"expected <{tag}> in <inertial>, found none; omit <inertial> if it has no mass"
                continue
            for key in keys:
                if key not in element.attrib:
                    yield element, f"expected {key} in <{tag}>, found none"
    yield from _malformed(link)
    for mass in link.findall("inertial/mass"):
        if _is_number(mass.get("value", "")) and float(mass.get("value", "")) < 0:
            yield mass, f"expected a mass >= 0, found {mass.get('value')}"
    for inertia in link.findall("inertial/inertia"):
        if all(_is_number(inertia.get(key, "")) and not _is_large(inertia.get(key, "")) for key in INERTIA):
            yield from _unphysical(inertia)


def _unphysical(inertia: Element) -> Found:
    """Negative moments of inertia."""
    negative = [key for key in ("ixx", "iyy", "izz") if float(inertia.get(key, "")) < 0]
    yield from ((inertia, f"expected {key} >= 0, found {inertia.get(key)}") for key in negative)
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "")) for key in INERTIA)
    least, *_, most = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not negative and least < -ROUNDING * most:
        yield inertia, f"expected an inertia whose principal moments are >= 0, found {least:.3g} among them"


def _joint(joint: Element) -> Found:
    for tag in OF_JOINT:
        yield from _single(joint, tag)
    yield from _malformed(joint)
    axis, limit = joint.find("axis"), joint.find("limit")
    direction = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
    turns = joint.get("type") in POINTED
    if turns and axis is not None and _is_column(direction, 3) and not any(numbers(direction)):
        yield axis, f"expected a nonzero axis, found {direction}"
    elif (
        turns
        and axis is not None
        and _is_column(direction, 3)
        and not 1 / LARGEST < math.hypot(*numbers(direction)) < LARGEST
    ):
        yield axis, f"expected an axis of length near 1, found {direction}"
    if joint.get("type") not in LIMITED:
        return
    if limit is None:
        yield joint, f"expected <limit> of a {joint.get('type')} joint, found none"
        return
    for key in ("effort", "velocity"):
        if key not in limit.attrib:
            yield limit, f"expected {key} in <limit>, found none"
    ends = [limit.get(key, "0") for key in ("lower", "upper")]
    if all(map(_is_number, ends)) and float(ends[0]) > float(ends[1]):
        yield limit, f"expected lower <= upper, found {ends[0]} and {ends[1]}"


def _single(parent: Element, tag: str) -> Found:
    """Report repeated elements, since the reader would use one of them without a message."""
    if len(found := parent.findall(tag)) > 1:
        yield found[1], f"expected one <{tag}>, found {len(found)}"


def _malformed(parent: Element) -> Found:
    for element, key, count in _numeric(parent):
        text = element.get(key)
        if text is None:
            continue
        if _is_column(text, count):
            if element.tag in SIZED and any(map(_is_large, text.split())):
                yield element, f"expected {'numbers' if count > 1 else 'a number'} below {LARGEST:g}, found {text!r}"
            continue
        if count == 1:
            name = "mass" if element.tag == "mass" else key
            yield element, f"expected a finite {name}, found {text!r}"
        else:
            yield element, f"expected {count} finite numbers as {key} of <{element.tag}>, found {text!r}"


def _every(root: Element) -> Iterator[tuple[Element, str, int]]:
    for kind in ("link", "joint"):
        for element in root.findall(kind):
            yield from _numeric(element)


def _numeric(parent: Element) -> Iterator[tuple[Element, str, int]]:
    """Each numeric attribute of a link or a joint, present or not, with its count."""
    if parent.tag == "joint":
        for tag, keys in OF_JOINT.items():
            for element in parent.findall(tag):
                yield from ((element, key, count) for key, count in keys.items())
        return
    for direction in ("inertial", "visual", "collision"):
        for element in parent.findall(f"{direction}/origin"):
            yield from ((element, key, count) for key, count in PLACE.items())
    for element in parent.findall("inertial/mass"):
        yield element, "value", 1
    for element in parent.findall("inertial/inertia"):
        yield from ((element, key, 1) for key in INERTIA)
    for direction in ("visual", "collision"):
        for tag, keys in SHAPES.items():
            for element in parent.findall(f"{direction}/geometry/{tag}"):
                yield from ((element, key, count) for key, count in keys.items())


def _is_number(text: str) -> bool:
    return bool(NUMBER.fullmatch(text.strip())) and math.isfinite(float(text))


def _is_large(text: str) -> bool:
    return abs(float(text)) >= LARGEST


def _is_column(text: str, count: int) -> bool:
    words = text.split()
    return len(words) == count and all(map(_is_number, words))


CHECKS: Final[Mapping[str, Callable[[Element], Found]]] = {"link": _link, "joint": _joint}
"""Checks of the numbers of an element by its tag."""
