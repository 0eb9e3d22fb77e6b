"""Figures of runs, drawn in forked processes while this one runs the graphs, evaluates V and writes the data."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, final

from dmframe.common.copies import Later, shared
from dmframe.common.errors import DmframeError
from dmframe.common.plotting import files_of, loaded
from dmframe.config import BaseGraph
from dmframe.remembered.recorder import end
from dmframe.results.figures import makers
from dmframe.results.place import FIGURES
from dmframe.results.run import Run
from dmframe.results.storage_figure import StoragePicture, storage_figure, storage_picture
from dmframe.simulate import Recording

LARGE = 200_000_000
"""Size of recordings [bytes] above which they are not sent to waiting processes, since that requires a copy."""

Sent = Sequence[tuple[str, str, Mapping[str, Any]]]
"""Name of the curves, label and recording without its diagram, for each run."""


@final
class Drawing:
    """Processes that draw the figures of runs.

    They are started before the runs, since they have to import matplotlib, and get the runs by `begin`. V is sent by
    `files`, when this process has evaluated it. Without such processes, `files` does all steps.
    """

    def __init__(self, graphs: Sequence[BaseGraph], formats: Sequence[str], stack: ExitStack) -> None:
        self._graphs, self._formats, self._stack = graphs, formats, stack
        self._process, self._known = os.getpid(), dict[str, Run]()
        self._sent, self._pictures = Later[Sent](), Later[Mapping[str, StoragePicture]]()
        self._finished: Callable[[], list[dict[str, bytes]]] = list

    def start(self) -> None:
        """Start the processes."""
        if not self._formats:
            return
        # the first figures are the fastest, so several processes end together; V is drawn last
        numbers = reversed(range(len(FIGURES) + len(self._graphs)))
        jobs = [*(partial(self._early, number) for number in numbers)]
        jobs += [partial(self._stored, number) for number in range(len(self._graphs))]
        later = (self._sent, self._pictures)
        self._finished = self._stack.enter_context(shared(jobs, busy=True, forks_only=True, later=later))

    def begin(self, runs: Mapping[str, Run]) -> None:
        """Draw the runs of the first graphs, by the names of their curves."""
        self._known = dict(runs)
        recordings = [run.recording for run in runs.values()]
        rows = [part for run in recordings for part in (*run.states.values(), *run.outputs.values())]
        if self._formats and sum(part.nbytes for part in rows) > LARGE:
            self._stack.pop_all().close()  # a new process shares the memory
            self.start()
        else:
            self._sent.give([(name, run.label, _without_diagram(run.recording)) for name, run in runs.items()])

    def files(self, known: Mapping[str, Run]) -> dict[str, bytes]:
        """Contents of all figure files by name; the runs `known` may have V already."""
        if not self._formats:
            return {}
        self._pictures.give({name: picture for name, run in known.items() if (picture := _picture(name, run))})
        return {name: content for found in self._finished() for name, content in found.items()}

    def _runs(self) -> dict[str, Run]:
        if not self._known:
            for graph, (name, label, recorded) in zip(self._graphs, self._sent.take(), strict=False):
                self._known[name] = Run(graph, Recording(diagram=graph.diagram, **recorded), label)
        return self._known

    def _early(self, number: int) -> dict[str, bytes]:
        """The files of one of the figures without V."""
        self._load()
        wanted = [item for item in makers(self._runs()).items() if item[1].func is not storage_figure]
        return self._files(*wanted[number]) if number < len(wanted) else {}

    def _stored(self, number: int) -> dict[str, bytes]:
        """The files of the figure of V of a run."""
        self._load()
        runs, pictures = self._runs(), self._pictures.take()
        wanted = [name for name, make in makers(runs).items() if make.func is storage_figure]
        name = list(runs)[number] if number < len(runs) else ""
        if name not in pictures:
            return {}
        return self._files(wanted[number], partial(storage_picture, pictures[name], runs[name].recording))

    def _load(self) -> None:
        """Import matplotlib; what a process reads to draw is not an input of a run's conclusions."""
        here = os.getpid() == self._process
        if not here:
            end()
        loaded(documented=here)

    def _files(self, name: str, make: Callable[[], Any]) -> dict[str, bytes]:
        figure = make()
        return {} if figure is None else files_of(figure, name, ", ".join(self._runs()), self._formats)


@contextmanager
def drawing(graphs: Sequence[BaseGraph], formats: Sequence[str]) -> Iterator[Drawing]:
    """Start to draw the runs of graphs; the processes end with the context."""
    with ExitStack() as stack:
        made = Drawing(graphs, formats, stack)
        made.start()
        yield made


@contextmanager
def drawing_of(runs: Mapping[str, Run], formats: Sequence[str]) -> Iterator[Drawing]:
    """Start to draw runs; the processes share their memory, and end with the context."""
    with ExitStack() as stack:
        made = Drawing([run.graph for run in runs.values()], formats, stack)
        made.begin(runs)
        made.start()
        yield made


def _without_diagram(recording: Recording) -> dict[str, Any]:
    return {name: value for name, value in vars(recording).items() if name != "diagram"}


def _picture(name: str, run: Run) -> StoragePicture | None:
    try:
        return StoragePicture.of(name, run)
    except DmframeError:
        return None
