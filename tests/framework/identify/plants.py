"""Hidden robots for identification: Pinocchio's forward dynamics, a servo and friction by hand, RK4."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

import dmframe as dm

Array = np.ndarray
QUANTUM = 2 * np.pi / 2**17
START = np.array([1.4, -1.1, 1.2])


@dataclass(frozen=True)
class Hidden:
    """tau = (f dq_c - dq + a q_c - b q)/w + z, z' = c (q_c - q)/w; joint friction; scaled masses and rotors."""

    a: Array
    b: Array
    c: Array
    f: float = 1.0
    w: Array = field(default_factory=lambda: np.array([1 / 700, 1 / 900, 1 / 450]))
    viscous: Array = field(default_factory=lambda: np.array([9.0, 7.0, 3.0]))
    coulomb: Array = field(default_factory=lambda: np.array([10.0, 9.0, 4.0]))
    v_0: float = 0.02
    per_torque: float = 0.0
    hysteresis: float = 0.0
    mass: float = 1.15
    rotor: float = 0.8


def steps(T: float, seconds: float, seed: int) -> Array:
    """Velocity steps of every joint that return towards the start."""
    rng, u = np.random.default_rng(seed), np.zeros((int(seconds / T), 3))
    for j in range(3):
        k, x = int(0.5 / T), 0.0
        while k < len(u):
            sign = -np.sign(x) if abs(x) > 0.25 else rng.choice([-1, 1])
            some = slice(k, k + int(rng.uniform(0.2, 1.0) / T))
            u[some, j] = sign * rng.uniform(0.05, 0.4) * (rng.random() > 0.2)
            x, k = x + T * float(np.sum(u[some, j])), some.stop
    return u


def record(
    hidden: Hidden,
    T: float = 0.008,
    seconds: float = 12.0,
    delay: int = 1,
    seed: int = 0,
    jitter: float = 0.0,
    limit: float = np.inf,
) -> tuple[Array, ...]:
    """Time, quantised positions and commands of a run from rest.

    With `jitter` the samples, at which commands are sent, deviate by up to this fraction of T from a regular clock; the
    robot clips commands at `limit` [rad/s].
    """
    model = dm.load("ur10_slow").diagram.robot.model.copy()
    for j, inertia in enumerate(model.inertias):
        model.inertias[j] = pin.Inertia(hidden.mass * inertia.mass, inertia.lever, hidden.mass * inertia.inertia)
    model.armature[:] = hidden.rotor
    data, u = model.createData(), steps(T, seconds, seed)
    held = pin.computeGeneralizedGravity(model, data, START)
    x = np.concatenate([START, np.zeros(3), np.zeros(3), held, np.zeros(3)])

    def rate(x: Array, dq_c: Array) -> Array:
        q, v, q_c, z, bristle = x.reshape(5, 3)
        tau = (hidden.f * dq_c - v + hidden.a * q_c - hidden.b * (q - START)) / hidden.w + z
        dry = hidden.coulomb + hidden.per_torque * np.abs(tau)
        tau = tau - hidden.viscous * v - dry * np.tanh(v / hidden.v_0) - hidden.hysteresis * bristle
        slip = (v - np.abs(v) * bristle) / 0.02  # Dahl's model: friction with memory, not in the twin's family
        zeta = hidden.c * (q_c - q + START) / hidden.w
        return np.concatenate([v, pin.aba(model, data, q, v, tau), dq_c, zeta, slip])

    time = T * (np.arange(len(u) + 1) + jitter * np.random.default_rng(seed + 1).uniform(-1, 1, len(u) + 1))
    found, time = np.empty((len(u), 3)), time - time[0]
    for k in range(len(u)):
        found[k] = x[:3]
        dq_c = np.clip(u[k - delay], -limit, limit) if k >= delay else np.zeros(3)
        count = round((time[k + 1] - time[k]) / 0.001) or 1
        h = (time[k + 1] - time[k]) / count
        for _ in range(count):
            k1 = rate(x, dq_c)
            k2 = rate(x + h / 2 * k1, dq_c)
            k3 = rate(x + h / 2 * k2, dq_c)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, dq_c))
    q = np.round(found / QUANTUM) * QUANTUM
    return time[:-1], q, u


def write(file: Path, t: Array, q: Array, u: Array, names: Callable[[str, int], str] | None = None) -> Path:
    """The log as CSV with plain column names."""
    named = names or (lambda stem, j: f"{stem}_{j}")
    head = ["t", *(named("q", j) for j in (1, 2, 3)), *(named("dq_c", j) for j in (1, 2, 3))]
    np.savetxt(file, np.column_stack([t, q, u]), delimiter=",", header=",".join(head), comments="", fmt="%.10g")
    return file
