"""Choice of the tool frame at the end of a robot's arm, for a new graph."""

from __future__ import annotations

import re
from typing import Final

from dmframe.common.errors import RobotError
from dmframe.robot.convert import Element, children

MOVING: Final = ("revolute", "continuous", "prismatic")
AXES: Final = (4, 7)
"""Least and most moving joints of an arm."""
FINGERS: Final = 2
"""A branch with at most so many moving joints in a row is part of a gripper or a head."""
FINGER: Final = 4
"""Largest number of moving joints in a finger."""
FLANGES: Final = re.compile(r"tool0|tcp|flange|tool|ee|eef|end.?effector|gripper_frame|link_?8|attachment|pinch", re.I)
"""Names of tool frames, as makers use them."""
JAWS: Final = re.compile(r"jaw|finger|claw|knuckle|^(gripper|hand)(_joint)?$", re.I)
"""Names of joints and links of a gripper."""


def flange_of(root: Element, where: str) -> str:
    """Link at the end of the arm, before the fingers of a gripper.

    Legs, heads and other chains with fewer moving joints than an arm are passed over.

    Raises
    ------
    RobotError
        The robot has several arms, or none; the message lists the frames. Or it has no base.
    """
    ends = _Tree(root).ends(_base(root, where), 0)
    arms = [end for end in ends if AXES[0] <= end[1]]
    if len(ends) == 1 or len(arms) == 1:
        return (arms or ends)[0][0]
    listed = ", ".join(f"{link} ({moving} joint{'s' * (moving != 1)})" for link, moving in arms or ends)
    if arms:
        raise RobotError(f"{where}: it branches into arms; name the tool with --tool, one of {listed}")
    raise RobotError(f"{where}: expected an arm with {AXES[0]} to {AXES[1]} moving joints, found chains to {listed}")


class _Tree:
    """Joints by parent link, and which of them belong to a gripper."""

    def __init__(self, root: Element) -> None:
        self.below = children(root)
        self._leaders = {mimic.get("joint") for mimic in root.findall("joint/mimic")}
        self._known = dict[Element, int]()

    def ends(self, link: str, passed: int) -> list[tuple[str, int]]:
        """The tool frame of each arm behind a link, with the number of its moving joints from the base."""
        while True:
            moving = sorted(((self.depth(joint), joint) for joint in self.below.get(link, [])), key=lambda p: -p[0])
            arms = [pair for pair in moving if pair[0] > 0]
            hand = len(arms) > 1 and passed >= AXES[0] and arms[0][0] <= FINGER
            if not arms or hand or (len(arms) > 1 and arms[0][0] <= FINGERS):
                return [(self._named(link), passed)]
            if len(arms) > 1 and arms[1][0] > FINGERS:
                whole = [joint for depth, joint in arms if depth >= AXES[0]]
                others = whole or [joint for depth, joint in arms if depth > FINGERS]
                if len(others) > 1:
                    return [end for joint in others for end in self.ends(_child(joint), passed + _moves(joint))]
            joint = arms[0][1]
            if arms[0][0] == 1:  # a jaw, next to a named frame or by its own name
                if flanges := self._flanges(link):
                    return [(flanges[0], passed)]
                if passed >= AXES[0] and any(JAWS.search(name) for name in (joint.get("name", ""), _child(joint))):
                    return [(self._named(link), passed)]
            passed += _moves(joint)
            link = _child(joint)

    def depth(self, joint: Element) -> int:
        """Most moving joints in a row from this one on, without a gripper's: those that mimic another one, and a last
        one that others mimic.
        """
        if joint not in self._known:
            behind = max((self.depth(other) for other in self.below.get(_child(joint), [])), default=0)
            gripper = behind == 0 and joint.get("name") in self._leaders
            self._known[joint] = behind + (_moves(joint) and not gripper)
        return self._known[joint]

    def _named(self, link: str) -> str:
        """Frame with the name of a flange fixed to the last link, else the last link itself."""
        if flanges := self._flanges(link):
            return flanges[0]
        if FLANGES.search(link):
            return link
        fixed = self._fixed(link)
        return fixed[0] if len(fixed) == 1 else link

    def _flanges(self, link: str) -> list[str]:
        """Fixed frames behind a link with the name of a flange, in the order of `FLANGES`."""
        ranks = FLANGES.pattern.split("|")
        found = [name for name in self._fixed(link) if FLANGES.search(name)]
        return sorted(found, key=lambda name: next(k for k, rank in enumerate(ranks) if re.search(rank, name, re.I)))

    def _fixed(self, link: str) -> list[str]:
        found = list[str]()
        for joint in self.below.get(link, []):
            if joint.get("type") == "fixed":
                found += [_child(joint), *self._fixed(_child(joint))]
        return found


def _moves(joint: Element) -> bool:
    return joint.get("type") in MOVING and joint.find("mimic") is None


def _base(root: Element, where: str) -> str:
    ends = {_child(joint) for joint in root.findall("joint")}
    links = [link.get("name", "") for link in root.findall("link")]
    base = next((name for name in links if name not in ends), None)
    if base is None:
        found = "each link is the child of a joint" if links else "there is none, as in a file that only defines macros"
        raise RobotError(f"{where}: expected a base, a link that is the child of no joint; {found}")
    return base


def _child(joint: Element) -> str:
    found = joint.find("child")
    return "" if found is None else found.get("link", "")
