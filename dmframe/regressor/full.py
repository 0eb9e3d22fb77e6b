"""The full regressor: a column for each dynamic parameter."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, final

import casadi as ca

from dmframe.exact import Tape, Trial
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters, Part
from dmframe.robot.symbolic import SymbolicRobot

SIGNALS: Final = ("q", "dq", "dq_ref", "ddq_ref")
KINEMATIC_SIGNALS: Final = ("q", "psi")


@final
@dataclass(frozen=True, eq=False)
class FullRegressor:
    """Y_d (n, p) as a function of q, dq, dq_ref, ddq_ref and then of the robot's constants.

    `values` are those of the constants; `a_k` is the place of the translations among them.
    """

    function: ca.Function
    parameters: DynamicParameters
    values: tuple[tuple[Fraction, ...], ...]
    a_k: int

    @property
    def n(self) -> int:
        """The number of joints."""
        return int(self.function.size1_out(0))


def full_regressor(chain: SerialChain, friction: Collection[str] = ()) -> FullRegressor:
    r"""The Slotine-Li regressor of :math:`(M + I_r)\ddot q_r + C\dot q_r + g + B\dot q_r + D\varphi(\dot q_r)`, (5).

    q_r-dot is `dq_ref`. Columns of the joints: rotors diag(ddq_ref), friction diag(dq_ref) and diag(phi(dq_ref)), phi
    the robot's smooth sign.
    """
    parameters, robot = DynamicParameters(chain, friction), SymbolicRobot(chain)
    signals = [ca.SX.sym(name, chain.n) for name in SIGNALS]
    columns: dict[Part, Any] = {
        "inertial": robot.regressor(*signals),
        "rotor": ca.diag(signals[3]),
        "viscous": ca.diag(signals[2]),
        "coulomb": ca.diag(robot.coulomb(signals[2])),
    }
    symbols = [constant.symbol for constant in robot.constants]
    place = next(i for i, constant in enumerate(robot.constants) if constant.name.endswith(".a_k"))
    function = ca.Function("Y_d", [*signals, *symbols], [ca.densify(ca.horzcat(*parameters.in_order(columns)))])
    return FullRegressor(function, parameters, tuple(constant.values for constant in robot.constants), place)


@final
class Sampler:
    """Rows of the full regressor at random motions, in the field of a trial."""

    def __init__(self, regressor: FullRegressor) -> None:
        self.regressor = regressor
        self.columns = regressor.parameters.size
        self._tape = Tape.from_function(regressor.function)

    def constants(self, trial: Trial) -> list[list[int]]:
        """The robot's constants as residues."""
        return [[trial.residue(value) for value in values] for values in self.regressor.values]

    def rows(self, trial: Trial, constants: Sequence[Sequence[int]]) -> list[list[int]]:
        """The n rows at one random motion."""
        n = self.regressor.n
        motion = [[trial.random() for _ in range(n)] for _ in SIGNALS]
        [dense] = self._tape.evaluate([*motion, *constants], trial)
        return [dense[i::n] for i in range(n)]
