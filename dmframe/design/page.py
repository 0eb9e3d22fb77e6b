"""Report of a design: the verdict first, then the laws, the checks, what it rests on, and how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from dmframe.common.units import plain
from dmframe.design.decide import Candidate
from dmframe.design.designed import Check, Designed
from dmframe.design.family import HELD_OUT, TRAINING, Kind
from dmframe.report.parts import Badge, Bullets, Cell, Lead, Marked, Paragraph, Section, Table, Word
from dmframe.study.pages import study_page

LAWS: Final = {
    "feedback": "proportional feedback of the joint errors, with prediction over the delay",
    "level": "feedback, and an observer of a constant disturbance",
    "trend": "feedback, and an observer of a disturbance that changes at a constant rate",
    "repetitive": "feedback, and a Fourier series of the disturbance on a path of known rate",
    "experts": "identified delay and servo, and corrections weighted by their past errors",
    "adaptive": "adaptive dynamics and inverse of the servo, the law of first.yaml",
}
"""What each law is."""
_LEADS: Final = {"adaptive": "proved", "simple": "not_applicable", "blocked": "refuted"}


def as_html(found: Designed) -> str:
    """The report as one self-contained HTML file."""
    note = f"Sampled at {plain(found.clock, 's')}, with a load of up to {found.payload:.3g} kg at the tool."
    answer = Lead(_LEADS[found.outcome], found.headline, Marked(found.reason))
    return study_page("Design of a controller", found.robot, "", note, answer, list(_sections(found)))


def _sections(found: Designed) -> Iterator[Section]:
    if found.ranking is not None:
        yield Section("laws", "The laws", [_laws(found), Paragraph(_measure(found), note=True)])
    if found.notes:
        yield Section("path", "The path", [Bullets([(note,) for note in found.notes])])
    if found.assumed:
        yield Section("assumed", "What was assumed of the robot", [Bullets([(text,) for text in found.assumed])])
    if found.checks:
        yield Section("checks", "The checks", [_checks(found)])
    if found.ranking is not None and not found.log:
        yield Section("plants", "The servos", [_plants(), Paragraph(Marked(_assumed()), note=True)])
    if found.files:
        rows: list[list[Cell]] = [[Word(name, "file"), about] for name, about in found.files]
        yield Section("files", "The files", [Table(rows, ["file", "what it is"], "In the folder of this page.")])
    again: Cell = (Word(found.command, "command"), " continues this design, or repeats it in another folder")
    yield Section("again", "To repeat it", [Bullets([again])])


def _laws(found: Designed) -> Table:
    assert found.ranking is not None
    rows = list[list[Cell]]()
    for item in sorted(found.ranking.candidates, key=lambda item: (item.score, item.law)):
        values = ", ".join(f"{label} = {value:.3g}" for label, value in item.values.items()) or "all rejected"
        own = (Word(item.law, "code"), Word(LAWS.get(item.law, ""), "next"))
        named: Cell = (own[0], " ", Badge("handed over", "proved"), own[1]) if item is found.chosen else own
        kind = "adaptive" if item.adaptive else "without a model"
        rows.append([named, kind, _number(item.error), _number(_worst(item)), str(_lost(item)), values])
    unit = found.unit
    heads: list[Cell] = ["law", "kind", f"median, {unit}", f"largest, {unit}", "diverged", "tuned values"]
    count = len(found.ranking.candidates[0].errors)
    cells = f"{count} cells: pairs of a servo and a path on which no law was tuned"
    caption = f"RMS error over the last eighth of {found.seconds:g} s, on {cells}."
    return Table(rows, heads, caption, kind="study", keys=True, numbers=(2, 3, 4))


def _measure(found: Designed) -> str:
    if found.chosen is None:
        return "No law is handed over."
    return (
        "An adaptive law is handed over if the median of its ratio to the best law without a model is at most 0.8, if "
        "it is at most 1.15 times as large in 85 % of the cells, if it is proved, if only for its estimates, "
        "and if it passes the rehearsal."
    )


def _checks(found: Designed) -> Table:
    rows: list[list[Cell]] = [[check.of, _result(check), check.text] for check in found.checks]
    caption = "The proof is of the model that runs here, a rehearsal of a simulated robot."
    if any(check.passed and not check.whole for check in found.checks):
        caption += " The proof does not cover the stability of the whole loop, which is tested by runs alone."
    return Table(rows, ["check", "", "result"], caption)


def _result(check: Check) -> Badge:
    if not check.passed:
        return Badge("failed", "refuted")
    return Badge("passed", "proved") if check.whole else Badge("passed, in part", "not_applicable")


def _plants() -> Table:
    rows = list[list[Cell]]()
    for use, kinds in (("tuning", TRAINING), ("comparison", HELD_OUT)):
        rows += [[Word(name, "code"), use, *_kind(kind)] for name, kind in kinds.items()]
    heads: list[Cell] = ["servo", "used for", "kind", "stiffness", "friction", "feed-forward", "delay", "load"]
    caption = "Relative to the placeholder of the first graph; delays in samples, besides one sample of the channel."
    return Table(rows, heads, caption, kind="study", numbers=(3, 4, 5, 6))


def _kind(kind: Kind) -> list[Cell]:
    share = f"{kind.feed_forward:g}" if kind.cascade else ""
    numbers = [f"{kind.stiffness:g}", f"{kind.friction:g}", share, f"{kind.delay:g}"]
    return ["P-PI cascade" if kind.cascade else "PID", *numbers, "after half of the time" if kind.loaded else "none"]


def _assumed() -> str:
    return (
        "The servo of this robot is not known: these are assumptions, scaled to the robot's inertia. A log of it "
        "determines its servo: see the command `identify`."
    )


def _number(value: float) -> str:
    return "diverged" if math.isinf(value) else f"{value:.3g}"


def _worst(item: Candidate) -> float:
    return max((error for error in item.errors if math.isfinite(error)), default=math.inf)


def _lost(item: Candidate) -> int:
    return sum(map(math.isinf, item.errors))
