"""How well `identify` finds hidden robots in MuJoCo: ``python -m tests.benchmarks.identify FIRST LAST [FILE]``.

Each seed is a UR10 with three joints, masses of links +-25 %, 0 to 5 kg at the tool, rotors, friction (half of them
with a Stribeck term), a servo of one of five kinds, a 17-bit encoder, a delay of 0 to 3 samples, and steps
for 20 s at 2 or 8 ms. In seeds 80 to 99 friction also increases with the servo's torque. From seed 100 on every fourth
robot has another deviation: friction that increases with the torque or differs by direction, recorded times with a
jitter of 10 % of the period, or 1 % lost samples.

With FILE each result is written to it as a line of JSON, and seeds in FILE are not computed again. ``--verdict`` also
computes the verdict, and the errors of its laws on the hidden robot.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import dmframe as dm
from dmframe.common.errors import DmframeError
from dmframe.identification.found import Identified
from dmframe.identification.verdict import verdict_of
from dmframe.identification.write import RACE
from dmframe.race.read import load_race
from dmframe.robot.library import find_robot
from tests.framework.identify.plants import QUANTUM, steps, write
from tests.in_mujoco.plant import Load, Plant
from tests.in_mujoco.servos import Array, Cascade, Pid, Servo
from tests.in_mujoco.verdict import true_error

HOLD = {"wrist_1_joint": 0.0, "wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}
LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
KINDS = ("PI", "PID", "P-PI, f = 1", "P-PI, f = 0", "P-PI, f below 1")
CLASSES = ("pi", "pid", "pid", "p_pi", "p_pi")
OTHER, STUDY = 80, 100
DEVIATIONS = ("friction by torque", "uneven friction", "jitter", "lost samples")


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


def deviation_of(seed: int) -> str:
    """Distinguishing features of a robot; empty for most."""
    if OTHER <= seed < STUDY:
        return DEVIATIONS[0]
    return DEVIATIONS[seed // 4 % 4] if seed >= STUDY and seed % 4 == 3 else ""


def recorded(seed: int) -> tuple[tuple[Array, Array, Array], dict[str, Array], int, Plant]:
    """Log, true parameters, delay [samples] and plant of a hidden robot."""
    rng, deviation = np.random.default_rng(seed), deviation_of(seed)
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
        per_torque=rng.uniform(0.02, 0.1) if deviation == "friction by torque" else 0.0,
        uneven=rng.uniform(-0.3, 0.3) if deviation == "uneven friction" else 0.0,
        rotor=tuple(rng.uniform(0.3, 3, 3)),
        mass_scale={name: rng.uniform(0.75, 1.25) for name in LINKS},
        loads=[Load(0.0, rng.uniform(0, 5))] if rng.random() < 0.7 else [],
    )
    u = steps(T, 20.0, seed)

    def command(_: object, t: float) -> Array:
        k = round(t / T) - delay
        return u[min(k, len(u) - 1)] if k >= 0 else np.zeros(3)

    motion = plant.run(command, np.array([1.4, -1.1, 1.2]) + rng.uniform(-0.3, 0.3, 3), T, 20.0)
    time, q = motion.time[:-1], np.round(motion.q[:-1] / QUANTUM) * QUANTUM
    if deviation == "jitter":
        time = time + 0.1 * T * rng.normal(size=len(time)).clip(-3, 3)
    kept = np.ones(len(time), bool)
    if deviation == "lost samples":
        kept[1:] = rng.random(len(time) - 1) > 0.01
    return (time[kept] - time[0], q[kept], u[kept]), true, delay, plant


def identified(seed: int, verdict: bool) -> dict[str, Any]:
    """The result of a seed as plain data; `right` is the true class, `true` are the true values."""
    log, true, delay, plant = recorded(seed)
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as place:
        about: dict[str, Any] = {
            "seed": seed,
            "verdict": verdict,
            "right": CLASSES[seed % 5],
            "deviation": deviation_of(seed),
        }
        try:
            found = dm.identify(write(Path(place) / "log.csv", *log), "ur10_slow")
        except DmframeError as error:
            return about | {"class": f"refused: {error}", "seconds": time.process_time() - begun}
        about |= {
            "class": found.kind,
            "delay": [delay, found.delay[0], *found.delay[1]],
            "seconds": time.process_time() - begun,
        }
        if found.kind == about["right"]:
            about["gains"] = {
                name: np.column_stack([value, found.servo[name][0], found.servo[name][1]]).tolist()
                for name, value in true.items()
            }
        if plant.per_torque and "per_torque" in found.friction:
            value, limits = found.friction["per_torque"]
            about["per_torque"] = np.column_stack([np.full(3, plant.per_torque), value, limits]).tolist()
        if verdict and found.known:
            about["laws"] = list(compared(found, plant, delay, Path(place)))
    return about


def compared(found: Identified, plant: Plant, delay: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Laws of the verdict with predicted errors, intervals and the errors on the hidden robot [mm]."""
    verdict = verdict_of(found, folder)
    for judged in verdict.laws:
        late, values = delay * found.fit.unknowns.log.period, tuple(judged.values.items())
        place = folder / "true" / judged.path
        place.mkdir(parents=True, exist_ok=True)
        error = true_error(load_race(folder / RACE), judged.law, judged.path, values, plant, late, place)
        about = {"outcome": verdict.outcome, "resolution": verdict.resolution, "true": error}
        yield {key: judged.summary[key] for key in ("law", "path", "error", "interval", "adaptive")} | about


