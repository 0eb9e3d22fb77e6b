"""The comparison of Section V as a study: adaptive over kinematic error, for many servos, frictions, clocks and gains.

    dmframe study docs/study/section_v_map.yaml --no-report        and section_v_boxed.yaml, section_v_unknowns.yaml
    python docs/study/section_v.py           gather their runs from studies/, write section_v.csv, then draw
    python docs/study/section_v.py --draw    figures and tables from section_v.csv alone

One row of the CSV is one run. Every run is a packaged graph with other numbers; ``dmframe study studies/section_v_map
--rerun N`` repeats a single one.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace
from itertools import product
from math import inf, isfinite, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np

from dmframe.common.errors import DmframeError

FOLDER = Path(__file__).parent
CSV, PAGE = FOLDER / "section_v.csv", FOLDER / "section_v.md"
STUDIES = ("section_v_map", "section_v_boxed", "section_v_unknowns")
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"

TASKS = {"fast": 0.008, "slow": 0.09}  # the paper's sampling periods [s]
FORMS = {"velocity": "(32)", "position": "(34)"}
"""The option `tie` of the PID inverse, and the paper's equation."""

# The map: effect of the servo's stiffness, of friction and of the clock on the benefit of adaptation.
SERVOS = (0.1, 0.3, 1.0, 3.0, 10.0)
FRICTIONS = (0.0, 1.0, 3.0)
CLOCKS = (0.002, 0.008, 0.03, 0.09)  # [s]
MAPPED = ("paper", "boxed_10", "boxed_100")

# The unknowns: quantities that are not in the paper, at its sampling periods. M_bar > 0 everywhere.
STIFFNESS = (0.3, 1.0, 3.0)
PROPORTIONAL = (0.5, 1.0, 3.0)  # of K_P/K_D = 2.2 1/s
INTEGRAL = (0.3, 1.0, 2.0)  # of K_I/K_D = 0.7 1/s^2
CHOSEN = ("paper", "tenth", "tenfold")

Place = tuple[str, float, float, float, float, float]


@dataclass(frozen=True)
class Cell:
    """One run: place, law, gains and results; `diverged` is a time, or nan."""

    task: str
    servo: float
    proportional: float
    integral: float
    friction: float
    clock: float
    form: str  # kinematic, velocity or position
    gains: str  # empty for the kinematic controller
    rms_mm: float = nan
    diverged: float = nan

    @property
    def place(self) -> Place:
        """The place, independent of the controller."""
        return self.task, self.servo, self.proportional, self.integral, self.friction, self.clock


def mapped() -> list[Place]:
    """The places of the map."""
    return [(task, servo, 1.0, 1.0, rub, T) for task, servo, rub, T in product(TASKS, SERVOS, FRICTIONS, CLOCKS)]


def unknown() -> list[Place]:
    """The places at which only quantities that are not in the paper vary."""
    each = product(TASKS.items(), STIFFNESS, PROPORTIONAL, INTEGRAL, FRICTIONS)
    return [(task, *unknowns, T) for (task, T), *unknowns in each]


def cells() -> list[Cell]:
    """Every run of the study, once."""
    found = dict[Cell, None]()
    for places, gains in ((mapped(), MAPPED), (unknown(), CHOSEN)):
        for place in places:
            found[Cell(*place, "kinematic", "")] = None
            found.update({Cell(*place, form, each): None for form, each in product(FORMS, gains)})
    return list(found)


def cell_of(values: Mapping[str, Any]) -> Cell:
    """The cell of a grid point of one of the studies."""
    task, form, gains = f"{values['controller']} ".split(" ", 2)
    return Cell(
        task,
        float(str(values["servo"]).removeprefix("x ")),
        *(float(values.get(key, 1.0)) for key in ("proportional", "integral", "friction")),
        float(values.get("clock", TASKS[task])),
        form,
        gains.strip(),
    )


