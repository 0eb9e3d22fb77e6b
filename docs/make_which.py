"""Write the tables of docs/how_to/which.md: which controller for which task, and competitors on one plant.

    python docs/make_which.py [--draw | --laws] [GRAPH...]

All facts of a row are computed from the graph, its verdict and a run; `which.yaml` contains only the use of each graph.
Cells are stored in `which.csv` and `which_laws.csv`, which `dmframe which` reads too, and in `which_limits.csv`; from
them ``--draw`` makes the tables without a run. With names only their rows and missing ones are computed; with
``--laws`` only those of competitors. The first table is made of the answers of `dmframe which`.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
from ruamel.yaml import YAML

import dmframe as dm
from dmframe.block.port import Side
from dmframe.catalogue import find_graph, find_guide
from dmframe.common.errors import listed
from dmframe.common.names import unicode_name
from dmframe.common.units import plain
from dmframe.diagram import Diagram
from dmframe.diagram.knowledge import known_truths
from dmframe.graph.which import Guide, Rule, digits, guide, rows_of, short_verdict
from dmframe.results.metrics import goal_of
from dmframe.simulate.keep import rotation_distance_of
from dmframe.simulate.warnings import warning_signals

DOCS = Path(__file__).parent
PAGE, WORDS = DOCS / "how_to" / "which.md", DOCS / "which.yaml"
GUIDES = find_guide("which").parent
TABLE, LAWS, LIMITS = GUIDES / "which.csv", GUIDES / "which_laws.csv", DOCS / "which_limits.csv"
FACTS: Final = ("follows", "robot", "servo", "takes", "clock", "measured", "known", "learnt")
HEADS: Final = ("graph", *FACTS, "proved", "error")
FIGURES: Final = ("rms_final", "unit", "diverged_at", "at_limits")
LAW_HEADS: Final = ("law", "circle", "graph", *FIGURES)
LIMIT_HEADS: Final = ("law", "reality", *FIGURES, "room", "says")
REALITIES: Final = ("none", "ur")
ANSWERS_BEGIN, ANSWERS_END = "<!-- answers: begin -->", "<!-- answers: end -->"
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
LAWS_BEGIN, LAWS_END = "<!-- laws: begin -->", "<!-- laws: end -->"
LIMITS_BEGIN, LIMITS_END = "<!-- limits: begin -->", "<!-- limits: end -->"

FOLLOWED: Final = {"q": "joints", "x": "position", "chi": "point of an image"}
TAKEN: Final = {"rad": "position", "rad/s": "velocity", "N m": "torque"}
KNOWN: Final = {
    "lengths": "lengths",
    "axes": "axes",
    "tool": "tool",
    "tool_rotation": "tool's turn",
    "gravity": "gravity",
    "friction_velocity": "v₀",
    "inertia": "masses",
}
"""Groups of `dmframe.diagram.knowledge`, short."""
LEARNT: Final = {
    "a_k_hat": "lengths",
    "a_c_hat": "camera",
    "a_d_hat": "dynamics",
    "theta": "coefficients over samples",
    "w": "servo",
    "w_P": "servo",
    "w_I": "servo",
    "w_f": "servo",
    "w_r": "servo",
    "w_c": "servo",
    "w_z": "servo",
}
"""States that are estimates of constants."""


def words() -> dict[str, Any]:
    """The hand-written part."""
    return dict(YAML(typ="safe").load(WORDS.read_text(encoding="utf-8")))


def faults(texts: Mapping[str, Any], names: Sequence[str]) -> Iterator[str]:
    """Packaged graphs without a line, or with two, and lines about unknown graphs."""
    present, left = texts["graphs"].keys(), texts["left_out"].keys()
    yield from (f"{name} has no line in which.yaml" for name in names if name not in present | left)
    yield from (f"{name} has a line and is left out" for name in sorted(present & left))
    yield from (f"{name} is no packaged graph" for name in sorted((present | left) - set(names)))


def facts(graph: dm.Graph) -> dict[str, str]:
    """Cells read from a graph, without its verdict and its error."""
    diagram, file, robot = graph.diagram, graph.file, graph.robot
    return {
        "follows": followed(diagram),
        "robot": f"{file.robot.model}, {robot.n} joint{'s' * (robot.n > 1)}" if file.robot and robot else "-",
        "servo": servo(diagram),
        "takes": " and ".join(dict.fromkeys(TAKEN[unit] for unit in units_taken(diagram))),
        "clock": "continuous" if graph.clock is None else plain(graph.clock, "s"),
        "measured": measured(diagram),
        "known": known(diagram),
        "learnt": learnt(diagram),
    }


def followed(diagram: Diagram) -> str:
    """The controlled quantity, its goal, and the number of redundant joints."""
    goal = goal_of(diagram.loop)
    if goal is None:
        return "-"
    what = FOLLOWED[goal.actual.partition(".")[2]]
    rows = int(goal.found.numel())
    if rotation_distance_of(diagram.loop) is not None:
        what, rows = f"{what} and orientation", rows + 3
    moves = ca.depends_on(goal.wanted, diagram.loop.time) or any(
        ca.depends_on(leaf.expression, diagram.loop.time)
        for leaf in diagram.loop.trajectories
        if ca.depends_on(goal.wanted, leaf.symbol)
    )
    led = goal.desired.partition(".")[0]
    block = diagram.blocks.get(led)
    if block is not None and block.side is Side.CONTROLLER:
        what, moves = f"{what}, as `{diagram.type_of(led)}` shifts it", True
    free = diagram.robot.n - rows if diagram.robot is not None else 0
    target = "a path that waits" if diagram.loop.paced else "a path" if moves else "a point"
    return f"{what}; {target}" + (f"; {free} joint{'s' * (free > 1)} redundant" if free > 0 else "")


def servo(diagram: Diagram) -> str:
    """The kind of the closed servo, by its block's name."""
    types = [diagram.type_of(name) for name, block in diagram.blocks.items() if block.side is Side.PLANT]
    found = next((kind.removesuffix("_servo") for kind in types if kind.endswith("_servo")), "none")
    return found if found == "none" else found.upper().replace("_", "-")


