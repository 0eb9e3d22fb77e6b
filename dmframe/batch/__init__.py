"""Many runs of one closed loop with other numbers, and of each its figures alone: RMS, extremes, divergence."""

from dmframe.batch.figures import Figures, Measured, Wanted
from dmframe.batch.measure import Batch, measure

__all__ = ["Batch", "Figures", "Measured", "Wanted", "measure"]
