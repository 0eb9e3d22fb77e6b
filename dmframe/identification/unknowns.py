"""Unknowns of a fit: which numbers of the twin are free, how they are scaled, and what is known of them before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from dmframe.identification.log import Log
from dmframe.identification.model import Array, Model
from dmframe.robot.parameters import INERTIAL

SERVOS: Final[Mapping[str, tuple[str, ...]]] = {
    "pi": ("k_I",),
    "pid": ("k_P", "k_I"),
    "p_pi": ("k_p", "k_i", "f"),
    "p_pi_0": ("k_p", "k_i"),
}
"""Candidates with their parameters [1/s, 1/s^2]; `p_pi_0` is a cascade without feed-forward, f = 0."""

SLOWEST: Final = 0.05
"""Smallest gain at which a candidate starts [1/s]."""
LEAST: Final = 1e-6
"""Standard deviation of an inertial parameter that is zero in the robot's file [kg, kg m, kg m^2]."""
SPREAD: Final = 0.3
"""Standard deviation of a link's mass relative to that of the robot's file."""
LOAD: Final = 3.0
"""Standard deviation of a point mass at the tool [kg]."""
ROTOR: Final = (0.3, 0.4)
"""Mean and standard deviation of a rotor's inertia before the log is seen, relative to `Unknowns.driven`.

Without the mean, half of the rotors would have a negative inertia, and a fit could end at a mass matrix that is not
positive definite.
"""
LIGHT: Final = 0.1
"""Least inertia that a motor is sized for, relative to the largest of the robot's joints of the same kind.

A wrist's rotor may have a hundred times the inertia of the links that it moves: of a UR10e, 0.3 to 0.4 kg m^2 are
reported at joints whose links have 0.003 to 0.05 kg m^2, and 4.7 kg m^2 at joint 2.
"""
VISCOUS: Final = 0.03
"""Standard deviation of w B before the log is seen."""
_FRICTION: Final = {"B": VISCOUS, "D": 0.05, "S": 0.01}
"""Standard deviations of w B, w D [rad/s] and w S [rad/s] before the log is seen."""
BY_TORQUE: Final = 0.05
"""Standard deviation of L, the friction per torque, before the log is seen."""