def units_taken(diagram: Diagram) -> list[str]:
    """Units of the commands of the plant."""
    units = {signal.label: signal.unit for signal in diagram.loop.outputs}
    return [units[leaf.name] for leaf in diagram.loop.commanded]


def measured(diagram: Diagram) -> str:
    """Ports of the plant that the controller reads, without its own command."""
    own = {end.partition(".")[2] for end in (leaf.name for leaf in diagram.loop.measured)}
    return ", ".join(unicode_name(name) for name in sorted(own - {"q_c"}, key=lambda name: (len(name), name)))


def known(diagram: Diagram) -> str:
    """The robot's true numbers in the controller; the regressor has true lengths also if the task estimates them."""
    holds = known_truths(diagram)
    groups = {group for block in holds for group in block.groups}
    cells = []
    for group, word in KNOWN.items():
        if group in groups:
            alone = group == "lengths" and "a_k_hat" in estimates(diagram)
            cells.append(f"{word} (of the regressor)" if alone else word)
    return ", ".join(cells) or "-"


def estimates(diagram: Diagram) -> dict[str, int]:
    """Estimates of constants, and how many numbers each has."""
    return {
        variable.name: int(variable.symbol.numel()) for variable in diagram.loop.controller if variable.name in LEARNT
    }


def learnt(diagram: Diagram) -> str:
    """The estimates, each with the number of its elements."""
    declared = {item.name for model in diagram.models.values() for item in model.estimates}
    found, counts = estimates(diagram), dict[str, int]()
    if missing := declared - found.keys():
        raise KeyError(f"{listed(sorted(missing))}: no words in LEARNT")
    for name in (name for name in LEARNT if name in found):
        counts[LEARNT[name]] = counts.get(LEARNT[name], 0) + found[name]
    return ", ".join(f"{word} ({count})" for word, count in counts.items()) or "none"


