"""A planar arm with three joints, and its equations of motion in closed form."""
