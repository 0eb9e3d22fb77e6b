"""Check of a URDF's tree; Pinocchio's reader silently drops links that are not connected to the base."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final
from xml.etree import ElementTree

from dmframe.common.errors import nearest

Element = ElementTree.Element
Found = Iterator[tuple[Element, str]]

KINDS: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


def tree_faults(root: Element) -> Found:
    """Faults of names, types and ends of joints, and then of their tree."""
    named = [fault for kind in ("link", "joint") for fault in _names(root, kind)]
    links = {link.get("name", ""): link for link in root.findall("link")}
    ends = [fault for joint in root.findall("joint") for fault in _ends(joint, links)]
    yield from (*named, *ends)
    if not named and not ends:
        yield from _shape(root, links)


def _names(root: Element, kind: str) -> Found:
    seen = set[str]()
    for element in root.findall(kind):
        name = element.get("name", "")
        if not name.strip():
            yield element, f"expected a name of this {kind}, found none"
        elif name in seen:
            yield element, f"expected one {kind} of that name, found two"
        seen.add(name)


def _ends(joint: Element, links: Mapping[str, Element]) -> Found:
    kind = joint.get("type", "")
    if kind not in KINDS:
        yield joint, f"expected a joint type, {', '.join(KINDS)}; found {kind or 'none'}"
    for tag in ("parent", "child"):
        found = joint.findall(tag)
        if len(found) != 1:
            yield joint, f"expected one <{tag}>, found {len(found) or 'none'}"
        elif (name := found[0].get("link", "")) not in links:
            yield found[0], f"its {tag} {name or 'without a name'} is not a link of the file; {nearest(name, links)}"


def _shape(root: Element, links: Mapping[str, Element]) -> Found:
    """One base, and each other link the child of one joint."""
    above, looped = dict[str, Element](), False
    for joint in root.findall("joint"):
        child = _end(joint, "child")
        if child in above:
            first = above[child].get("name", "")
            yield joint, f"expected each link to be the child of one joint, found {child} to be that of {first} too"
        above.setdefault(child, joint)
    for joint in root.findall("joint"):
        before, link = set[str](), _end(joint, "parent")
        while link in above and link not in before and link != _end(joint, "child"):
            before.add(link)
            link = _end(above[link], "parent")
        if link == _end(joint, "child") and not looped:
            looped = True  # reported once
            yield (
                joint,
                f"expected a tree, found a loop: its parent {_end(joint, 'parent')} moves with its child {link}",
            )
    bases = [name for name in links if name not in above]
    if len(bases) > 1 and not looped:
        yield links[bases[1]], f"expected one base, found {bases[0]} and {bases[1]}, neither the child of a joint"


def _end(joint: Element, tag: str) -> str:
    return next(element.get("link", "") for element in joint.findall(tag))
