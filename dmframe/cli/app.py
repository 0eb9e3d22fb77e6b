"""Commands: thin calls of the library, with deferred imports."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from dmframe.cli.arguments import (
    NOTHING,
    TUBE,
    AsJson,
    Boxes,
    Centre,
    FigureFormats,
    Graphs,
    Least,
    OneGraph,
    Overrides,
    Rank,
    Scale,
    Shape,
    Trust,
    Tube,
    home,
    robot_names,
)
from dmframe.cli.catalogue import blocks, graphs, learn, new, robots, schema
from dmframe.cli.design import design
from dmframe.cli.experiment import experiment
from dmframe.cli.groups import GroupedCommands
from dmframe.cli.identify import identify
from dmframe.cli.live import demo, page
from dmframe.cli.path import path
from dmframe.cli.races import race
from dmframe.cli.robots import drive, export, rehearse, replay, robot
from dmframe.cli.streams import tell
from dmframe.cli.studies import study, tune
from dmframe.cli.studio import studio
from dmframe.cli.which import which
from dmframe.common.errors import DmframeError
from dmframe.common.files import check_place

if TYPE_CHECKING:
    from dmframe.simulate.engine import Choice

app = typer.Typer(
    name="dmframe",
    cls=GroupedCommands,
    help="Controllers for robots whose joint servo is closed: written as graphs, simulated, drawn and proved.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

HORIZON = "20"
RECORD = "3"


def _version(wanted: bool) -> None:
    if wanted:
        from dmframe.common.version import version as installed

        tell(f"dmframe {installed()}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Controllers for robots whose joint servo is closed: written as graphs, simulated, drawn and proved."""


command: Callable[..., Any]
for command in (design, path, study, tune, race, which, graphs, robots, new):
    app.command()(command)


@app.command()
def check(graph: OneGraph, overrides: Overrides = NOTHING, trust: Trust = False) -> int:
    """Build a graph, print its blocks, wires, shapes, units and clock, and compare printed laws with the code.

    Exit status 1 if a printed law or a docstring differs from the code.
    """
    from dmframe.cli.graphs import one_graph
    from dmframe.config.plausible import implausible

    loaded = one_graph(graph, overrides, trust=trust)
    loaded.intervals()
    loaded.check_units()
    tell(str(loaded))
    for remark in implausible(loaded):
        tell(f"notice: {remark}")
    try:
        notices = loaded.check_laws()
    except DmframeError as error:
        tell(f"\n{error.text}")
        return 1
    for notice in notices:
        tell(f"notice: {notice}")
    return 0


@app.command()
def explain(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    trust: Trust = False,
) -> None:
    """Describe the blocks of a graph, its signal flow and its certificate in sentences."""
    from dmframe.cli.graphs import one_graph

    found = one_graph(graph, overrides, trust=trust).explain()
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))


