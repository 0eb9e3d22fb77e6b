"""The commands about robots: thin calls of the library, as those of `dmframe.cli.app`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from dmframe.cli.arguments import NOTHING, AsJson, FigureFormats, LimitsFile, OneGraph, Overrides, Trust, home
from dmframe.cli.streams import tell
from dmframe.errors import MissingError


def rehearse(
    graph: OneGraph,
    seconds: Annotated[
        str | None, typer.Option(metavar="S", help="Of each run; the graph's duration, 40 s at most, without it.")
    ] = None,
    payload: Annotated[
        str | None, typer.Option(metavar="M", help="At the tool, not told; a twentieth of what moves without it.")
    ] = None,
    limits: LimitsFile = None,
    overrides: Overrides = NOTHING,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Try in simulation what a robot does to a controller: delay, jitter, lost samples, a load, a speed slider."""
    from dmframe.cli.drive import rehearse_graph
    from dmframe.cli.graphs import one_graph

    found = one_graph(graph, overrides, trust=trust)
    return rehearse_graph(found, seconds=seconds, payload=payload, limits=limits, as_json=as_json)


def drive(
    graph: OneGraph,
    robot: Annotated[
        str,
        typer.Option(
            metavar="ROBOT",
            help="sim: the graph's own; sim:2: that one, two samples late; ur:HOST; ur_rtde:HOST; xarm:HOST. The last "
            "three are untested on hardware.",
        ),
    ],
    seconds: Annotated[
        str | None, typer.Option(metavar="S", help="Time of the reference; the graph's duration without it.")
    ] = None,
    limits: LimitsFile = None,
    ramp: Annotated[
        str | None,
        typer.Option(metavar="S", help="How long the first motion gathers speed; 0 for sim, else 1 s."),
    ] = None,
    patience: Annotated[
        str | None,
        typer.Option(metavar="S", help="How long to wait for a sample of a real robot; five periods without it."),
    ] = None,
    payload: Annotated[
        str | None, typer.Option(metavar="M", help="What the rehearsal tried at the tool, where that was given to it.")
    ] = None,
    shadow: Annotated[bool, typer.Option("--shadow", help="Compute, and send nothing.")] = False,
    unrehearsed: Annotated[
        bool, typer.Option("--without-a-passed-rehearsal", help="Drive a real robot all the same.")
    ] = False,
    overrides: Overrides = NOTHING,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", callback=home, help="Folder of the results; new or empty.")
    ] = None,
    figures: FigureFormats = "svg",
    no_plots: Annotated[bool, typer.Option("--no-plots", help="Draw no figures.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write to --out though it holds files.")] = False,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Drive a robot with a graph's controller, through the gate, and write what `run` writes.

    Ctrl-C and SIGTERM bring the robot to rest. The gate is no safety function, and none of this was tried on hardware.
    """
    from dmframe.cli.drive import drive_graph
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import formats_of

    return drive_graph(
        one_graph(graph, overrides, trust=trust),
        robot=robot,
        seconds=seconds,
        limits=limits,
        ramp=ramp,
        patience=patience,
        payload=payload,
        shadow=shadow,
        rehearsed=not unrehearsed,
        out=out,
        formats=() if no_plots else formats_of(figures),
        force=force,
        as_json=as_json,
    )


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="The folder of a drive or a run.", callback=home)],
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Compute commands again from what was measured, and tell where they differ; 1 where they do."""
    from dmframe.cli.drive import replay_log
    from dmframe.cli.graphs import one_graph

    return replay_log(log, one_graph(graph, overrides, trust=trust), as_json=as_json)


def export(
    graph: OneGraph,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="A new folder.", callback=home)],
    overrides: Overrides = NOTHING,
    c: Annotated[bool, typer.Option("--c", help="The controller as C99, with an example and a test.")] = False,
    fmi2: Annotated[bool, typer.Option("--fmi2", help="Controller and robot as units of FMI 2.0.")] = False,
    fmi3: Annotated[bool, typer.Option("--fmi3", help="Controller and robot as units of FMI 3.0.")] = False,
    ros2: Annotated[
        bool, typer.Option("--ros2", help="A package with a controller of ros2_control; never run in ROS 2.")
    ] = False,
    trust: Trust = False,
) -> None:
    """Write a graph's controller for other programs."""
    from dmframe.cli.graphs import one_graph

    kinds: dict[Literal["c", "fmi2", "fmi3", "ros2"], bool] = {"c": c, "fmi2": fmi2, "fmi3": fmi3, "ros2": ros2}
    asked = [kind for kind, wanted in kinds.items() if wanted]
    if len(asked) != 1:
        raise MissingError(f"expected one of --c, --fmi2, --fmi3 and --ros2, found {len(asked) or 'none'}")
    files = one_graph(graph, overrides, trust=trust).export(out, asked[0])
    tell(f"wrote {out}: {', '.join(file.name for file in files)}")


def robot(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    host: Annotated[str, typer.Option(metavar="ADDRESS", help="Of this machine, on which to listen.")] = "127.0.0.1",
    port: Annotated[
        list[str],
        typer.Option(metavar="NAME=NUMBER", help="Another port, rtde=40004; 0 for any free one. May be repeated."),
    ] = NOTHING,
    series: Annotated[str, typer.Option(metavar="SERIES", help="cb3, 125 cycles a second, or e, 500.")] = "e",
    slider: Annotated[str, typer.Option(metavar="SHARE", help="Where the speed slider stands, 0 to 1.")] = "1",
    command_delay: Annotated[str, typer.Option(metavar="N", help="Cycles until what a client writes is taken.")] = "0",
    measurement_delay: Annotated[str, typer.Option(metavar="N", help="Cycles until a sample is sent.")] = "0",
    lost: Annotated[str, typer.Option(metavar="SHARE", help="Share of samples that are not sent.")] = "0",
    seed: Annotated[str, typer.Option(metavar="N", help="Of the samples that are lost.")] = "0",
    until: Annotated[str | None, typer.Option(metavar="S", help="End after this time; at Ctrl-C without it.")] = None,
    patience: Annotated[
        str | None,
        typer.Option(
            metavar="S", help="Let the clock wait so long for a client's answer to a sample; real time without it."
        ),
    ] = None,
    trust: Trust = False,
) -> None:
    """Be a closed UR robot without hardware: a graph's arm and hidden servo behind the maker's protocols.

    RTDE, dashboard and script ports on this machine, in real time, or with --patience in step with a client.
    """
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import quantity, whole
    from dmframe.cli.robot import ports_of, serve
    from dmframe.graph.arguments import seconds as time_of

    serve(
        one_graph(graph, overrides, trust=trust),
        host,
        ports_of(port),
        None if until is None else quantity("--until", until, "s"),
        0.0 if patience is None else time_of("--patience", patience),
        series=series,
        slider=quantity("--slider", slider, ""),
        command_delay=whole("--command-delay", command_delay),
        measurement_delay=whole("--measurement-delay", measurement_delay),
        lost=quantity("--lost", lost, ""),
        seed=whole("--seed", seed),
    )
