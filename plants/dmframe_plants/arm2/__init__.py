"""A planar arm with two joints, and its equations of motion as a textbook writes them."""
