"""The entrant of the packaged race on cells drawn at random: ``python docs/study/fresh_cells.py RACE_FOLDER [SEED]``.

RACE_FOLDER contains the results of ``dmframe race``: all laws run with the values that were chosen there. Each
cell has its own plant, path, sampling period and channel, drawn with SEED. The entrant runs with probe
seeds that the race does not use, its rivals once. `silent` is the inverse of J that the aggregation uses before the
delay is identified and after a trip: its probe excites nothing and never identifies a delay.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from ruamel.yaml import YAML

from dmframe.catalogue import find_race
from dmframe.race.compute import Kept, computed
from dmframe.race.plan import Cell, Race, Run
from dmframe.race.read import load_race

CELLS: Final = 20
PROBES: Final = (11, 12, 13, 14, 15)
"""Seeds of a run; the race has 1 and 2."""
CLOCKS: Final = (0.008, 0.02, 0.09)
SILENT: Final = {"probe.lasting": "1e9 s", "probe.probe": 1e-12}
"""Without an excitation, so that no delay is identified."""


def plant(rng: np.random.Generator) -> dict[str, Any]:
    """A PID servo or a P-PI cascade, friction, and for every third plant a load after half of the time."""
    stiffness, rubbing = math.exp(rng.uniform(math.log(0.6), math.log(2.5))), rng.uniform(0.5, 2)
    K = np.array([800, 800, 400]) * stiffness
    if rng.random() < 0.5:
        k_P, k_I = rng.uniform(1.5, 4), rng.uniform(0.5, 3)
        servo = {"type": "pid_servo", "K_D": rounded(K), "K_P": rounded(k_P * K), "K_I": rounded(k_I * K)}
    else:
        share = (0.0, 1.0, float(rng.uniform(0.1, 0.95)))[rng.integers(3)]
        gains = {"k_p": rounded(rng.uniform(8, 22)), "K_v": rounded(K), "K_i": rounded(rng.uniform(4, 11) * K)}
        lags = {"velocity_filter": "2 ms", "torque_lag": "1 ms"}
        servo = {"type": "p_pi_servo", **gains, "feed_forward": rounded(share), **lags}
    load = [rounded(rng.uniform(1, 5)) if rng.random() < 1 / 3 else 0]
    friction = {"viscous": rounded(rubbing * np.array([5, 5, 2])), "coulomb": rounded(rubbing * np.array([8, 8, 4]))}
    return {"servo": servo, "arm": {"type": "loaded_manipulator", **friction, "payload": load, "payload_at": [30]}}


def path(rng: np.random.Generator) -> dict[str, Any]:
    """Four circles; half of the paths repeat, and a quarter stop every few seconds."""
    radius, rate, repeats = np.zeros(4), np.zeros(4), rng.random() < 0.5
    count, slow = int(rng.integers(1, 4)), rng.uniform(0.4, 0.9)
    radius[:count] = rng.uniform(0.03, 0.06, count)
    signs = rng.choice([-1, 1], count)
    rate[:count] = slow * signs * (np.arange(1, count + 1) if repeats else np.sort(rng.uniform(1, 2, count)))
    if not repeats and count == 1:
        radius[1], rate[1] = 0.03, -1.618034 * rate[0]
    made = {"type": "epicycles", "center": [-0.4, 0.5, 0.5], "radius": rounded(radius), "rate": rounded(rate)}
    made["phase"] = rounded(rng.uniform(0, 6, 4))
    if rng.random() < 0.25:  # a path with stops repeats only with them
        return {**made, "stop": 1, "every": f"{rounded(rng.uniform(3, 6))} s"}
    return {**made, "repeats": rounded(slow)} if repeats else made


def rounded(values: Any) -> Any:
    """Rounded to four digits, as YAML writes them."""
    return json.loads(json.dumps(np.vectorize(lambda value: float(f"{value:.4g}"))(values).tolist()))


def drawn(race: Race, seed: int) -> tuple[dict[str, Any], list[Cell]]:
    """The race's document with other plants and paths and the law `silent`, and one cell for each of them."""
    rng, text = np.random.default_rng(seed), YAML(typ="safe").load(race.text)
    cells = list[Cell]()
    for k in range(CELLS):
        text["plants"][f"plant_{k}"], text["paths"][f"path_{k}"] = plant(rng), path(rng)
        reality = ("ideal", "ur")[k % 2]
        cells.append(Cell(CLOCKS[k // 2 % 3], f"path_{k}", f"plant_{k}", reality))
    entrant = text["laws"][race.file.entrant]
    text["laws"]["silent"] = {**entrant, "set": SILENT}
    return text, cells


def main(folder: Path, seed: int) -> None:
    """Draw the cells, run all laws, and print a line for each cell and the proportions."""
    packaged = find_race("packaged")
    text, cells = drawn(load_race("packaged"), seed)
    out = folder / f"fresh_{seed}"
    out.mkdir(exist_ok=True)
    for law in text["laws"].values():  # the race's own graphs are in the folder of its file
        graphs = law["graph"] if isinstance(law["graph"], dict) else {}
        for key, name in graphs.items():
            if str(name).endswith(".yaml"):
                graphs[key] = str(packaged.parent / name)
    with (out / "race.yaml").open("w") as file:
        YAML().dump(text, file)
    race, chosen = load_race(str(out / "race.yaml")), values_in(folder)
    runs = {cell: runs_of(race, cell, chosen) for cell in cells}
    errors = computed(race, [run for each in runs.values() for run in each], Kept(out))
    report(race.file.entrant, runs, errors)


def values_in(folder: Path) -> Mapping[tuple[str, float], Any]:
    """The chosen values of each law at each sampling period; None for a law without an accepted candidate."""
    rows = json.loads((folder / "tuned.json").read_text(encoding="utf-8"))
    return {(row["law"], row["clock"]): row["values"] for row in rows}


def runs_of(race: Race, cell: Cell, chosen: Mapping[tuple[str, float], Any]) -> list[Run]:
    """The entrant with each probe seed, and every other law once."""
    found = list[Run]()
    for law in race.file.laws:
        values = chosen[race.file.entrant if law == "silent" else law, cell.clock]
        seeds = PROBES if law == race.file.entrant else PROBES[:1]
        found += [Run(law, cell, tuple(values.items()), seed) for seed in seeds if values is not None]
    return found


def report(entrant: str, runs: Mapping[Cell, Sequence[Run]], errors: Mapping[Run, float]) -> None:
    """A line for each cell, and the proportions over all seeds and those cells in which some rival does not diverge."""
    ratios, silent = list[float](), list[float]()
    for cell, each in runs.items():
        own = [errors[run] for run in each if run.law == entrant]
        rivals = {run.law: errors[run] for run in each if run.law not in (entrant, "silent")}
        best = min(rivals, key=lambda law: rivals[law])
        figures = " ".join(f"{error:.4f}" for error in own)
        if not math.isfinite(rivals[best]):
            say(f"{cell.name}: {figures} mm; every rival diverges, so that it is left out")
            continue
        ratios += [error / rivals[best] for error in own]
        silent += [error / errors[run] for run in each if run.law == "silent" for error in own]
        say(f"{cell.name}: {figures} mm; {best} {rivals[best]:.4f}; ratio {max(own) / rivals[best]:.2f} at most")
    found, trip = np.array(ratios), np.array(silent)
    say(f"{len(found)} runs: {np.mean(found <= 1.05):.0%} at most 1.05, median {np.median(found):.2f}")
    say(f"largest ratio {found.max():.2f}, to the inverse of J after a trip {trip.max():.2f}")


def say(line: str) -> None:
    """Print a line."""
    sys.stdout.write(f"{line}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 29)