def gather(folders: Iterable[Path]) -> list[Cell]:
    """All cells, from the folders of the studies."""
    from dmframe.study.results import Results

    found = dict[Cell, Cell]()
    for folder in folders:
        results = Results(folder)
        for row in results.frame.collect().iter_rows(named=True):
            cell = cell_of(results.study.points[row["point"]].values)
            if row["fault"] is not None:
                raise RuntimeError(f"{folder}: run {row['run']}: {row['fault']}")
            if row["diverged"]:
                found[cell] = replace(cell, diverged=float(f"{row['diverged_at']:.4g}"))
            else:
                found[cell] = replace(cell, rms_mm=float(f"{row['rms_final'] * 1e3:.4g}"))
    return [found[cell] for cell in cells()]


def ratios(rows: Iterable[Cell], form: str, gains: str) -> dict[Place, float]:
    """RMS over that of the kinematic controller at the same place; inf where the adaptive one diverged."""
    found = {(cell.place, cell.form, cell.gains): cell for cell in rows}
    return {
        place: inf if isfinite(cell.diverged) else cell.rms_mm / found[place, "kinematic", ""].rms_mm
        for (place, *law), cell in found.items()
        if law == [form, gains]
    }


def write(rows: Sequence[Cell]) -> None:
    """The CSV."""

    def text(value: Any) -> str:
        return value if isinstance(value, str) else "" if isnan(value) else f"{value:g}"

    with CSV.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in fields(Cell)])
        writer.writerows([text(value) for value in astuple(row)] for row in rows)


def read() -> list[Cell]:
    """The CSV's rows."""
    with CSV.open(encoding="utf-8") as file:
        return [
            Cell(
                row["task"],
                *(float(row[key]) for key in ("servo", "proportional", "integral", "friction", "clock")),
                row["form"],
                row["gains"],
                *(float(row[key] or "nan") for key in ("rms_mm", "diverged")),
            )
            for row in csv.DictReader(file)
        ]


TITLES = {
    "paper": "the paper's gains",
    "tenth": "Gamma = 0.1",
    "tenfold": "Gamma = 10",
    "boxed_10": "Gamma = 10, w boxed",
    "boxed_100": "Gamma = 100, w boxed",
}


def draw(rows: Sequence[Cell]) -> None:
    """A map a task, forms down and gains across; and all places of the unknowns, ordered by their ratio."""
    import matplotlib.pyplot as plt

    for task in TASKS:
        figure, axes = plt.subplots(len(FORMS), len(MAPPED), figsize=(11, 5.6), sharex=True, sharey=True)
        for line, form in zip(axes, FORMS, strict=True):
            for axis, gains in zip(line, MAPPED, strict=True):
                found = ratios(rows, form, gains)
                field = [[found[task, servo, 1.0, 1.0, 1.0, clock] for servo in SERVOS] for clock in CLOCKS]
                _field(axis, np.array(field))
                axis.set_title(f"{FORMS[form]} {TITLES[gains]}", fontsize=9)
        for axis in axes[-1]:
            axis.set_xticks(range(len(SERVOS)), [f"x {servo:g}" for servo in SERVOS])
            axis.set_xlabel("servo gains")
        for axis in axes[:, 0]:
            axis.set_yticks(range(len(CLOCKS)), [f"{clock * 1e3:g} ms" for clock in CLOCKS])
        figure.suptitle(f"{task}: RMS task error, adaptive over kinematic (bold: adaptation helps; div.: it diverges)")
        _save(figure, f"section_v_{task}.png")

    figure, axes = plt.subplots(1, len(TASKS), figsize=(11, 4.2), sharey=True)
    for axis, task in zip(axes, TASKS, strict=True):
        for (form, number), gains in product(FORMS.items(), CHOSEN):
            values = sorted(_of(rows, unknown(), task, form, gains))
            look = {
                "color": {"velocity": "C0", "position": "C1"}[form],
                "ls": {"paper": "-", "tenth": ":"}.get(gains, "--"),
            }
            axis.semilogy(np.minimum(values, 99), label=f"{number}, {TITLES[gains]}", **look)
        axis.axhline(1, color="k", lw=0.8)
        axis.set(title=f"{task}, {TASKS[task] * 1e3:g} ms", xlabel="places, ordered by the ratio", ylim=(0.01, 10))
    axes[0].set_ylabel("RMS task error, adaptive over kinematic")
    axes[0].legend(fontsize=8)
    _save(figure, "section_v_unknown.png")


