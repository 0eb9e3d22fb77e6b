"""Plants of an identified robot: the best fit, and draws from the covariance of the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.identification.nearest import bodies_near
from dmframe.identification.pseudo_inertia import pseudo_inertia
from dmframe.identification.solve import MOST_DELAY
from dmframe.identification.unknowns import SERVOS, Unknowns
from dmframe.robot.parameters import DynamicParameters

NARROW: Final = 0.05
"""Two standard deviations of a delay below which it is not drawn [samples]."""
MOST_SAMPLES: Final = 4.0
"""Longest delay of a graph, in samples of its clock."""
PROJECTIONS: Final = 2000
SMALLEST: Final = 1e-4
"""Least eigenvalue of a pseudo-inertia, relative to its largest one."""
WHOLE: Final = 0.02
"""Deviation from a whole number of samples below which a delay is rounded."""


@final
@dataclass(frozen=True, eq=False)
class Plant:
    """Numbers of one twin.

    Parameters
    ----------
    servo
        Gains of the servo's block, by name, (n,) each.
    viscous, coulomb, sticking, per_torque
        (n,), friction B, D, S and L.
    velocity
        Stribeck velocity [rad/s].
    bodies, rotors
        (n, 10) and (n,), inertial parameters of the links and inertia of the rotors [kg m^2].
    delay
        From command to servo [samples of the log].
    """

    servo: dict[str, Array]
    viscous: Array
    coulomb: Array
    sticking: Array
    per_torque: Array
    velocity: float
    bodies: Array
    rotors: Array
    delay: float

    @classmethod
    def of(cls, unknowns: Unknowns, theta: Array, *, physical: bool = True) -> Plant:
        """The twin with the unknowns theta; friction and rotors are not negative, and bodies are physical."""
        p = unknowns.numbers(theta[:, None], 0.0)[:, 0]
        number = {name: p[place] for name, place in unknowns.model.places.items()}
        own = {name: theta[unknowns.places[name]] for name in SERVOS[unknowns.kind]}
        gains = {name: np.maximum(value, 0.0) if name == "f" else np.exp(value) for name, value in own.items()}
        bodies, rotors = bodies_of(unknowns, number["beta"], physical=physical)
        friction = {name: np.maximum(number[name], 0.0) for name in ("B", "D", "S", "L")}
        return cls(
            servo=servo_of(unknowns.kind, 1 / number["w"], gains),
            viscous=friction["B"],
            coulomb=friction["D"],
            sticking=friction["S"],
            per_torque=friction["L"],
            velocity=float(number["v_s"][0]),
            bodies=bodies,
            rotors=rotors,
            delay=whole(float(theta[unknowns.places["delay"]][0])),
        )

    def blocks(self, servo: str, rubbing: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Blocks of a graph: a servo of this type, the arm and the terms `rubbing` of its friction, by `rubbing_of`."""
        arm = {"viscous": plain(self.viscous), "coulomb": plain(self.coulomb), "rotor": plain(self.rotors)}
        found: dict[str, dict[str, Any]] = {
            "servo": {"type": servo} | {name: plain(value) for name, value in self.servo.items()},
            "arm": {"type": "loaded_manipulator", **arm, "bodies": [plain(row) for row in self.bodies]},
        }
        if rubbing:
            found["rubbing"] = {"type": "stribeck_friction", **self.rubbing(rubbing)}
        return found

    def rubbing(self, terms: Sequence[str]) -> dict[str, Any]:
        """Parameters of `stribeck_friction` for the terms `rubbing_of`."""
        found: dict[str, Any] = {}
        if "sticking" in terms:
            found |= {"sticking": plain(self.sticking), "velocity": plain([self.velocity])[0]}
        if "per_torque" in terms:
            found["per_torque"] = plain(self.per_torque)
        return found


def rubbing_of(found: Identified) -> tuple[str, ...]:
    """Terms of the friction that viscous and Coulomb friction do not contain, if their intervals exclude zero."""
    own = found.friction
    return tuple(name for name in ("sticking", "per_torque") if name in own and np.any(own[name][1][:, 0] > 0))


def servo_of(kind: str, speed: Array, gains: dict[str, Array]) -> dict[str, Array]:
    """Gains of the servo's block: velocity gains `speed`, and ratios by the names of `SERVOS`."""
    if kind == "pi":
        return {"K_P": speed, "K_I": speed * gains["k_I"]}
    if kind == "pid":
        return {"K_D": speed, "K_P": speed * gains["k_P"], "K_I": speed * gains["k_I"]}
    return {
        "k_p": gains["k_p"],
        "K_v": speed,
        "K_i": speed * gains["k_i"],
        "feed_forward": gains.get("f", 0 * speed),
    }


