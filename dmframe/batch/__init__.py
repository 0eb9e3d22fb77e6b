"""Many runs of one closed loop with other numbers, and of each its figures alone: RMS, extremes, divergence."""

from dmframe.batch.batch import Batch, measure
from dmframe.batch.figures import Figures, Measured, Wanted

__all__ = ["Batch", "Figures", "Measured", "Wanted", "measure"]
