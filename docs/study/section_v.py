"""The comparison of Section V as a study: adaptive over kinematic error, for many servos, frictions and clocks.

    python docs/study/section_v.py           run everything, write section_v.csv, then draw
    python docs/study/section_v.py --draw    figures and table from section_v.csv alone

One row of the CSV is one run. Every run is a packaged graph with other numbers, so each can be had alone by ``dmframe
run GRAPH --set ...``, as `overrides` writes them.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import multiprocessing
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent
CSV, PAGE = FOLDER / "section_v.csv", FOLDER / "section_v.md"
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"

HORIZON = 100.531  # [s], 32 pi; its last eighth is two whole turns of the fast circle, one of the slow
SERVOS = (0.1, 0.3, 1.0, 3.0, 10.0)
FRICTIONS = (0.0, 1.0, 3.0)
CLOCKS = (0.002, 0.008, 0.03, 0.09)  # [s]
TASKS = ("fast", "slow")
CONTROLLERS = {"kinematic": None, "paper": None, "boxed_10": 10, "boxed_100": 100}
"""Gamma where it is ours; the boxed ones keep w in [0, 0.004] divided by the servo's factor."""

STIFF, DAMPED, SHAKY = (800, 800, 400), (1760, 1760, 880), (560, 560, 280)  # K_D, K_P, K_I of the packaged graphs
VISCOUS, COULOMB = (5, 5, 2), (8, 8, 4)
W_LARGEST = 0.004  # [rad/(N m s)], above every 1/K_star of the packaged servo
LIGHTEST = 0.6  # [kg m^2], the elbow's: about the least eigenvalue of the mass matrix at the start
SMOOTHED = 0.005  # [rad/s], the robot's friction_velocity


@dataclass(frozen=True)
class Cell:
    """One run: where on the map, and what came out; `diverged` is a time, or nothing."""

    task: str
    servo: float
    friction: float
    clock: float
    controller: str
    rms_mm: float = float("nan")
    diverged: float = float("nan")

    @property
    def place(self) -> tuple[str, float, float, float]:
        """Where on the map, whatever the controller."""
        return self.task, self.servo, self.friction, self.clock


def cells() -> list[Cell]:
    """Every run of the study."""
    product = itertools.product(TASKS, SERVOS, FRICTIONS, CLOCKS, CONTROLLERS)
    return [Cell(*each) for each in product]


def overrides(cell: Cell) -> tuple[str, list[str]]:
    """The packaged graph of a cell, and its ``--set`` values."""
    graph = f"ur10_{cell.task}" + ("_kinematic" if cell.controller == "kinematic" else "")
    servo = zip(("K_D", "K_P", "K_I"), (STIFF, DAMPED, SHAKY), strict=True)
    changes = [f"servo.{name}={_scaled(values, cell.servo)}" for name, values in servo]
    changes += [f"arm.viscous={_scaled(VISCOUS, cell.friction)}", f"arm.coulomb={_scaled(COULOMB, cell.friction)}"]
    changes += [f"clock={cell.clock:g}", f"duration={HORIZON}", f"solver.step={solver_step(cell):.3g}"]
    Gamma = CONTROLLERS[cell.controller]
    if Gamma is not None:
        changes += [f"dynamics.Gamma={Gamma}", f"inverse.w_box=[0, {W_LARGEST / cell.servo:.6g}]"]
    return graph, changes


def solver_step(cell: Cell) -> float:
    """A step [s] at which RK4 is stable: the friction law's slope at rest, and the servo, over the inertia."""
    slopes = zip(STIFF, VISCOUS, COULOMB, strict=True)
    # the elbow, the last, turns the lightest inertia
    *_, fastest = (cell.servo * K + cell.friction * (B + D / SMOOTHED) for K, B, D in slopes)
    return min(1e-3, 2.0 * LIGHTEST / fastest)


def _scaled(values: Iterable[float], factor: float) -> list[float]:
    return [float(f"{value * factor:.6g}") for value in values]


def run(cell: Cell) -> Cell:
    """Simulate a cell."""
    from dmframe.config.graph import load_graph
    from dmframe.results.metrics import tracking_error
    from dmframe.simulate import simulate

    name, changes = overrides(cell)
    graph = load_graph(name, changes)
    done = simulate(
        graph.diagram(), graph.file.duration, clock=graph.file.clock, solver=graph.solver, start=graph.start
    )
    if any("stiff" in notice for notice in done.notices):
        raise RuntimeError(f"{cell}: {done.notices}")
    if done.divergence is not None:
        return Cell(*cell.place, cell.controller, diverged=round(done.divergence.time, 3))
    error = tracking_error(done)
    return Cell(*cell.place, cell.controller, rms_mm=float(f"{error.rms_final * 1e3:.4g}"))


def ratios(rows: Iterable[Cell], controller: str) -> dict[tuple[str, float, float, float], float]:
    """RMS over that of the kinematic controller at the same place; inf where the adaptive one diverged."""
    found = {(cell.place, cell.controller): cell for cell in rows}
    told = dict[tuple[str, float, float, float], float]()
    for (place, name), cell in found.items():
        if name == controller:
            told[place] = np.inf if np.isfinite(cell.diverged) else cell.rms_mm / found[place, "kinematic"].rms_mm
    return told


