"""Choice of a robot's tool frame and repair of its links, for a new graph."""

from __future__ import annotations

import re
from typing import Final
from xml.etree import ElementTree

import numpy as np

from dmframe.common.errors import RobotError
from dmframe.robot.convert import Element, children, joints_to
from dmframe.robot.urdf_numbers import Lines, faults_of, numbers

MOVING: Final = ("revolute", "continuous", "prismatic")
FINGERS: Final = 2
"""Largest number of consecutive moving joints in a branch of a gripper."""
ARM: Final = 4
"""Number of consecutive moving joints after which a branching is a hand, not several arms."""
FLANGES: Final = re.compile(r"tool0|tcp|flange|tool|ee|eef|end.?effector|gripper_frame|link_?8|attachment|pinch", re.I)
"""Names of tool frames in use by makers."""
DENSITY: Final = 5.0
"""Placeholder mass of a link per length [kg/m]."""
LEAST: Final = 0.5
"""Least placeholder mass of a link [kg]."""


def flange_of(root: Element, where: str) -> str:
    """Link at the end of the arm, before the fingers of a gripper.

    Raises
    ------
    RobotError
        The robot has several arms; the message lists the frames.
    """
    below = children(root)
    link, passed = _base(root), 0
    while True:
        moving = sorted(((_depth(below, joint), joint) for joint in below.get(link, [])), key=lambda pair: -pair[0])
        arms = [pair for pair in moving if pair[0] > 0]
        if not arms or (len(arms) > 1 and (arms[0][0] <= FINGERS or passed >= ARM)):
            return _named(root, below, link)
        if len(arms) > 1 and arms[1][0] > FINGERS:
            raise RobotError(
                f"{where}: at link {link} it branches into arms; name the tool with --tool, one of "
                f"{', '.join(_frames(root))}"
            )
        if arms[0][0] == 1 and (named := _flanges(below, link)):  # a jaw next to a named frame
            return named[0]
        passed += arms[0][1].get("type") in MOVING
        link = _child(arms[0][1])


def _named(root: Element, below: dict[str, list[Element]], link: str) -> str:
    """Frame with the name of a flange fixed to the last link, else the last link itself."""
    if flanges := _flanges(below, link):
        return flanges[0]
    if FLANGES.search(link):
        return link
    fixed = _fixed(below, link)
    return fixed[0] if len(fixed) == 1 else link


def _flanges(below: dict[str, list[Element]], link: str) -> list[str]:
    """Fixed frames behind a link with the name of a flange, in the order of `FLANGES`."""
    ranks = FLANGES.pattern.split("|")
    found = [name for name in _fixed(below, link) if FLANGES.search(name)]
    return sorted(found, key=lambda name: next(k for k, rank in enumerate(ranks) if re.search(rank, name, re.I)))


def _fixed(below: dict[str, list[Element]], link: str) -> list[str]:
    found = list[str]()
    for joint in below.get(link, []):
        if joint.get("type") == "fixed":
            found += [_child(joint), *_fixed(below, _child(joint))]
    return found


def _depth(below: dict[str, list[Element]], joint: Element) -> int:
    """Largest number of consecutive moving joints from this one on, without mimic joints."""
    own = joint.get("type") in MOVING and joint.find("mimic") is None
    return own + max((_depth(below, other) for other in below.get(_child(joint), [])), default=0)


def _frames(root: Element) -> list[str]:
    inner = {joint.find("parent").get("link") for joint in root.findall("joint")}  # type: ignore[union-attr]  # it was checked
    return [link.get("name", "") for link in root.findall("link") if link.get("name") not in inner]


def _base(root: Element) -> str:
    ends = {_child(joint) for joint in root.findall("joint")}
    return next(link.get("name", "") for link in root.findall("link") if link.get("name") not in ends)


def _child(joint: Element) -> str:
    found = joint.find("child")
    return "" if found is None else found.get("link", "")


def repaired(root: Element, tool: str, where: str) -> list[str]:
    """Remove invalid inertias of links outside the arm, and add placeholders in the arm; returns a note for each.

    A placeholder is a sphere of `DENSITY` times the distance to the next joint, half way to it.
    """
    chain, notes = joints_to(root, tool), list[str]()
    on = {_base(root), *map(_child, chain)}
    lines = Lines.fromkeys(root.iter(), 0)
    for link in root.findall("link"):
        alone = ElementTree.Element("robot")
        alone.append(link)
        name, inertial = link.get("name", ""), link.find("inertial")
        if name not in on and inertial is not None and any(faults_of(alone, lines, where)):
            link.remove(inertial)
            notes.append(f"link {name}: invalid inertia removed; the link is not between the base and {tool}")
    moving = [place for place, joint in enumerate(chain) if joint.get("type") in MOVING]
    links = {link.get("name", ""): link for link in root.findall("link")}
    for place, following in zip(moving, [*moving[1:], len(chain)][: len(moving)], strict=True):
        group = [links[_child(joint)] for joint in chain[place:following]]
        if any(float(mass.get("value", "0")) > 0 for link in group for mass in link.findall("inertial/mass")):
            continue
        steps = [_origin(joint) for joint in chain[place + 1 : following + 1]]
        reach = np.sum(steps, axis=0) if steps else np.zeros(3)
        notes.append(_placeholder(group[0], np.asarray(reach, dtype=float)))
    return notes


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
