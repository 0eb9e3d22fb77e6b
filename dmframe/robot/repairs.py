"""Repair of a robot's file for a new graph: invalid elements outside the chain to the tool, missing ones in it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final
from xml.etree import ElementTree

import numpy as np

from dmframe.common.errors import listed
from dmframe.robot.convert import Element, joints_to
from dmframe.robot.flange import MOVING
from dmframe.robot.urdf_numbers import INERTIA, ROUNDING, numbers, part_faults
from dmframe.robot.xml_tree import Lines

DENSITY: Final = 5.0
"""Placeholder mass of a link per length [kg/m]."""
LEAST: Final = 0.5
"""Least placeholder mass of a link [kg]."""
DENSEST: Final = 22590.0
"""Density of the densest metal, osmium [kg/m^3]."""
MOST_ANGLE: Final = 40.0
"""Largest plausible limit of a revolute joint [rad], 6 turns; a limit in degrees is larger."""
UNLIMITED: Final = "1e9"
"""Value of a velocity or effort that means no limit [SI units]."""
STROKE: Final = 0.5
"""Placeholder limit of a prismatic joint [m]."""


def repaired(root: Element, tool: str, where: str) -> list[str]:
    """Repair a URDF tree for an arm that ends at `tool`; returns a note for each change.

    Outside the chain to the tool invalid inertias are removed, and invalid joints fixed. In the chain missing limits
    are set to none, and links without inertia get a placeholder: a sphere of `DENSITY` times the distance to the next
    joint, half way to it.
    """
    way = joints_to(root, tool)
    return [*_without_faults(root, way, tool, where), *_limits(root, way), *_inertias(root, way)]


def impossible_inertias(root: Element, tool: str) -> Iterator[str]:
    """Notices of links between the base and `tool` whose largest moment of inertia exceeds the sum of the others.

    Each link is a body of its own here; what is fixed to it may make up for it.
    """
    moved = {_end(joint, "child") for joint in joints_to(root, tool)}
    for link in root.findall("link"):
        for inertia in link.findall("inertial/inertia"):
            xx, xy, xz, yy, yz, zz = (_value(inertia.get(key, "0")) for key in INERTIA)
            matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if link.get("name", "") not in moved or not np.isfinite(matrix).all():
                continue
            least, middle, most = np.linalg.eigvalsh(matrix)
            if most > (1 + ROUNDING) * (least + middle):
                yield (
                    f"link {link.get('name', '')}: no body has its moments of inertia, {least:.3g}, {middle:.3g} and "
                    f"{most:.3g} kg m^2: the largest exceeds the sum of the others; correct them in the file, since "
                    "dmframe verify cannot prove M(q) > 0 with them"
                )


def implausible_values(root: Element, tool: str) -> Iterator[str]:
    """Notices of values between the base and `tool` that seem to have another unit: limits and masses.

    The integral J of the density times the squared distance from the centre of mass is half of the trace of the
    inertia. Of all bodies of mass m whose density is at most `DENSEST`, a ball of that density has the least J.
    """
    way = joints_to(root, tool)
    for joint in way:
        limit = joint.find("limit")
        if joint.get("type") == "revolute" and limit is not None:
            low, high = (_value(limit.get(key, "0")) for key in ("lower", "upper"))
            if max(abs(low), abs(high)) > MOST_ANGLE:
                yield (
                    f"joint {joint.get('name', '')}: limits of {low:g} and {high:g} rad, {(high - low) / math.tau:.0f} "
                    "turns; a URDF has radians: correct the file if they are degrees"
                )
    moved = {_end(joint, "child") for joint in way}
    for link in root.findall("link"):
        mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
        if link.get("name", "") not in moved or mass is None or inertia is None:
            continue
        m, J = _value(mass.get("value", "0")), sum(_value(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz")) / 2
        if 0 < J < 0.6 * m * (3 * m / (4 * math.pi * DENSEST)) ** (2 / 3):
            yield (
                f"link {link.get('name', '')}: no body of {m:.4g} kg has moments of inertia as small, {2 * J:.3g} "
                "kg m^2 in sum: check the units of both, kg and kg m^2"
            )


def _without_faults(root: Element, way: list[Element], tool: str, where: str) -> Iterator[str]:
    on = {_end(joint, "child") for joint in way} | {_end(joint, "parent") for joint in way}
    lines = Lines.fromkeys(root.iter(), 0)
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if link.get("name", "") not in on and inertial is not None and part_faults(link, lines, where):
            for found in link.findall("inertial"):
                link.remove(found)
            yield f"link {link.get('name', '')}: invalid inertia removed; the link is not between the base and {tool}"
    for joint in root.findall("joint"):
        if joint in way or joint.get("type") == "fixed":
            continue
        _complete(joint)
        if part_faults(joint, lines, where):
            joint.set("type", "fixed")
            for tag in ("axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"):
                for found in joint.findall(tag):
                    joint.remove(found)
            yield f"joint {joint.get('name', '')}: invalid, made fixed; the joint is not between the base and {tool}"


def _limits(root: Element, way: list[Element]) -> Iterator[str]:
    for joint in way:
        if joint.get("type") not in MOVING:
            continue
        missing = _complete(joint)
        if joint.get("type") in ("revolute", "prismatic") and _is_empty(joint):
            limit = joint.find("limit")
            assert limit is not None  # it was completed
            if joint.get("type") == "revolute":
                joint.set("type", "continuous")
                for key in ("lower", "upper"):
                    limit.attrib.pop(key, None)
            else:
                limit.attrib.update(lower=str(-STROKE), upper=str(STROKE))
            missing = ["position", *missing]
        if missing:
            taken = {"continuous": "; it turns without limits", "prismatic": f"; taken as {STROKE:g} m to both sides"}
            range_ = taken[joint.get("type", "")] if "position" in missing else ""
            yield f"joint {joint.get('name', '')}: no limit of {listed(missing)} in the file{range_}"


def _complete(joint: Element) -> list[str]:
    """Set limits of velocity and effort that are missing or zero; returns their names."""
    if joint.get("type") not in MOVING:
        return []
    limit = joint.find("limit")
    if limit is None:
        if joint.get("type") == "continuous":
            return []
        limit = ElementTree.SubElement(joint, "limit")
    found = [key for key in ("velocity", "effort") if _value(limit.get(key, "0")) == 0]
    for key in found:
        limit.set(key, UNLIMITED)
    return found


def _is_empty(joint: Element) -> bool:
    """True if the lower and the upper limit are equal, as if they are omitted."""
    limit = joint.find("limit")
    ends = [0.0, 0.0] if limit is None else [_value(limit.get(key, "0")) for key in ("lower", "upper")]
    return ends[0] == ends[1]


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan  # reported when the file is read


def _inertias(root: Element, way: list[Element]) -> Iterator[str]:
    moving = [place for place, joint in enumerate(way) if joint.get("type") in MOVING]
    links = {link.get("name", ""): link for link in root.findall("link")}
    for place, following in zip(moving, [*moving[1:], len(way)][: len(moving)], strict=True):
        group = [links[_end(joint, "child")] for joint in way[place:following]]
        if any(_value(mass.get("value", "0")) != 0 for link in group for mass in link.findall("inertial/mass")):
            yield from _without_moments(group)
            continue
        steps = [_origin(joint) for joint in way[place + 1 : following + 1]]
        reach = np.sum(steps, axis=0) if steps else np.zeros(3)
        yield _placeholder(group[0], np.asarray(reach, dtype=float))


def _without_moments(group: list[Element]) -> Iterator[str]:
    """Give links whose moments of inertia are all zero those of a sphere."""
    for link in group:
        for inertial in link.findall("inertial"):
            mass, inertia = inertial.find("mass"), inertial.find("inertia")
            if mass is None or inertia is None or _value(mass.get("value", "0")) <= 0:
                continue
            if not any(_value(inertia.get(key, "0")) for key in INERTIA):
                moment = f"{_value(mass.get('value', '0')) * 0.05**2:.4g}"
                inertia.attrib.update(dict.fromkeys(("ixx", "iyy", "izz"), moment))
                yield f"link {link.get('name', '')}: no moments of inertia in the file; placeholder of {moment} kg m^2"


def _origin(joint: Element) -> list[float]:
    origin = joint.find("origin")
    return numbers(origin.get("xyz", "0 0 0")) if origin is not None else [0.0, 0.0, 0.0]


def _placeholder(link: Element, reach: np.ndarray) -> str:
    length = float(np.linalg.norm(reach))
    mass = max(LEAST, DENSITY * length)
    moment = mass * max(0.05, 0.3 * length) ** 2
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=" ".join(f"{x:.6g}" for x in reach / 2))
    ElementTree.SubElement(inertial, "mass", value=f"{mass:.4g}")
    zeros = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    ElementTree.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz"), f"{moment:.4g}") | zeros)
    return f"link {link.get('name', '')}: no inertia in the file; placeholder of {mass:.3g} kg and {moment:.3g} kg m^2"


def _end(joint: Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")