def _save(figure: Any, name: str) -> None:
    import matplotlib.pyplot as plt

    figure.tight_layout()
    figure.savefig(FOLDER / name, dpi=100, metadata={"Software": None})
    plt.close(figure)


def _field(axis: Any, values: np.ndarray) -> None:
    shade = np.clip(np.log10(np.where(np.isfinite(values), values, 10.0)), -1.5, 1.0)
    axis.imshow(shade, cmap="Greys", vmin=-1.5, vmax=1.5, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        dark = shade[row, column] > 0.35
        text = f"{value:.2g}" if np.isfinite(value) else "div."
        weight = "bold" if value < 1 else "normal"
        axis.text(column, row, text, ha="center", va="center", color="w" if dark else "k", fontsize=9, weight=weight)


def _of(rows: Sequence[Cell], places: Iterable[Place], task: str, form: str, gains: str) -> list[float]:
    found = ratios(rows, form, gains)
    return [found[place] for place in places if place[0] == task]


def counts(rows: Sequence[Cell], places: Sequence[Place], chosen: Sequence[str]) -> str:
    """How often each law helps, hurts and diverges, out of the places of each task."""
    lines = ["| task | gains | form | better by half | better | not better | diverges |", "|" + "---|" * 7]
    for task, gains, (form, number) in product(TASKS, chosen, FORMS.items()):
        values = np.array(_of(rows, places, task, form, gains))
        half, better, diverges = np.sum(values < 0.5), np.sum(values < 1), np.sum(np.isinf(values))
        parts = (half, better - half, len(values) - better - diverges, diverges)
        lines.append(f"| {task} | {TITLES[gains]} | {number} | " + " | ".join(map(str, parts)) + " |")
    return "\n".join(lines)


def table(rows: Sequence[Cell]) -> str:
    """Each servo and clock at the packaged ratios and friction: kinematic error, and the ratios."""
    kinematic = {cell.place: cell.rms_mm for cell in rows if cell.form == "kinematic"}
    laws = list(product(MAPPED, FORMS))
    found = {law: ratios(rows, law[1], law[0]) for law in laws}
    heads = [f"{TITLES[gains]} {FORMS[form]}" for gains, form in laws]
    lines = ["| task | servo | period | kinematic | " + " | ".join(heads) + " |", "|" + "---|" * (4 + len(laws))]
    for task, servo, clock in product(TASKS, SERVOS, CLOCKS):
        place = (task, servo, 1.0, 1.0, 1.0, clock)
        parts = [f"{value:.2g}" if isfinite(value := found[law][place]) else "diverges" for law in laws]
        first = f"| {task} | x {servo:g} | {clock * 1e3:g} ms | {kinematic[place]:.3g} mm | "
        lines.append(first + " | ".join(parts) + " |")
    return "\n".join(lines)


def generated(rows: Sequence[Cell]) -> str:
    """The text between the page's marks."""
    parts = (
        "What the paper does not give varied, at its sampling periods:",
        counts(rows, unknown(), CHOSEN),
        "The map:",
        counts(rows, mapped(), MAPPED),
        "Each servo and period of the map at the graphs' friction:",
        table(rows),
    )
    return f"{BEGIN}\n" + "\n\n".join(parts) + f"\n{END}"


def fill(page: str, rows: Sequence[Cell]) -> str:
    """The page with its tables put in."""
    before, _, rest = page.partition(BEGIN)
    return before + generated(rows) + rest.partition(END)[2]


def main(arguments: Sequence[str]) -> None:
    """Gather, write, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", action="store_true", help="from section_v.csv alone")
    parser.add_argument("folder", nargs="?", default="studies", help="where dmframe study left the three studies")
    given = parser.parse_args(arguments)
    if not given.draw:
        try:
            write(gather(Path(given.folder, name) for name in STUDIES))
        except DmframeError as error:
            parser.exit(2, f"{error}\n")
    rows = read()
    draw(rows)
    if PAGE.exists():
        PAGE.write_text(fill(PAGE.read_text(encoding="utf-8"), rows), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
