"""The sampled law where its assumptions fail: ``python docs/study/stress.py [--draw] [CASE...]``.

The slow circle at 90 ms, with the kinematic controllers, the sampled law, the supervised law, the disturbance observer,
and the paper's law with the paper's and with tuned gains, for cases in which a real robot differs from the model. Cases
with random numbers are run three times; the row has the worst run. Rows go to ``stress.csv``, where existing rows are
not computed again, and from there to the page; ``--draw`` only writes the page.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, final

import numpy as np

import dmframe as dm
from dmframe.common.errors import DmframeError
from dmframe.common.units import plain

FOLDER = Path(__file__).parent
PAGE, TABLE = FOLDER / "stress.md", FOLDER / "stress.csv"
CONTROLLERS: Final = {
    "ur10_slow_kinematic": "kinematic, J'",
    "ur10_slow_kinematic_inverse": "kinematic, inverse",
    "ur10_slow_sampled": "sampled law",
    "ur10_slow_supervised": "supervised",
    "ur10_slow_observer": "observer",
    "ur10_slow": "paper",
    "ur10_slow_tuned": "paper, tuned",
}
HEADS: Final = ("case", "graph", "rms_middle", "rms_final", "peak_after", "peak", "diverged_at", "fault")
START: Final = (2.023732, -1.174227, 1.336627)
"""[rad] Where the packaged graphs start, on the path."""
SERVO: Final = {"K_D": (800, 800, 400), "K_P": (1760, 1760, 880), "K_I": (560, 560, 280)}
LATE: Final = {"transport_delay": {"samples": 1}}
STEPS: Final = {"encoder": {"step": "47.94 urad"}}
SETTLED: Final = 2.0  # [s] after which the peak counts, since estimates start at zero
SEEDS: Final = 3
NOTHING: Final = 1e-6  # [m] below which the page shows 0
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"


@final
@dataclass(frozen=True)
class Case:
    """Changes of a case: values and blocks of the graph, non-idealities, and the delay that controllers assume."""

    values: Mapping[str, Any] = field(default_factory=dict)
    reality: Mapping[str, Any] = field(default_factory=dict)
    configured: int = 0
    seconds: float = 200.0
    random: bool = False
    echoed: bool = False


def servo(scale: float) -> dict[str, Any]:
    """The servo's gains, all times a number."""
    return {f"servo.{name}": [scale * gain for gain in gains] for name, gains in SERVO.items()}


def off(angle: float) -> dict[str, Any]:
    """The servo's initial target differs from the pose by an angle [rad] that is unknown to the controllers."""
    return {"start.servo.q_c": [q + angle for q in START]}


def block(kind: str, **parameters: Any) -> dict[str, Any]:
    """A block of a graph."""
    return {"type": kind, **parameters}