def row_of(name: str) -> dict[str, str]:
    """The row of a graph, all of it."""
    graph = dm.load(name)
    verdict = graph.verify()
    proved = "no certificate" if verdict.outcome == "not_applicable" else verdict.headline
    return {"graph": name, **facts(graph), "proved": proved, "error": error_of(graph.run(progress=False, judge=False))}


def error_of(run: dm.Run) -> str:
    """The RMS over the last eighth in mm and degrees."""
    if run.divergence is not None:
        return f"diverges at {plain(run.divergence.time, 's')}"
    error, turn = run.error, run.turn
    if error is None or error.rms_final is None:
        return "-"
    rms = shown(error.rms_final, error.unit)
    return rms if turn is None or turn.rms_final is None else f"{rms}, {turn.rms_final:.2g}°"


def shown(value: float, unit: str) -> str:
    """Three digits in mm or degrees; two for a number without a unit, such as a point of an image."""
    if not unit:
        return f"{value:.2g}"
    scale, sign = {"m": (1e3, " mm"), "rad": (57.29577951308232, "°")}.get(unit, (1.0, f" {unit}".rstrip()))
    return f"{digits(scale * value)}{sign}"


def law_of(cell: str | Mapping[str, Any], on: str) -> dm.Graph:
    """The controller of a cell on the plant, path and clock of a packaged graph."""
    if isinstance(cell, str):
        return dm.load(cell)
    plant = _document(on)
    keep = {name for name, block in dm.load(on).blocks.items() if block.side is not Side.CONTROLLER}
    other = _document(cell["of"]) if "of" in cell else cell
    own = {name: block for name, block in plant["blocks"].items() if name in keep}
    blocks = {name: block for name, block in other["blocks"].items() if name not in keep or "of" not in cell}
    plant["blocks"] = own | blocks
    plant["wires"] = dict(other.get("wires", {}))
    plant.pop("baseline", None)
    return dm.load(plant).set(cell.get("set", {}))


def _document(name: str) -> dict[str, Any]:
    return dict(YAML(typ="safe").load(find_graph(name).read_text(encoding="utf-8")))


def real(graph: dm.Graph, reality: str) -> dm.Graph:
    """A law with non-idealities; one with a delay parameter is configured for the delay."""
    if reality == "none":
        return graph
    made = graph.reality(reality)
    delayed = [label for label, block in graph.blocks.items() if "delay" in type(block).model_fields]
    identified = any(getattr(graph.blocks[label], "delay_up_to", None) is not None for label in delayed)
    # the goal of the task is that of a later sample: correct if a predictor outputs the start of that sample
    if not delayed or identified or delayed == ["task"]:
        return made
    samples = made.data["blocks"]["transport_delay"]["samples"]
    return made.set({f"{label}.delay": samples for label in delayed})


def figures(run: dm.Run, graph: dm.Graph) -> dict[str, Any]:
    """Error and end of a run, and the share of its instants in which commands, torques or joints were at a limit."""
    plant = {name for name, block in graph.blocks.items() if block.side is Side.PLANT}
    labels = [item.label for item in warning_signals(graph.diagram) if item.label.split(".")[0] in plant]
    signals = [run.data[label].values for label in labels]
    beyond = [np.any(np.nan_to_num(values) != 0, axis=tuple(range(1, values.ndim))) for values in signals]
    share = float(np.mean(np.any(beyond, axis=0))) if beyond else ""
    found = dict.fromkeys(FIGURES, "") | {"at_limits": share}
    if run.divergence is not None:
        return found | {"diverged_at": run.divergence.time}
    assert run.error is not None  # each follows a circle
    return found | {"rms_final": run.error.rms_final, "unit": run.error.unit}


