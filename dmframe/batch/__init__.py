"""Batch runner: many runs of one closed loop with different numbers, reduced to figures of merit."""

from dmframe.batch.batch import Batch
from dmframe.batch.figures import Figures, Measured, Wanted
from dmframe.batch.runner import Runner, Runs

__all__ = ["Batch", "Figures", "Measured", "Runner", "Runs", "Wanted"]
