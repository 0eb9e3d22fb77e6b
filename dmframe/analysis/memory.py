"""Delay lines of a discrete-time loop: its transition without the states that only store."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int_]

_UNREAD: Final = 1e-13
"""Singular values below this, relative to the largest coefficient of a reader, count as zero."""


def without_memory(Phi: Array) -> Array:
    r"""Transition without unread stored values: a smaller matrix with the same eigenvalues except some at zero.

    States that copy another, and those that they copy, form delay lines. With :math:`c_d` the inputs of all lines d
    ticks ago, :math:`x` the other states, and :math:`c_0^+` like :math:`x^+`,

    .. math:: x^+ = F x + \sum_d R_d c_d.

    Of the lines, the result keeps :math:`V_d c_d` for each d, with :math:`V_d` orthonormal rows that span those of
    :math:`R_d, R_{d+1}, \ldots`. As :math:`V_{d+1}` are the first rows of :math:`V_d`, these sums are delay lines too.
    Lines that the inputs of other lines read are reduced after these.
    """
    core, heads, reads = _lines(Phi)
    if not len(heads):
        return Phi
    groups = _groups(reads, len(core))
    kept = [reads[d][:, mine] @ V[:m].T for mine, V, sizes in groups for d, m in enumerate(sizes)]
    moved = np.hstack([Phi[np.ix_(np.concatenate([core, heads]), core)], *kept])
    rows, at = [moved[: len(core)]], len(core)
    for mine, V, sizes in groups:
        rows.append(V @ moved[len(core) + mine])
        for size, following in pairwise(sizes):
            rows.append(np.eye(following, moved.shape[1], at))
            at += size
        at += sizes[-1]
    return np.vstack(rows)


def _lines(Phi: Array) -> tuple[Index, Index, Array]:
    """States that are not stored, inputs of lines, and (ticks, states and inputs, lines): coefficients R_d."""
    filled, stored = Phi != 0, np.isin(np.arange(len(Phi)), _memory(Phi))
    source = np.argmax(filled, axis=1)
    copies = stored & (filled.sum(axis=1) == 1) & stored[source]
    head, late, factor = np.arange(len(Phi)), np.zeros(len(Phi), dtype=int), np.ones(len(Phi))
    while len(behind := np.flatnonzero(copies[head])):
        factor[behind] *= Phi[head[behind], source[head[behind]]]
        head[behind] = source[head[behind]]
        late[behind] += 1
    core, heads = np.flatnonzero(~stored), np.flatnonzero(stored & ~copies)
    moving = np.concatenate([core, heads])
    reads = np.zeros((int(np.max(late)) + 1, len(moving), len(heads)))
    for state in np.flatnonzero(stored):
        reads[late[state], :, np.searchsorted(heads, head[state])] += Phi[moving, state] * factor[state]
    return core, heads, reads


def _groups(reads: Array, core: int) -> list[tuple[Index, Array, tuple[int, ...]]]:
    """Lines by group, those first that no other line's input reads; each with V_0 and the numbers of rows of V_d."""
    found, left = list[tuple[Index, Array, tuple[int, ...]]](), np.arange(reads.shape[2])
    known, readers = np.any(reads[:, core:] != 0, axis=0), [_scaled(reads[:, :core], np.eye(core))]
    while len(left):
        mine = left[~np.any(known[np.ix_(left, left)], axis=0)]
        V, sizes = _sums(np.concatenate(readers, axis=1)[:, :, mine])
        found.append((mine, V, sizes))
        readers.append(_scaled(reads[:, core + mine], V))
        left = np.setdiff1d(left, mine)
    return found


def _scaled(reads: Array, V: Array) -> Array:
    """V R_d for each d, relative to the largest coefficient of all R_d."""
    return np.asarray(V @ reads / max(float(np.max(np.abs(reads), initial=0.0)), 1e-300))


def _sums(reads: Array) -> tuple[Array, tuple[int, ...]]:
    """Rows V_0 that span all rows of R_d, and how many of the first ones span those of R_d, R_(d+1), ..."""
    V, sizes = np.zeros((0, reads.shape[2])), list[int]()
    for R in reads[::-1]:
        new = R[np.any(R != 0, axis=1)]
        for _ in range(2):  # twice is enough
            new = new - (new @ V.T) @ V
        _, values, rows = np.linalg.svd(new, full_matrices=False)
        V = np.vstack([V, rows[values > _UNREAD]])
        sizes.append(len(V))
    return V, tuple(sizes[::-1])


def _memory(Phi: Array) -> Index:
    """States that copy another, and those that are copied, without feedback."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    filled = Phi != 0
    copies = np.flatnonzero((filled.sum(axis=1) == 1) & (np.diag(Phi) == 0))
    sources = np.unique(np.argmax(filled[copies], axis=1)) if len(copies) else copies
    store = np.union1d(copies, sources[np.diag(Phi)[sources] == 0])
    # exclude states that feed one another: each must be a strongly connected component of its own
    _, groups = connected_components(csr_array(filled[np.ix_(store, store)]), connection="strong")
    alone = np.bincount(groups)[groups] == 1 if len(store) else np.zeros(0, dtype=bool)
    return np.asarray(store[alone], dtype=int)