def law_row(law: Mapping[str, Any], k: int, circle: Mapping[str, str]) -> dict[str, Any]:
    """The result of a law on a circle."""
    cell = law["cells"][circle.get("cell", k)]
    named = cell if isinstance(cell, str) else cell.get("of", "")
    row = {"law": law["title"], "circle": circle["title"], "graph": named}
    graph = law_of(cell, circle["on"])
    if "servo" in circle:
        if "dq_c" not in {port.name for port in graph.blocks["servo"].inputs}:
            return row | dict.fromkeys(FIGURES, "")  # it drives the joints by torques
        graph = graph.set({"servo": circle["servo"]})
    graph = real(graph, circle.get("reality", "none"))
    return row | figures(graph.run(progress=False, judge=False), graph)


def limit_row(law: Mapping[str, Any], reality: str, on: str) -> dict[str, Any]:
    """Result of a law near the limits of the block `safe` of a packaged graph."""
    ideal, safe = law_of(law["cell"], on), dm.load(on).blocks["safe"]
    graph = real(ideal, reality)
    run = graph.run(progress=False, judge=False)
    q, lower, upper = run.data["arm.q"].values, *(np.asarray(getattr(safe, end)) for end in ("lower", "upper"))
    room = float(np.min(np.minimum(q - lower, upper - q)))
    says = _kept(ideal) if graph is ideal else ""
    return {"law": law["title"], "reality": reality, "room": room, "says": says} | figures(run, graph)


def _kept(graph: dm.Graph) -> str:
    """The proved bound of the joints."""
    statements = graph.verify().verdict.statements
    return next((item.says for item in statements if item.says.startswith("stays between")), "no proof")


def table(rows: list[dict[str, str]], texts: Mapping[str, Any]) -> Iterator[str]:
    """The table of graphs, in the order of the words."""
    by_name = {row["graph"]: row for row in rows}
    heads = ["use it if", "error", "proved", "controlled", "robot", "servo, command, clock"]
    heads += ["measured", "known exactly", "estimated"]
    yield f"| {' | '.join(heads)} |"
    yield "|" + "---|" * len(heads)
    for name, word in texts["graphs"].items():
        row = by_name[name]
        when = f"{word['when']}<br>[`{name}`]({word['page']})"
        interface = f"{row['servo']}, {row['takes']}, {row['clock']}"
        cells = [when, row["error"], short_verdict(row["proved"]), row["follows"], row["robot"], interface]
        yield f"| {' | '.join([*cells, row['measured'], row['known'], row['learnt']])} |"


def answer_table(found: Guide, texts: Mapping[str, Any]) -> Iterator[str]:
    """The table of answers, in their order; a condition that is not stated holds for any answer."""
    heads = ["servo", "period", "path", "load", "known"]
    yield f"| {' | '.join([*heads, 'take', 'error, mm: ideal / `ur`', 'reason'])} |"
    yield "|" + "---|" * (len(heads) + 3)
    for rule in found.rules:
        given = [", ".join(rule.when[key]) if key in rule.when else "any" for key in found.questions]
        yield f"| {' | '.join([*given, *_answer(found, rule, texts), rule.because])} |"


def _answer(found: Guide, rule: Rule, texts: Mapping[str, Any]) -> tuple[str, str]:
    """The cells of the graphs and their errors, one line a class of periods if these differ."""
    kinds, servo = dict(rule.graphs()), rule.when.get("servo", ("unknown",))[0]
    names = {kind: f"[`{name}`]({texts['graphs'][name]['page']})" for kind, name in kinds.items()}
    return _by_kind(names), _by_kind({kind: _errors(found, name, servo, kind) for kind, name in kinds.items()})


def _by_kind(cells: Mapping[str, str]) -> str:
    """A line for each class of periods; one alone if they are equal."""
    if len(set(cells.values())) == 1:
        return next(iter(cells.values()))
    return "<br>".join(f"{kind}: {cell}" for kind, cell in cells.items())


def _errors(found: Guide, name: str, servo: str, kind: str) -> str:
    take = found.taken(name, servo, kind)
    return "-" if take.ideal is None or take.ur is None else f"{digits(1e3 * take.ideal)} / {digits(1e3 * take.ur)}"


