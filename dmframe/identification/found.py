"""Result of an identification: numbers with intervals, as JSON and as text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from dmframe.identification.answer import NOT_REQUESTED, Verdict
from dmframe.identification.choose import ABOVE, Choice
from dmframe.identification.clipped import Limit
from dmframe.identification.model import Array
from dmframe.identification.roots import second
from dmframe.identification.solve import Fit
from dmframe.identification.torque import Factor
from dmframe.identification.unknowns import SERVOS

ALWAYS: Final = (
    "absolute gains K and inertia: positions determine them relative to one another; the robot's file gives the scale",
    "inertia of rotor and link where a base parameter contains both",
)
_OF_F: Final = (
    "velocity feed-forward f and viscous friction",
    "velocity feed-forward f and the delay, to first order",
)
_WIDER: Final = {"p_pi": 1.5, "p_pi_0": 1.5}
"""Factor of the standard deviations of a cascade, whose parameters are correlated."""


@final
@dataclass(frozen=True, eq=False)
class Identified:
    """An identified servo and robot.

    Parameters
    ----------
    choice
        Fitted candidates.
    notices
        Remarks on the log and on the engine.
    record
        How to repeat it: versions, digest of the log, options.
    verdict
        Whether an adaptive law is worth it.
    limits
        Joints whose commands the robot clips, with the first estimate of the limit.
    torques
        Measured torques or currents relative to the torques of the identified robot.
    """

    choice: Choice
    notices: tuple[str, ...]
    record: dict[str, Any]
    verdict: Verdict = NOT_REQUESTED
    limits: tuple[Limit, ...] = ()
    torques: tuple[Factor, ...] = ()

    @property
    def fit(self) -> Fit:
        """The best candidate's fit."""
        return self.choice.fits[self.choice.best]

    @property
    def known(self) -> bool:
        """False if no candidate explains the log."""
        return self.choice.explained(self.choice.best)

    @property
    def unexplained(self) -> list[str]:
        """Names of the joints on which the best candidate leaves a residual above the floor."""
        far = self.fit.rms > ABOVE * self.choice.floor
        return [name for name, bad in zip(self.fit.unknowns.model.chain.joint_names, far, strict=True) if bad]

    @property
    def kind(self) -> str:
        """Class of the servo: pi, pid, p_pi, or unknown."""
        return self.choice.best.replace("_0", "") if self.known else "unknown"

    @cached_property
    def _spread(self) -> tuple[Array, Array]:
        """Numbers of the twin and their standard deviations."""
        fit, step = self.fit, 1e-6
        columns = np.hstack([fit.theta[:, None], fit.theta[:, None] + step * np.eye(len(fit.theta))])
        p = fit.unknowns.numbers(columns, 0.0)
        slopes = (p[:, 1:] - p[:, :1]) / step
        return p[:, 0], self.wider * np.sqrt(np.einsum("ij,jk,ik->i", slopes, fit.covariance, slopes))

    @property
    def wider(self) -> float:
        """Factor of the standard deviations: of the class, and of a residual that is above the noise.

        Such a residual has a systematic part, of a model error or a local minimum, which may shift the numbers as far.
        """
        return _WIDER.get(self.choice.best, 1.0) * self.above

    @property
    def above(self) -> float:
        """Largest residual of a joint relative to the noise; 1 if the fit leaves noise only."""
        if self.choice.sharp(self.choice.best):
            return 1.0
        return max(1.0, float(np.max(self.fit.rms / self.choice.least)))

    def positive(self, name: str) -> tuple[Array, Array]:
        """Values of an unknown that is fitted as a logarithm, and (n, 2) limits of two standard deviations."""
        at = self.fit.unknowns.places[name]
        value, deviation = self.fit.theta[at], self.wider * np.sqrt(np.diag(self.fit.covariance)[at])
        limits = np.column_stack([value - 2 * deviation, value + 2 * deviation])
        return np.exp(value), np.exp(np.clip(limits, -50, 50))

    def number(self, name: str, least: float = -np.inf) -> tuple[Array, Array]:
        """Values of a number of the twin, and (n, 2) limits of two standard deviations, at least `least`."""
        value, deviation = (each[self.fit.unknowns.model.places[name]] for each in self._spread)
        return np.maximum(value, least), np.maximum(
            np.column_stack([value - 2 * deviation, value + 2 * deviation]), least
        )

    @property
    def servo(self) -> dict[str, tuple[Array, Array]]:
        """Parameters of the servo with limits: ratios [1/s, 1/s^2], and w, the inverse of the velocity gain."""
        found = {"w": self.positive("w")}
        for name in SERVOS[self.choice.best]:
            found[name] = self.number("f", 0.0) if name == "f" else self.positive(name)
        if self.choice.best == "p_pi_0":
            found["f"] = np.zeros(self.fit.unknowns.model.n), np.zeros((self.fit.unknowns.model.n, 2))
        return self._with_second(found)

    @cached_property
    def _second(self) -> dict[str, Array]:
        """Gains of the cascade with the same motion, (n,), NaN where its viscous friction is clearly negative."""
        fit = self.fit
        if self.choice.best != "p_pi":
            return {}
        other, at = second(fit.unknowns, fit.theta), fit.unknowns.places
        possible = other[at["B"]] >= -2 * self.wider * np.sqrt(np.diag(fit.covariance)[at["B"]])
        own = {name: np.exp(other[at[name]]) for name in ("w", "k_p", "k_i")} | {"f": other[at["f"]]}
        own["viscous"] = other[at["B"]] / own["w"]
        return {name: np.where(possible, values, np.nan) for name, values in own.items()}

    def _with_second(self, found: dict[str, tuple[Array, Array]]) -> dict[str, tuple[Array, Array]]:
        """Limits that contain the second cascade too, with as wide an interval."""
        for name, other in self._second.items():
            if name in found:
                value, limits = found[name]
                moved = limits + (other - value)[:, None]
                found[name] = (
                    value,
                    np.column_stack([np.fmin(limits[:, 0], moved[:, 0]), np.fmax(limits[:, 1], moved[:, 1])]),
                )
        return found

    @property
    def friction(self) -> dict[str, tuple[Array, Array]]:
        """Friction with limits; `per_torque` is there only if the log shows that friction grows with the torque."""
        joints = {"viscous": "B", "coulomb": "D", "sticking": "S"}
        if self.fit.unknowns.by_torque:
            joints["per_torque"] = "L"
        shared = {"friction_velocity": "v_0", "stribeck_velocity": "v_s"}
        found = {name: self.number(own, 0.0) for name, own in joints.items()}
        return self._with_second(found) | {name: self.positive(own) for name, own in shared.items()}

    @property
    def delay(self) -> tuple[float, tuple[float, float]]:
        """Delay from command to servo, and its limits [samples]."""
        at = self.fit.unknowns.places["delay"].start
        value, deviation = float(self.fit.theta[at]), self.wider * float(np.sqrt(self.fit.covariance[at, at]))
        return value, (max(0.0, value - 2 * deviation), value + 2 * deviation)

    @property
    def limited(self) -> dict[int, tuple[float, tuple[float, float]]]:
        """Velocities to which the robot clips the commands, with their limits, by joint [rad/s]."""
        found, first = dict[int, tuple[float, tuple[float, float]]](), self.fit.unknowns.places["command"].start
        for k, limit in enumerate(self.limits, first):
            deviation = self.wider * float(np.sqrt(self.fit.covariance[k, k]))
            value = limit.speed + float(self.fit.theta[k])
            found[limit.joint] = value, (value - 2 * deviation, value + 2 * deviation)
        return found

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Quantities that positions and commands cannot separate."""
        return (*ALWAYS, *(_OF_F if self.choice.best.startswith("p_pi") else ()), *self._cascade, *self._twice)

    @property
    def _twice(self) -> tuple[str, ...]:
        """Joints for which two cascades have the same motion."""
        own = self._second
        return tuple(
            f"joint {j + 1}: a cascade with k_p {own['k_p'][j]:.4g}, k_i {own['k_i'][j]:.4g} 1/s, f {own['f'][j]:.4g}, "
            f"and viscous friction {own['viscous'][j]:.4g}; the intervals contain both"
            for j in np.flatnonzero(np.isfinite(own.get("f", np.array([]))))
        )

    @property
    def _cascade(self) -> tuple[str, ...]:
        if self.choice.best != "pid":
            return ()
        half, product = self.positive("k_P")[0] / 2, self.positive("k_I")[0]
        if np.any(half**2 < product):
            return ()
        root = np.sqrt(half**2 - product)
        return (
            "a PID servo and a P-PI cascade with f = 1, for which k_p and k_i of each joint are "
            + ", ".join(f"{b + r:.4g} and {b - r:.4g}" for b, r in zip(half, root, strict=True))
            + " 1/s, or the reverse",
        )

    @property
    def summary(self) -> dict[str, Any]:
        """The result for programs, as ``dmframe identify --json`` prints it."""
        value, limits = self.delay
        base = self.fit.unknowns.model.base
        beta, between = self.number("beta")
        bodies = [
            {"name": name, "meaning": text, "value": float(b), "interval": _limits(row) if self.known else None}
            for name, text, b, row in zip(base.kept, base.symbolic, beta, between, strict=True)
        ]
        return {
            "servo": {
                "class": self.kind,
                "parameters": {name: own[0].tolist() for name, own in self.servo.items()} if self.known else {},
                "intervals": {name: own[1].tolist() for name, own in self.servo.items()} if self.known else None,
            },
            "delay": {"samples": value, "interval": _limits(limits) if self.known else None},
            "friction": {
                name: {"value": own[0].tolist(), "interval": own[1].tolist() if self.known else None}
                for name, own in self.friction.items()
            },
            "limits": [
                {"joint": joint + 1, "speed": speed, "interval": _limits(own) if self.known else None}
                for joint, (speed, own) in self.limited.items()
            ],
            "torques": [own.summary for own in self.torques],
            "bodies": bodies,
            "residual": self.fit.rms.tolist(),
            "floor": self.choice.floor.tolist(),
            "indistinguishable": list(self.indistinguishable),
            "verdict": self.verdict.summary,
        }

    def __str__(self) -> str:
        lines = [f"notice: {text}" for text in self.notices]
        names = self.fit.unknowns.model.chain.joint_names
        for name, residual, floor in zip(names, 1e6 * self.fit.rms, 1e6 * self.choice.floor, strict=True):
            lines.append(f"{name}: residual {residual:.4g} urad, floor {floor:.4g} urad")
        if not self.known:
            lines.append(
                f"servo: unknown; the closest class, {self.choice.best.replace('_0', '')}, leaves a residual above "
                f"three times the floor at {', '.join(self.unexplained)}: its parameters are not reported. Check the "
                "robot's file, tool and "
                "payload, and use a "
                "log with velocity steps that begins at rest"
            )
            return "\n".join([*lines, f"verdict: {self.verdict.sentence}"])
        value, limits = self.delay
        lines.append(f"servo: {self.kind}")
        lines.append(f"delay: {value:.3f} samples ({limits[0]:.3f} to {limits[1]:.3f})")
        lines += [_line(name, own) for name, own in (self.servo | self.friction).items()]
        lines += [
            f"joint {joint + 1}: velocity limit {speed:.4g} rad/s ({own[0]:.4g} to {own[1]:.4g})"
            for joint, (speed, own) in self.limited.items()
        ]
        lines += [str(own) for own in self.torques]
        lines += [f"not separable: {text}" for text in self.indistinguishable]
        return "\n".join([*lines, f"verdict: {self.verdict.sentence}"])


def _limits(pair: Any) -> list[float]:
    return [float(pair[0]), float(pair[1])]


def _line(name: str, own: tuple[Array, Array]) -> str:
    values = zip(own[0], own[1], strict=True)
    return f"{name}: " + ", ".join(f"{value:.4g} ({low:.4g} to {high:.4g})" for value, (low, high) in values)
