"""Sampling designs: points of the unit cube; a sample's numbers do not depend on which others are requested."""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, final

import numpy as np

from dmframe.common.errors import ValueFault

Method = Literal["random", "latin_hypercube", "sobol"]

DIGITS: Final = 12
"""Significant decimal digits of a drawn number: the last bits of a logarithm differ between machines."""
_BITS: Final = 52
_SOBOL_BITS: Final = 30  # SciPy looks no further ahead with more than 32


@final
@dataclass(frozen=True)
class Design:
    """The samples of a study, as points in the open unit cube.

    Parameters
    ----------
    method
        ``random``: independent draws; ``sobol``: a scrambled Sobol sequence; ``latin_hypercube``: `samples` points.
    seed
        Of the random numbers.
    names
        Of the dimensions; with ``random``, the numbers of one do not depend on the others.
    samples
        Number of samples.
    """

    method: Method
    seed: int
    names: tuple[str, ...]
    samples: int

    @property
    def extends(self) -> bool:
        """True if more samples leave the existing ones unchanged."""
        return self.method != "latin_hypercube" or not self.names

    def __post_init__(self) -> None:
        if self.method == "latin_hypercube" and self.samples * len(self.names) > MOST_LATIN:
            raise ValueFault(
                f"sample.runs: expected at most {MOST_LATIN // len(self.names)} with latin_hypercube, which is "
                f"computed as a whole, found {self.samples}; use sobol or random",
                path=("sample", "runs"),
            )

    def points(self, first: int, stop: int) -> np.ndarray:
        """(stop - first, dimensions), numbers strictly between 0 and 1.

        Raises
        ------
        ValueFault
            Samples outside of the design.
        """
        if not 0 <= first <= stop <= self.samples:
            raise ValueFault(f"samples: expected some from 0 to {self.samples}, found {first} to {stop}")
        if not self.names or first == stop:
            return np.zeros((stop - first, len(self.names)))
        if self.method == "random":
            return np.stack([_stream(self.seed, name, first, stop) for name in self.names], axis=1)
        if self.method == "sobol":
            return _sobol(self.seed, len(self.names), first, stop)
        return _latin(self.seed, len(self.names), self.samples)[first:stop]


MOST_LATIN: Final = 10**7
"""Numbers of a Latin hypercube, which is computed as a whole in memory."""


def _stream(seed: int, name: str, first: int, stop: int) -> np.ndarray:
    words = np.frombuffer(hashlib.sha256(name.encode()).digest(), dtype=np.uint32).tolist()
    generator = np.random.PCG64(np.random.SeedSequence([seed, *words])).advance(first)
    raw = generator.random_raw(stop - first)  # NumPy guarantees these bits across versions
    return np.asarray(((raw >> np.uint64(64 - _BITS)) + 0.5) * 2.0**-_BITS)


def _sobol(seed: int, dimensions: int, first: int, stop: int) -> np.ndarray:
    from scipy.stats import qmc

    engine = qmc.Sobol(dimensions, scramble=True, bits=_SOBOL_BITS, rng=np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about a number of samples that is not a power of two
        if first:
            engine.fast_forward(first)
        return np.asarray(engine.random(stop - first)) + 2.0 ** -(_SOBOL_BITS + 1)


@lru_cache(maxsize=2)
def _latin(seed: int, dimensions: int, samples: int) -> np.ndarray:
    from scipy.stats import qmc

    found = np.asarray(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(samples))
    return found.clip(2.0**-_BITS, 1 - 2.0**-_BITS)


@final
@dataclass(frozen=True)
class Spread:
    """A distribution in a parameter's own unit.

    Parameters
    ----------
    kind
        ``uniform`` and ``log`` lie between `a` and `b`; ``normal`` has mean `a` and standard deviation `b`.
    lower, upper
        Bounds; infinite without one.
    """

    kind: Literal["uniform", "log", "normal"]
    a: float
    b: float
    lower: float
    upper: float

    def at(self, points: np.ndarray) -> np.ndarray:
        """Quantiles at points between 0 and 1, rounded to `DIGITS`."""
        drawn = map(self._quantile, points.tolist())
        rounded = (float(f"{value:.{DIGITS - 1}e}") for value in drawn)
        return np.array([min(max(value, self.lower), self.upper) for value in rounded])

    def _quantile(self, point: float) -> float:
        if self.kind == "uniform":
            return self.a + (self.b - self.a) * point
        if self.kind == "log":
            return math.exp(math.log(self.a) + (math.log(self.b) - math.log(self.a)) * point)
        return self.a + self.b * _normal((self.lower - self.a) / self.b, (self.upper - self.a) / self.b, point)


def _normal(lower: float, upper: float, point: float) -> float:
    """Quantile of the standard normal distribution truncated to an interval."""
    if lower > 0:  # by symmetry: probabilities in the upper tail are all near 1
        return -_normal(-upper, -lower, 1 - point)
    from scipy.special import ndtr, ndtri

    below, above = float(ndtr(lower)), float(ndtr(upper))
    return float(ndtri(below + (above - below) * point))


def columns_of(name: str, elements: int | None) -> Sequence[str]:
    """Columns of a varied quantity: one, or one per element."""
    return [name] if elements is None else [f"{name}[{k}]" for k in range(elements)]
