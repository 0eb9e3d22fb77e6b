"""Report of a tuning: the answer, then the evidence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from dmframe.common.plotting import figure_svg
from dmframe.common.units import plain
from dmframe.report.parts import Badge, Bullets, Cell, Lead, Marked, Paragraph, Picture, Section, Table, Word
from dmframe.study.cautions import LONGER
from dmframe.study.numbers import distribution
from dmframe.study.pages import study_page

if TYPE_CHECKING:
    from dmframe.study.plan import Study
    from dmframe.study.tuned import Tuned

_CAPTIONS = {
    "search": "The first objective, trial by trial.",
    "front": "The Pareto front: no trial is better in both objectives, to the left and below.",
    "values": "The first objective over each searched value; the best in colour.",
}


def as_html(found: Tuned, figures: Mapping[str, Any]) -> str:
    """The page, as one self-contained file."""
    study = found.tuning.study
    parts = list(_sections(found, figures))
    return study_page("Tuning of a control loop", study.name, study.title, "", _lead(found), parts)


def _lead(found: Tuned) -> Lead:
    tuning = found.tuning
    of = tuning.objectives[0]
    if not found.front:
        return Lead("refuted", "nothing found", Marked(f"{found.counts}; none meets all constraints."))
    best = found.best
    values = ", ".join(best.described(tuning, "`"))
    at = best.fresh or best.searched
    where = "on fresh plants" if best.fresh else "over the study's runs"
    before = ""
    if found.own is not None and (found.own.fresh or found.own.searched):
        own = (found.own.fresh or found.own.searched)[0]
        before = f", {of.shown(own)} with the graph's own values"
    proved = best.proof is not None and best.proof.proved
    sentence = f"with {values}, {of.text} is {of.shown(at[0])} {where}{before}. {found.counts.capitalize()}."
    if found.misled:
        return Lead("refuted", "do not use", Marked(f"{sentence} In longer runs it is worse, see below."))
    if best.broken:
        return Lead("refuted", "do not use", Marked(f"{sentence} A constraint is violated: {best.broken[0]}."))
    if best.unstable:
        return Lead(
            "not_applicable",
            "tuned, unstable near its set-point",
            Marked(f"{sentence} The linearised loop is unstable on its clock."),
        )
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
    yield Section("problem", "The problem", [_problem(found)])
    yield Section("again", "To repeat it", [_repetition(found)])


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
                shown: list[Cell] = [of.shown(each[k]) if each else "-" for each in values]
                rows.append([(of.text, Word(what, "next")), *shown])
    if any(each.radius is not None for each in chosen):
        radii = ("-" if each.radius is None else f"{each.radius:.4f}" for each in chosen)
        rows.append(["spectral radius on its clock", *radii])
    proofs = (each.proof for each in chosen)
    rows.append(["proof", *("-" if proof is None else Badge(proof.headline, proof.outcome) for proof in proofs)])
    return Table(rows, heads, keys=True, numbers=range(1, len(chosen) + 1))


def _longer(found: Tuned) -> str:
    return f"over {plain(LONGER * found.tuning.study.points[0].graph.duration, 's')}, on fresh plants"


def _about(found: Tuned) -> Iterator[Paragraph]:
    files = ", ".join(f"`{each.label}.yaml`" for each in found.front)
    if found.front:
        text = f"Each is a graph: {files}. The proofs, with every condition and its margin, are in `certificate.html`."
        if found.size > len(found.front):
            text += f" The Pareto front has {found.size} points; these are spread over it."
        yield Paragraph(Marked(text))
        yield Paragraph("The proof is in continuous time; the runs are sampled on the graph's clock.", note=True)


def _problem(found: Tuned) -> Table:
    tuning = found.tuning
    study, section = tuning.study, tuning.section
    rows: list[list[Cell]] = [["minimise", "; ".join(each.text for each in tuning.objectives)]]
    rows.append(["subject to", "; ".join(section.subject_to) or "nothing"])
    rows += [[Word(name, "code"), distribution(factor)] for name, factor in tuning.columns.items()]
    rows.append(["plants", _plants(study)])
    for factor in study.factors:
        rows.append([Word(factor.name, "code"), distribution(factor)])
    rows.append(["each run", plain(study.points[0].graph.duration, "s")])
    early = "no"
    if section.screen is not None:
        early = (
            f"the {100 * section.screen:g} % of the plants that were the hardest for the best trial run first; the "
            "others are skipped if an earlier trial dominates the result"
        )
    rows.append(["early stop", early])
    return Table(rows, keys=True)


def _plants(study: Study) -> str:
    each = f"at each of {len(study.points)} points" if len(study.points) > 1 else ""
    drawn = (
        f"{study.samples} samples, {study.file.sample.method.replace('_', ' ')}" if study.factors else "the graph's own"
    )
    return f"{drawn} {each}".rstrip()


def _repetition(found: Tuned) -> Bullets:
    study, place = found.tuning.study, found.folder.name
    file = study.path.name if study.path is not None else "study.yaml"
    items: list[Cell] = [
        (Word(f"dmframe tune {file} --out {place}", "command"), " continues this search"),
        (Word(f"dmframe tune {file} --out AGAIN", "command"), " repeats the search; a single process finds the same"),
    ]
    if found.front:
        command = f"dmframe verify {place}/{found.front[0].label}.yaml"
        items.append((Word(command, "command"), " proves the best again"))
    return Bullets(items)