OWN, PLANTS = "stress_servos.py", "stress_plants.py"
FRICTION: Final = {"viscous": (5, 5, 2), "coulomb": (8, 8, 4)}
ROUND: Final = {"center": (-0.45, 0.45, 0.5), "radius": 0.1}
STRETCHED: Final = {"path.center": [-0.665, 0.665, 0.5], "start.q": [2.123928, -0.593373, 0.295104]}
SPRINGS: Final = {
    "blocks.springs": block("elastic_joints", stiffness=1e4, damping=50, inertia=[2, 2, 1]),
    "blocks.motors": block(f"{PLANTS}:MotorEncoders"),
    "wires.servo.q": "springs.theta",
    "wires.servo.dq": "springs.dtheta",
}
STAMPED: Final = {f"{label}.time_stamps": True for label in ("inverse", "column")}
PAYLOAD: Final = {"loaded_manipulator": {"payload": ["5 kg"], "payload_at": ["100 s"]}}
CASES: Final[dict[str, Case]] = {
    "as configured": Case(),
    "encoder's steps": Case(reality=STEPS),
    "delay 1": Case(reality=LATE, configured=1),
    "delay 1, steps": Case(reality=LATE | STEPS, configured=1),
    "noise 1e-4 rad, delay 1": Case(
        reality=LATE | {"encoder": {"step": "1 nrad", "noise": 1e-4}}, configured=1, random=True
    ),
    "the same, `average: 2`": Case(
        {"inverse.average": 2},
        LATE | {"encoder": {"step": "1 nrad", "noise": 1e-4}},
        configured=1,
        random=True,
    ),
    "q_c(0) off by 10 mrad": Case(off(0.01)),
    "q_c(0) off by 10 mrad, delay 1, steps": Case(off(0.01), LATE | STEPS, configured=1),
    "1 % of commands lost": Case(reality={"transport_delay": {"samples": 0, "lost": 0.01}}, seconds=400, random=True),
    "servo's q_c integrates 0.99 of dq_c": Case({"blocks.servo": block(f"{OWN}:DriftingServo", **SERVO)}, seconds=600),
    "velocity P servo without q_c": Case({"blocks.servo": block(f"{OWN}:VelocityServo", K_P=SERVO["K_D"])}),
    "PI servo": Case({"blocks.servo": block("pi_servo", K_P=SERVO["K_D"], K_I=SERVO["K_P"])}),
    "commands ramp with 0.5 rad/s^2": Case(reality={"command_ramp": {"acceleration": "0.5 rad/s^2"}}),
    "samples of 81 to 99 ms": Case({"jitter": "4.5 ms"}, random=True),
    "samples of 81 to 99 ms, time-stamped": Case({"jitter": "4.5 ms"} | STAMPED, random=True),
    "delay 1/2, configured 0": Case(reality={"transport_delay": {"samples": 0, "share": 0.5}}),
    "delay 3/4, configured 0": Case(reality={"transport_delay": {"samples": 0, "share": 0.75}}),
    "delay 1, configured 0": Case(reality=LATE),
    "delay 0, configured 1": Case(configured=1),
    "delay 1 or 2 at random, configured 1": Case(
        reality={"transport_delay": {"samples": 1, "late": 0.5}}, configured=1, random=True
    ),
    "the same, the servo's target echoed": Case(
        reality={"transport_delay": {"samples": 1, "late": 0.5}}, configured=1, random=True, echoed=True
    ),
    "delay 1, configured 0, the servo's target echoed": Case(reality=LATE, echoed=True),
    "robot's clock fast by 1e-3": Case({"blocks.servo": block(f"{OWN}:HurriedServo", **SERVO, pace=1.001)}),
    "servo filters its velocity, 30 ms": Case(
        {"blocks.servo": block(f"{OWN}:FilteredServo", **SERVO, time_constant="30 ms")}
    ),
    "rotors of 9 kg m^2": Case({"blocks.arm": block(f"{PLANTS}:GearedArm", rotor=9, **FRICTION)}),
    "springs of 1e4 N m/rad, encoders at the motors": Case(SPRINGS),
    "friction changes with the pose": Case({"blocks.rub": block(f"{PLANTS}:PoseFriction", size=[4, 4, 2], waves=2)}),
    "friction sticks and is uneven": Case(
        reality={"stribeck_friction": {"sticking": [4, 4, 2], "uneven": [1.6, 1.6, 0.8]}}
    ),
    "5 kg at half time, delay 1, steps": Case(reality=LATE | STEPS | PAYLOAD, configured=1),
    **{f"servo x {scale:g}": Case(servo(scale)) for scale in (0.1, 0.3, 3, 10)},
    **{f"servo x {scale:g}, delay 1, steps": Case(servo(scale), LATE | STEPS, 1) for scale in (0.1, 0.3, 3, 10)},
    "start off the path by 0.2 rad a joint": Case({"start.q": [q + 0.2 for q in START]}),
    "start 447 mm off the path": Case({"start.q": [q + 0.3524 for q in START]}),
    "path stops and goes": Case({"blocks.path": block(f"{PLANTS}:StopAndGo", **ROUND, rate=0.15, period="20 s")}),
    "arm nearly stretched": Case(STRETCHED),
    "w_0 x 0.03": Case({"inverse.w_0": 0.03 * 0.00125}),
    "w_0 x 30": Case({"inverse.w_0": 30 * 0.00125}),
    "a box without the truth": Case({"inverse.k_P_box": [0.2, 1.9], "inverse.friction_box": [0, 3]}),
    "a drive ends at 75 of 81 N m": Case(reality={"torque_limits": {"torque": [100, 75, 100]}}),
    "a drive ends at 75 of 81 N m, delay 1": Case(
        reality=LATE | {"torque_limits": {"torque": [100, 75, 100]}}, configured=1
    ),
    "manufacturer compensates gravity": Case({"arm.maker_gravity": 1}),
    "standing still": Case({"path.rate": 0}),
}


