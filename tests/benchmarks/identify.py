"""How well `identify` finds hidden robots in MuJoCo: ``python -m tests.benchmarks.identify FIRST LAST``.

Each seed is a UR10 with three joints, masses of links +-25 %, 0 to 5 kg at the tool, rotors, friction (half of them
with a Stribeck term), a servo of one of five kinds, a 17-bit encoder, a delay of 0 to 3 samples, and steps
for 20 s at 2 or 8 ms. From seed 80 on friction also grows with the servo's torque, which the twin does not contain.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dmframe as dm
from dmframe.robot.library import find_robot
from tests.framework.identify.plants import QUANTUM, steps, write
from tests.in_mujoco.plant import Load, Plant
from tests.in_mujoco.servos import Array, Cascade, Pid, Servo

HOLD = {"wrist_1_joint": 0.0, "wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}
LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
KINDS = ("PI", "PID", "P-PI, f = 1", "P-PI, f = 0", "P-PI, f below 1")
CLASSES = ("pi", "pid", "pid", "p_pi", "p_pi")
OTHER = 80


@dataclass(frozen=True)
class Pi(Servo):
    """tau = -K_P (dq - dq_c) - K_I i, with i the integral of dq - dq_c."""

    K_P: Array
    K_I: Array
    rows = 2

    def start(self, q: Array, held: Array) -> Array:
        return np.array([q, -held / self.K_I])

    def law(self, q: Array, dq: Array, x: Array, dq_c: Array) -> tuple[Array, list[Array]]:
        return -self.K_P * (dq - dq_c) - self.K_I * x[1], [dq_c, dq - dq_c]


def servo_of(seed: int, rng: np.random.Generator) -> tuple[Servo, dict[str, Array]]:
    """A servo, and its parameters as `identify` reports them."""
    K = np.array([800, 800, 400]) * np.exp(rng.uniform(-0.4, 0.4)) * np.exp(rng.uniform(-0.2, 0.2, 3))
    if seed % 5 == 0:
        k_I = rng.uniform(1.5, 8, 3)
        return Pi(K, K * k_I), {"k_I": k_I}
    if seed % 5 == 1:
        k_P, k_I = rng.uniform(2, 12, 3), rng.uniform(0.7, 10, 3)
        return Pid(K, K * k_P, K * k_I), {"k_P": k_P, "k_I": k_I}
    f = (1.0, 0.0, float(rng.uniform(0.5, 0.95)))[seed % 5 - 2]
    p, i = rng.uniform(4, 20, 3), rng.uniform(2, 10, 3)
    servo = Cascade(p, K, K * i, f=f)
    return servo, {"k_P": p + i, "k_I": p * i} if f == 1 else {"k_p": p, "k_i": i, "f": np.full(3, f)}


def recorded(seed: int) -> tuple[tuple[Array, Array, Array], dict[str, Array], int, Plant]:
    """Log, true parameters, delay [samples] and plant of a hidden robot."""
    rng = np.random.default_rng(seed)
    servo, true = servo_of(seed, rng)
    T, delay, stribeck = (0.008, 0.002)[rng.integers(2)], int(rng.integers(4)), rng.random() < 0.5
    plant = Plant(
        find_robot("ur10").urdf,
        "ee_link",
        HOLD,
        servo,
        np.array([5, 5, 2]) * rng.uniform(0.5, 3, 3),
        np.array([8, 8, 4]) * rng.uniform(0.5, 2, 3),
        0.005 * 2 ** rng.uniform(-0.5, 2),
        sticking=rng.uniform(1, 6) if stribeck else 0.0,
        slow=rng.uniform(0.02, 0.1),
        per_torque=rng.uniform(0.02, 0.1) if seed >= OTHER else 0.0,
        rotor=tuple(rng.uniform(0.3, 3, 3)),
        mass_scale={name: rng.uniform(0.75, 1.25) for name in LINKS},
        loads=[Load(0.0, rng.uniform(0, 5))] if rng.random() < 0.7 else [],
    )
    u = steps(T, 20.0, seed)

    def command(_: object, t: float) -> Array:
        k = round(t / T) - delay
        return u[min(k, len(u) - 1)] if k >= 0 else np.zeros(3)

    motion = plant.run(command, np.array([1.4, -1.1, 1.2]) + rng.uniform(-0.3, 0.3, 3), T, 20.0)
    return (motion.time[:-1], np.round(motion.q[:-1] / QUANTUM) * QUANTUM, u), true, delay, plant


def main(first: int, last: int) -> None:
    """Print a line for each seed, and the totals."""
    right = unknown = inside = covered = count = 0
    errors, seconds = list[float](), list[float]()
    for seed in range(first, last):
        log, true, delay, _ = recorded(seed)
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as place:
            found = dm.identify(write(Path(place) / "log.csv", *log), "ur10_slow")
        seconds.append(time.process_time() - begun)
        kind, (samples, limits) = found.kind, found.delay
        right, unknown = right + (kind == CLASSES[seed % 5]), unknown + (kind == "unknown")
        line = f"{seed} {KINDS[seed % 5]}: {kind}, delay {samples:.3f} ({delay}), {seconds[-1]:.0f} s"
        if kind == CLASSES[seed % 5]:
            inside += limits[0] <= delay <= limits[1] or round(samples) == delay
            gain = next(iter(true))
            errors.append(float(np.max(np.abs(found.servo[gain][0] / true[gain] - 1))))
            for name, value in true.items():
                between = found.servo[name][1]
                covered, count = covered + int(np.sum((between[:, 0] <= value) & (value <= between[:, 1]))), count + 3
            line += f", {gain} within {100 * errors[-1]:.2g} %"
        print(line, flush=True)
    print(f"class right {right}, unknown {unknown}, of {last - first}; delay right or inside {inside} of {right}")
    if not right:
        return
    print(f"main gain, worst joint: median {100 * np.median(errors):.2g} %, worst {100 * max(errors):.2g} %")
    print(f"intervals contain {covered} of {count}; seconds: median {np.median(seconds):.0f}, worst {max(seconds):.0f}")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
