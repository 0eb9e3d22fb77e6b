"""Whether the identified delay is the best one: ``python docs/study/identified_delay.py [CLOCK ...] > FILE.csv``, in s.

The entrant of the packaged race, with the values of its graphs, runs in ideal cells of this race with every plant. Its
probe identifies a delay, and the other blocks use this one, or one that is a sample shorter or longer. The trip of the
probe, which would replace a delay that is too short, is off. A load is carried from the beginning: after its change the
error is that of a model that adapts, with any delay. A line for each cell: the identified delay in samples, and the RMS
error over the last eighth with each of the three, in mm; inf for a run that diverged, and nothing for a delay below 0.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from dmframe.batch.figures import ERROR, MeasuredSignals
from dmframe.batch.runner import Runner, Runs
from dmframe.graph.graph import Graph
from dmframe.race.plan import Cell, Race, Run
from dmframe.race.read import load_race

PATHS: Final = ("stops", "wander", "eight")
SHIFTS: Final = (0, -1, 1)
OWN: Final = "shifted_delay.py:ShiftedDelay"


@dataclass(frozen=True)
class Row:
    """Errors in a cell [mm], by the shift of the delay; a shift to below 0 is absent."""

    cell: Cell
    delay: int
    errors: dict[int, float]

    @property
    def line(self) -> str:
        """The row of the table."""
        figures = [f"{self.errors[shift]:.3g}" if shift in self.errors else "" for shift in sorted(SHIFTS)]
        return ",".join([f"{self.cell.clock:g}", self.cell.path, self.cell.plant, str(self.delay), *figures])


def shifted(race: Race, cell: Cell, shift: int, seed: int, like: Graph | None) -> Graph:
    """The entrant in a cell, with a delay that is longer by `shift` than the identified one."""
    entrant = race.file.entrant
    document = race.document_of(Run(entrant, cell, race.laws[entrant, cell.clock].own, seed))
    here = replace(document, name=str(Path(__file__).with_name("shifted.yaml")))  # its blocks are found in this folder
    wires = {f"wires.{name}.delay_hat": "shifted.delay_hat" for name in ("task", "inverse", "mix")}
    own = {"blocks.shifted": {"type": OWN, "shift": shift}, "wires.shifted.delay_probed": "probe.delay_hat"}
    return Graph.of(here, like).set({"probe.tripping": False, "arm.payload_at": [0], **own, **wires})


def rows(race: Race, cells: Sequence[Cell], seed: int = 1) -> Iterator[Row]:
    """The errors in these cells, which should have one loop structure."""
    runner, graphs = Runner(), list[Graph]()
    for cell in cells:
        graphs += [shifted(race, cell, shift, seed, graphs[-1] if graphs else None) for shift in SHIFTS]
    wanted = MeasuredSignals(("probe.delay_hat", "probe.identified"))
    measured = runner.measure([Runs(graph) for graph in graphs], lambda _: wanted, threads=1)
    for k, cell in enumerate(cells):
        found = [each.signals for each in measured[k * len(SHIFTS) : (k + 1) * len(SHIFTS)]]
        delay, known = (round(float(found[0][label].last[0, 0])) for label in wanted.signals)
        if not known:
            raise RuntimeError(f"{cell.name}: the probe identified no delay")
        errors = [1000 * float(signals[ERROR].rms_by_eighth[0, 0, -1]) for signals in found]
        errors = [error if error < 1000 * race.file.limit else math.inf for error in errors]
        yield Row(cell, delay, {k: error for k, error in zip(SHIFTS, errors, strict=True) if delay + k >= 0})


def main(clocks: Sequence[float]) -> None:
    """Print the table."""
    race = load_race("packaged")
    sys.stdout.write("clock_s,path,plant,delay,shorter_mm,identified_mm,longer_mm\n")
    for clock in clocks or race.file.clocks:
        for family in ("pid", "p_pi"):
            plants = [name for name in race.file.plants if name.startswith(family)]
            for row in rows(race, [Cell(clock, path, plant, "ideal") for plant in plants for path in PATHS]):
                sys.stdout.write(f"{row.line}\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main([float(text) for text in sys.argv[1:]])