def changed(name: str, case: Case, seed: int = 0) -> dm.Graph:
    """A controller in a case; a predictor is configured for the delay."""
    graph = dm.load(dm.load(name).text, name=str(FOLDER / f"{name}.yaml"))  # its own blocks are there
    late = [label for label in graph.blocks if "delay" in type(graph.blocks[label]).model_fields]
    delays = {f"{label}.delay": case.configured for label in late if late != ["task"]}
    lacking = [key for key in case.values if "." in key and not _has(graph, key)]
    values = {key: value for key, value in case.values.items() if key not in lacking}
    if case.echoed:
        echoing = [label for label in graph.blocks if "echoed" in type(graph.blocks[label]).model_fields]
        values |= {f"{label}.echoed": True for label in echoing}
        values |= {f"wires.{label}.q_echo": "servo.q_c" for label in echoing}
    graph = graph.set({**delays, **values, "duration": f"{case.seconds} s", "seed": seed})
    return graph.reality(dict(case.reality)) if case.reality else graph


def _has(graph: dm.Graph, key: str) -> bool:
    """Whether a graph has the parameter: the baselines lack some of a law's parameters."""
    name, _, parameter = key.partition(".")
    if name in ("blocks", "start", "wires"):
        return True
    return name in graph.blocks and parameter in type(graph.blocks[name]).model_fields


def row_of(case: str, name: str) -> dict[str, Any]:
    """The row of the worst run [m]; for a graph that cannot be run in this way, the reason."""
    found = [_figures(case, name, seed) for seed in range(SEEDS if CASES[case].random else 1)]
    return max(found, key=lambda row: math.inf if row["diverged_at"] != "" or row["fault"] else row["rms_final"])


def _figures(case: str, name: str, seed: int) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(HEADS, "") | {"case": case, "graph": name}
    try:
        run = changed(name, CASES[case], seed).run(progress=False)
    except DmframeError as fault:
        return row | {"fault": str(fault).splitlines()[0].rpartition(".yaml:")[2]}
    error = run.error
    if error is None:
        return row | {"fault": "no error"}
    if run.divergence:
        return row | {"diverged_at": run.divergence.time}
    size = error.norm
    eighth = size.size // 8
    return row | {
        "rms_middle": float(np.sqrt(np.mean(size[4 * eighth : 5 * eighth] ** 2))),
        "rms_final": error.rms_final,
        "peak_after": float(np.max(size[run.time >= SETTLED])),
        "peak": float(np.max(size)),
    }


def table(rows: list[dict[str, str]]) -> Iterator[str]:
    """The table of the page."""
    yield f"| case | {' | '.join(CONTROLLERS.values())} |"
    yield "|---" * (1 + len(CONTROLLERS)) + "|"
    for case in CASES:
        mine = {row["graph"]: row for row in rows if row["case"] == case}
        if mine:
            cells = (_cell(mine[name]) if name in mine else "" for name in CONTROLLERS)
            yield f"| {case} | {' | '.join(cells)} |"


def _cell(row: Mapping[str, str]) -> str:
    if row["fault"]:
        return "-"
    if row["diverged_at"]:
        return f"**diverges** at {plain(float(row['diverged_at']), 's')}"
    final, peak = float(row["rms_final"]), float(row["peak_after"])
    return f"{_millimetres(final)} ({_millimetres(peak)})"


def _millimetres(error: float) -> str:
    return f"{1e3 * error:.3g}" if error > NOTHING else "0"


def read() -> list[dict[str, str]]:
    """The stored rows."""
    if not TABLE.exists():
        return []
    with TABLE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write(rows: list[dict[str, Any]]) -> None:
    """Write the table next to the page and into it."""
    order = [(case, name) for case in CASES for name in CONTROLLERS]
    rows.sort(key=lambda row: order.index((row["case"], row["graph"])))
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, HEADS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    draw()


def fill(text: str, rows: list[dict[str, str]]) -> str:
    """The page with the table of these rows."""
    before, _, rest = text.partition(BEGIN)
    return "".join([before, BEGIN, "\n", "\n".join(table(rows)), "\n", END, rest.partition(END)[2]])


def draw() -> None:
    """The page from the table."""
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), read()), encoding="utf-8")


def main(words: list[str]) -> None:
    """Compute the missing rows, and write them after each case."""
    if "--draw" in words:
        draw()
        return
    rows: list[dict[str, Any]] = [row for row in read() if row["case"] in CASES and row["case"] not in words]
    done = {(row["case"], row["graph"]) for row in rows}
    for case in words or CASES:
        for name in (name for name in CONTROLLERS if (case, name) not in done):
            rows.append(row_of(case, name))
            sys.stderr.write(f"{case}: {rows[-1]}\n")
        write(rows)


if __name__ == "__main__":
    main(sys.argv[1:])
