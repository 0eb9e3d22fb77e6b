"""Page of an identification: the answer, the verdict, the fit, the parameters, and how to repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from dmframe.common.plotting import COLORS, COLUMN, DASHES, draw_curve, figure_svg, frame, names_above, page
from dmframe.common.units import plain
from dmframe.identification.answer import Judged, millimetres
from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.report.parts import Bullets, Cell, Columns, Lead, Marked, Paragraph, Picture, Section, Table, Titled, Word
from dmframe.study.pages import study_page

CLASSES: Final = {"pi": "PI servo", "pid": "PID servo", "p_pi": "P-PI cascade"}
MEANINGS: Final = {
    "w": ("inverse of the velocity gain", "rad/(N m s)"),
    "k_P": ("proportional over velocity gain", "1/s"),
    "k_I": ("integral over velocity gain", "1/s²"),
    "k_p": ("position gain", "1/s"),
    "k_i": ("integral over velocity gain", "1/s"),
    "f": ("velocity feed-forward", ""),
    "viscous": ("viscous friction", "N m s/rad"),
    "coulomb": ("Coulomb friction", "N m"),
    "sticking": ("additional friction at low speed", "N m"),
    "per_torque": ("friction per torque", ""),
    "friction_velocity": ("velocity of the friction law", "rad/s"),
    "stribeck_velocity": ("Stribeck velocity", "rad/s"),
}
ROW: Final = 1.15
"""Height of a panel [inch]."""
_STYLES: Final[Sequence[dict[str, Any]]] = (
    {"color": COLORS[3], "linewidth": 2.2},
    {"color": COLORS[4], "linewidth": 0.7},
    {"color": COLORS[3], "linewidth": 0.5},
)
"""Of the measured and the simulated error, and of the residual."""
RESTRICTION: Final = (
    "The verdict holds for what the identified robot contains. Elastic joints, friction with memory, a wrong kinematic "
    "model, limits of acceleration and loads that change are not in it. An interval is from the least to the largest "
    "of the draws from the covariance of the fit."
)


def as_html(found: Identified) -> str:
    """The page, as one self-contained file."""
    log, record = found.fit.unknowns.log, found.record
    note = (
        f"{record.get('log', 'log')}: {len(log.time)} samples of {plain(log.period, 's')}, "
        f"{plain(float(log.time[-1]), 's')} of positions and commands."
    )
    name = found.fit.unknowns.model.chain.name
    return study_page("Identified servo", name, "", note, lead(found), list(_sections(found)))


def lead(found: Identified) -> Lead:
    """Class, delay and verdict."""
    verdict = f"Verdict: {found.verdict.sentence}.".replace("$", "")  # a file's name may have it, a formula has none
    if not found.known:
        closest, where = CLASSES[found.choice.best.replace("_0", "")], ", ".join(found.unexplained)
        why = f"the closest class, {closest}, leaves more than three times the floor at {where}"
        return Lead("refuted", "Unknown servo", Marked(f"{why}. {verdict}"))
    value, (low, high) = found.delay
    period = 1000 * found.fit.unknowns.log.period
    delay = f"delay {value:.3f} samples ({low:.3f} to {high:.3f}), {value * period:.3g} ms"
    return Lead("proved", CLASSES[found.kind], Marked(f"{delay}. {verdict}"))


def _sections(found: Identified) -> Iterator[Section]:
    if found.verdict.laws:
        yield Section("verdict", "Is an adaptive law worth it?", [_laws(found), Paragraph(RESTRICTION, note=True)])
    figures = Columns([Titled("Tracking error", _errors(found)), Titled("Residual", _residuals(found))])
    yield Section("fit", "Measured and simulated", [figures, _floors(found)])
    if found.known:
        yield Section("parameters", "Parameters", [_numbers(found), _shared(found)])
        yield Section("bodies", "Base parameters", [_bodies(found)])
    yield Section("separable", "What positions cannot separate", [Bullets(list(found.indistinguishable))])
    yield Section("notices", "Notices", [Bullets(list(found.notices))])
    yield Section("again", "To repeat it", [*_again(found)])


def _laws(found: Identified) -> Table:
    verdict = found.verdict
    rows = [[_path(verdict.paths[law.path]), *_law(law)] for law in verdict.laws]
    heads: list[Cell] = ["path", "law", "error, mm", "interval, mm", "tuned values"]
    caption = (
        f"RMS of the tool's error over {verdict.draws} draws of the identified robot at {plain(verdict.clock, 's')}; "
        "the best first. All laws have been tuned by one protocol on the best fit. Position noise at the tool: "
        f"{millimetres(verdict.resolution)} mm."
    )
    best = [k for k, law in enumerate(verdict.laws) if k == 0 or verdict.laws[k - 1].path != law.path]
    marked = [
        [Word(str(cell), "strong") if k in best and c == 2 else cell for c, cell in enumerate(row)]
        for k, row in enumerate(rows)
    ]
    return Table(marked, heads, caption, kind="study", numbers=(2, 3))


def _path(path: Any) -> str:
    return "repeats" if path["repeats"] else "never repeats"


def _law(law: Judged) -> list[Cell]:
    values = ", ".join(f"{name} = {value:.4g}" for name, value in law.values.items())
    interval = " to ".join(map(millimetres, law.interval))
    return [Word(law.law, "code"), millimetres(law.error), interval, values or "none: diverged in tuning"]


def _errors(found: Identified) -> Picture:
    log = found.fit.unknowns.log
    measured = 1000 * (log.q - log.q[0] - log.commanded(log.time))
    curves = [("measured", measured), ("simulated", measured - 1000 * found.fit.residual)]
    svg = _panels(found, log.time, curves, "mrad")
    return Picture(svg, "errors", "Position minus commanded position, measured and of the identified robot.")


def _residuals(found: Identified) -> Picture:
    svg = _panels(
        found, found.fit.unknowns.log.time, [("residual", 1e6 * found.fit.residual)], "µrad", 1e6 * found.choice.floor
    )
    return Picture(
        svg, "residuals", "Measured minus simulated position; the dashed lines are plus and minus the floor."
    )


def _panels(
    found: Identified, t: Array, curves: Sequence[tuple[str, Array]], unit: str, band: Array | None = None
) -> str:
    """A panel for each joint."""
    chain = found.fit.unknowns.model.chain
    with page(COLUMN, 0.5 + ROW * chain.n) as figure:
        panels = figure.subplots(chain.n, 1, sharex=True, squeeze=False)[:, 0]
        for j, (axes, name) in enumerate(zip(panels, chain.joint_names, strict=True)):
            for (label, values), style in zip(curves, _STYLES if band is None else _STYLES[2:], strict=False):
                draw_curve(axes, t, values[:, j], most=1500, label=label, **style)
            if band is not None:
                axes.axhline(band[j], color=COLORS[2], linestyle=DASHES[1], label="floor")
                axes.axhline(-band[j], color=COLORS[2], linestyle=DASHES[1])
            ends = [] if band is None else [(np.array([-band[j], band[j]]), False)]
            frame(axes, [*((values[:, j], False) for _, values in curves), *ends])
            axes.set_title(name, loc="left")
            axes.set_ylabel(unit)
        panels[-1].set_xlabel("time [s]")
        panels[-1].set_xlim(t[0], t[-1])
        names_above(figure, panels[0], COLUMN)
    return figure_svg(figure)


def _floors(found: Identified) -> Table:
    names = found.fit.unknowns.model.chain.joint_names
    pairs = zip(names, 1e6 * found.fit.rms, 1e6 * found.choice.floor, strict=True)
    rows: list[list[Cell]] = [[name, f"{rms:.4g}", f"{floor:.4g}", f"{rms / floor:.2f}"] for name, rms, floor in pairs]
    caption = (
        "The floor is the residual of an exact twin: noise, and a thousandth of the tracking error. A class explains "
        "the log up to a ratio of 3."
    )
    return Table(
        rows,
        ["joint", "RMS residual, µrad", "floor, µrad", "ratio"],
        caption,
        kind="study",
        keys=True,
        numbers=(1, 2, 3),
    )


def _numbers(found: Identified) -> Table:
    joints = found.fit.unknowns.model.chain.joint_names
    rows = [
        [_named(name, found.kind), *(_number(value, limits) for value, limits in zip(*own, strict=True))]
        for name, own in (found.servo | found.friction).items()
        if len(own[0]) == len(joints)
    ]
    caption = "Values with intervals of two standard deviations, widened for the autocorrelation of the residual."
    return Table(rows, ["parameter", *joints], caption, kind="study", keys=True)


def _shared(found: Identified) -> Table:
    joints = found.fit.unknowns.model.n
    rows = [
        [_named(name, found.kind), _number(*(each[0] for each in own))]
        for name, own in found.friction.items()
        if len(own[0]) < joints
    ]
    value, limits = found.delay
    delay: list[Cell] = [("delay", Word("from command to servo, samples", "next")), _number(value, limits)]
    return Table([delay, *rows], ["parameter", "all joints"], kind="study", keys=True)


def _named(name: str, kind: str) -> Cell:
    meaning, unit = MEANINGS[name]
    unit = "1/s" if kind == "pi" and name == "k_I" else unit
    return (Word(name, "code"), Word(f"{meaning}, {unit}" if unit else meaning, "next"))


def _number(value: float, limits: Sequence[float] | Array) -> Cell:
    return (f"{value:.4g}", Word(f"{limits[0]:.4g} to {limits[1]:.4g}", "next"))


def _bodies(found: Identified) -> Table:
    base, (values, limits) = found.fit.unknowns.model.base, found.number("beta")
    rows: list[list[Cell]] = [
        [Word(name, "code"), f"{value:.4g}", f"{low:.4g} to {high:.4g}", meaning]
        for name, meaning, value, (low, high) in zip(base.kept, base.symbolic, values, limits, strict=True)
    ]
    caption = (
        "Combinations of inertial parameters that the motion depends on, in kg, kg m and kg m²; the scale is that of "
        "the robot's file."
    )
    return Table(rows, ["parameter", "value", "interval", "contains"], caption, kind="study", keys=True, numbers=(1, 2))


def _again(found: Identified) -> Iterator[Bullets | Table]:
    items: list[Cell] = []
    if command := found.record.get("command"):
        items.append((Word(str(command), "command"), " repeats this identification"))
    if found.known:
        items.append((Word("dmframe run twin.yaml", "command"), " runs the identified robot along a joint path"))
    if found.verdict.laws:
        items.append(
            (Word("dmframe race verdict.yaml", "command"), " repeats the comparison of laws, also with a law of yours")
        )
    yield Bullets(items)
    rows: list[list[Cell]] = [
        [name, Word(str(value), "long" if name == "sha256" else "small")]
        for name, value in found.record.items()
        if name not in ("columns", "command", "period")
    ]
    yield Table(rows, kind="values", keys=True)
