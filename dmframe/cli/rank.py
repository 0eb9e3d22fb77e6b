"""``dmframe analyse --rank``: the kinematic parameters with which a Jacobian keeps its rank along the path."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from dmframe.analysis.rank_region import RankRegion, rank_region
from dmframe.analysis.rank_report import KEPT, MODEL, PROVED, option_value, rank_summary
from dmframe.cli.streams import tell
from dmframe.columns import columns
from dmframe.diagram.fingerprint import short
from dmframe.graph import Graph
from dmframe.graph.progress import telling
from dmframe.units import plain

NO_REGION = 1


def rank_of(graph: Graph, *, tube: float, as_json: bool, **options: Any) -> int:
    """Find the region of one graph and print it; returns the exit status."""
    with telling(f"{graph.name}: rank", quiet=as_json) as progress:
        region = rank_region(
            graph.diagram, graph.experiment.start, duration=graph.duration, tube=tube, progress=progress, **options
        )
    if as_json:
        told = {**rank_summary(graph.name, region), "field_hash": graph.diagram.fingerprint}
        tell(json.dumps(told, indent=2))
    else:
        tell(page(graph, region))
    return 0 if region.holds else NO_REGION


def page(graph: Graph, region: RankRegion) -> str:
    """A region for the terminal."""
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
        columns(_facts(region, graph.diagram.fingerprint)),
        "",
        columns(_set(region)),
        "",
        *(f"  {line}" for line in textwrap.wrap(f"{PROVED} {MODEL if region.option is None else KEPT}", 110)),
    ]
    return "\n".join([*parts, *_use(region)])


def _facts(region: RankRegion, field_hash: str) -> Iterator[tuple[str, str]]:
    path = region.path
    yield "radius", plain(region.radius, "m")
    yield (
        "fails at",
        f"{plain(region.fails_at, 'm')}: parameters with a smaller singular value are known"
        if region.fails_at is not None
        else "not known: no parameters were found that refute a larger one",
    )
    yield "least singular value", f"{region.certified:.4g} {region.unit} certified, {region.asked:.4g} asked for"
    yield "", f"{region.nominal:.4g} {region.unit} on the path itself, in the middle of the {region.shape}"
    yield "tightest", f"t = {region.time:.4g} s, q = [{', '.join(f'{angle:.4g}' for angle in region.q)}]"
    covered = f"over {path.span:.4g} s" if path.span else "from the start to where the path rests"
    yield "joint path", f"{len(path.poses)} poses {covered}{'; it repeats itself' if path.span and path.period else ''}"
    yield "proved over", f"{region.boxes} boxes of poses, of the model {short(field_hash)}"


def _set(region: RankRegion) -> Iterator[tuple[str, str, str]]:
    yield "translation", "middle", "half-width" if region.shape == "box" else "half axis"
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
            f"The estimate starts outside: a run with this {region.shape} is refused. Begin nearer, or take "
            "--centre start, and then see that the true value lies inside.",
            110,
        )
