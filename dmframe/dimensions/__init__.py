"""Checks that the units of equations agree: each quantity's powers of the base units, carried through every operation.

A parameter, an input and a state have the units that they declare. Dimensions are then one more table of rules on a
function's instructions (`dmframe.program`): both terms of a sum have the same powers, a product adds them, a sine takes
an angle. `unit_faults` does this for all that a block states: outputs, rates, next values, starts, certificate,
conditions. A fault names the first operation that disagrees, and the parameter whose unit would make it agree, if there
is one.

What is not declared is inferred. A gain whose unit depends on the error that drives it, and an element of an array
whose elements differ, such as the inertial parameters, have *unknown* powers; each sum is a linear equation for them.

The radian is a base unit, by one rule: **an angle on a lever arm is a length, a force on it a torque, and the arm has
metres per radian; a sine, a mass and a plain number say nothing of radians**. In detail:

- The m of N m is that of an arm, so that a torque is an energy per angle: 1 N m = 1 J/rad. A stiffness in N m/rad and
  a torque in N m differ by one radian, and a Jacobian in m/rad maps velocities to m/s and forces to N m.
- A sine loses the radian: x = l cos q, in m, has the slope -l sin q, in m/rad. A mass on an arm has the moment of
  inertia m l^2, and SI calls the radian the number one. So the power of rad is not known in what is made of a sine of
  an angle, of a quantity with kg in its unit, or of a signal that is declared a plain number. It is known again of a
  port that declares it.
- In a block that uses the robot's functions of a pose the power of rad is not compared: they hold lengths in m.
- A number that is written out in an equation is dimensionless; it may be one of radians. Zero is of any unit, and so
  are numbers up to 2^-100, and from 10^9 on, which stand for zero and for no limit.

A robot with a prismatic joint has coordinates in rad and in m; of its graphs the powers of m and rad are not checked.
"""

from dmframe.dimensions.check import unit_faults

__all__ = ["unit_faults"]