def line(own: dict[str, Any]) -> str:
    """Description of one robot."""
    text = f"{own['seed']} {KINDS[own['seed'] % 5]} {own['deviation']}: {own['class']}, {own['seconds']:.0f} s"
    if "delay" in own:
        true, samples, low, high = own["delay"]
        text += f", delay {samples:.3f} ({low:.3f} to {high:.3f}; {true})"
    for name, rows in own.get("gains", {}).items():
        errors = [value - true for true, value, _, _ in rows] if name == "f" else [v / t - 1 for t, v, _, _ in rows]
        text += f", {name} {100 * max(map(abs, errors)):.2g} %"
    for law in own.get("laws", ()):
        low, high = law["interval"]
        text += (
            f"\n    {law['path']} {law['law']} {law['error']:.4g} ({low:.4g} to {high:.4g}), true {law['true']:.4g} mm"
        )
    return text


def totals(all_: list[dict[str, Any]]) -> Iterator[str]:
    """Figures over all robots."""
    right, none = [own for own in all_ if "gains" in own], sum(own["class"] not in CLASSES for own in all_)
    exact = sum(round(own["delay"][1]) == own["delay"][0] for own in right)
    inside = sum(own["delay"][2] <= own["delay"][0] <= own["delay"][3] for own in right)
    wrong = len(all_) - len(right) - none
    yield f"class right {len(right)}, unknown or refused {none}, wrong {wrong}, of {len(all_)}"
    yield f"delay, rounded, right in {exact}, inside its interval in {inside}, of {len(right)}"
    for kind in sorted({own["right"] for own in right}):
        some = [own for own in right if own["right"] == kind]
        inside_ = [low <= true <= high for own in some for rows in own["gains"].values() for true, _, low, high in rows]
        yield f"{kind}: intervals of the servo's parameters contain {sum(inside_)} of {len(inside_)}"
        for name in some[0]["gains"]:
            rows = [row for own in some if name in own["gains"] for row in own["gains"][name]]
            errors = [abs(value - true) / (1 if name == "f" else true) for true, value, _, _ in rows]
            yield f"{kind}: error of {name}, median {100 * np.median(errors):.2g} %, worst {100 * max(errors):.2g} %"
    seconds = [own["seconds"] for own in all_]
    yield f"seconds: median {np.median(seconds):.0f}, worst {max(seconds):.0f}"
    yield from of_verdicts([own["laws"] for own in all_ if own.get("laws")])


def of_verdicts(robots: list[list[dict[str, Any]]]) -> Iterator[str]:
    """The figures of predicted errors and winners."""
    if not robots:
        return
    for adaptive in (False, True):
        laws = [law for own in robots for law in own if law["adaptive"] == adaptive]
        far = [abs(law["error"] / law["true"] - 1) for law in laws]
        near = sum(abs(law["error"] - law["true"]) < law["resolution"] for law in laws)
        inside = sum(law["interval"][0] <= law["true"] <= law["interval"][1] for law in laws)
        yield (
            f"{'aggregation' if adaptive else 'rivals'}: predicted error, median deviation {100 * np.median(far):.2g} "
            f"%, within 5 % in {sum(x < 0.05 for x in far)}, within the position noise in {near}, inside the interval "
            f"in {inside}, of {len(far)}"
        )
    same = reversed_ = count = 0
    for own in robots:
        for path in {law["path"] for law in own}:
            some = [law for law in own if law["path"] == path]
            first, best = min(some, key=lambda law: law["error"]), min(some, key=lambda law: law["true"])
            count, same = count + 1, same + (first["law"] == best["law"])
            apart = first["interval"][1] < best["interval"][0] and first["true"] - best["true"] > first["resolution"]
            reversed_ += first["law"] != best["law"] and apart
    yield f"{len(robots)} verdicts: the predicted winner is true on {same} of {count} paths, reversed on {reversed_}"


def main() -> None:
    """Print a line for each seed, and the totals."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("file", type=Path, nargs="?")
    parser.add_argument("--verdict", action="store_true")
    given = parser.parse_args()
    text = given.file.read_text(encoding="utf-8") if given.file and given.file.exists() else ""
    kept = {own["seed"]: own for own in map(json.loads, text.splitlines()) if own["verdict"] >= given.verdict}
    for seed in range(given.first, given.last):
        if seed not in kept:
            kept[seed] = identified(seed, given.verdict)
            if given.file:
                with given.file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(kept[seed]) + "\n")
        print(line(kept[seed]), flush=True)
    print("\n".join(totals([kept[seed] for seed in range(given.first, given.last)])))


if __name__ == "__main__":
    main()
