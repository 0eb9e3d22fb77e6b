"""Long runs of the packaged graphs on their own clocks: ``make soak``, or ``soak.py --hours 24 [NAME...]``.

A loop that is proved in continuous time may diverge in discrete time, long after the graph's own `duration`. Each graph
is run for a day; one line each reports that it reached the end, or where it left its bounds.
"""

from __future__ import annotations

import argparse
import sys

import dmframe as dm
from dmframe.common.units import plain


def main() -> int:
    """Run them; the status is 1 if one diverged."""
    words = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    words.add_argument("--hours", type=float, default=24.0)
    words.add_argument("names", nargs="*", help="graphs; all packaged ones without")
    chosen = words.parse_args()
    diverged = 0
    for name in chosen.names or dm.graphs():
        graph = dm.load(name).set({"duration": f"{chosen.hours} h", "log.every": f"{chosen.hours / 800} h"})
        run = graph.run(engine="compiled", progress=False)
        error = run.error
        last = "" if error is None else f", |{error.signal}| {plain(float(error.norm[-1]), error.unit)} at its end"
        line = f"diverged: {run.divergence}" if run.divergence else f"sound for {chosen.hours:g} h{last}"
        diverged += run.divergence is not None
        print(f"{name:<32} {line}", flush=True)
    print(f"{diverged} diverged")
    return int(diverged > 0)


if __name__ == "__main__":
    sys.exit(main())
