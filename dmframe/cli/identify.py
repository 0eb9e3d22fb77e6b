"""``dmframe identify``: the servo, delay, friction and base parameters of a robot, from a log."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import NOTHING, home, robot_names
from dmframe.cli.streams import tell

UNKNOWN = 1


def identify(
    log: Annotated[str, typer.Argument(metavar="LOG", help="A CSV or Parquet file of commands and positions.")],
    robot: Annotated[str, typer.Argument(help="A robot's name, a URDF file, or a graph.", autocompletion=robot_names)],
    columns: Annotated[
        list[str], typer.Option(metavar="NAME=COLUMN", help="The column of a signal: q_1=shoulder; may be repeated.")
    ] = NOTHING,
    out: Annotated[Path | None, typer.Option(metavar="DIR", callback=home, help="Folder for identified.json.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Identify a closed servo, the delay, friction and base parameters from a log, with intervals.

    Exit status 1 if no class of servo explains the log.
    """
    from dmframe.graph.progress import progress_line
    from dmframe.identification.identify import identify as identified

    with progress_line(log) as say:
        found = identified(log, robot, columns=columns, out=out, say=say)
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))
    return 0 if found.known else UNKNOWN
