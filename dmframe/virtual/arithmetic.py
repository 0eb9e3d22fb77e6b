"""Functions of scripts on numbers, poses and texts, independent of the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from dmframe.virtual.words import ScriptError

LONGEST: Final = 1 << 16
"""Maximum length of a text [characters]."""


@final
class Pose(list[float]):
    """Position and rotation vector: a list of six numbers."""


def norm_(a: Any) -> float:
    return float(np.linalg.norm(a)) if isinstance(a, list) else abs(a)


def pow_(base: Any, exponent: Any) -> float:
    return float(math.pow(base, exponent))


def log_(b: Any, f: Any) -> float:
    return math.log(f, b)


def pose_add_(p_1: Any, p_2: Any) -> Pose:
    first, second = placed(p_1), placed(p_2)
    return posed(first.rotation @ second.rotation, first.translation + second.translation)


def pose_sub_(p_to: Any, p_from: Any) -> Pose:
    to, start = placed(p_to), placed(p_from)
    return posed(to.rotation @ start.rotation.T, to.translation - start.translation)


def pose_trans_(p_from: Any, p_from_to: Any) -> Pose:
    found = placed(p_from) * placed(p_from_to)
    return posed(found.rotation, found.translation)


def pose_inv_(p_from: Any) -> Pose:
    found = placed(p_from).inverse()
    return posed(found.rotation, found.translation)


def pose_dist_(p_from: Any, p_to: Any) -> float:
    return float(np.linalg.norm(six(p_to)[:3] - six(p_from)[:3]))


def str_cat_(op1: Any, op2: Any) -> str:
    found = f"{text(op1)}{text(op2)}"
    if len(found) > LONGEST:
        raise ScriptError(f"str_cat: expected no more than {LONGEST} characters, found {len(found)}")
    return found


def six(values: Any) -> np.ndarray:
    """Convert six numbers to an array. Raises `ScriptError` for other values."""
    if not isinstance(values, list) or len(values) != 6 or not all(map(is_number, values)):
        raise ScriptError(f"expected six numbers, found {values}")
    return np.array(values, dtype=float)


def is_number(value: Any) -> bool:
    """True for an integer or a float, which a truth value is not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def text(value: Any) -> str:
    """Format a value as URScript prints it."""
    if isinstance(value, list):
        inner = ", ".join(map(text, value))
        return f"{'p' if isinstance(value, Pose) else ''}[{inner}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def placed(pose: Any) -> Any:
    """Convert a pose to an SE(3) placement."""
    import pinocchio as pin

    numbers = six(pose)
    return pin.SE3(pin.exp3(numbers[3:]), numbers[:3])


def posed(rotation: np.ndarray, translation: np.ndarray) -> Pose:
    """Convert a placement to a pose."""
    import pinocchio as pin

    return Pose([*translation.tolist(), *pin.log3(rotation).tolist()])


FUNCTIONS: Final[Mapping[str, Any]] = {
    "norm": norm_,
    "sqrt": math.sqrt,
    "pow": pow_,
    "log": log_,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
    "atan2": math.atan2,
    "floor": math.floor,
    "ceil": math.ceil,
    "d2r": math.radians,
    "r2d": math.degrees,
    "length": len,
    "pose_add": pose_add_,
    "pose_sub": pose_sub_,
    "pose_trans": pose_trans_,
    "pose_inv": pose_inv_,
    "pose_dist": pose_dist_,
    "point_dist": pose_dist_,
    "str_cat": str_cat_,
    "str_len": len,
    "to_str": text,
    "to_num": float,
    "get_list_length": len,
}
"""URScript name -> function."""
