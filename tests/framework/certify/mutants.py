"""Faults seeded into equations, certificates and shared functions; `python tests/framework/certify/mutants.py`.

Each fault ends with one of `OUTCOMES`. It is tried in the fastest closed loops that contain its place, until it changes
an expression in one; with ``--everywhere`` in all of them. Results in a file are not computed again, unless a source
has changed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import re
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from hashlib import sha256
from pathlib import Path

from closed_loops import known_blocks, loops
from judged_faults import OUTCOMES, tried
from seeded_faults import LIBRARY, Mutant, all_mutants

import dmframe
import dmframe_blocks

SHARE = 20
"""Number of faults that a process tries before it reports."""

Row = Mapping[str, str | float]
"""A result as JSON: fault, loop, outcome, reason, CPU seconds, and the hash of the sources."""


@cache
def faults(scope: str) -> tuple[Mutant, ...]:
    """Every fault of `scope` that is part of some closed loop."""
    found = all_mutants(certificates=scope != "equations", library=scope == "all")
    held = {kind for loop in loops() for kind in loop.types} | set(LIBRARY)
    return tuple(mutant for mutant in found if mutant.owner in held)


def without_loop() -> list[str]:
    """Types of blocks in no closed loop, whose faults are therefore not tried."""
    return sorted(set(known_blocks()) - {kind for loop in loops() for kind in loop.types})


@cache
def sources() -> str:
    """A hash of the framework, the blocks, the closed loops, and the code that evaluates a fault."""
    folders = [Path(module.__file__).parent for module in (dmframe, dmframe_blocks)]
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    files += [Path(__file__).with_name(f"{name}.py") for name in ("closed_loops", "seeded_faults", "judged_faults")]
    return sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()[:16]


def share(scope: str, everywhere: bool, places: Sequence[int]) -> list[Row]:
    """The results of some faults; each process builds its own list of faults."""
    rows = list[Row]()
    for place in places:
        mutant, begin = faults(scope)[place], time.process_time()
        results = tried(mutant, everywhere)
        seconds = (time.process_time() - begin) / max(1, len(results))
        rows += [
            {
                "fault": str(mutant),
                "loop": result.loop,
                "outcome": result.outcome,
                "reason": result.reason,
                "seconds": round(seconds, 3),
                "sources": sources(),
            }
            for result in results
        ]
    return rows


def read_results(path: Path | None) -> list[Row]:
    """The results in a file that were computed from these sources."""
    if path is None or not path.exists():
        return []
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [row for row in rows if row["sources"] == sources()]


def main() -> int:
    """Try all faults, and print the number of faults with each outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--everywhere", action="store_true", help="each fault in every closed loop that holds its place"
    )
    parser.add_argument("--scope", choices=["equations", "blocks", "all"], default="all", help="whose faults")
    parser.add_argument("--list", action="store_true", help="print every fault that was not refuted")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--results", type=Path, help="file of results, one a line; it is read first, and added to")
    parser.add_argument("--every", type=int, default=1, help="only each n-th fault")
    options = parser.parse_args()
    rows = read_results(options.results)
    known = {row["fault"] for row in rows}
    chosen = range(0, len(faults(options.scope)), options.every)
    left = [place for place in chosen if str(faults(options.scope)[place]) not in known]
    shares = [left[first : first + SHARE] for first in range(0, len(left), SHARE)]
    random.Random(0).shuffle(shares)  # a run that is stopped has tried some faults of every block
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(share, options.scope, options.everywhere, places) for places in shares]):
            rows += done.result()
            if options.results:
                with options.results.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(row) + "\n" for row in done.result())
            survived = sum(row["outcome"] == "survived" for row in rows)
            print(f"{len(rows)} of {len(chosen)} results, {survived} survived", file=sys.stderr)  # noqa: T201
    return reported(rows, options.list)


LOST = re.compile(r"\b(NameError|UnboundLocalError|ImportError)\b")
"""Errors that come from the harness, which compiles a function without its names, not from a fault."""

CAUSE = re.compile(r"\b\w+(Error|StopIteration)\b")


def reported(rows: Sequence[Row], every: bool) -> int:
    """Print the results; 1 if a fault survived, or a name was lost."""
    lost = [row for row in rows if row["outcome"] == "no diagram" and LOST.search(str(row["reason"]))]
    for row in rows:
        if row["outcome"] == "survived" or row in lost or (every and row["outcome"] != "refuted"):
            print(f"{row['outcome']}: {row['fault']} [{row['loop']}]: {row['reason']}")  # noqa: T201
    counts = Counter(row["outcome"] for row in rows)
    for outcome, meaning in OUTCOMES.items():
        print(f"{counts[outcome]:6d} {outcome:12s} {meaning}")  # noqa: T201
    for (outcome, why), count in sorted(Counter(_why(row) for row in rows if row["outcome"] != "refuted").items()):
        print(f"{count:6d} {outcome}: {why}")  # noqa: T201
    print(f"{sum(float(row['seconds']) for row in rows):.0f} CPU s")  # noqa: T201
    print(f"in no closed loop, so not tried: {', '.join(without_loop())}")  # noqa: T201
    return 1 if counts["survived"] or lost else 0


def _why(row: Row) -> tuple[str, str]:
    """Outcome, and the class of its reason."""
    outcome, reason = str(row["outcome"]), str(row["reason"])
    if outcome == "no diagram":
        error = CAUSE.search(reason)
        return outcome, f"{error.group()} in the function" if error else "refused by the framework"
    return outcome, reason if outcome in ("equivalent", "unchanged") else "all"


if __name__ == "__main__":
    sys.exit(main())
