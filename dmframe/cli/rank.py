"""``dmframe analyse --rank``: kinematic parameters for which a Jacobian keeps its rank along the path."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from dmframe.analysis.rank_region import RankRegion, rank_region
from dmframe.analysis.rank_report import option_value, proved, rank_summary
from dmframe.cli.streams import tell
from dmframe.common.columns import columns
from dmframe.common.units import plain
from dmframe.graph.graph import Graph
from dmframe.graph.progress import progress_line

NO_REGION = 1


def rank_of(graph: Graph, *, tube: float, as_json: bool, **options: Any) -> int:
    """Compute and print the region of a graph; returns the exit status."""
    with progress_line(f"{graph.name}: rank", quiet=as_json) as progress:
        region = rank_region(
            graph.diagram, graph.start, duration=graph.duration, tube=tube, progress=progress, **options
        )
    tell(json.dumps(rank_summary(graph.name, region), indent=2) if as_json else page(graph, region))
    return 0 if region.holds else NO_REGION


def page(graph: Graph, region: RankRegion) -> str:
    """Terminal page of a region."""
    parts = [f"{graph.name}: {graph.title}".rstrip(": "), ""]
    if region.loss is not None:
        return "\n".join([*parts, f"no region: {region.loss.text}"])
    J = region.matrix
    parts += [
        *textwrap.wrap(
            f"{J} {J}' >= c^2 I with c = {region.certified:.4g} {region.unit}, for every {region.parameters} in the "
            f"{region.shape} below and every q within {region.tube:.4g} rad, in each joint, of the joint path",
            110,
        ),
        "",
        columns(_facts(region)),
        "",
        columns(_set(region)),
        "",
        *(f"  {line}" for line in textwrap.wrap(proved(region), 110)),
    ]
    return "\n".join([*parts, *_use(region)])


def _facts(region: RankRegion) -> Iterator[tuple[str, str]]:
    path = region.path
    yield "radius", plain(region.radius, "m")
    yield (
        "fails at",
        f"{plain(region.fails_at, 'm')}: there are parameters with a smaller singular value"
        if region.fails_at is not None
        else "unknown: no parameters found that refute a larger one",
    )
    yield "least singular value", f"{region.certified:.4g} {region.unit} certified, {region.asked:.4g} required"
    yield "", f"{region.nominal:.4g} {region.unit} on the path, at the centre of the {region.shape}"
    yield "tightest", f"t = {region.time:.4g} s, q = [{', '.join(f'{angle:.4g}' for angle in region.q)}]"
    covered = f"over {path.span:.4g} s" if path.span else "from the start to the end point"
    again = f"; periodic, proved up to {region.until:.6g} s" if path.span and path.period else ""
    yield "joint path", f"{len(path.poses)} poses {covered}{again}"
    yield "proved over", f"{region.boxes} boxes of poses, model {region.model[:12]}"


def _set(region: RankRegion) -> Iterator[tuple[str, str, str]]:
    yield "translation", "centre", "half-width" if region.shape == "box" else "half axis"
    for name, centre, half in zip(region.names, region.centre, region.half, strict=True):
        yield name, f"{centre:.6g} m", f"{half:.4g} m"


def _use(region: RankRegion) -> Iterator[str]:
    if region.option is None:
        return
    block, _, option = region.option.partition(".")
    yield from ("", "to use it, under blocks:", f"  {block}:", f"    {option}: {option_value(region)}")
    if not region.start_inside:
        yield ""
        yield from textwrap.wrap(
            f"The initial estimate is outside: a run with this {region.shape} is rejected. Start closer, or use "
            "--centre start and make sure that the true value is inside.",
            110,
        )
