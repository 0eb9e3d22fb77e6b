"""Pseudo-inertia of a body, which is positive definite exactly if its mass is nowhere negative."""

from __future__ import annotations

from typing import Final

import numpy as np

from dmframe.identification.model import Array

LENGTH: Final = 0.3
"""Unit of lengths in a pseudo-inertia, with which its elements are of similar size [m]."""


def pseudo_inertia(own: Array) -> Array:
    """[[tr(I)/2 - I, m r], [m r', m]] of m, m r, xx, xy, yy, xz, yz, zz, with lengths relative to `LENGTH`."""
    mass, moment, (xx, xy, yy, xz, yz, zz) = own[0], own[1:4] / LENGTH, own[4:] / LENGTH**2
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = np.trace(inertia) / 2 * np.eye(3) - inertia
    return np.block([[second, moment[:, None]], [moment[None], np.array([[mass]])]])