@final
@dataclass(frozen=True, eq=False)
class Unknowns:
    """Vector theta of a candidate, and its map to the numbers of a twin.

    Parameters
    ----------
    model, log
        The robot's twin, and what was recorded.
    kind
        A key of `SERVOS`.
    by_torque
        Whether friction grows with the torque: L is an unknown, otherwise zero.
    """

    model: Model
    log: Log
    kind: str
    by_torque: bool = False

    @cached_property
    def places(self) -> dict[str, slice]:
        """Places in theta; joint by joint for each name, then shared ones."""
        n, at, found = self.model.n, 0, dict[str, slice]()
        growing = ("L",) if self.by_torque else ()
        for name in ("w", *SERVOS[self.kind], *_FRICTION, *growing, "offset", "q_0", "dq_0"):
            found[name], at = slice(at, at + n), at + n
        for name in ("v_0", "v_s", "delay"):
            found[name], at = slice(at, at + 1), at + 1
        found["command"], at = slice(at, at + len(self.log.unknown)), at + len(self.log.unknown)
        found["beta"] = slice(at, at + self.model.base.count)
        return found

    @property
    def size(self) -> int:
        """Length of theta."""
        return int(self.places["beta"].stop)

    @cached_property
    def bodies(self) -> Array:
        """Square root L of the prior covariance of the base parameters, (count, count): beta = center + L z."""
        root = self.model.grouping @ self.full
        covariance = root @ root.T
        return np.linalg.cholesky(covariance + 1e-6 * np.diag(np.diag(covariance)))

    @cached_property
    def full(self) -> Array:
        """Square root of the prior covariance of all parameters: links, the tool's load, rotors."""
        parameters = self.model.base.parameters
        values = np.array([0.0 if value is None else float(value) for value in parameters.values])
        # a parameter that is zero in the file may differ from it: else no bodies would have the fitted base parameters
        columns = [np.diag(np.maximum(0.1 * np.abs(values), LEAST))]
        for link in range(self.model.n):
            column = np.zeros(len(values))
            column[parameters.of_link(link)] = SPREAD * values[parameters.of_link(link)]
            columns.append(column[:, None])
        x, y, z = (float(value) for value in self.model.chain.tool)
        point = (1, x, y, z, y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
        column = np.zeros(len(values))
        column[len(INERTIAL) * (self.model.n - 1) : len(INERTIAL) * self.model.n] = point
        columns.append(LOAD * column[:, None])
        rotors = np.zeros((len(values), self.model.n))
        rotors[parameters.places("rotor")] = np.diag(np.maximum(ROTOR[1] * self.driven, 1e-3))
        return np.hstack([*columns, rotors])

    @cached_property
    def center(self) -> Array:
        """Base parameters before the log is seen: links of the robot's file, with rotors."""
        parameters = self.model.base.parameters
        rotors = np.zeros(len(self.full))
        rotors[parameters.places("rotor")] = self.rotors
        return np.asarray(self.model.nominal + self.model.grouping @ rotors)

    @cached_property
    def inertia(self) -> Array:
        """Diagonal of the nominal mass matrix at the first position [kg m^2]."""
        q, zero = self.log.q[0], np.zeros(self.model.n)
        rows = [np.array(self.model.torque_rows(q, zero, axis)) for axis in (*np.eye(self.model.n), zero)]
        still = rows[-1] @ self.model.nominal
        return np.array([(rows[j] @ self.model.nominal - still)[j] for j in range(self.model.n)])

    @property
    def rotors(self) -> Array:
        """Mean of the rotors' inertia before the log is seen [kg m^2], (n,)."""
        return np.asarray(np.maximum(ROTOR[0] * self.driven, 1e-3))

    @cached_property
    def driven(self) -> Array:
        """Inertia that each motor is sized for, (n,): of the links, at least a fraction of the robot's largest."""
        kinds = np.array([joint.kind for joint in self.model.chain.joints])
        largest = np.array([np.max(self.inertia[kinds == kind]) for kind in kinds])
        return np.asarray(np.maximum(self.inertia, LIGHT * largest))

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation of theta before the log is seen; infinite for what is unknown."""
        mean, deviation = np.zeros(self.size), np.full(self.size, np.inf)
        for name, value in _FRICTION.items():
            deviation[self.places[name]] = value
        if "L" in self.places:
            deviation[self.places["L"]] = BY_TORQUE
        deviation[self.places["offset"]] = 0.05
        deviation[self.places["q_0"]] = max(3 * self.log.noise, 1e-6)
        deviation[self.places["dq_0"]] = 0.05 if self.log.moving else 1e-4
        mean[self.places["v_0"]], deviation[self.places["v_0"]] = np.log(0.01), 1.0
        mean[self.places["v_s"]], deviation[self.places["v_s"]] = np.log(0.05), 0.7
        deviation[self.places["beta"]] = 1.0
        deviation[self.places["command"]] = [part.deviation for part in self.log.unknown]
        if "f" in self.places:
            mean[self.places["f"]], deviation[self.places["f"]] = 0.5, 1.0
        return mean, deviation

    def numbers(self, theta: Array, delay: float) -> Array:
        """Columns p of the twins for columns of theta; the schedule's delay is `delay` [s]."""
        at, to = self.places, self.model.places
        p = np.zeros((self.model.size, theta.shape[1]))
        w = np.exp(theta[at["w"]])
        p[to["w"]] = w
        p[to["f"]], p[to["a"]], p[to["b"]], p[to["c"]] = self.family(theta)
        for name in _FRICTION:
            p[to[name]] = theta[at[name]] / w
        if "L" in at:
            p[to["L"]] = theta[at["L"]]
        p[to["offset"]] = theta[at["offset"]] / w
        p[to["q_0"]] = self.log.q[0][:, None] + theta[at["q_0"]]
        p[to["dq_0"]], p[to["e_0"]] = theta[at["dq_0"]], self.log.ahead[:, None]
        p[to["v_0"]], p[to["v_s"]] = np.exp(theta[at["v_0"]]), np.exp(theta[at["v_s"]])
        p[to["delay"]] = theta[at["delay"]] * self.log.period - delay
        p[to["command"].start : to["command"].start + len(self.log.unknown)] = theta[at["command"]]
        p[to["beta"]] = self.center[:, None] + self.bodies @ theta[at["beta"]]
        return p

    def carried(self, other: Unknowns, theta: Array) -> Array:
        """Start values from the unknowns `theta` of another candidate: what both have, and gains that are nearest."""
        found = self.prior[0].copy()
        for name, place in self.places.items():
            if name in other.places:
                found[place] = theta[other.places[name]]
        f, a, b, c = (row[:, 0] for row in other.family(theta[:, None]))
        if self.kind == "pi":
            found[self.places["k_I"]] = np.log(np.maximum(a, SLOWEST))
        elif self.kind == "pid":
            found[self.places["k_P"]], found[self.places["k_I"]] = np.log(a), np.log(np.maximum(c, SLOWEST**2))
        elif not other.kind.startswith("p_pi"):
            root = np.sqrt(np.maximum(b * b / 4 - c, 0.0))
            found[self.places["k_p"]] = np.log(b / 2 + root)
            found[self.places["k_i"]] = np.log(np.maximum(b / 2 - root, SLOWEST))
            if "f" in self.places:
                found[self.places["f"]] = f
        elif "f" in self.places and "f" not in other.places:
            found[self.places["f"]] = 0.0
        return found

    def family(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """f, a, b and c of (1) and (2) of `dmframe.identification.model`."""
        at = self.places
        if self.kind == "pi":
            k = np.exp(theta[at["k_I"]])
            return np.ones_like(k), k, k, np.zeros_like(k)
        if self.kind == "pid":
            k = np.exp(theta[at["k_P"]])
            return np.ones_like(k), k, k, np.exp(theta[at["k_I"]])
        gain, integral = np.exp(theta[at["k_p"]]), np.exp(theta[at["k_i"]])
        f = theta[at["f"]] if "f" in at else np.zeros_like(gain)
        return f, gain + f * integral, gain + integral, gain * integral
