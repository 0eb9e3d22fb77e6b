"""Every packaged controller with encoder, delay and load: ``python docs/study/robustness.py [--draw] [GRAPH...]``.

Each controller that commands a servo runs ideal, behind an encoder, also behind one sample of delay, and also with a
load from half time on, on four clocks. A law with a delay parameter is configured for it. Rows go to
``robustness.csv``, where existing rows are not computed again, and from there to the page; ``--draw`` only writes the
page.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import dmframe as dm
from dmframe.block.port import Side
from dmframe.common.errors import DmframeError
from dmframe.common.units import plain

FOLDER = Path(__file__).parent
PAGE, TABLE = FOLDER / "robustness.md", FOLDER / "robustness.csv"
CLOCKS: Final = ("8 ms", "20 ms", "40 ms", "90 ms")
SECONDS: Final = 60.0
ENCODER: Final = {"encoder": {"step": "47.94 urad"}}
DELAYED: Final = ENCODER | {"transport_delay": {"samples": 1}}
CASES: Final[dict[str, dict[str, Any]]] = {"ideal": {}, "encoder": ENCODER, "delay": DELAYED, "load": DELAYED}
HEADS: Final = ("graph", "clock", "case", "rms_final", "unit", "most_after", "diverged_at")
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"


def controllers() -> list[str]:
    """Packaged graphs that command a closed servo and have an error."""
    found = []
    for name in dm.graphs():
        graph = dm.load(name)
        plant = [block for block in graph.blocks.values() if block.side is Side.PLANT]
        servo = any(port.name == "dq_c" for block in plant for port in block.inputs)
        if servo and graph.clock is not None:
            found.append(name)
    return found


def changed(name: str, clock: str, case: str) -> dm.Graph:
    """One controller with one set of non-idealities; a load is added after half of the time."""
    graph = dm.load(name)
    reality = dict(CASES[case])
    if case == "load":
        reality["loaded_manipulator"] = {"payload": [_load(graph)], "payload_at": [f"{SECONDS / 2} s"]}
    graph = graph.set({"clock": clock, "duration": f"{SECONDS} s"})
    if "transport_delay" in reality:
        delayed = [label for label in graph.blocks if "delay" in type(graph.blocks[label]).model_fields]
        if delayed != [
            "task"
        ]:  # its goal is that of a later sample: correct if a predictor outputs the start of that sample
            graph = graph.set({f"{label}.delay": 1 for label in delayed})
    return graph.reality(reality) if reality else graph


def _load(graph: dm.Graph) -> str:
    """A sixth of the mass of the links, some 5 kg for a UR10."""
    robot = graph.diagram.robot
    assert robot is not None  # it has a servo
    return f"{sum(float(link[0]) for link in robot.inertia) / 6:.1f} kg"


def row_of(name: str, clock: str, case: str) -> dict[str, Any]:
    """The row of a run; empty for a graph that cannot be run in this way."""
    empty = dict.fromkeys(HEADS, "") | {"graph": name, "clock": clock, "case": case}
    if case == "load" and any(kind == "loaded_manipulator" for kind in _types(name)):
        return empty  # the graph has its own load, which is not replaced
    try:
        run = changed(name, clock, case).run(progress=False)
    except DmframeError:
        return empty
    error, at = run.error, run.divergence.time if run.divergence else ""
    if error is None:
        return empty
    after = error.norm[run.time >= SECONDS / 2]
    figures = {} if run.divergence else {"rms_final": error.rms_final, "most_after": float(max(after))}
    return empty | {"unit": error.unit, "diverged_at": at} | figures


def _types(name: str) -> list[str]:
    diagram = dm.load(name).diagram
    return [diagram.type_of(label) for label in diagram.blocks]


def table(rows: list[dict[str, str]]) -> Iterator[str]:
    """The tables of the page, one per clock."""
    for clock in CLOCKS:
        yield f"\n## {clock}\n"
        yield "| graph | ideal | encoder | and a sample of delay | and a load at 30 s (peak) |"
        yield "|---|---|---|---|---|"
        names = sorted({row["graph"] for row in rows})
        for name in names:
            mine = {row["case"]: row for row in rows if (row["graph"], row["clock"]) == (name, clock)}
            if len(mine) == len(CASES):
                yield f"| `{name}` | {' | '.join(_cell(mine[case], case) for case in CASES)} |"


def _cell(row: dict[str, str], case: str) -> str:
    if row["diverged_at"]:
        return f"**diverges** at {plain(float(row['diverged_at']), 's')}"
    if not row["rms_final"]:
        return "-"
    rms = plain(float(row["rms_final"]), row["unit"])
    return f"{rms} ({plain(float(row['most_after']), row['unit'])})" if case == "load" else rms


def write(rows: list[dict[str, Any]]) -> None:
    """Write the table next to the page and into it."""
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, HEADS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    draw()


def draw() -> None:
    """The page from the table."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text("".join([before, BEGIN, "\n", "\n".join(table(rows)), "\n", END, after]), encoding="utf-8")


def main(words: list[str]) -> None:
    """Compute the missing rows, and write each when it is complete."""
    if "--draw" in words:
        draw()
        return
    rows = list[dict[str, Any]]()
    if TABLE.exists():
        with TABLE.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    done = {(row["graph"], row["clock"], row["case"]) for row in rows}
    for name in words or controllers():
        for clock in CLOCKS:
            for case in (case for case in CASES if (name, clock, case) not in done):
                rows.append(row_of(name, clock, case))
                sys.stderr.write(f"{name} {clock} {case}\n")
        write(rows)


if __name__ == "__main__":
    main(sys.argv[1:])
