"""``dmframe identify``: the servo, delay, friction and base parameters of a robot, from a log."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import NOTHING, home, robot_names
from dmframe.cli.streams import tell
from dmframe.common.errors import OutputError

UNKNOWN = 1


def identify(
    log: Annotated[str, typer.Argument(metavar="LOG", help="A CSV or Parquet file of commands and positions.")],
    robot: Annotated[str, typer.Argument(help="A robot's name, a URDF file, or a graph.", autocompletion=robot_names)],
    columns: Annotated[
        list[str], typer.Option(metavar="NAME=COLUMN", help="The column of a signal: q_1=shoulder; may be repeated.")
    ] = NOTHING,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", callback=home, help="Folder for report.html and files.")
    ] = None,
    no_verdict: Annotated[
        bool,
        typer.Option(
            "--no-verdict", help="Do not compare control laws on the identified robot, which takes one to two minutes."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Identify a closed servo, the delay, friction and base parameters from a log, with intervals.

    Three joints take 10 to 40 s of computing, six about two minutes.

    The verdict compares an adaptive law with tuned laws without a model on the identified robot. There is none for
    more than three joints.

    Exit status 1 if no class of servo explains the log.
    """
    from dmframe.cli import STOPPED
    from dmframe.graph.progress import progress_line
    from dmframe.identification.answer import INTERRUPTED
    from dmframe.identification.identify import identify as identified
    from dmframe.identification.verdict import with_verdict

    with progress_line(log, kept=True) as say:
        found = identified(log, robot, columns=columns, out=out, say=say)
        try:
            found = found if no_verdict else with_verdict(found, out, say)
        except KeyboardInterrupt:
            found = replace(found, verdict=INTERRUPTED)
        except OutputError:  # the identification is not lost with a full disk
            tell(json.dumps(found.summary, indent=2) if as_json else str(found))
            raise
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))
    return STOPPED if found.verdict is INTERRUPTED else 0 if found.known else UNKNOWN
