"""Consecutive parts of a column."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, pairwise


def slices(sizes: Iterable[int]) -> list[slice]:
    """One slice for each size, each from where the one before it ends: ``[2, 3]`` gives 0:2 and 2:5."""
    return [slice(first, last) for first, last in pairwise(accumulate(sizes, initial=0))]
