"""Chunks of a study's runs: rectangles of points and samples, one file of results each.

The size of a chunk is found by timing the first ones (`Sizes`), whose rows are kept. Then all boundaries are fixed
(`Extent`); a study that is extended by more samples only adds chunks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, final

FIRST: Final = 8
"""Runs of the first timed chunk: as many as the widest SIMD batch."""
GROWTH: Final = 16
"""Largest ratio of the runs of a timed chunk to those of the one before."""
LEAST: Final = 0.25
"""Shortest duration of a chunk from which the time of a run is estimated [s]."""
WORK: Final = 2.0
"""Target duration of a chunk [s]."""


@final
@dataclass(frozen=True, order=True)
class Chunk:
    """The samples [first, stop) of the points [point, end)."""

    point: int
    end: int
    first: int
    stop: int

    @property
    def runs(self) -> int:
        """Number of runs."""
        return (self.end - self.point) * (self.stop - self.first)

    def name(self, key: str) -> str:
        """Name of its file without the ending; `key` is the study's."""
        several = f"-{self.end:06}" if self.end - self.point > 1 else ""
        return f"{key[:16]}-p{self.point:06}{several}-s{self.first:09}-{self.stop:09}"

    def __str__(self) -> str:
        points = f"point {self.point}" if self.end - self.point == 1 else f"points {self.point} to {self.end - 1}"
        return f"{points}, samples {self.first} to {self.stop - 1}"


@final
@dataclass(frozen=True)
class Extent:
    """A rectangle of points and samples, divided into equal chunks of `points` by `samples`."""

    point: int
    end: int
    first: int
    stop: int
    points: int
    samples: int

    @property
    def count(self) -> int:
        """Number of chunks."""
        return -(-(self.end - self.point) // self.points) * self._parts

    @property
    def _parts(self) -> int:
        """Division of a point's samples; the remainder is a separate chunk, or lengthens the last one."""
        return max(round((self.stop - self.first) / self.samples), 1)

    @property
    def runs(self) -> int:
        """Number of runs."""
        return (self.end - self.point) * (self.stop - self.first)

    def __iter__(self) -> Iterator[Chunk]:
        """Chunks point by point, since a worker keeps the closed loop of its last points."""
        for point in range(self.point, self.end, self.points):
            end = min(point + self.points, self.end)
            for part in range(self._parts):
                first = self.first + part * self.samples
                yield Chunk(point, end, first, first + self.samples if part < self._parts - 1 else self.stop)


@final
class Sizes:
    """Divides the runs of a study into chunks.

    Parameters
    ----------
    points, samples
        Of the study.
    extents
        Existing chunks.
    each
        Points and samples per chunk; None if the size has not been found yet.
    work
        Target duration of a chunk [s].
    """

    def __init__(
        self,
        points: int,
        samples: int,
        *,
        extents: Sequence[Extent] = (),
        each: tuple[int, int] | None = None,
        work: float = WORK,
    ) -> None:
        self.points, self.samples, self.work = points, samples, work
        self.extents, self.each = list(extents), each
        self._covered = [0] * points
        for extent in extents:
            self._cover(extent)
        self._along, self._size, self._timed = "samples", FIRST, 0
        self._found: int | None = None
        if each is not None:
            self._cut()

    @property
    def whole(self) -> bool:
        """True if every run belongs to a chunk."""
        return min(self._covered) >= self.samples

    def probe(self) -> Extent | None:
        """The next chunk to time, which is added to the extents; None if every run belongs to a chunk."""
        if self.whole:
            return None
        if self._along == "samples" and self._covered[0] >= self.samples:
            self._along, self._size, self._timed = "points", self._fewest, 0
        if self._along == "samples":
            first = self._covered[0]
            stop = min(first + self._size, self.samples)
            extent = Extent(0, 1, first, stop, 1, stop - first)
        else:
            point, end = next(self._bands())
            end, first = min(end, point + self._size), self._covered[point]
            extent = Extent(point, end, first, self.samples, end - point, self.samples - first)
        self._add(extent)
        return extent

    def timed(self, extent: Extent, seconds: float) -> None:
        """Report the duration of the last `probe` [s]."""
        count = extent.samples if self._along == "samples" else extent.points
        fitting = max(int(self.work * count / max(seconds, 1e-9)), 1)
        if self._along == "samples" and seconds < self.work * count:  # includes the preparation of a new worker
            fitting = max(fitting, FIRST)
        if self._timed and seconds >= LEAST:  # the first run includes compilation
            self._settle(fitting)
        else:
            self._size = min(fitting, count * GROWTH)
        self._timed += 1

    @property
    def _fewest(self) -> int:
        """Points that fill a SIMD batch when each has few samples."""
        return max(FIRST // self.samples, 1)

    def _settle(self, fitting: int) -> None:
        if self._along == "points":
            whole = fitting // self._fewest * self._fewest
            few = self._fewest if fitting > 1 else 1  # a batch of one takes as long as a full one
            self.each = (whole or few, self._found or self.samples)
        elif fitting >= self.samples and self.points > 1:  # several points per chunk: time how many
            self._found = fitting
            self._rest_of_first()
            self._along, self._size, self._timed = "points", self._fewest, 0
            return
        else:
            self.each = (1, fitting)
        self._cut()

    def _rest_of_first(self) -> None:
        if (first := self._covered[0]) < self.samples:
            self._add(Extent(0, 1, first, self.samples, 1, self.samples - first))

    def _cut(self) -> None:
        """Divide all remaining runs into chunks of the size that was found."""
        assert self.each is not None  # checked by the callers
        points, samples = self.each
        for point, end in list(self._bands()):
            first = self._covered[point]
            size = _even(self.samples - first, samples)
            whole = size == self.samples - first
            self._add(Extent(point, end, first, self.samples, min(points, end - point) if whole else 1, size))

    def _bands(self) -> Iterator[tuple[int, int]]:
        """Ranges of points with equally many samples in chunks, if some samples are not."""
        point = 0
        while point < self.points:
            end = point + 1
            while end < self.points and self._covered[end] == self._covered[point]:
                end += 1
            if self._covered[point] < self.samples:
                yield point, end
            point = end

    def _add(self, extent: Extent) -> None:
        self.extents.append(extent)
        self._cover(extent)

    def _cover(self, extent: Extent) -> None:
        for point in range(extent.point, extent.end):
            self._covered[point] = extent.stop


def _even(length: int, most: int) -> int:
    """Size of equal parts of `length`, about `most` each; a multiple of `FIRST` if possible."""
    if length <= most:
        return length
    size = -(-length // -(-length // most))
    return size if size < FIRST else min(-(-size // FIRST) * FIRST, length)
