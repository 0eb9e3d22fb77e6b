"""Division of runs into chunks: each run once, in chunks of some seconds, and never repeated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import pytest

from dmframe.study.chunks import WORK, Chunk, Extent, Sizes

Seconds = Callable[[Extent], float]


def cut(sizes: Sizes, seconds: Seconds) -> Sizes:
    while (probe := sizes.probe()) is not None:
        sizes.timed(probe, seconds(probe))
    return sizes


def chunks(sizes: Sizes) -> list[Chunk]:
    return [chunk for extent in sizes.extents for chunk in extent]


def runs(found: list[Chunk]) -> Counter[tuple[int, int]]:
    return Counter((p, s) for c in found for p in range(c.point, c.end) for s in range(c.first, c.stop))


def of(run: float, point: float = 0.0, first: float = 3.0) -> Seconds:
    """A model of the time: per run, per point, and for the first compilation."""
    count = 0

    def seconds(extent: Extent) -> float:
        nonlocal count
        count += 1
        return extent.runs * run + (extent.end - extent.point) * point + (first if count == 1 else 0)

    return seconds


@pytest.mark.parametrize(("points", "samples"), [(1, 1), (1, 7), (1, 5000), (4, 1000), (700, 1), (90, 13), (3, 8)])
@pytest.mark.parametrize("run", [1e-4, 0.03, 40.0])
def test_every_run_is_in_one_chunk(points: int, samples: int, run: float) -> None:
    sizes = cut(Sizes(points, samples), of(run))
    assert sizes.whole
    assert runs(chunks(sizes)) == {(p, s): 1 for p in range(points) for s in range(samples)}
    assert sum(extent.count for extent in sizes.extents) == len(chunks(sizes))


@pytest.mark.parametrize("run", [1e-4, 1e-3, 0.02, 0.3])
def test_a_chunk_takes_some_seconds_whatever_a_run_takes(run: float) -> None:
    found = chunks(cut(Sizes(2, 100_000), of(run)))
    times = sorted(chunk.runs * run for chunk in found)
    assert times[len(times) // 2] == pytest.approx(WORK, rel=0.5)
    assert times[-1] < 1.6 * WORK


def test_runs_slower_than_a_chunk_go_one_by_one() -> None:
    assert {chunk.runs for chunk in chunks(cut(Sizes(1, 50), of(9.0)))[2:]} == {1}


def test_many_points_of_few_samples_share_a_chunk() -> None:
    found = chunks(cut(Sizes(10_000, 2), of(1e-4, point=0.01)))
    assert len(found) < 120


def test_a_study_that_grows_keeps_its_chunks() -> None:
    small = cut(Sizes(3, 1000), of(0.01))
    large = cut(Sizes(3, 2500, extents=small.extents, each=small.each), of(0.01))
    assert chunks(large)[: len(chunks(small))] == chunks(small)
    assert runs(chunks(large)) == {(p, s): 1 for p in range(3) for s in range(2500)}


@pytest.mark.parametrize("after", range(6))
@pytest.mark.parametrize("points", [1, 40])
def test_a_process_that_ends_while_chunks_are_timed_loses_none_of_them(after: int, points: int) -> None:
    before, seconds = Sizes(points, 300), of(1e-3)
    for _ in range(after):
        if (probe := before.probe()) is not None:
            before.timed(probe, seconds(probe))
    again = cut(Sizes(points, 300, extents=before.extents, each=before.each), of(1e-3))
    assert chunks(again)[: len(chunks(before))] == chunks(before)
    assert runs(chunks(again)) == {(p, s): 1 for p in range(points) for s in range(300)}


def test_chunk_names_are_unique() -> None:
    found = chunks(cut(Sizes(50, 40), of(1e-3)))
    assert len({chunk.name("ab" * 32) for chunk in found}) == len(found)
    assert Chunk(3, 4, 8, 16).name("ab" * 32) != Chunk(3, 4, 8, 16).name("cd" * 32)
    assert str(Chunk(3, 4, 8, 16)) == "point 3, samples 8 to 15"
    assert str(Chunk(3, 6, 0, 2)) == "points 3 to 5, samples 0 to 1"
