"""What a study would run, and how long that would take here."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

from dmframe.errors import DmframeError
from dmframe.study.chunks import Extent, Sizes
from dmframe.study.computed import Computable, Failed, compute, cores
from dmframe.study.disk import kept_in
from dmframe.study.lock import difference, read_lock


@final
@dataclass(frozen=True)
class Foreseen:
    """A study before it runs.

    Parameters
    ----------
    kept
        Runs whose rows are there.
    chunks, each
        How many are left, and the runs of the largest.
    rate
        Runs a second, of one worker here.
    seconds
        For what is left, on `workers` of them.
    """

    points: int
    samples: int
    runs: int
    kept: int
    chunks: int
    each: int
    rate: float
    workers: int
    seconds: float

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def foreseen(study: Computable, place: Path, workers: int | None = None) -> Foreseen:
    """Cut a study into chunks without running it; some runs are timed, where its folder tells no times.

    Raises
    ------
    DmframeError
        The runs that are timed cannot be made.
    """
    lock = read_lock(place)
    mine = lock is not None and not difference(lock, study.identity)
    kept = kept_in(place) if mine else {}
    extents = [Extent(*numbers) for numbers in lock["extents"]] if lock and mine else []
    each = tuple(lock["each"]) if lock and mine and lock["each"] else None
    sizes = Sizes(len(study.points), study.samples, extents=extents, each=each)
    count, seconds = sum(line.rows for line in kept.values()), sum(line.seconds for line in kept.values())
    rate = count / seconds if seconds and each else _cut(study, sizes)
    left = [chunk for extent in sizes.extents for chunk in extent if f"{chunk.name(study.key)}.parquet" not in kept]
    many = workers or cores()
    return Foreseen(
        points=len(study.points),
        samples=study.samples,
        runs=study.runs,
        kept=count,
        chunks=len(left),
        each=max((chunk.runs for chunk in left), default=0),
        rate=rate,
        workers=many,
        seconds=sum(chunk.runs for chunk in left) / rate / min(many, max(len(left), 1)),
    )


def _cut(study: Computable, sizes: Sizes) -> float:
    """Cut all, by timing chunks in this process; returns how many runs it makes in a second."""
    rate = 1.0
    while (probe := sizes.probe()) is not None:
        (chunk,) = probe
        found = compute(study, chunk)
        if isinstance(found, Failed):
            raise DmframeError(f"{chunk}: {found.text}")
        sizes.timed(probe, found.seconds)
        rate = chunk.runs / max(found.seconds, 1e-9)
    return rate
