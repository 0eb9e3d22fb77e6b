"""A URDF file of a serial chain with given inertial parameters: joints, limits, links and tool, without shapes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import numpy as np

from dmframe.identification.model import Array
from dmframe.robot.chain import SerialChain

TOOL = "tool"


def urdf_text(chain: SerialChain, inertia: Array) -> str:
    """The URDF of a chain whose links have the inertial parameters `inertia`, (n, 10)."""
    root = ET.Element("robot", name=f"{chain.name}_identified")
    ET.SubElement(root, "link", name="base")
    before = "base"
    for k, (joint, own) in enumerate(zip(chain.joints, inertia, strict=True), 1):
        _link(root, f"link_{k}", own)
        element = ET.SubElement(root, "joint", name=joint.name, type=joint.kind)
        _placed(element, before, f"link_{k}", joint.rotation, joint.translation)
        ET.SubElement(element, "axis", xyz=_text(joint.axis))
        limits = {"lower": joint.lower, "upper": joint.upper, "velocity": joint.velocity, "effort": joint.effort}
        ET.SubElement(element, "limit", {name: repr(float(np.clip(x, -1e9, 1e9))) for name, x in limits.items()})
        before = f"link_{k}"
    ET.SubElement(root, "link", name=TOOL)
    _placed(
        ET.SubElement(root, "joint", name=f"to_{TOOL}", type="fixed"), before, TOOL, chain.tool_rotation, chain.tool
    )
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _link(root: ET.Element, name: str, own: Array) -> None:
    """A link with the ten parameters; its inertia about the centre of mass, as the format requires."""
    mass, moment, (xx, xy, yy, xz, yz, zz) = own[0], own[1:4], own[4:]
    center = moment / mass if mass > 0 else 0 * moment
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about -= mass * (center @ center * np.eye(3) - np.outer(center, center))
    inertial = ET.SubElement(ET.SubElement(root, "link", name=name), "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(center), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {key: repr(float(about[place])) for key, place in entries.items()})


def _placed(element: ET.Element, parent: str, child: str, rotation: Any, translation: Any) -> None:
    from pinocchio.rpy import matrixToRpy

    turn = matrixToRpy(np.array([[float(x) for x in row] for row in rotation]))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    ET.SubElement(element, "origin", xyz=_text(translation), rpy=_text(turn))


def _text(values: Sequence[Any] | Array) -> str:
    return " ".join(repr(float(x)) for x in values)