def write(rows: Sequence[Cell]) -> None:
    """The CSV."""
    with CSV.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in fields(Cell)])
        writer.writerows(
            [
                ""
                if isinstance(value, float) and np.isnan(value)
                else f"{value:g}"
                if isinstance(value, float)
                else value
                for value in (getattr(row, field.name) for field in fields(Cell))
            ]
            for row in rows
        )


def read() -> list[Cell]:
    """The CSV's rows."""
    with CSV.open(encoding="utf-8") as file:
        return [
            Cell(
                row["task"],
                *(float(row[key]) for key in ("servo", "friction", "clock")),
                row["controller"],
                *(float(row[key] or "nan") for key in ("rms_mm", "diverged")),
            )
            for row in csv.DictReader(file)
        ]


TITLES = {"paper": "the paper's gains", "boxed_10": "Gamma = 10, w boxed", "boxed_100": "Gamma = 100, w boxed"}


def draw(rows: Sequence[Cell]) -> None:
    """One figure a task: controllers down, frictions across; in each field, servo across and sampling period down."""
    import matplotlib.pyplot as plt

    for task in TASKS:
        figure, axes = plt.subplots(len(TITLES), len(FRICTIONS), figsize=(10, 8.2), sharex=True, sharey=True)
        for line, controller in zip(axes, TITLES, strict=True):
            told = ratios(rows, controller)
            for axis, friction in zip(line, FRICTIONS, strict=True):
                field = [[told[task, servo, friction, clock] for servo in SERVOS] for clock in CLOCKS]
                _field(axis, np.array(field))
                axis.set_title(f"{TITLES[controller]}, friction x {friction:g}", fontsize=9)
        for axis in axes[-1]:
            axis.set_xticks(range(len(SERVOS)), [f"x {servo:g}" for servo in SERVOS])
            axis.set_xlabel("servo gains")
        for axis in axes[:, 0]:
            axis.set_yticks(range(len(CLOCKS)), [f"{clock * 1e3:g} ms" for clock in CLOCKS])
        figure.suptitle(
            f"{task} experiment: RMS task error, adaptive over kinematic (light: adaptation helps; div.: it diverges)"
        )
        figure.tight_layout()
        figure.savefig(FOLDER / f"section_v_{task}.png", dpi=100, metadata={"Software": None})
        plt.close(figure)


def _field(axis: Any, values: np.ndarray) -> None:
    shade = np.clip(np.log10(np.where(np.isfinite(values), values, 10.0)), -1.5, 1.0)
    axis.imshow(shade, cmap="Greys", vmin=-1.5, vmax=1.5, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        dark = shade[row, column] > 0.35
        text = f"{value:.2g}" if np.isfinite(value) else "div."
        weight = "bold" if value < 1 else "normal"
        axis.text(column, row, text, ha="center", va="center", color="w" if dark else "k", fontsize=9, weight=weight)


def table(rows: Sequence[Cell]) -> str:
    """Each servo and clock at the packaged friction: kinematic error, and the ratios."""
    found = {(cell.place, cell.controller): cell for cell in rows}
    told = {controller: ratios(rows, controller) for controller in TITLES}
    lines = [
        "| task | servo | period | kinematic | " + " | ".join(TITLES.values()) + " |",
        "|" + "---|" * (4 + len(TITLES)),
    ]
    for task, servo, clock in itertools.product(TASKS, SERVOS, CLOCKS):
        place = (task, servo, 1.0, clock)
        parts = [f"{told[controller][place]:.2g}" for controller in TITLES]
        parts = ["diverges" if part == "inf" else part for part in parts]
        kinematic = f"{found[place, 'kinematic'].rms_mm:.3g} mm"
        lines.append(f"| {task} | x {servo:g} | {clock * 1e3:g} ms | {kinematic} | " + " | ".join(parts) + " |")
    return "\n".join(lines)


def counts(rows: Sequence[Cell]) -> str:
    """How often each controller helps, hurts and diverges, out of all places."""
    lines = ["| task | controller | better by half | better | not better | diverges |", "|---|---|---|---|---|---|"]
    for task, controller in itertools.product(TASKS, TITLES):
        values = np.array([value for place, value in ratios(rows, controller).items() if place[0] == task])
        diverges = int(np.sum(np.isinf(values)))
        half, better = int(np.sum(values < 0.5)), int(np.sum((values >= 0.5) & (values < 1)))
        rest = len(values) - half - better - diverges
        lines.append(f"| {task} | {TITLES[controller]} | {half} | {better} | {rest} | {diverges} |")
    return "\n".join(lines)


def generated(rows: Sequence[Cell]) -> str:
    """What stands between the page's marks."""
    return f"{BEGIN}\n{counts(rows)}\n\n{table(rows)}\n{END}"


def fill(page: str, rows: Sequence[Cell]) -> str:
    """The page with its tables put in."""
    before, _, rest = page.partition(BEGIN)
    return before + generated(rows) + rest.partition(END)[2]


def main(arguments: Sequence[str]) -> None:
    """Run, write, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", action="store_true", help="from section_v.csv, without running")
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args(arguments)
    if not chosen.draw:
        with multiprocessing.Pool(chosen.processes) as pool:
            rows = list[Cell]()
            for row in pool.imap(run, cells(), chunksize=4):
                rows.append(row)
                sys.stderr.write(f"\r{len(rows)} of {len(cells())}")
        write(rows)
    rows = read()
    draw(rows)
    if PAGE.exists():
        PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), rows), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
