"""Dimensional analysis of blocks: the powers of the base units of each quantity, through every operation.

Parameters, inputs and states have their declared units. A table of rules then gives the dimension of each instruction
of a function (`dmframe.program`): the terms of a sum have equal powers, a product adds them, the argument of a sine is
an angle. `unit_faults` checks all expressions of a block: outputs, rates, next values, initial values, certificate,
conditions. A fault names the first inconsistent operation, and the parameter whose unit would resolve it, if there is
one.

Dimensions that are not declared are inferred. A gain whose unit depends on the error that drives it, and an element of
an array with different units, such as the inertial parameters, have *unknown* powers; each sum is a linear equation
for them.

The radian is a base unit, by one rule: **an angle times a lever arm is a length, a force times an arm is a torque, and
an arm has the unit m/rad; the power of rad is undetermined after a sine, for a mass, and for a plain number**. In
detail:

- The m of N m is that of an arm, so that a torque is an energy per angle: 1 N m = 1 J/rad. A stiffness in N m/rad and
  a torque in N m differ by one radian, and a Jacobian in m/rad maps velocities to m/s and forces to N m.
- A sine loses the radian: x = l cos q, in m, has the slope -l sin q, in m/rad. A mass on an arm has the moment of
  inertia m l^2, and in SI the radian is the number one. The power of rad is therefore undetermined in expressions of
  the sine of an angle, of a quantity with kg in its unit, or of a signal declared as a plain number. A port that
  declares its unit determines it again.
- In a block that uses the robot's functions of a pose the power of rad is not compared: they contain lengths in m.
- A literal number in an equation is dimensionless; it may be in radians. Zero has any unit. So do numbers up to
  2^-100, which replace zero, and from 10^9 on, which mean that there is no limit.

A robot with a prismatic joint has coordinates in rad and in m; for its graphs the powers of m and rad are not checked.
"""

from dmframe.dimensions.check import unit_faults

__all__ = ["unit_faults"]
