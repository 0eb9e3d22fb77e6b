"""The commands. Each is a thin call of the library; heavy parts are imported when a command needs them."""

from __future__ import annotations

import json
from collections.abc import Callable
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
from dmframe.cli.robots import drive, export, rehearse, replay, robot
from dmframe.cli.streams import tell
from dmframe.cli.studies import study, tune
from dmframe.errors import raise_all, visible
from dmframe.files import check_place

if TYPE_CHECKING:
    from dmframe.simulate.engine import Choice

app = typer.Typer(
    name="dmframe",
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
        from dmframe.version import version as installed

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
for command in (study, tune, graphs, robots, new):
    app.command()(command)


@app.command()
def check(graph: OneGraph, overrides: Overrides = NOTHING, trust: Trust = False) -> None:
    """Build a graph and print its blocks, wires, shapes, units and clock.

    Of block files that others may have written, which are not run without --trust, print what they declare.
    """
    from dmframe.cli.graphs import one_graph, unrun

    if (looked := unrun(graph, overrides, trust=trust)) is not None:
        from dmframe.graph.unrun_page import unrun_page

        tell(unrun_page(looked))
        raise_all(looked.faults)
    loaded = one_graph(graph, overrides, trust=trust)
    loaded.experiment.intervals(loaded.diagram)
    loaded.experiment.check_units(loaded.diagram)
    tell(str(loaded))


@app.command()
def explain(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    trust: Trust = False,
) -> None:
    """Say in sentences what each block of a graph does, which signals go where, and what its certificate says."""
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
        Path | None, typer.Option(metavar="DIR", callback=home, help="Folder of the results; new or empty.")
    ] = None,
    engine: Annotated[str, typer.Option(metavar="ENGINE", help="auto, compiled or interpreted.")] = "auto",
    reality: Annotated[
        str | None,
        typer.Option(metavar="SET", help="Put what is real between controller and robot: ur; none,ur runs both."),
    ] = None,
    baseline: Annotated[bool, typer.Option("--baseline", help="Run each graph's baseline too, to compare.")] = False,
    figures: FigureFormats = "svg",
    no_plots: Annotated[bool, typer.Option("--no-plots", help="Draw no figures.")] = False,
    page: Annotated[bool, typer.Option("--page", help="Write each graph's live page beside its results.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write to --out though it holds files.")] = False,
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
        engine=cast("Choice", engine),  # where it is used, it is checked
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
    seed: Annotated[str, typer.Option(metavar="N", help="Of the random points and primes.")] = "0",
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Prove dV/dt of graphs exactly, for all gains and parameters, and check the conditions."""
    from dmframe.cli.graphs import graphs_of
    from dmframe.cli.options import whole
    from dmframe.cli.verify import verify_graphs

    replay = ["dmframe", "verify", *graph, *(word for text in overrides for word in ("--set", text))]
    found = graphs_of(graph, overrides, trust=trust)
    return verify_graphs(found, report=report, replay=replay, seed=whole("--seed", seed), as_json=as_json)


@app.command()
def analyse(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    horizon: Annotated[
        str | None,
        typer.Option(metavar="S", help="Length of the runs that look for the period.", show_default=HORIZON),
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

        refuse({"--horizon": horizon}, "it does nothing with --rank; leave one out")
        options: dict[str, Any] = {key: word for key, word in words.items() if word is not None}
        if least is not None:
            options["least"] = quantity("--least", least, "")
        if boxes is not None:
            options["boxes"] = whole("--boxes", boxes)
        options["tube"] = quantity("--tube", tube or TUBE, "rad")
        return rank_of(one_graph(graph, overrides, trust=trust), as_json=as_json, **options)
    from dmframe.cli.analyse import analyse_graph

    given = {"tube": tube, "least": least, **words, "boxes": boxes}
    refuse({f"--{key}": value for key, value in given.items()}, "it does nothing without --rank; add that")
    analyse_graph(
        one_graph(graph, overrides, trust=trust),
        horizon=quantity("--horizon", horizon or HORIZON, "s"),
        as_json=as_json,
    )
    return 0


@app.command()
def delay(
    graph: OneGraph,
    overrides: Overrides = NOTHING,
    until: Annotated[str | None, typer.Option(metavar="S", help="Length of the record.", show_default=RECORD)] = None,
    as_json: AsJson = False,
    trust: Trust = False,
) -> int:
    """Run a graph that probes its robot, and fit how many samples later than commanded it moves.

    Prints what to tell the blocks; or why no delay may be told, with exit status 1.
    """
    from dmframe.cli.delay import delay_of
    from dmframe.cli.graphs import one_graph
    from dmframe.cli.options import quantity

    duration = quantity("--until", until or RECORD, "s")
    return delay_of(one_graph(graph, overrides, trust=trust), duration=duration, as_json=as_json)


for command in (rehearse, drive, replay, export, robot):
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
    from dmframe.cli.graphs import one_graph, unrun
    from dmframe.drawing import Drawing, check_ending

    if out is not None:
        check_ending(out)
        check_place(out)
    looked = unrun(graph, overrides, trust=trust)
    if looked is None:
        drawing = one_graph(graph, overrides, trust=trust).draw()
    else:
        drawing = Drawing(looked, looked.experiment.file.title)
        for fault in looked.faults:
            tell(f"drawn from declarations alone: {visible(str(fault))}", aside=True)
    if out is None:
        tell(drawing.mermaid.rstrip())
        return
    drawing.save(out)
    tell(f"wrote {out}")


@app.command()
def page(
    graph: OneGraph,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", callback=home, help="A file .html; GRAPH.html without it."),
    ] = None,
    periods: Annotated[
        bool, typer.Option(help="Look for the sampling periods up to which the loop is stable; takes seconds.")
    ] = True,
    overrides: Overrides = NOTHING,
    trust: Trust = False,
) -> None:
    """Write a live page of a graph: it runs in a browser, under sliders, beside its proof."""
    from dmframe.cli.graphs import one_graph
    from dmframe.page.page import check_own_place, check_page_place
    from dmframe.results.folder import safe_name

    loaded = one_graph(graph, overrides, trust=trust)
    place = out if out is not None else Path(f"{safe_name(loaded.name)}.html")
    (check_page_place if out is not None else check_own_place)(place)
    loaded.page(periods=periods).save(place)
    tell(f"wrote {place}")


for command in (blocks, learn, schema):
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
    hold: Annotated[list[str], typer.Option(metavar="JOINT=ANGLE", help="A joint held still.")] = NOTHING,
    tool: Annotated[str | None, typer.Option(metavar="FRAME", help="The tool's frame.")] = None,
    friction: Annotated[str, typer.Option(metavar="KINDS", help="viscous, coulomb, or viscous,coulomb.")] = "",
) -> int:
    """A robot's regressor: parameters, entries, code, proofs, and how far it is from Pinocchio's."""
    from dmframe.cli.options import angles, refuse, words
    from dmframe.cli.regressor import Wanted, regressor_of
    from dmframe.robot.library import load

    kinds = words(friction) or ()
    if kinematic and latex is None:  # which holds both regressors
        refuse({"--base": base, "--friction": friction or None}, "it does nothing with --kinematic; leave one out")
    chain = load(robot, base=Path(), free=words(free), hold=angles("--hold", hold), tool=tool)
    return regressor_of(chain, kinds, Wanted(base, kinematic, symbolic, prove, c, python, latex))
