"""Serial robots: read from URDF, made exactly rational, and written as symbolic equations of motion."""
