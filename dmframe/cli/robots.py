"""Commands about robots."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import NOTHING, AsJson, FigureFormats, LimitsFile, OneGraph, Overrides, Trust, home
from dmframe.cli.streams import tell
from dmframe.common.errors import MissingError, listed
from dmframe.export import TARGETS

Ramp = Annotated[
    str | None, typer.Option(metavar="S", help="Acceleration time of the first motion; 0 for sim, else 1 s.")
]
Patience = Annotated[
    str | None, typer.Option(metavar="S", help="Waiting time for a sample of a real robot; default: five periods.")
]


def rehearse(
    graph: OneGraph,
    seconds: Annotated[
        str | None,
        typer.Option(
            "--until", "--seconds", metavar="S", help="Duration of each run; default: that of the graph, 40 s at most."
        ),
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(
            metavar="M", help="Mass at the tool, unknown to the controller; default: 1/20 of the moving mass."
        ),
    ] = None,
    limits: LimitsFile = None,
    ramp: Ramp = None,
    patience: Patience = None,
    overrides: Overrides = NOTHING,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Simulate effects of real robots on a controller: delay, jitter, lost samples, payload, speed slider."""
    from dmframe.cli.drive import rehearse_graph
    from dmframe.cli.graphs import one_graph

    found = one_graph(graph, overrides, trust=trust)
    return rehearse_graph(
        found, seconds=seconds, payload=payload, limits=limits, ramp=ramp, patience=patience, as_json=as_json
    )


def drive(
    graph: OneGraph,
    robot: Annotated[
        str,
        typer.Option(
            metavar="ROBOT",
            help="sim: that of the graph; sim:2: with a delay of two samples; ur:HOST; ur_rtde:HOST; xarm:HOST. The "
            "last three are untested on hardware.",
        ),
    ],
    seconds: Annotated[
        str | None,
        typer.Option("--until", "--seconds", metavar="S", help="Reference time; default: the duration of the graph."),
    ] = None,
    limits: LimitsFile = None,
    ramp: Ramp = None,
    patience: Patience = None,
    payload: Annotated[
        str | None, typer.Option(metavar="M", help="Payload of the rehearsal, if one was given.")
    ] = None,
    shadow: Annotated[bool, typer.Option("--shadow", help="Compute commands without sending them.")] = False,
    unrehearsed: Annotated[
        bool, typer.Option("--without-a-passed-rehearsal", help="Drive a real robot without a passed rehearsal.")
    ] = False,
    overrides: Overrides = NOTHING,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", callback=home, help="Folder of the results; new or empty."),
    ] = None,
    figures: FigureFormats = "svg",
    no_plots: Annotated[bool, typer.Option("--no-plots", help="Draw no figures.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write to --out even if it contains files.")] = False,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Drive a robot with a graph's controller, through the gate, and write the same results as `run`.

    Ctrl-C and SIGTERM stop the robot. The gate is not a safety function, and it was not tested on hardware.
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
    """Recompute commands from recorded measurements and report differences; exit status 1 if there are any."""
    from dmframe.cli.drive import replay_log
    from dmframe.cli.graphs import one_graph

    return replay_log(log, one_graph(graph, overrides, trust=trust), as_json=as_json)


def export(
    graph: OneGraph,
    folder: Annotated[Path | None, typer.Argument(metavar="OUT", help="A new folder.", callback=home)] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", callback=home, help="The new folder, as an option.")
    ] = None,
    overrides: Overrides = NOTHING,
    trust: Trust = False,
    **targets: bool,
) -> None:
    """Export the controller of a graph for other programs."""
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import refuse

    refuse({"--out": out if folder is not None else None}, "the new folder is given twice; leave one out")
    place = folder or out
    if place is None:
        raise MissingError("expected a new folder: dmframe export GRAPH OUT, or --out OUT")
    chosen = [name for name, wanted in targets.items() if wanted]
    if len(chosen) != 1:
        raise MissingError(f"expected one of {_options()}, found {len(chosen) or 'none'}")
    files = one_graph(graph, overrides, trust=trust).export(place, chosen[0])
    tell(f"wrote {place}: {', '.join(file.name for file in files)}")


def _options() -> str:
    return listed([f"--{name}" for name in TARGETS])


def _with_targets(function: Callable[..., None]) -> Signature:
    """The signature of a function with an option for each target, which typer reads."""
    *named, _ = signature(function, eval_str=True).parameters.values()
    own = [
        Parameter(
            name,
            Parameter.KEYWORD_ONLY,
            default=False,
            annotation=Annotated[bool, typer.Option(f"--{name}", help=target.about)],
        )
        for name, target in TARGETS.items()
    ]
    *first, trust = [each.replace(kind=Parameter.KEYWORD_ONLY) for each in named]
    return Signature([*first, *own, trust])


export.__signature__ = _with_targets(export)  # type: ignore[attr-defined]  # functions of Python have no such field


def robot(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    host: Annotated[str, typer.Option(metavar="ADDRESS", help="Address of this machine to listen on.")] = "127.0.0.1",
    port: Annotated[
        list[str],
        typer.Option(metavar="NAME=NUMBER", help="Another port, rtde=40004; 0 for any free one. May be repeated."),
    ] = NOTHING,
    series: Annotated[str, typer.Option(metavar="SERIES", help="cb3, 125 cycles a second, or e, 500.")] = "e",
    slider: Annotated[str, typer.Option(metavar="SHARE", help="Speed slider, 0 to 1.")] = "1",
    command_delay: Annotated[str, typer.Option(metavar="N", help="Cycles until a client command takes effect.")] = "0",
    measurement_delay: Annotated[str, typer.Option(metavar="N", help="Cycles until a sample is sent.")] = "0",
    lost: Annotated[str, typer.Option(metavar="SHARE", help="Fraction of lost samples.")] = "0",
    seed: Annotated[str, typer.Option(metavar="N", help="Seed of the lost samples.")] = "0",
    until: Annotated[str | None, typer.Option(metavar="S", help="End after this time; at Ctrl-C without it.")] = None,
    patience: Annotated[
        str | None,
        typer.Option(metavar="S", help="Maximum waiting time for a client's answer to a sample; default: real time."),
    ] = None,
    trust: Trust = False,
) -> None:
    """Be a closed UR robot without hardware: a graph's arm and hidden servo behind the maker's protocols.

    RTDE, dashboard and script ports on this machine, in real time, or with --patience in step with a client.
    """
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import quantity, whole
    from dmframe.cli.robot import ports_of, serve
    from dmframe.common.units import seconds as time_of

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
