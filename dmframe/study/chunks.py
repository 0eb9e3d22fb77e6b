"""How the runs of a study are cut into chunks: by the time that they take, and then once and for all.

A chunk is a rectangle of points and samples, and one file of results. Its size is found by timing some first chunks
(`Sizes`), which are results as all others are; then all boundaries are fixed (`Extent`), and a study of more samples
only adds chunks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, final

FIRST: Final = 8
"""Runs of the first chunk that is timed: as many as the widest machine advances at once."""
GROWTH: Final = 16
"""A chunk that is timed has at most so many times the runs of the one before it."""
LEAST: Final = 0.25
"""A chunk of less time says little about the time of a run [s]."""
WORK: Final = 2.0
"""What a chunk should take [s]."""


@final
@dataclass(frozen=True, order=True)
class Chunk:
    """The samples `first` to `stop` of the points `point` to `end`; `stop` and `end` are not among them."""

    point: int
    end: int
    first: int
    stop: int

    @property
    def runs(self) -> int:
        """How many."""
        return (self.end - self.point) * (self.stop - self.first)

    def name(self, key: str) -> str:
        """Of its file, without the ending; `key` is the study's."""
        several = f"-{self.end:06}" if self.end - self.point > 1 else ""
        return f"{key[:16]}-p{self.point:06}{several}-s{self.first:09}-{self.stop:09}"

    def __str__(self) -> str:
        points = f"point {self.point}" if self.end - self.point == 1 else f"points {self.point} to {self.end - 1}"
        return f"{points}, samples {self.first} to {self.stop - 1}"


@final
@dataclass(frozen=True)
class Extent:
    """A rectangle of points and samples that is cut into equal chunks, `points` by `samples` each."""

    point: int
    end: int
    first: int
    stop: int
    points: int
    samples: int

    @property
    def count(self) -> int:
        """How many chunks."""
        return -(-(self.end - self.point) // self.points) * self._parts

    @property
    def _parts(self) -> int:
        """Of a point's samples; what is left over is a part of its own, or makes the last one longer."""
        return max(round((self.stop - self.first) / self.samples), 1)

    @property
    def runs(self) -> int:
        """How many runs."""
        return (self.end - self.point) * (self.stop - self.first)

    def __iter__(self) -> Iterator[Chunk]:
        """Point by point: a worker has prepared the diagram of a point that it has met."""
        for point in range(self.point, self.end, self.points):
            end = min(point + self.points, self.end)
            for part in range(self._parts):
                first = self.first + part * self.samples
                yield Chunk(point, end, first, first + self.samples if part < self._parts - 1 else self.stop)


@final
class Sizes:
    """Cuts the runs of a study into chunks.

    Parameters
    ----------
    points, samples
        Of the study.
    extents
        What was cut before.
    each
        Points and samples a chunk, as found before; None where that is not known yet.
    work
        What a chunk should take [s].
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
        """True where all runs are cut."""
        return min(self._covered) >= self.samples

    def probe(self) -> Extent | None:
        """The next chunk that is to be timed, from now on one of the study; None where all is cut."""
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
        """What the last `probe` took."""
        count = extent.samples if self._along == "samples" else extent.points
        fitting = max(int(self.work * count / max(seconds, 1e-9)), 1)
        if self._along == "samples" and seconds < self.work * count:  # a worker that has just begun prepares, too
            fitting = max(fitting, FIRST)
        if self._timed and seconds >= LEAST:  # the first of all compiles, too
            self._settle(fitting)
        else:
            self._size = min(fitting, count * GROWTH)
        self._timed += 1

    @property
    def _fewest(self) -> int:
        """Points of few samples that a machine advances at once."""
        return max(FIRST // self.samples, 1)

    def _settle(self, fitting: int) -> None:
        if self._along == "points":
            whole = fitting // self._fewest * self._fewest
            few = self._fewest if fitting > 1 else 1  # a batch of one takes as long as a full one
            self.each = (whole or few, self._found or self.samples)
        elif fitting >= self.samples and self.points > 1:  # several points make a chunk: how many, is timed next
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
        """Cut all the rest into chunks of the size that was found."""
        assert self.each is not None  # the callers looked
        points, samples = self.each
        for point, end in list(self._bands()):
            first = self._covered[point]
            size = _even(self.samples - first, samples)
            whole = size == self.samples - first
            self._add(Extent(point, end, first, self.samples, min(points, end - point) if whole else 1, size))

    def _bands(self) -> Iterator[tuple[int, int]]:
        """Points side by side of which as many samples are cut, where some are not."""
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
    """The size of equal parts of `length`, about `most` each; a multiple of `FIRST` where it can be."""
    if length <= most:
        return length
    size = -(-length // -(-length // most))
    return size if size < FIRST else min(-(-size // FIRST) * FIRST, length)
