"""Ten thousand robots for every packaged controller: ``python docs/study/every_controller.py [RUNS] [GRAPH...]``.

For each run of a graph the servo's gains and the robot's friction are drawn within a factor of two; a run takes 20 s at
most. Results go to ``studies/every_controller``, where existing rows are not computed again; the table goes to
``every_controller.csv`` and to the page. With names, only their rows are replaced.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

import dmframe as dm
from dmframe.block.port import Side
from dmframe.common.units import plain
from dmframe.study.proof import proofs_of

FOLDER = Path(__file__).parent
PAGE, TABLE = FOLDER / "every_controller.md", FOLDER / "every_controller.csv"
RUNS, SECONDS = 10_000, 20.0
VARIED = {"servo": ("K_D", "K_P", "K_I", "K_v", "K_i"), "friction": ("viscous", "coulomb")}
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
HEADS = ("graph", "varied", "runs", "diverged", "at_most", "unit", "median", "q99", "proved")


def study_of(name: str, runs: int) -> dict[str, Any]:
    """One factor for all gains of the servo, one for all friction, each from half to twice the graph's."""
    graph = dm.load(name)
    plant = {label: block for label, block in graph.blocks.items() if block.side is Side.PLANT}
    sample = dict[str, Any]()
    for factor, keys in VARIED.items():
        labels = [f"{label}.{key}" for label, block in plant.items() for key in keys if getattr(block, key, None)]
        if labels:
            sample[factor] = {"scale": {"log": [0.5, 2]}, "of": labels}
    return {
        "dmframe-study": 1,
        "title": f"{runs} robots for {name}",
        "graph": name,
        "set": {"duration": min(graph.duration, SECONDS)},
        "sample": {"runs": runs, "seed": 1, **sample},
    }


def row_of(name: str, runs: int) -> dict[str, Any]:
    """The row of a graph, from its study."""
    data = study_of(name, runs)
    study = dm.load_study(data)
    results = study.run(Path("studies/every_controller") / name)
    found = results.table.row(0, named=True)
    (proof,) = proofs_of(study, [name])
    varied = " and ".join(factor for factor in VARIED if factor in data["sample"]) or "none"
    figures = (found.get("rms_final_median"), found.get("rms_final_q99"))
    return {"graph": name, "varied": varied, "runs": found["runs"], "diverged": found["diverged"]} | {
        "at_most": found["at_most"],
        "unit": results.units.get("rms_final", ""),
        "median": figures[0],
        "q99": figures[1],
        "proved": "yes" if proof.proved else "not all",
    }


def table(rows: list[dict[str, str]]) -> str:
    """The row as shown in the page."""
    lines = ["| graph | varied | diverged | at most | median | 99 % | proved |", "|" + "---|" * 7]
    for row in rows:
        share = f"{int(row['diverged']) / int(row['runs']):.2%}" if int(row["diverged"]) else "none"
        cells = [f"`{row['graph']}`", row["varied"], share, f"{float(row['at_most']):.3%}"]
        cells += ["-" if row[key] in ("", "inf") else plain(float(row[key]), row["unit"]) for key in ("median", "q99")]
        lines.append(f"| {' | '.join((*cells, row['proved']))} |")
    return "\n".join(lines)


def write(rows: list[dict[str, Any]]) -> None:
    """Write the table next to the page and into it."""
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, HEADS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    with TABLE.open(encoding="utf-8", newline="") as file:
        text = table(list(csv.DictReader(file)))
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def main(words: list[str]) -> None:
    """Run one graph after the other; the table grows with each."""
    runs, names = int(words[0]) if words else RUNS, words[1:]
    rows = dict[str, dict[str, Any]]()
    if names:
        with TABLE.open(encoding="utf-8", newline="") as file:
            rows = {row["graph"]: row for row in csv.DictReader(file)}
    for name in names or dm.graphs():
        if study_of(name, runs)["sample"].keys() & VARIED.keys():  # others have neither
            rows[name] = row_of(name, runs)
            write([rows[key] for key in sorted(rows)])


if __name__ == "__main__":
    main(sys.argv[1:])
