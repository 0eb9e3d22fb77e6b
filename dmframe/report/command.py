"""The command line that does something with a graph as it stands."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple

from dmframe.catalogue import graphs
from dmframe.config import Experiment

ENDINGS = (".yaml", ".yml")


class Command(NamedTuple):
    """What a shell reads, and what must be done before it; `before` is empty where nothing must."""

    text: str
    before: str


def command(experiment: Experiment, verb: str) -> Command:
    """``dmframe VERB GRAPH --set ...``, quoted; of a graph that is no file, for the file into which its text goes."""
    own, path = experiment.name, experiment.document.name
    known = graphs()
    changes = [word for text in experiment.overrides for word in ("--set", text)]
    if own in known and str(known[own]) == path:
        return Command(shlex.join(["dmframe", verb, own, *changes]), "")
    if Path(path).suffix.lower() in ENDINGS:
        return Command(shlex.join(["dmframe", verb, path, *changes]), "")
    file = f"{own}.yaml"
    return Command(shlex.join(["dmframe", verb, file]), f"the graph's text in {file}")
