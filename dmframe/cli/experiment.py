"""``dmframe experiment``: an excitation of a robot for ``dmframe identify``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import LimitsFile, home, robot_names
from dmframe.cli.streams import tell


def experiment(
    robot: Annotated[
        str,
        typer.Argument(help="A robot's name, a URDF, xacro or MJCF file, or a graph.", autocompletion=robot_names),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", callback=home, help="Folder for the CSV, the graph and the script."),
    ] = None,
    period: Annotated[
        str | None, typer.Option(metavar="S", help="Sampling period; default: the graph's clock, or 8 ms.")
    ] = None,
    seconds: Annotated[str, typer.Option("--until", "--seconds", metavar="S", help="Duration, 6 to 30 s.")] = "20",
    seed: Annotated[str, typer.Option(metavar="N", help="Seed of the steps.")] = "0",
    start: Annotated[
        str | None, typer.Option(metavar="Q1,Q2,...", help="Start posture; default: the graph's, or a dexterous one.")
    ] = None,
    limits: LimitsFile = None,
    floor: Annotated[
        str | None, typer.Option(metavar="Z", help="Height in the base frame above which joints and tool stay.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Propose velocity steps of every joint for identify: inside limits and a box without self-collision.

    It was not tested on hardware, and the surroundings of the robot are unknown except for --floor.
    """
    from dmframe.cli.options import quantity, whole, words
    from dmframe.common.units import joint_place
    from dmframe.graph.progress import progress_line
    from dmframe.identification.experiment import experiment as proposed

    posture = None if start is None else [joint_place(word) for word in words(start) or ()]
    with progress_line(robot) as say:
        found = proposed(
            robot,
            out=out,
            period=None if period is None else quantity("--period", period, "s"),
            seconds=quantity("--until", seconds, "s"),
            seed=whole("--seed", seed),
            start=posture,
            limits=limits,
            floor=None if floor is None else quantity("--floor", floor, "m"),
            say=say,
        )
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))
    if out is not None and not as_json:
        graph = out / "experiment.yaml"
        more = f"; try: dmframe drive {graph} --robot sim --out log; dmframe identify log {graph}"
        tell(f"wrote {out}{more if graph.is_file() else ''}")
