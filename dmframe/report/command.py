"""The command line that does something with a graph as it stands."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple

from dmframe.catalogue import graphs
from dmframe.config import Experiment
from dmframe.files import is_file

ENDINGS = (".yaml", ".yml")


class Command(NamedTuple):
    """What a shell reads, and what must be done before it; `before` is empty where nothing must.

    ``--set`` reaches the blocks in `swapped` as ``baseline.block.parameter``.
    """

    text: str
    before: str
    swapped: tuple[str, ...] = ()


def command(experiment: Experiment, verb: str) -> Command:
    """``dmframe VERB GRAPH --set ...``, quoted; of a graph that is no file, for the file into which its text goes.

    So it is, too, of a baseline, but where VERB is ``run``, which runs the graph beside it.
    """
    own, path, known = experiment.name, experiment.document.name, graphs()
    packaged = [name for name, place in known.items() if str(place) == path]
    file = Path(path).suffix.lower() in ENDINGS or is_file(Path(path))
    swapped = experiment.swapped
    if (packaged or file) and (swapped is None or verb == "run"):
        changes = [word for text in experiment.overrides for word in ("--set", text)]
        words = ["dmframe", verb, *(packaged[:1] or [path]), *["--baseline"] * (swapped is not None), *changes]
        return Command(shlex.join(words), "", swapped or ())
    return Command(shlex.join(["dmframe", verb, f"{own}.yaml"]), f"the graph's text in {own}.yaml")