@app.command()
def run(
    graph: Graphs,
    until: Annotated[
        str | None, typer.Option(metavar="S", help="Simulated time, instead of the graph's: 20 s.")
    ] = None,
    overrides: Overrides = NOTHING,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", callback=home, help="Folder of the results; new or empty."),
    ] = None,
    engine: Annotated[str, typer.Option(metavar="ENGINE", help="auto, compiled or interpreted.")] = "auto",
    reality: Annotated[
        str | None,
        typer.Option(metavar="SET", help="Add channel models between controller and robot: ur; none,ur runs both."),
    ] = None,
    baseline: Annotated[bool, typer.Option("--baseline", help="Run each graph's baseline too, to compare.")] = False,
    figures: FigureFormats = "svg",
    no_plots: Annotated[bool, typer.Option("--no-plots", help="Draw no figures.")] = False,
    page: Annotated[bool, typer.Option("--page", help="Write each graph's live page to its results.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write to --out even if it contains files.")] = False,
    fresh: Annotated[  # read by `dmframe.remembered.front`, as that of `verify`
        bool, typer.Option("--fresh", help="Decide again what depends on the graph alone, even if it is remembered.")
    ] = False,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Simulate graphs and write signals, figures and a summary; several are overlaid.

    Several values, --set task.gamma=1,2,5, make a graph of each.
    """
    from dmframe.cli.graphs import graphs_of
    from dmframe.cli.options import formats_of
    from dmframe.cli.run import run_graphs

    real = [] if reality is None else [f"reality={reality}"]
    return run_graphs(
        graphs_of(graph, [*real, *overrides], trust=trust),
        until=until,
        out=out,
        engine=cast("Choice", engine),  # checked where it is used
        baseline=baseline,
        formats=() if no_plots else formats_of(figures),
        pages=page,
        force=force,
        as_json=as_json,
    )


@app.command()
def verify(
    graph: Graphs,
    overrides: Overrides = NOTHING,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=home, help="Write a report: .html, .md or .json.")
    ] = None,
    claim: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=home, help="Write the claim that was checked, as JSON.")
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=home, help="Write a certificate for independent checkers.")
    ] = None,
    over: Annotated[str, typer.Option(metavar="TIME", help="Length of the run for bounds on the error.")] = "60 s",
    disturbance: Annotated[
        str, typer.Option(metavar="TORQUE", help="Disturbance torque of bounds, such as 5 N m; one, or one per joint.")
    ] = "0 N m",
    clock: Annotated[
        bool, typer.Option("--clock", help="Look for sampling intervals up to which the loop is proved on its clock.")
    ] = False,
    seed: Annotated[str, typer.Option(metavar="N", help="Seed of the random points and primes.")] = "0",
    fresh: Annotated[  # read by `dmframe.remembered.front`, before the library is imported
        bool, typer.Option("--fresh", help="Prove again, even if a verdict for the same inputs is remembered.")
    ] = False,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Prove dV/dt of graphs exactly, for all gains and parameters, and check the conditions."""
    from dmframe.cli.graphs import graphs_of
    from dmframe.cli.options import whole
    from dmframe.cli.verify import verify_graphs

    replay = ["dmframe", "verify", *graph, *(word for text in overrides for word in ("--set", text))]
    found = graphs_of(graph, overrides, trust=trust)
    number = whole("--seed", seed)
    files = {"claim": claim, "certificate": certificate}
    bounds = {"over": over, "disturbance": disturbance}
    return verify_graphs(
        found,
        report=report,
        files=files,
        replay=replay,
        seed=number,
        bounds=bounds,
        clock=clock,
        as_json=as_json,
    )


