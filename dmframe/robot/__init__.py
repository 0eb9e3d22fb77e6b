"""Serial robots: URDF reader, exact rational parameters, and symbolic equations of motion."""
