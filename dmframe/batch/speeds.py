"""How fast the plants of many runs move by themselves, by which their integrator's steps are chosen."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dmframe.simulate.stiffness import fastest


def slope_of(rate: Any) -> Any:
    """(state, p) -> the Jacobian of what flows in the plant with respect to itself, at t = 0; see `Step.rate`."""
    state, p = (ca.SX.sym(name, rate.numel_in(place)) for name, place in (("state", 0), ("p", 2)))
    size = rate.numel_out(0)
    flowing = state[state.numel() - size :]
    slope = ca.jacobian(rate.expand()(state, 0, p), flowing)
    return ca.Function("slope", [state, p], [ca.cse(ca.densify(slope))])


def speeds_of(slope: Any, states: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(N,): `speed_of` at each column of the states with that of p [1/s].

    Those that do not differ in what the slope reads are computed once.
    """
    size, runs = slope.size1_out(0), states.shape[1]
    if not size or not runs:
        return np.zeros(runs)
    read = [np.unique(slope.jac_sparsity(0, place).get_triplet()[1]).astype(int) for place in (0, 1)]
    _, first, which = np.unique(
        np.vstack([states[read[0]], p[read[1]]]), axis=1, return_index=True, return_inverse=True
    )
    found = slope.map(first.size)(states[:, first], p[:, first]).full()
    return np.asarray(fastest(found.reshape(size, first.size, size).transpose(1, 0, 2))[which.ravel()])