@app.command()
def audit(
    folder: Annotated[Path, typer.Argument(metavar="DIR", callback=home, help="A folder with a graph.")],
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Compare certificates, code, runs, rehearsals and drives of a folder with the model of its graph."""
    from dmframe.graph.audit import audit as follow

    found = follow(folder, trust=trust)
    tell(json.dumps(found.summary, indent=2) if as_json else str(found))
    return 0 if found.holds else 1


@app.command()
def analyse(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    horizon: Annotated[
        str | None,
        typer.Option(
            "--until",
            "--horizon",
            metavar="S",
            help=f"Length of the runs in the search for the period; default: {HORIZON} s.",
        ),
    ] = None,
    rank: Rank = False,
    tube: Tube = None,
    least: Least = None,
    shape: Shape = None,
    centre: Centre = None,
    scale: Scale = None,
    boxes: Boxes = None,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Linearise a graph: margins and passivity of the servo, poles, the largest stable sampling period."""
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import quantity, refuse, whole

    words = {"shape": shape, "centre": centre, "scale": scale}
    if rank:
        from dmframe.cli.rank import rank_of

        refuse({"--until": horizon}, "it has no effect with --rank; leave one out")
        options: dict[str, Any] = {key: word for key, word in words.items() if word is not None}
        if least is not None:
            options["least"] = quantity("--least", least, "")
        if boxes is not None:
            options["boxes"] = whole("--boxes", boxes)
        options["tube"] = quantity("--tube", tube or TUBE, "rad")
        return rank_of(one_graph(graph, overrides, trust=trust), as_json=as_json, **options)
    from dmframe.cli.analyse import analyse_graph

    given = {"tube": tube, "least": least, **words, "boxes": boxes}
    refuse({f"--{key}": value for key, value in given.items()}, "it has no effect without --rank; add that")
    analyse_graph(
        one_graph(graph, overrides, trust=trust),
        horizon=quantity("--until", horizon or HORIZON, "s"),
        as_json=as_json,
    )
    return 0


@app.command()
def delay(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    until: Annotated[str | None, typer.Option(metavar="S", help=f"Length of the record; default: {RECORD} s.")] = None,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Run a graph with an excitation of its robot, and fit the delay between command and motion in samples.

    Prints the delay for the blocks; exit status 1 with the reason if it cannot be determined.
    """
    from dmframe.cli.delay import delay_of
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import quantity

    duration = quantity("--until", until or RECORD, "s")
    return delay_of(one_graph(graph, overrides, trust=trust), duration=duration, as_json=as_json)


for command in (experiment, identify, rehearse, drive, replay, export, robot):
    app.command()(command)


@app.command()
def draw(
    graph: OneGraph,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FILE", callback=home, help=".svg, .png, .pdf, .mmd; Mermaid text without it."
        ),
    ] = None,
    overrides: Overrides = NOTHING,
    trust: Trust = False,
) -> None:
    """Draw the block diagram of a graph."""
    from dmframe.cli.graphs import one_graph
    from dmframe.drawing import check_ending

    if out is not None:
        check_ending(out)
        check_place(out)
    drawing = one_graph(graph, overrides, trust=trust).draw()
    if out is None:
        tell(drawing.mermaid.rstrip())
        return
    drawing.save(out)
    tell(f"wrote {out}")


for command in (demo, page, studio, blocks, learn, schema):
    app.command()(command)


@app.command()
def regressor(
    robot: Annotated[str, typer.Argument(help="A robot's name, or a URDF file.", autocompletion=robot_names)],
    base: Annotated[bool, typer.Option("--base", help="Exact base parameters instead of all.")] = False,
    kinematic: Annotated[bool, typer.Option("--kinematic", help="Y_k instead of Y_d.")] = False,
    symbolic: Annotated[bool, typer.Option("--symbolic", help="Print each entry; up to 3 joints.")] = False,
    prove: Annotated[bool, typer.Option("--prove", help="Prove the properties that controllers rely on.")] = False,
    c: Annotated[Path | None, typer.Option("--c", metavar="FILE", callback=home, help="Write it as C source.")] = None,
    python: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=home, help="Write it as a NumPy module.")
    ] = None,
    latex: Annotated[
        Path | None, typer.Option(metavar="FILE", callback=home, help="Write M, C, g, Y_d, Y_k; up to 3 joints.")
    ] = None,
    free: Annotated[str | None, typer.Option(metavar="J1,J2,...", help="The joints that move.")] = None,
    hold: Annotated[list[str], typer.Option(metavar="JOINT=ANGLE", help="A locked joint with its angle.")] = NOTHING,
    tool: Annotated[str | None, typer.Option(metavar="FRAME", help="The tool's frame.")] = None,
    friction: Annotated[str, typer.Option(metavar="KINDS", help="Some of viscous,coulomb,rotor.")] = "",
) -> int:
    """Regressor of a robot: parameters, entries, code, proofs, and difference from Pinocchio."""
    from dmframe.cli.options import angles, refuse, words
    from dmframe.cli.regressor import RegressorOptions, regressor_of
    from dmframe.robot.library import load

    kinds = words(friction) or ()
    if kinematic and latex is None:  # LaTeX contains both regressors
        refuse({"--base": base, "--friction": friction or None}, "it has no effect with --kinematic; leave one out")
    chain = load(robot, base=Path(), free=words(free), hold=angles("--hold", hold), tool=tool)
    return regressor_of(chain, kinds, RegressorOptions(base, kinematic, symbolic, prove, c, python, latex))


def app_for(words: Sequence[str]) -> typer.Typer:
    """Application for a command line: the command that is its first word, or all of them if none is.

    typer reads the signatures of all the commands that it is given, which takes longer than the rest of its work.
    """
    named = [each for each in app.registered_commands if each.callback and [each.callback.__name__] == words[:1]]
    if not named:
        return app
    one = copy.copy(app)
    one.registered_commands = named
    return one
