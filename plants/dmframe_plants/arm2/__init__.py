"""A planar arm with two joints, and its equations of motion in closed form."""
