"""The figures of a run, and of several runs overlaid."""

from __future__ import annotations

from pathlib import Path

from dmframe.results.command_figure import command_figure
from dmframe.results.drawn_runs import Runs
from dmframe.results.error_figure import error_figure
from dmframe.results.estimate_figure import estimate_figure
from dmframe.results.path_figure import path_figure
from dmframe.results.plotting import save


def save_figures(runs: Runs, folder: Path) -> list[str]:
    """Write every figure that the runs allow, as PNG and SVG, and return their names.

    ``error``, ``path``, ``commands``, and for each run that estimates something ``estimates`` (``estimates_<name>``
    where there are several runs).
    """
    made = {"error": error_figure(runs), "path": path_figure(runs), "commands": command_figure(runs)}
    for name, run in runs.items():
        made["estimates" if len(runs) == 1 else f"estimates_{name}"] = estimate_figure(name, run)
    written = {name: figure for name, figure in made.items() if figure is not None}
    for name, figure in written.items():
        save(figure, folder, name, about=", ".join(runs))
    return list(written)
