"""A pendulum, and its equation of motion."""
