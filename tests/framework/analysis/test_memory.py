"""A transition matrix without its delay lines: the same eigenvalues from a matrix of the size of what is read."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dmframe.analysis.memory import without_memory

Array = NDArray[np.float64]
N, LINES, TICKS = 5, 6, 9
"""States, delay lines, and copies in each."""


def remembering(rng: np.random.Generator) -> Array:
    """A loop that reads one sum of its lines at each sample, and two lines of four samples with sums of these lines."""
    first = N + LINES * (TICKS + 1)
    Phi = np.zeros((first + 8, first + 8))
    Phi[:N, :N] = 0.3 * rng.standard_normal((N, N))
    Phi[N : N + LINES, :N] = rng.standard_normal((LINES, N))
    for at in range(N + LINES, first, LINES):
        Phi[at : at + LINES, at - LINES : at] = rng.choice([1.0, -1.0, 0.5]) * np.eye(LINES)
    Phi[:N, N:first] = 0.02 * np.tile(np.outer(np.ones(N), rng.standard_normal(LINES)), TICKS + 1)
    Phi[first : first + 2, N + LINES : N + 2 * LINES] = rng.standard_normal((2, LINES))
    Phi[first + 2 :, first : first + 6] = np.eye(6)
    Phi[:N, first + 4 :] = 0.05 * rng.standard_normal((N, 4))
    return Phi


def by_krylov(Phi: Array, store: Array) -> Array:
    """Reference: the rows of stored values that the other states read at some sample, found sample by sample."""
    core = np.setdiff1d(np.arange(len(Phi)), store)
    M, reads, kept = Phi[np.ix_(store, store)], Phi[np.ix_(core, store)], np.zeros((0, len(store)))
    new = reads
    while len(new):
        new = new - (new @ kept.T) @ kept
        new = new - (new @ kept.T) @ kept
        _, values, rows = np.linalg.svd(new, full_matrices=False)
        rows = rows[values > 1e-13]
        kept, new = np.vstack([kept, rows]), rows @ M
    upper = np.hstack([Phi[np.ix_(core, core)], reads @ kept.T])
    return np.vstack([upper, np.hstack([kept @ Phi[np.ix_(store, core)], kept @ M @ kept.T])])


def distance(found: Array, expected: Array, least: float = 0.3) -> float:
    """Largest distance of an eigenvalue of at least this modulus from the nearest of the other matrix, both ways."""
    a, b = np.linalg.eigvals(found), np.linalg.eigvals(expected)
    gaps = np.abs(a[:, None] - b[None, :])
    return float(max(np.max(gaps.min(1)[np.abs(a) > least]), np.max(gaps.min(0)[np.abs(b) > least])))


@pytest.mark.parametrize("seed", range(4))
def test_eigenvalues_are_those_of_the_whole_and_of_the_search_tick_by_tick(seed: int) -> None:
    Phi = remembering(np.random.default_rng(seed))
    found, expected = without_memory(Phi), by_krylov(Phi, np.arange(N, len(Phi)))
    assert len(found) < len(Phi) / 2
    assert distance(found, expected) < 1e-10
    order = np.random.default_rng(seed).permutation(len(Phi))
    assert distance(without_memory(Phi[np.ix_(order, order)]), expected) < 1e-10
    for power in range(1, 6):  # traces of powers: independent of any eigenvalue solver, and of eigenvalues at zero
        traces = [float(np.trace(np.linalg.matrix_power(matrix, power))) for matrix in (found, Phi)]
        assert traces[0] == pytest.approx(traces[1], rel=1e-9, abs=1e-12)


def test_a_sum_that_is_read_late_is_kept_as_long_as_it_is_read() -> None:
    Phi = np.zeros((8, 8))
    Phi[0, [0, 1, 7]] = 0.5, 1.0, 1e-6
    Phi[[1, 2], 0] = 1.0
    Phi[[3, 4, 5, 6, 7], [1, 2, 3, 4, 5]] = 1.0  # two lines, of 4 and 3 states; the second is never read
    found = without_memory(Phi)
    assert len(found) == 1 + 4
    assert distance(found, Phi) < 1e-9


def test_a_transition_that_stores_nothing_stays() -> None:
    Phi = np.random.default_rng(0).standard_normal((6, 6))
    assert without_memory(Phi) is Phi


def test_states_that_copy_one_another_in_a_ring_are_no_memory() -> None:
    Phi = np.roll(np.eye(4), 1, axis=0)
    assert distance(without_memory(Phi), Phi) < 1e-12
