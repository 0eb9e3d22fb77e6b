"""Rank region as a graph value and as plain data."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from typing import Any, Final

from dmframe.analysis.rank_region import RankRegion

PROVED: Final = (
    "The bound on J J' is proved for the model {model} by interval arithmetic with outward rounding, for every pose in "
    "the tube and all parameters in the set. Assumption: the robot stays in the tube."
)
EXACT: Final = (
    "At every time from 0 to {until:.6g} s, also between the poses, the joint path on which the tool follows its path "
    "is proved to lie within {line_distance:.2g} rad of the lines between the poses, in each joint; the boxes cover "
    "the tube about it."
)
APPROACH: Final = "The straight lines from the start onto the path are an assumption; the robot may move differently."
MANY: Final = "The robot is redundant: this joint path is one of many, and its controller may choose another."
GIVEN: Final = "The joint path was given; whether the tool follows its path on it was not checked."
KEPT: Final = "The projection keeps the estimate in the set."
MODEL: Final = "The true translations must be in the set: it bounds the model error."

_MICROMETRE: Final = Decimal("0.000001")


def proved(region: RankRegion) -> str:
    """Proved statements with their model, and assumptions."""
    parts = [PROVED.format(model=region.model[:12])]
    if region.line_distance is None:
        parts.append(GIVEN)
    else:
        parts.append(EXACT.format(until=region.until, line_distance=region.line_distance))
        parts += [APPROACH] * region.path.has_approach + [MANY] * region.redundant
    return " ".join([*parts, MODEL if region.option is None else KEPT])


def option_value(region: RankRegion) -> list[Any] | None:
    """What ``a_k_hat_box`` or ``a_k_hat_ball`` takes [m], rounded inward; None without a region or an option."""
    if not region.holds or region.option is None:
        return None
    pairs = [(Decimal(float(c)), Decimal(float(r))) for c, r in zip(region.centre, region.half, strict=True)]
    if region.shape == "box":
        lower = [float((c - r).quantize(_MICROMETRE, ROUND_CEILING)) for c, r in pairs]
        upper = [float((c + r).quantize(_MICROMETRE, ROUND_FLOOR)) for c, r in pairs]
        return [lower, upper]
    radii = [float(r.quantize(_MICROMETRE, ROUND_FLOOR)) for _, r in pairs]
    return [[float(c) for c, _ in pairs], radii[0] if len(set(radii)) == 1 else radii]


def rank_summary(name: str, region: RankRegion) -> dict[str, Any]:
    """Plain data that JSON can hold."""
    path, loss = region.path, region.loss
    return {
        "graph": name,
        "matrix": region.matrix,
        "parameters": region.parameters,
        "holds": region.holds,
        "radius": region.radius,
        "shape": region.shape,
        "set": [
            {"name": label, "centre": float(c), "half": float(r)}
            for label, c, r in zip(region.names, region.centre, region.half, strict=True)
        ],
        "option": region.option,
        "value": option_value(region),
        "start_inside": region.start_inside,
        "tube": region.tube,
        "asked": region.asked,
        "certified": region.certified,
        "nominal": region.nominal,
        "unit": region.unit,
        "time": region.time,
        "q": region.q.tolist(),
        "fails_at": region.fails_at,
        "path": {
            "poses": len(path.poses),
            "span": path.span,
            "period": path.period,
            "until": region.until,
            "apart": region.line_distance,
        },
        "boxes": region.boxes,
        "field_hash": region.model,
        "loss": None
        if loss is None
        else {
            "kind": loss.kind,
            "time": loss.time,
            "q": loss.q.tolist(),
            "singular": loss.singular,
            "text": loss.text,
        },
    }
