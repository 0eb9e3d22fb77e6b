"""Figures drawn in processes that start before the runs."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import nullcontext
from typing import Any

import pytest

from dmframe.common.plotting import files_of
from dmframe.graph.load import load
from dmframe.results import drawing_process
from dmframe.results.drawing_process import drawing
from dmframe.results.figures import figures_of
from dmframe.results.folder import named
from dmframe.results.run import Run

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="no forks elsewhere")


@pytest.fixture(scope="module")
def two() -> list[Run]:
    """Runs of two graphs, one without V."""
    graphs = [load("pendulum").until(0.2), load("arm2_joint").until(0.2)]
    return [graph.run(judge=False) for graph in graphs]


def alone(runs: list[Run]) -> dict[str, bytes]:
    """The files as drawn by this process."""
    figures = figures_of(named(runs))
    files = [files_of(figure, name, figures.about) for name, figure in figures.items()]
    return {name: content for item in files for name, content in item.items()}


@pytest.fixture(scope="module")
def expected(two: list[Run]) -> dict[str, bytes]:
    """The files of both, drawn once."""
    return alone(two)


@pytest.mark.parametrize(("cores", "large"), [(1, False), (2, False), (4, False), (2, True)])
def test_processes_draw_the_same_bytes_as_this_one(
    two: list[Run], expected: dict[str, bytes], cores: int, large: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also runs that are too large to be copied, and without a drawing process."""
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: cores)
    monkeypatch.setattr(drawing_process, "LARGE", 0 if large else drawing_process.LARGE)
    with drawing([run.graph for run in two], ["svg"]) as drawn:
        drawn.begin(named(two))
        found = drawn.files(named(two))
    assert found == expected
    assert {"error.svg", "storage_pendulum.svg", "estimates_pendulum.svg"} <= set(found)


def test_of_fewer_runs_than_graphs_only_those_are_drawn(two: list[Run], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 2)
    with drawing([run.graph for run in two], ["svg"]) as drawn:
        drawn.begin(named(two[:1]))
        assert drawn.files(named(two[:1])) == alone(two[:1])


@LINUX
def test_a_process_that_was_killed_loses_no_figure(
    two: list[Run], expected: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dmframe.common.copies._cores", lambda: 2)
    here = os.getpid()

    def killed(*given: Any) -> dict[str, bytes]:
        if os.getpid() != here:
            os._exit(9)
        return files_of(*given)

    monkeypatch.setattr(drawing_process, "files_of", killed)
    with drawing([run.graph for run in two], ["svg"]) as drawn:
        drawn.begin(named(two))
        assert drawn.files(named(two)) == expected


@LINUX
def test_without_docstrings_matplotlib_draws_the_same() -> None:
    """In a new process each, since the tests' own has imported it."""
    code = (
        "from dmframe.common.plotting import figure_svg, loaded, new_figure, settle; loaded(documented={}); "
        "from matplotlib.lines import Line2D; figure = new_figure(3, 2); axes = figure.subplots(); "
        "axes.plot([0, 1], [1, 3], label='x'); axes.legend(); settle(figure); "
        "print(bool(Line2D.set.__doc__)); print(figure_svg(figure))"
    )
    first, second = (
        subprocess.run([sys.executable, "-c", code.format(given)], capture_output=True, text=True, check=True).stdout
        for given in (True, False)
    )
    assert first.startswith("True\n<?xml")
    assert second == "False" + first.removeprefix("True")


def test_figures_whose_texts_are_measured_once_are_the_same(
    two: list[Run], expected: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also as PNG, whose texts are measured by another renderer, and after a change of limits."""

    def with_others(files: dict[str, bytes]) -> dict[str, bytes]:
        figure = figures_of(named(two))["error"]
        figure.axes[0].set_ylim(-3.0, 3.0)
        return files | files_of(figure, "changed", "", ("svg", "png", "pdf"))

    found = with_others(expected)
    monkeypatch.setattr("dmframe.common.plotting.measured_once", nullcontext)
    assert found == with_others(alone(two))
