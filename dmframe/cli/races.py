"""``dmframe race``: tune laws by one protocol, judge them on held-out cells, and report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Final

import typer

from dmframe.cli.arguments import Trust, home
from dmframe.common.errors import ValueFault

PACKAGED: Final = "packaged"
EVERY: Final = 10.0
"""Interval of progress lines [s]."""


def race(
    file: Annotated[
        str, typer.Argument(metavar="RACE", help="A race file, or the name of a packaged race.")
    ] = PACKAGED,
    quick: Annotated[bool, typer.Option("--quick", help="Run the part that the file's section quick selects.")] = False,
    workers: Annotated[
        str | None, typer.Option(metavar="N", help="Processes on this machine; default: number of cores.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", callback=home, help="Folder of the results; default: races/NAME."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the table as a JSON list.")] = False,
    trust: Trust = False,
) -> int:
    """Tune control laws by one protocol, and compare them on plants and paths that none was tuned on.

    An interrupted race continues; results in its folder are not computed again.
    """
    from dmframe.build.compiler import find_compiler
    from dmframe.catalogue import find_race
    from dmframe.cli import STOPPED
    from dmframe.cli.options import whole
    from dmframe.cli.streams import tell
    from dmframe.common.trust import remember
    from dmframe.graph.progress import progress_line
    from dmframe.race.page import lead
    from dmframe.race.read import load_race
    from dmframe.race.run import PAGE, run_race
    from dmframe.results.folder import safe_name
    from dmframe.study.execute import State

    count = None if workers is None else whole("--workers", workers)
    if count is not None and count < 1:
        raise ValueFault(f"--workers {count}: expected at least 1")
    if trust:
        remember(find_race(file).parent)
    with progress_line(file) as say:
        say("reading its laws, plants and paths")
        found = load_race(file)
        found = found.quick if quick else found
    if find_compiler() is None:
        tell(f"{found.name}: notice: there is no C compiler: runs are interpreted, which takes longer", aside=True)
    place = out or Path("races", safe_name(found.name))
    printed, at = ("", False), 0.0

    def report(stage: str, state: State) -> None:
        nonlocal printed, at
        if (stage, state.complete) != printed or state.seconds > at + EVERY:
            printed, at = (stage, state.complete), state.seconds
            count = f"{state.kept} of {state.runs} runs"
            tell(f"{found.name}: {stage}: {count} after {state.seconds:.0f} s", aside=True)

    try:
        result = run_race(found, place, workers=count, report=report)
    except KeyboardInterrupt:
        tell(f"{found.name}: stopped; the finished runs are kept in {place}, the same command continues", aside=True)
        return STOPPED
    if as_json:
        tell(json.dumps([row.summary for row in result.rows], indent=1))
    else:
        answer = lead(result)
        tell(f"{answer.headline}\n{answer.sentence.text.replace('`', '')}\nreport: {place / PAGE}")
    return 0
