"""The robot as a page draws it: the maker's collision meshes where there are any, else a tube from joint to joint."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from dmframe.robot.chain import SerialChain
from dmframe.robot.mimics import with_mimics
from dmframe.robot.reduction import model_configuration
from dmframe.robot.urdf import read_urdf

MOST = 12_000
"""Triangles of a robot; of more, a page would be too large, and tubes are drawn."""
LEVELS = 4095
"""Of a coordinate: a mesh is drawn to a quarter of a thousandth of its size."""
MOST_CORNERS = 32_767
"""Of one mesh: differences of their numbers are kept in 16 bits."""
OUT_OF_SCALE = 30.0
"""Meshes that are so many times larger, or smaller, than the arm is long are of another unit than its file."""


def meshes_of(chain: SerialChain, urdf: Path | None, hold: dict[str, float]) -> list[dict[str, Any]]:
    """Each body's triangles in its joint's frame; empty where the meshes that are there do not show the whole robot.

    ``joint`` counts the free joints from 0, -1 is the base. There are ``corners`` corners on a grid of `LEVELS` between
    ``low`` and ``high`` [m], and ``faces`` triangles of them; `_packed` says how ``packed`` holds both.
    """
    found = list[dict[str, Any]]()
    if urdf is None:
        return found
    try:
        bodies = _bodies(chain, urdf, hold)
    except (OSError, RuntimeError, ValueError):  # meshes that are missing or broken: tubes are drawn
        return found
    if not {*range(chain.n)} <= {joint for joint, _, _ in bodies}:  # a part of a robot in the air says less than tubes
        return found
    for joint, corners, faces in bodies:
        low, high = corners.min(axis=0), corners.max(axis=0)
        span = np.where(high > low, high - low, 1.0)
        grid = np.round((corners - low) / span * LEVELS).astype(int)
        kept, place = np.unique(grid, axis=0, return_inverse=True)
        turned = place.reshape(-1)[faces]
        turned = turned[
            (turned[:, 0] != turned[:, 1]) & (turned[:, 1] != turned[:, 2]) & (turned[:, 0] != turned[:, 2])
        ]
        if len(kept) > MOST_CORNERS:
            return []
        found.append(
            {
                "joint": joint,
                "low": low.tolist(),
                "high": (low + span).tolist(),
                "corners": len(kept),
                "faces": len(turned),
                "packed": _packed(kept, turned),
            }
        )
    return found


def _bodies(chain: SerialChain, urdf: Path, hold: dict[str, float]) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Joint, corners and faces of each collision mesh, at the reduced model's joints."""
    model = pin.buildModelFromUrdf(str(urdf))
    folders = [str(folder) for folder in (urdf.parent, *urdf.parents)]
    geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders)
    locked = [i for i, name in enumerate(model.names) if i and name not in chain.joint_names]
    places = with_mimics(read_urdf(urdf)[1], hold, chain.joint_names, chain.name)
    _, reduced = pin.buildReducedModel(model, geometry, locked, model_configuration(model, places))
    meshes = [body for body in reduced.geometryObjects if hasattr(body.geometry, "vertices")]
    if sum(body.geometry.num_tris for body in meshes) > MOST:
        raise ValueError("expected fewer triangles")
    found = list[tuple[int, np.ndarray, np.ndarray]]()
    for body in meshes:
        shape = body.geometry
        corners = np.asarray(shape.vertices()) * np.asarray(body.meshScale)
        if not np.all(np.isfinite(corners)):
            raise ValueError("expected finite corners")
        triangles = map(shape.tri_indices, range(shape.num_tris))
        faces = np.array([(triangle[0], triangle[1], triangle[2]) for triangle in triangles])
        if len(faces):
            place = body.placement
            found.append((body.parentJoint - 1, corners @ place.rotation.T + place.translation, faces))
    if found and not _to_scale(chain, max(np.ptp(corners, axis=0).max() for _, corners, _ in found)):
        raise ValueError("expected meshes in the unit of the robot's file")
    return found


def _to_scale(chain: SerialChain, span: float) -> bool:
    """True where the largest mesh, so many metres wide, fits an arm as long as from joint to joint to the tool."""
    places = [*(placed.translation for placed in chain.model.jointPlacements[2:]), [float(part) for part in chain.tool]]
    strokes = [max(abs(joint.lower), abs(joint.upper)) for joint in chain.joints if joint.kind == "prismatic"]
    length = sum(map(np.linalg.norm, places)) + sum(stroke for stroke in strokes if np.isfinite(stroke))
    return length == 0 or bool(length / OUT_OF_SCALE < span < length * OUT_OF_SCALE)


def _packed(corners: np.ndarray, faces: np.ndarray) -> str:
    """Six columns of 16-bit numbers, of each first all low bytes and then all high ones, deflated, in base64.

    They are x, y and z of the corners, each less that of the corner before; then of each face its first corner less
    that of the face before, and its second and its third corner less its first. Half as long as the plain numbers.
    """
    first = np.argmin(faces, axis=1)
    turned = np.stack([faces[np.arange(len(faces)), (first + k) % 3] for k in range(3)], axis=1)
    turned = turned[np.lexsort(turned.T[::-1])]
    steps = np.diff(corners.astype(int), axis=0, prepend=0)
    columns = [*steps.T, np.diff(turned[:, 0], prepend=0), turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0]]
    pairs = (np.ascontiguousarray(column.astype("<i2")).view(np.uint8).reshape(-1, 2) for column in columns)
    return base64.b64encode(zlib.compress(b"".join(pair.T.tobytes() for pair in pairs), 9)).decode()
