"""``dmframe design``: from a robot to a controller."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import NOTHING, home, robot_names
from dmframe.cli.streams import tell

BLOCKED = 1
USUAL, MOST = 180, 600
"""Usual and longest time of a design on two cores [s]."""


def design(
    robot: Annotated[
        str, typer.Argument(help="A robot's name, or a URDF, xacro or MJCF file.", autocompletion=robot_names)
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", callback=home, help="Folder of the results.")],
    log: Annotated[
        str | None, typer.Option(metavar="LOG", help="Log from which the servo is identified; see identify.")
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(metavar="TASK", help="joints, position or pose; default: that of --path, or joints."),
    ] = None,
    path: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Path as CSV, or as JointTrajectory in YAML or JSON; see path."),
    ] = None,
    clock: Annotated[
        str | None, typer.Option("--period", "--clock", metavar="S", help="Sampling period; default: 8 ms.")
    ] = None,
    payload: Annotated[
        str | None, typer.Option(metavar="0..M", help="Mass at the tool [kg]; default: 1/20 of the moving mass.")
    ] = None,
    tool: Annotated[str | None, typer.Option(metavar="FRAME", help="Tool frame of the robot; default: flange.")] = None,
    hold: Annotated[
        list[str], typer.Option(metavar="JOINT=POSITION", help="Hold a joint of the robot; repeatable.")
    ] = NOTHING,
    workers: Annotated[
        str | None, typer.Option(metavar="N", help="Processes on this machine; default: number of cores.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Design a controller for a robot: tune and compare laws, prove and rehearse the best one, in one folder.

    The outcome is an adaptive law that is clearly better than the best simple one, or the simple one, or what hinders
    (exit status 1). An interrupted design continues in its folder.
    """
    from dmframe.cli import STOPPED
    from dmframe.cli.options import angles, whole
    from dmframe.common.units import plain
    from dmframe.design.design import design as designed
    from dmframe.design.request import Request
    from dmframe.graph.progress import progress_line

    count = None if workers is None else whole("--workers", workers)
    held = tuple(angles("--hold", hold).items())
    request = Request.of(robot, task=task, clock=clock, payload=payload, log=log, tool=tool, hold=held, path=path)
    tell(
        f"about {USUAL // 60} to {MOST // 60} min, less in a folder with a part of it; Ctrl-C keeps what is done",
        aside=True,
    )
    begin = time.monotonic()
    try:
        with progress_line(Path(robot).name) as say:
            found = designed(request, out, workers=count, say=say)
    except KeyboardInterrupt:
        tell(f"stopped; the finished runs are kept in {out}, the same command continues", aside=True)
        return STOPPED
    tell(json.dumps(found.summary, indent=2) if as_json else f"{found}\nreport: {found.report}")
    tell(f"took {plain(time.monotonic() - begin, 's')}", aside=as_json)
    return BLOCKED if found.outcome == "blocked" else 0
