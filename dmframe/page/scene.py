"""Robot geometry of a page: collision meshes if available, else the page draws tubes between joints."""

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
"""Maximum number of triangles; above it tubes are drawn, to limit the size of the page."""
LEVELS = 4095
"""Quantisation levels of a coordinate: resolution 1/4000 of the size of a mesh."""
MOST_CORNERS = 32_767
"""Maximum corners of a mesh: index differences are stored in 16 bits."""
OUT_OF_SCALE = 30.0
"""Ratio of mesh size to arm length above (or below its inverse) which the mesh must be in another unit."""


def meshes_of(chain: SerialChain, urdf: Path | None, hold: dict[str, float]) -> list[dict[str, Any]]:
    """Triangles of each body in the frame of its joint; empty if the available meshes do not cover the whole robot.

    ``joint`` counts the free joints from 0, -1 is the base. The ``corners`` corners are on a grid of `LEVELS` between
    ``low`` and ``high`` [m]; see `_packed` for the encoding of corners and ``faces`` triangles.
    """
    found = list[dict[str, Any]]()
    if urdf is None:
        return found
    try:
        bodies = _bodies(chain, urdf, hold)
    except (OSError, RuntimeError, ValueError):  # missing or broken meshes: draw tubes
        return found
    if not {*range(chain.n)} <= {joint for joint, _, _ in bodies}:  # incomplete meshes are worse than tubes
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
    """Joint, corners and faces of each collision mesh of the reduced model."""
    model = pin.buildModelFromUrdf(str(urdf))
    folders = [str(folder) for folder in (urdf.parent, *urdf.parents)]
    geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders)
    locked = [i for i, name in enumerate(model.names) if i and name not in chain.joint_names]
    places = with_mimics(read_urdf(urdf, free=chain.joint_names)[1], hold, chain.joint_names, chain.name)
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
    """True if the size of the largest mesh [m] is plausible for the length of the arm."""
    places = [*(placed.translation for placed in chain.model.jointPlacements[2:]), [float(part) for part in chain.tool]]
    strokes = [max(abs(joint.lower), abs(joint.upper)) for joint in chain.joints if joint.kind == "prismatic"]
    length = sum(map(np.linalg.norm, places)) + sum(stroke for stroke in strokes if np.isfinite(stroke))
    return length == 0 or bool(length / OUT_OF_SCALE < span < length * OUT_OF_SCALE)


def _packed(corners: np.ndarray, faces: np.ndarray) -> str:
    """Six columns of 16-bit numbers, each as low bytes then high bytes, deflated, in base64.

    Columns: differences of x, y, z between successive corners; difference of the first corner index between successive
    faces, and second and third corner index minus the first. Half the size of the plain numbers.
    """
    first = np.argmin(faces, axis=1)
    turned = np.stack([faces[np.arange(len(faces)), (first + k) % 3] for k in range(3)], axis=1)
    turned = turned[np.lexsort(turned.T[::-1])]
    steps = np.diff(corners.astype(int), axis=0, prepend=0)
    columns = [*steps.T, np.diff(turned[:, 0], prepend=0), turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0]]
    pairs = (np.ascontiguousarray(column.astype("<i2")).view(np.uint8).reshape(-1, 2) for column in columns)
    return base64.b64encode(zlib.compress(b"".join(pair.T.tobytes() for pair in pairs), 9)).decode()
