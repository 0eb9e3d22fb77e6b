"""``dmframe path``: a recorded or planned path as a block for a graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import NOTHING, home, robot_names
from dmframe.cli.streams import tell


def path(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", callback=home, help="CSV, or a JointTrajectory in YAML or JSON.")
    ],
    robot: Annotated[str, typer.Argument(help="A graph, or a robot by name or file.", autocompletion=robot_names)],
    joints: Annotated[
        bool, typer.Option("--joints", help="Joint positions of a path of the tool, by inverse kinematics.")
    ] = False,
    after: Annotated[
        str, typer.Option(metavar="WHAT", help="After the last point: stays, repeats or returns.")
    ] = "stays",
    tool: Annotated[str | None, typer.Option(metavar="FRAME", help="Tool frame of the robot; default: flange.")] = None,
    hold: Annotated[
        list[str], typer.Option(metavar="JOINT=POSITION", help="Hold a joint of the robot; repeatable.")
    ] = NOTHING,
) -> None:
    """Print a path of a file as the block waypoints of a graph, with the robot's start.

    Columns of a CSV file: t [s], and the joints by name or as q_1, q_2 [rad], or x, y, z of the tool [m].
    """
    from typing import get_args

    from dmframe.cli.options import angles
    from dmframe.common.errors import ValueFault
    from dmframe.design.path_block import path_block
    from dmframe.design.points import After

    chosen: After | None = next((item for item in get_args(After) if item == after), None)
    if chosen is None:
        raise ValueFault(f"--after: expected {', '.join(get_args(After))}, found {after}")
    tell(str(path_block(file, robot, joints=joints, after=chosen, tool=tool, hold=angles("--hold", hold))).rstrip())
