"""Identification of a robot's servo, friction and inertia from a log of commands and positions."""
