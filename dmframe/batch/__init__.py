"""Batch runner: many runs of one closed loop with different numbers, reduced to figures of merit."""
