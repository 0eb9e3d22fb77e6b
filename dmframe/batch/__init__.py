"""Many runs of one closed loop with other numbers, and of each its figures alone: RMS, extremes, divergence."""

from dmframe.batch.figures import Figures, Measured
from dmframe.batch.measure import measure

__all__ = ["Figures", "Measured", "measure"]
