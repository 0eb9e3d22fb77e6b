"""dmframe compared with other tools: ``python -m tests.benchmarks``.

Parts: (a) the closed loop of ur10_fast, (b) of ur10_full, (c) the controller step, (d) cost against the number of
joints, (e) time to first result, (f) a batch, (g) a stiff loop, (h) SIMD batches. All ratios of a table come from one
run on one machine. Other tools are an optional dependency group: ``pip install --group peers``; the table lists a
missing one as missing. With --check the exit status is 1 if a ratio is below the baseline.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks import baseline, batch, chains, closed_loop, controller_step, first_result, simd, stiff
from tests.benchmarks.machine import describe
from tests.benchmarks.peers import PEERS
from tests.benchmarks.table import Report, Section

PARTS = "abcdefgh"
HEAD = "## The table"


def parser() -> argparse.ArgumentParser:
    """The command line."""
    found = argparse.ArgumentParser("python -m tests.benchmarks", description=__doc__)
    found.add_argument("parts", nargs="*", metavar="PART", help=f"of {' '.join(PARTS)}; all if none is named")
    found.add_argument("--seconds", type=float, default=200.0, help="simulated time of (a); (b) takes half of it")
    found.add_argument("--step", type=float, default=1.0, metavar="MS", help="longest step of the plant's integrator")
    found.add_argument("--peers", nargs="+", default=list(PEERS), choices=PEERS, help="of (a) and (b)")
    found.add_argument("--joints", nargs="+", type=int, default=list(chains.JOINTS), help="of (d)")
    found.add_argument("--runs", type=int, default=1000, help="of (f), at most 1000")
    found.add_argument("--batch-seconds", type=float, default=2.0, help="simulated time of each run of (f)")
    found.add_argument("--limit", type=float, default=900.0, metavar="S", help="longest time of one measurement")
    form = found.add_mutually_exclusive_group()
    form.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    form.add_argument("--json", action="store_true", help="print everything as JSON")
    found.add_argument("--page", type=Path, metavar="FILE", help=f"write the table into a page, below its {HEAD!r}")
    found.add_argument("--from-json", type=Path, metavar="FILE", help="show or check an earlier table, measure nothing")
    found.add_argument("--check", action="store_true", help="compare with the baseline; status 1 at a regression")
    found.add_argument("--baseline", type=Path, default=baseline.FILE, help="its file")
    found.add_argument("--write-baseline", action="store_true", help="make this table the baseline")
    return found


def progress(text: str) -> None:
    """Print progress to standard error."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def sections(chosen: argparse.Namespace) -> list[Section]:
    """Measure the chosen sections."""
    step, limit, found = chosen.step / 1e3, chosen.limit, list[Section]()
    for part in chosen.parts or PARTS:
        if part == "a":
            found.append(
                closed_loop.section(
                    "a", "ur10_fast", chosen.seconds, step, limit, peers=chosen.peers, progress=progress
                )
            )
        elif part == "b":
            some = [key for key in chosen.peers if key in closed_loop.SIX_JOINTS]
            found.append(
                closed_loop.section("b", "ur10_full", chosen.seconds / 2, step, limit, peers=some, progress=progress)
            )
        elif part == "c":
            found.append(controller_step.section(limit, progress))
        elif part == "d":
            found.append(chains.section(limit, chosen.joints, progress))
        elif part == "e":
            found.append(first_result.section(progress=progress))
        elif part == "f":
            found.append(batch.section(chosen.runs, chosen.batch_seconds, step, limit, progress))
        elif part == "g":
            found.append(stiff.section(progress=progress))
        else:
            found.append(simd.section(limit, progress))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and check if `--check` is given."""
    chosen = parser().parse_args(arguments)
    wrong = [part for part in chosen.parts if part not in PARTS or len(part) != 1]
    if wrong:
        parser().error(f"expected parts of {' '.join(PARTS)}, found {' '.join(wrong)}")
    if chosen.from_json:
        report = Report.from_json(chosen.from_json.read_text(encoding="utf-8"))
    else:
        words = sys.argv[1:] if arguments is None else arguments
        machine = describe()
        report = Report(" ".join(["python -m tests.benchmarks", *words]), machine, tuple(sections(chosen)))
    printed = report.as_json() if chosen.json else report.as_markdown() if chosen.markdown else report.as_text()
    sys.stdout.write(printed)
    if chosen.page:
        above = chosen.page.read_text(encoding="utf-8").split(HEAD)[0]
        chosen.page.write_text(f"{above}{HEAD}\n\n{report.as_markdown()}", encoding="utf-8")
    if chosen.write_baseline:
        baseline.write(report, chosen.baseline)
    if not chosen.check:
        return 0
    found = baseline.regressions(report, baseline.read(chosen.baseline))
    for regression in found:
        progress(f"regression: {regression}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
