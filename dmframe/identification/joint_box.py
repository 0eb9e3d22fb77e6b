"""Box of joint positions around a start posture: inside the limits, and at samples of it without a collision."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, final
from xml.etree import ElementTree

import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.identification.log import Array
from dmframe.robot.chain import SerialChain, pin_configuration

REACH: Final = {"revolute": 0.3, "prismatic": 0.06}
"""Largest distance from the start [rad, m]."""
MARGIN: Final = {"revolute": 0.03, "prismatic": 0.005}
"""Distance to the limits [rad, m]: the robot deviates from its commands."""
LEAST: Final = 0.1
"""Smallest box, relative to `REACH`."""
CLEARANCE: Final = 0.02
"""Distance between links below which they count as colliding [m]."""
SAMPLES: Final = 300
SHRINK: Final = 0.85
TRIED: Final = 200
"""Postures that are tried."""
ALWAYS: Final = 0.95
"""Fraction of random postures from which on two links count as overlapping by their shapes."""


@final
class Obstacles:
    """Collisions of a robot's links with one another, and with a floor.

    Parameters
    ----------
    shapes
        The URDF tree with collision shapes, and the folder of its meshes; None without one.
    floor
        Height in the base frame above which moving joints and the tool stay [m].
    """

    def __init__(self, chain: SerialChain, shapes: tuple[ElementTree.Element, Path] | None, floor: float | None):
        self.chain, self.floor, self.notes = chain, floor, list[str]()
        self.data = chain.model.createData()
        self.geometry: Any = None
        self.lost = ""  # the first mesh that is missing
        if shapes is not None:
            self._add_shapes(*shapes)
        if self.geometry is None:
            why = f"the mesh {self.lost} was not found" if self.lost else "the robot's file has no collision shapes"
            self.notes.append(f"self-collision is not checked: {why}")

    def _add_shapes(self, root: ElementTree.Element, folder: Path) -> None:
        import pinocchio as pin

        for mesh in root.iterfind(".//collision//mesh"):
            name = mesh.get("filename", "")
            place = _found(name, folder)
            self.lost = self.lost or ("" if place.is_file() else name)
            mesh.set("filename", str(place))
        text = ElementTree.tostring(root, encoding="unicode")
        try:
            whole = pin.buildModelFromXML(text)
            shapes = pin.buildGeomFromUrdfString(whole, text, pin.GeometryType.COLLISION)
        except (ValueError, RuntimeError):  # a mesh is missing
            return
        found = pin.GeometryModel()
        for shape in shapes.geometryObjects:
            before = whole.frames[shape.parentFrame]
            if not self.chain.model.existFrame(before.name, pin.FrameType.BODY):
                continue
            frame = self.chain.model.frames[self.chain.model.getFrameId(before.name, pin.FrameType.BODY)]
            shape.placement = frame.placement * before.placement.inverse() * shape.placement
            shape.parentJoint, shape.parentFrame = frame.parentJoint, 0
            found.addGeometryObject(shape)
        for (a, one), (b, other) in itertools.combinations(enumerate(found.geometryObjects), 2):
            if abs(one.parentJoint - other.parentJoint) > 1:  # neighbours touch
                found.addCollisionPair(pin.CollisionPair(a, b))
        if not len(found.collisionPairs):
            return
        self.geometry, self.geometry_data = found, pin.GeometryData(found)
        joints = [shape.parentJoint for shape in found.geometryObjects]
        for pair, request in zip(found.collisionPairs, self.geometry_data.collisionRequests, strict=True):
            far = abs(joints[pair.first] - joints[pair.second]) > 2  # links two joints apart are near one another
            request.security_margin = CLEARANCE * far

    def without_overlaps(self, postures: Sequence[Array]) -> None:
        """Ignore pairs of links whose shapes overlap in nearly all postures."""
        if self.geometry is None:
            return
        counts = np.zeros(len(self.geometry.collisionPairs))
        for q in postures:
            self._collide(q, stop=False)
            counts += [result.isCollision() for result in self.geometry_data.collisionResults]
        for k in np.flatnonzero(counts >= ALWAYS * len(postures)):
            self.geometry_data.deactivateCollisionPair(int(k))
            self.notes.append(f"collision shapes of {self._pair(int(k))} always overlap and are ignored")

    def _collide(self, q: Array, *, stop: bool) -> bool:
        import pinocchio as pin

        configuration = pin_configuration(self.chain, q)
        return bool(
            pin.computeCollisions(self.chain.model, self.data, self.geometry, self.geometry_data, configuration, stop)
        )

    def _pair(self, k: int) -> str:
        pair = self.geometry.collisionPairs[k]
        return " and ".join(self.geometry.geometryObjects[i].name.rpartition("_")[0] for i in (pair.first, pair.second))

    def hit(self, q: Array) -> str:
        """What a posture collides with; empty if it is free."""
        import pinocchio as pin

        if self.geometry is not None and self._collide(q, stop=True):
            results = self.geometry_data.collisionResults
            return self._pair(next(k for k in range(len(results)) if results[k].isCollision()))
        if self.floor is not None:
            pin.framesForwardKinematics(self.chain.model, self.data, pin_configuration(self.chain, q))
            tool = self.data.oMf[self.chain.model_tool].translation[2]
            heights = [placement.translation[2] for placement in list(self.data.oMi)[2:]]
            if min([tool, *heights]) < self.floor:
                return "the floor"
        return ""


def free_posture(
    chain: SerialChain, first: Array, lower: Array, upper: Array, hit: Callable[[Array], str]
) -> Array | None:
    """The first of some postures around which the whole box is free; None if there is none."""
    random = np.random.default_rng(0)
    away = np.array([REACH[joint.kind] + MARGIN[joint.kind] for joint in chain.joints])
    low, high = np.maximum(lower, -np.pi) + away, np.minimum(upper, np.pi) - away
    middle = (low + high) / 2
    low, high = np.minimum(low, middle), np.maximum(high, middle)
    for q in (first, *np.round(random.uniform(low, high, (TRIED, chain.n)), 3)):
        try:
            box_around(chain, q, lower, upper, hit, 0, least=1.0)
        except ValueFault:
            continue
        return np.asarray(q)
    return None


def box_around(
    chain: SerialChain,
    start: Array,
    lower: Array,
    upper: Array,
    hit: Callable[[Array], str],
    seed: int,
    least: float = LEAST,
) -> tuple[Array, Array]:
    """The largest box of a family around a start posture without a collision at its corners and at random postures.

    Raises
    ------
    ValueFault
        The start is outside the limits or collides, or hardly a box is free.
    """
    reach = np.array([REACH[joint.kind] for joint in chain.joints])
    margin = np.array([MARGIN[joint.kind] for joint in chain.joints])
    for joint, q, low, high, own in zip(chain.joints, start, lower, upper, reach, strict=True):
        if not low <= q <= high:
            raise ValueFault(
                f"start: joint {joint.name} is at {q:.4g}, outside its limits {low:.4g} to {high:.4g}; choose another "
                "with --start"
            )
        if high - low < 2 * (MARGIN[joint.kind] + LEAST * own):
            raise ValueFault(f"joint {joint.name}: the limits {low:.4g} to {high:.4g} leave no room for steps")
    if what := hit(start):
        raise ValueFault(f"start: the robot collides there ({what}); choose another posture with --start")
    random, share = np.random.default_rng(seed), 1.0
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=chain.n)))
    while share >= least:
        low, high = np.maximum(lower + margin, start - share * reach), np.minimum(upper - margin, start + share * reach)
        low, high = np.minimum(low, start), np.maximum(high, start)  # a start at its limit
        at = np.vstack([corners, random.random((SAMPLES, chain.n))])
        if not any(hit(low + row * (high - low)) for row in at):
            return low, high
        share *= SHRINK
    raise ValueFault(
        "start: within a tenth of the usual steps the robot collides; choose another posture with --start, or a lower "
        "--floor"
    )


def _found(name: str, folder: Path) -> Path:
    """Path of a mesh; one of a package is searched in the folder and above."""
    if name.startswith("package://"):
        inside = Path(name.removeprefix("package://"))
        parts = inside, inside.relative_to(inside.parts[0])
        choices = [place / part for place in (folder, *folder.resolve().parents) for part in parts]
        return next((path for path in choices if path.is_file()), folder / inside)
    return (folder / name.removeprefix("file://")).resolve()
