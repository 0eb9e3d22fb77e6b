"""Commands about studies of many runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dmframe.cli.arguments import NOTHING, Overrides, Trust, home
from dmframe.common.errors import ValueFault


def study(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="[report] FILE",
            help="A study file, a graph with uncertain intervals, or the folder of a study's results; report DIR "
            "rewrites the report of that folder.",
        ),
    ],
    workers: Annotated[
        str | None, typer.Option(metavar="N", help="Processes on this machine; default: number of cores.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Address of a dask scheduler whose workers compute.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", callback=home, help="Folder of the results; default: studies/NAME."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the planned runs and their time.")] = False,
    rerun: Annotated[
        str | None, typer.Option(metavar="RUN", help="Write this run as a graph, run it, compare it with its row.")
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Delete the runs of another study in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    trust: Trust = False,
) -> int:
    """Run a study: a graph with varied parameters. Results in its folder are not computed again."""
    from dmframe.cli.options import refuse, whole
    from dmframe.cli.study import REPORT, one_file, report, run
    from dmframe.cli.study import dry_run as dry
    from dmframe.cli.study import rerun as repeated

    if words[0] == REPORT and len(words) > 1:
        given = {"--workers": workers, "--scheduler": scheduler, "--out": out, "--dry-run": dry_run, "--rerun": rerun}
        refuse({**given, "--no-report": no_report, "--force": force}, "it has no effect with report; leave one out")
        return report(one_file(words[1:]), as_json=as_json, trust=trust)
    file = one_file(words)
    count = None if workers is None else whole("--workers", workers)
    if dry_run or rerun is not None:
        what = "--dry-run" if dry_run else "--rerun"
        refuse({"--scheduler": scheduler}, f"it has no effect with {what}; leave one out")
    if dry_run:
        unused = {"--rerun": rerun, "--force": force, "--no-report": no_report}
        refuse(unused, "it has no effect with --dry-run; leave one out")
        return dry(file, workers=count, out=out, as_json=as_json, trust=trust)
    if rerun is not None:
        refuse({"--workers": workers, "--no-report": no_report}, "it has no effect with --rerun; leave one out")
        return repeated(file, whole("--rerun", rerun), out=out, force=force, as_json=as_json, trust=trust)
    return run(
        file,
        workers=count,
        scheduler=scheduler,
        out=out,
        report=not no_report,
        force=force,
        as_json=as_json,
        trust=trust,
    )


def tune(
    study: Annotated[str, typer.Argument(metavar="STUDY", help="A study file with a section tune.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="DIR", callback=home, help="Folder of the search; an existing search continues."
        ),
    ] = None,
    trials: Annotated[
        str | None, typer.Option(metavar="N", help="Total number of trials; default: that of the file.")
    ] = None,
    overrides: Overrides = NOTHING,
    workers: Annotated[str | None, typer.Option(metavar="N", help="Threads; default: number of cores.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    trust: Trust = False,
) -> int:
    """Optimise parameters over the plants of a study, validate them on new plants, and prove them.

    An interrupted search continues; several processes may share one folder.
    """
    from dmframe.cli.options import whole
    from dmframe.cli.tune import tune_study
    from dmframe.common.trust import remember

    if trust:
        remember(Path(study).parent)
    counts = {
        name: None if text is None else whole(name, text)
        for name, text in (("--trials", trials), ("--workers", workers))
    }
    for name, count in counts.items():
        if count is not None and count < 1:
            raise ValueFault(f"{name} {count}: expected at least 1")
    return tune_study(
        study,
        out=out,
        trials=counts["--trials"],
        overrides=overrides,
        jobs=counts["--workers"] or 0,
        as_json=as_json,
    )