def bodies_of(unknowns: Unknowns, beta: Array, *, physical: bool = True) -> tuple[Array, Array]:
    """Inertial parameters of the links, (n, 10), and of the rotors, (n,), with the base parameters `beta`.

    Of all that have them, those are chosen that deviate least from the robot's file, relative to the prior; rotors are
    not negative. If no physical bodies have them, those are chosen whose base parameters deviate least, relative to the
    prior; without `physical`, masses may be negative.
    """
    model, parameters = unknowns.model, unknowns.model.base.parameters
    values = np.array([0.0 if value is None else float(value) for value in parameters.values])
    root, rotors = unknowns.full, parameters.places("rotor")

    def nearest(start: Array, root: Array) -> Array:
        gain = model.grouping @ root
        return np.asarray(start + root @ np.linalg.lstsq(gain, beta - model.grouping @ start, rcond=1e-9)[0])

    start = values.copy()
    start[rotors] = np.maximum(nearest(values, root)[rotors], 0.0)
    fixed = root.copy()
    fixed[rotors] = 0.0
    everything = nearest(start, fixed)
    if physical:
        everything = reflected(everything, beta, model.grouping, parameters)
    if physical and not buildable(everything, parameters):
        everything = bodies_near(unknowns, np.linalg.solve(unknowns.bodies, beta - unknowns.center))
    return everything[parameters.inertial].reshape(model.n, -1), everything[rotors]


def buildable(values: Array, parameters: DynamicParameters) -> bool:
    """True if the masses of all links are nowhere negative, and rotors are not."""
    links = values[parameters.inertial].reshape(-1, 10)
    least = min(float(np.linalg.eigvalsh(pseudo_inertia(own))[0]) for own in links)
    return least > 0 and bool(np.all(values[parameters.places("rotor")] >= 0))


def reflected(values: Array, beta: Array, grouping: Array, parameters: DynamicParameters) -> Array:
    """Parameters of bodies whose mass is nowhere negative, with the same base parameters, near `values`.

    By alternating reflections at the positive definite pseudo-inertias P and projections on the base parameters, in the
    Frobenius norm of P with lengths relative to `LENGTH`; `values` if they do not meet within `PROJECTIONS`.
    """
    links, rotors = np.arange(len(values))[parameters.inertial].reshape(-1, 10), parameters.places("rotor")
    root, turned = np.eye(len(values)), np.array([pseudo_inertia(row) for row in np.eye(10)])
    corner = np.triu_indices(4)
    weight = np.where(corner[0] == corner[1], 1.0, np.sqrt(2.0))
    own = np.array([matrix[corner] * weight for matrix in turned]).T  # the coordinates of a link's parameters
    for link in links:
        root[np.ix_(link, link)] = own
    to, x = np.linalg.inv(root), root @ values
    G = grouping @ to
    back = np.linalg.pinv(G)
    for _ in range(PROJECTIONS):
        P = np.zeros((len(links), 4, 4))
        P[:, corner[0], corner[1]] = P[:, corner[1], corner[0]] = x[links] / weight
        sizes, axes = np.linalg.eigh(P)
        least = SMALLEST * sizes[:, -1:]
        if np.all(sizes > 0.5 * least) and np.all(x[rotors] >= 0):
            return np.asarray(to @ x)
        P = np.einsum("lij,lj,lkj->lik", axes, np.maximum(sizes, 2 * least - sizes), axes)
        x[links] = P[:, corner[0], corner[1]] * weight
        x[rotors] = np.abs(x[rotors])
        x += back @ (beta - G @ x)
    return values


def thetas(found: Identified, count: int, seed: int = 0) -> Array:
    """Draws of the unknowns, (size, count), from the normal distribution with the covariance of the fit.

    What `held_covariance` holds is not drawn.
    """
    fit, unknowns = found.fit, found.fit.unknowns
    values, vectors = np.linalg.eigh(held_covariance(found))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = np.random.default_rng(seed).standard_normal((len(fit.theta), count))
    drawn = fit.theta[:, None] + root @ normal
    drawn[unknowns.places["delay"]] = np.clip(drawn[unknowns.places["delay"]], 0.0, MOST_DELAY)
    return np.asarray(drawn)


def held_covariance(found: Identified) -> Array:
    """Covariance of the unknowns for a given scale of the torques.

    A common factor of all torques changes no motion, and positions do not determine it: the mean of log w is held, by
    conditioning. So are the velocity v_0 of the friction law and a delay that is known within `NARROW`.
    """
    fit, unknowns = found.fit, found.fit.unknowns
    low, high = found.delay[1]
    held = [("w", 1 / unknowns.model.n), ("v_0", 1.0), *([("delay", 1.0)] if high - low < 2 * NARROW else [])]
    C = np.zeros((len(held), len(fit.theta)))
    for row, (name, weight) in zip(C, held, strict=True):
        row[unknowns.places[name]] = weight
    covariance = found.wider**2 * fit.covariance
    gain = covariance @ C.T @ np.linalg.inv(C @ covariance @ C.T)
    return np.asarray(covariance - gain @ C @ covariance)


def whole(samples: float) -> float:
    """A delay, rounded if it is near a whole number of samples."""
    return float(round(samples)) if abs(samples - round(samples)) < WHOLE else samples


def periods(found: Identified, least: float = 0.0) -> int:
    """The fewest periods of the log that are at least `least` [s] and in which the delay is at most 4 samples."""
    return math.ceil(max(least / found.fit.unknowns.log.period - 1e-6, found.delay[1][1] / MOST_SAMPLES, 1.0))


def plain(values: Sequence[float] | Array) -> list[float]:
    """Numbers of nine significant digits, for a file."""
    return [float(f"{float(x):.9g}") for x in values]
