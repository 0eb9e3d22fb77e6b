"""Figures of one run or of several runs overlaid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, final

from dmframe.common import notebook
from dmframe.common.errors import OutputError
from dmframe.common.files import expanded, write_bytes, writing
from dmframe.common.plotting import FORMATS, checked_formats, files_of
from dmframe.results.command_figure import command_figure
from dmframe.results.effort_figure import effort_figure
from dmframe.results.error_figure import error_figure
from dmframe.results.estimate_figure import estimate_figure
from dmframe.results.path_figure import path_figure
from dmframe.results.place import FIGURES, OF_EACH
from dmframe.results.plotting import Runs
from dmframe.results.run import Run
from dmframe.results.signal_figure import signal_figure
from dmframe.results.storage_figure import storage_figure


@final
@dataclass(frozen=True, repr=False)
class Figures(Mapping[str, Any]):
    """Matplotlib figures by name; a notebook shows them all.

    Parameters
    ----------
    about
        Names of the runs.
    """

    made: Mapping[str, Any]
    about: str

    def save(self, folder: str | Path, formats: Sequence[str] = FORMATS[:1]) -> list[Path]:
        """Write the figures to a folder as ``svg``, ``png`` or ``pdf``; raises `OutputError` on failure."""
        place, files = expanded(folder), list[Path]()
        formats = checked_formats("save", formats)
        if place.suffix in (".png", ".svg", ".pdf"):
            raise OutputError(f"{place}: expected a folder, found the name of a file; use savefig of a single figure")
        with writing(place, "figures"):
            place.mkdir(parents=True, exist_ok=True)
        for name, figure in self.items():
            for file, content in files_of(figure, name, self.about, formats).items():
                write_bytes(place / file, content)
                files.append(place / file)
        return files

    def __getitem__(self, name: str) -> Any:
        return self.made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.made)

    def __len__(self) -> int:
        return len(self.made)

    def __repr__(self) -> str:
        return f"<Figures of {self.about}: {', '.join(self) or 'none'}>"

    def _repr_html_(self) -> str:
        return "".join(notebook.picture(figure, f"{name} of {self.about}") for name, figure in self.items())


def figures_of(runs: Mapping[str, Run]) -> Figures:
    """All applicable figures: ``error``, ``path``, ``commands``, ``effort``, and by run ``storage`` and ``estimates``.

    With several runs, the last two are ``storage_<name>`` and ``estimates_<name>``.
    """
    made = {name: make() for name, make in makers(runs).items()}
    return Figures({name: figure for name, figure in made.items() if figure is not None}, ", ".join(runs))


def makers(runs: Mapping[str, Run]) -> dict[str, partial[Any]]:
    """Functions that draw the figures, by name."""
    recordings = _recordings(runs)
    made: dict[str, partial[Any]] = {
        name: partial(figure, recordings)
        for name, figure in zip(FIGURES, (error_figure, path_figure, command_figure, effort_figure), strict=True)
    }
    for name, run in runs.items():
        own = (partial(storage_figure, name, run), partial(estimate_figure, name, run.recording))
        made |= {kind if len(runs) == 1 else f"{kind}_{name}": make for kind, make in zip(OF_EACH, own, strict=True)}
    return made


def _recordings(runs: Mapping[str, Run]) -> Runs:
    return {name: run.recording for name, run in runs.items()}


def signals_figure(runs: Mapping[str, Run], labels: Sequence[str]) -> Figures:
    """Figure of signals over time, a panel each; raises `UnknownNameError` for a signal that no run recorded."""
    return Figures({"signals": signal_figure(_recordings(runs), labels)}, ", ".join(runs))


def error_picture(runs: Mapping[str, Run]) -> str:
    """HTML picture of the tracking error; empty without a goal."""
    figure = error_figure(_recordings(runs))
    return "" if figure is None else notebook.picture(figure, f"tracking error of {', '.join(runs)}")
