"""A search's report: the answer first, then what it rests on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from dmframe.plotting import figure_svg
from dmframe.report import html
from dmframe.report.html import plain as text_of
from dmframe.report.html import tag
from dmframe.report.page import document
from dmframe.report.parts import Badge, Bullets, Cell, Lead, Marked, Paragraph, Picture, Section, Table, Word
from dmframe.units import plain

if TYPE_CHECKING:
    from dmframe.study.plan import Study
    from dmframe.study.tuned import Tuned
    from dmframe.study.varied import Factor

_CAPTIONS = {
    "search": "The first objective, trial by trial.",
    "front": "What cannot be had together: to the left and below is better, and nothing that was tried lies there.",
    "values": "The first objective over each value that was searched; the best in colour.",
}


def as_html(found: Tuned, figures: Mapping[str, Any]) -> str:
    """The page, in one file that fetches nothing."""
    study = found.tuning.study
    titled = [tag("p", text_of(study.title), class_="doc-title")] if study.title else []
    kind = tag("p", text_of("Tuning of a control loop"), class_="doc-kind")
    head = tag("header", html.joined([kind, tag("h1", text_of(study.name)), *titled]))
    writer, parts, answer = html.Writer("t"), list(_sections(found, figures)), _lead(found)
    inside = [html.lead(answer), writer.contents(study.name, parts), *map(writer.section, parts)]
    return document(f"{study.name}: {answer.headline}", [head, tag("article", html.joined(inside), id="t")])


def _lead(found: Tuned) -> Lead:
    tuning = found.tuning
    of = tuning.objectives[0]
    if not found.front:
        return Lead("refuted", "nothing found", Marked(f"{found.counts}; none keeps to all limits."))
    best = found.best
    values = ", ".join(best.told(tuning, "`"))
    at = best.fresh or best.searched
    where = "on fresh plants" if best.fresh else "over the study's runs"
    before = ""
    if found.own is not None and (found.own.fresh or found.own.searched):
        own = (found.own.fresh or found.own.searched)[0]
        before = f", {of.shown(own)} with the graph's own values"
    proved = best.proof is not None and best.proof.proved
    sentence = f"with {values}, {of.text} is {of.shown(at[0])} {where}{before}. {found.counts.capitalize()}."
    if found.misled:
        return Lead(
            "refuted", "not to be used as it is", Marked(f"{sentence} Over longer runs it is worse: see below.")
        )
    if best.broken:
        return Lead("refuted", "not to be used as it is", Marked(f"{sentence} Limits are broken: {best.broken[0]}."))
    if best.unstable:
        return Lead("not_applicable", "tuned, with a doubt", Marked(f"{sentence} Near its set-point it is unstable."))
    return Lead("proved" if proved else "not_applicable", "tuned" if proved else "tuned, not proved", Marked(sentence))


def _sections(found: Tuned, figures: Mapping[str, Any]) -> Iterator[Section]:
    if found.notices:
        yield Section(
            "trust", "Before you use it", [Bullets(found.notices, failing=range(len(found.notices) - found.quiet))]
        )
    yield Section("found", "What was found", [_table(found), *_about(found)])
    pictures = [
        Picture(figure_svg(figures[name]), name, caption, wide=name == "values")
        for name, caption in _CAPTIONS.items()
        if name in figures
    ]
    if pictures:
        yield Section("search", "The search", pictures)
    yield Section("asked", "What was asked", [_asked(found)])
    yield Section("again", "To repeat it", [_again(found)])


def _table(found: Tuned) -> Table:
    tuning = found.tuning
    chosen = [*([found.own] if found.own is not None else []), *found.front]
    heads: list[Cell] = ["", *(each.label for each in chosen)]
    rows = list[list[Cell]]()
    for name, factor in tuning.columns.items():
        before = "x " if factor.how == "scale" else ""
        rows.append([Word(name, "code"), *(f"{before}{each.values[name]:g} {factor.unit}".rstrip() for each in chosen)])
    for k, of in enumerate(tuning.objectives):
        for what, get in (("in the search", "searched"), ("on fresh plants", "fresh"), (_longer(found), "longer")):
            values = [getattr(each, get) for each in chosen]
            if any(values):
                told: list[Cell] = [of.shown(each[k]) if each else "-" for each in values]
                rows.append([(of.text, Word(what, "next")), *told])
    if any(each.radius is not None for each in chosen):
        radii = ("-" if each.radius is None else f"{each.radius:.4f}" for each in chosen)
        rows.append(["spectral radius on its clock", *radii])
    proofs = (each.proof for each in chosen)
    rows.append(["proof", *("-" if proof is None else Badge(proof.headline, proof.outcome) for proof in proofs)])
    return Table(rows, heads, keys=True, numbers=range(1, len(chosen) + 1))


def _longer(found: Tuned) -> str:
    from dmframe.study.tuned import LONGER

    return f"over {plain(LONGER * found.tuning.study.points[0].graph.duration, 's')}, on fresh plants"


def _about(found: Tuned) -> Iterator[Paragraph]:
    files = ", ".join(f"`{each.label}.yaml`" for each in found.front)
    if found.front:
        told = f"Each is a graph: {files}; the proofs, with every condition and its margin, are in `certificate.html`."
        if found.size > len(found.front):
            told += f" The front has {found.size} points, over which these are spread."
        yield Paragraph(Marked(told))
        yield Paragraph("The proof is in continuous time; the runs are sampled on the graph's clock.", note=True)


def _asked(found: Tuned) -> Table:
    tuning = found.tuning
    study, section = tuning.study, tuning.section
    rows: list[list[Cell]] = [["minimise", "; ".join(each.text for each in tuning.objectives)]]
    rows.append(["subject to", "; ".join(section.subject_to) or "nothing"])
    rows += [[Word(name, "code"), _ends(factor)] for name, factor in tuning.columns.items()]
    rows.append(["plants", _plants(study)])
    for factor in study.factors:
        of = f", of {', '.join(factor.labels)}" if factor.labels != (factor.name,) else ""
        rows.append([Word(factor.name, "code"), _ends(factor) + of])
    rows.append(["each run", plain(study.points[0].graph.duration, "s")])
    early = "no"
    if section.screen is not None:
        early = (
            f"the {100 * section.screen:g} % of the plants that were the hardest for the best trial run first; the "
            "rest is left out where they show that another trial is nowhere worse"
        )
    rows.append(["early stop", early])
    return Table(rows, keys=True)


def _plants(study: Study) -> str:
    each = f"at each of {len(study.points)} points" if len(study.points) > 1 else ""
    drawn = (
        f"{study.samples} samples, {study.file.sample.method.replace('_', ' ')}" if study.factors else "the graph's own"
    )
    return f"{drawn} {each}".rstrip()


def _ends(factor: Factor) -> str:
    """How a quantity is drawn or searched, in words."""
    spread = factor.spread
    if spread is None:
        return ""
    what = {"scale": "a factor, ", "shift": "a difference, ", "value": ""}[factor.how]
    unit = f" {factor.unit}" if factor.unit else ""
    ends = f"{spread.lower:g} to {spread.upper:g}{unit}"
    if spread.kind == "normal":
        between = f", {ends}" if math.isfinite(spread.lower) else ""
        ends = f"about {spread.a:g}, deviation {spread.b:g}{unit}{between}"
    return f"{what}{spread.kind}, {ends}"


def _again(found: Tuned) -> Bullets:
    study, place = found.tuning.study, found.folder.name
    file = study.path.name if study.path is not None else "study.yaml"
    items: list[Cell] = [
        (Word(f"dmframe tune {file} --out {place}", "command"), " goes on with this search"),
        (Word(f"dmframe tune {file} --out AGAIN", "command"), " searches anew; one process alone finds the same"),
    ]
    if found.front:
        again = f"dmframe verify {place}/{found.front[0].label}.yaml"
        items.append((Word(again, "command"), " proves the best again"))
    return Bullets(items)
