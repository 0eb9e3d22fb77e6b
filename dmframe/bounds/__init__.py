"""Bounds in numbers on the tracking error of a proved loop."""

from __future__ import annotations

from dmframe.bounds.mean_square import error_bounds

__all__ = ["error_bounds"]