def law_table(rows: list[dict[str, str]], texts: Mapping[str, Any]) -> Iterator[str]:
    """The table of laws, one column a circle."""
    titles = [circle["title"] for circle in texts["circles"]]
    by_cell = {(row["law"], row["circle"]): row for row in rows}
    yield f"| law | {' | '.join(titles)} |"
    yield "|" + "---|" * (1 + len(titles))
    for law in texts["laws"]:
        yield f"| {law['title']} | {' | '.join(_cell(by_cell[law['title'], title]) for title in titles)} |"


def limit_table(rows: list[dict[str, str]], texts: Mapping[str, Any]) -> Iterator[str]:
    """The table of laws near limits, ideal and with non-idealities."""
    by_cell = {(row["law"], row["reality"]): row for row in rows}
    yield "| law | error | least distance | error, `ur` | least distance, `ur` | proved for the joints |"
    yield "|" + "---|" * 6
    for title in (law["title"] for law in texts["limits"]["laws"]):
        cells = (f"{_cell(by_cell[title, each])} | {_room(by_cell[title, each])}" for each in REALITIES)
        yield f"| {title} | {' | '.join(cells)} | {by_cell[title, 'none']['says']} |"


def _room(row: Mapping[str, str]) -> str:
    room = float(row["room"])
    return shown_mrad(room) if room >= 0 else f"**{shown_mrad(-room)} beyond**"


def shown_mrad(value: float) -> str:
    """Tenths, in mrad."""
    return f"{1e3 * value:.1f} mrad"


def _cell(row: Mapping[str, str]) -> str:
    if row["diverged_at"]:
        return f"**diverges** at {plain(float(row['diverged_at']), 's')}"
    if not row["rms_final"]:
        return "-"
    rms = shown(float(row["rms_final"]), row["unit"])
    share = float(row["at_limits"] or 0)
    return f"**{rms}**, at limits {100 * share:.0f} % of the time" if share >= 0.01 else rms


def write(path: Path, heads: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    """Write rows."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, heads, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def fill(
    text: str,
    rows: list[dict[str, str]],
    laws: list[dict[str, str]],
    limits: list[dict[str, str]],
    texts: Mapping[str, Any],
) -> str:
    """The page with its tables put in."""
    parts = (
        (ANSWERS_BEGIN, ANSWERS_END, answer_table(guide(), texts)),
        (BEGIN, END, table(rows, texts)),
        (LAWS_BEGIN, LAWS_END, law_table(laws, texts)),
        (LIMITS_BEGIN, LIMITS_END, limit_table(limits, texts)),
    )
    for begin, end, lines in parts:
        before, _, rest = text.partition(begin)
        text = "".join([before, begin, "\n", "\n".join(lines), "\n", end, rest.partition(end)[2]])
    return text


def draw() -> None:
    """The page from the stored rows."""
    text = fill(PAGE.read_text(encoding="utf-8"), rows_of(TABLE), rows_of(LAWS), rows_of(LIMITS), words())
    PAGE.write_text(text, encoding="utf-8")


def main(arguments: list[str]) -> None:
    """Compute rows, store them, and draw the page."""
    texts, names = words(), [word for word in arguments if not word.startswith("--")]
    if wrong := list(faults(texts, dm.graphs())):
        sys.exit("\n".join(wrong))
    if not {"--draw", "--laws"} & set(arguments):
        kept = {row["graph"]: row for row in rows_of(TABLE)} if names and TABLE.exists() else {}
        for name in texts["graphs"]:
            if name not in kept or name in names:
                kept[name] = row_of(name)
                sys.stderr.write(f"{name}\n")
        write(TABLE, HEADS, [kept[name] for name in texts["graphs"]])
    if "--draw" not in arguments and not names:
        circles, limits = list(enumerate(texts["circles"])), texts["limits"]
        write(LAWS, LAW_HEADS, [law_row(law, k, circle) for law in texts["laws"] for k, circle in circles])
        near = [limit_row(law, reality, limits["on"]) for law in limits["laws"] for reality in REALITIES]
        write(LIMITS, LIMIT_HEADS, near)
    draw()


if __name__ == "__main__":
    main(sys.argv[1:])
