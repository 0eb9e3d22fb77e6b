"""Sections of a report, with all their texts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

from dmframe.common.plotting import unit_text
from dmframe.common.units import plain
from dmframe.report.content import BlockLaw, Content, Follows, Opening
from dmframe.report.linear import EMULATION_HEADS, JOINT_HEADS
from dmframe.report.parts import (
    Bullets,
    Cell,
    Columns,
    Equations,
    Formula,
    Lead,
    Listing,
    Marked,
    Paragraph,
    Part,
    Picture,
    Section,
    Subsection,
    Table,
    Titled,
    Word,
)
from dmframe.report.terms import TermRow, Terms
from dmframe.report.verdict_text import disturbance_of, lowering_of, size_of, useless_of

_SIDES: Final = {"source": "desired trajectory", "controller": "controller", "plant": "robot and servo"}
_KINDS: Final = {"rms": "root mean square", "sup": "largest value"}
_TERM_HEADS: Final = ("block", "square of", "weight", (), "at this graph's numbers", "times")
_KAPPA: Final = Formula(r"\kappa")
WIDE: Final = 900.0
"""Width of a picture above which it is printed in landscape [px]."""


def sections(content: Content) -> Iterator[Section]:
    """Sections below the verdict."""
    r = content
    yield Section("meaning", "What this means", [*meaning(r), *_witness(r)])
    wide = _width(r.picture) > WIDE
    yield Section("diagram", "The diagram", _diagram(r, wide), wide)
    yield Section("laws", "The laws", [*_laws(r)])
    yield Section("terms", "V and its derivative", [*_terms(r)])
    yield Section("conditions", "Conditions and assumptions", [*_conditions(r)])
    yield Section("follows", "What follows", [_follows(r.follows), *_error_bounds(r)])
    yield Section("run", "The loop as it runs", [*_run(r)])
    yield Section("linear", "Poles, margins and the sampling period", [*_linear(r)])
    yield Section("controls", "Fault injection", [*_controls(r)])
    if r.model is not None:
        yield Section("model", "The robot's equations", [*_model(r)])
    yield from r.own
    yield Section("provenance", "Provenance", [*_provenance(r)])


def lead(r: Opening | Content) -> Lead:
    """Verdict at the top of the page."""
    return Lead(r.outcome, r.meaning.headline, Marked(r.meaning.sentence))


def meaning(r: Opening | Content) -> list[Part]:
    """Meaning of the verdict, and its limits."""
    lists = (("Statement", r.meaning.means), ("Not covered", r.meaning.means_not))
    return [Columns([Titled(title, Bullets([*map(Marked, texts)])) for title, texts in lists])]


def first_page(r: Opening) -> list[Part]:
    """Short form below the verdict: meaning, conclusions, assumptions."""
    parts = meaning(r)
    if r.follows:
        parts.append(
            Titled("What follows", Bullets([(*_joined(item.signals, ", "), f" {item.says}") for item in r.follows]))
        )
    if r.assumptions:
        parts.append(Titled("Assumptions", Bullets([Marked(text) for text, _ in r.assumptions])))
    return parts


def _joined(formulas: Sequence[str], between: str) -> list[str | Formula]:
    """Formulas separated by a text."""
    return [piece for latex in formulas for piece in (between, Formula(latex, "whole"))][1:]


def _witness(r: Content) -> Iterator[Part]:
    if r.witness is None:
        return
    rows: list[tuple[Cell, Cell]] = [
        ("faulty blocks", ", ".join(r.witness.blame) or "no single block; the exchanged signals differ"),
        ("smallest set of non-zero signals", ", ".join(r.witness.signals) or "empty: all signals can be zero"),
        ("prime p", Word(r.witness.prime, "long")),
        ("claimed minus true, modulo p", Word(r.witness.residue, "long")),
        *((f"{label}, modulo p", Word(values, "long")) for label, values in r.witness.point),
    ]
    note = Paragraph("The values of all gains and parameters at this point are in the JSON.", note=True)
    yield Subsection("Where it fails", [Table(rows, keys=True), note])


def _diagram(r: Content, wide: bool) -> list[Part]:
    caption = Marked(
        "Sources and controller; right of the dashed line, servo and robot, whose measured signals alone it reads. "
        "`d/dt` marks an input that is the derivative of the one above it."
    )
    picture = Picture(r.picture, "picture", caption, "diagram", wide, Listing(r.mermaid, "mermaid"))
    return [picture, Table(r.facts, keys=True)]


def _width(svg: str) -> float:
    """Width attribute of an SVG [px]."""
    found = re.search(r'<svg[^>]* width="([\d.]+)', svg)
    return float(found[1]) if found else 0.0


def _laws(r: Content) -> Iterator[Part]:
    yield Paragraph(
        Marked(
            "Block by block, printed from the code that is simulated and proved. In a product, a column that is not "
            "the last factor denotes a diagonal matrix. Equation numbers count within a block. The laws were compared "
            "with the code at two points; `dmframe check` compares them, and the docstrings, in full."
        )
    )
    for block in r.laws:
        yield Subsection(block.name, [*_law(block)], f"{block.type}, {_SIDES[block.side]}", law=True)
    if r.signs:
        yield Table(r.signs, ("sign", "meaning"), "Signs in these laws:")


def _law(block: BlockLaw) -> Iterator[Part]:
    yield Paragraph(Marked(block.law.summary))
    yield Equations(block.equations)
    if block.values:
        rows = [(Word(v.name, "code"), v.value, unit_text(v.unit), Marked(v.says)) for v in block.values]
        yield Table(rows, ("parameter", "in this graph", "unit", "description"), kind="values")
    if block.law.notes:
        yield Paragraph(Marked(block.law.notes), note=True)
    if block.law.source:
        yield Paragraph(("Source: ", Marked(block.law.source)), note=True)


def _terms(r: Content) -> Iterator[Part]:
    found = r.terms
    if found is None:
        yield Paragraph(f"There is no V: {r.summary['reason']}.")
        return
    yield Equations(found.V)
    if r.outcome == "refuted":
        yield Paragraph("Derivative according to the certificates; this is refuted:")
    yield Equations(found.rate)
    if found.definitions:
        yield Equations(found.definitions)
    yield Paragraph(Marked(_weights_and_kappa(r, found)))
    stored = [(row.block, _square(row), *_weight(row)) for row in found.storage]
    terms = "terms, squares unless noted" if any(row.beside for row in found.storage) else "squares"
    yield Table(stored, _TERM_HEADS, Marked(f"Storage: $V$ is half the sum of these {terms}."))
    lost = [(row.block, (*_lost(row), *_by(row)), *_weight(row)) for row in found.dissipation]
    lost += [_projected(symbol, name, found) for symbol, name in found.projections]
    consumed: tuple[str | Formula, ...] = (", plus ", Formula(found.consumption)) if found.consumption else ()
    projected = ", plus the projection terms" if found.projections else ""
    yield Table(
        lost, _TERM_HEADS, (Marked(r"Dissipation: $\dot V$ is minus the sum of these"), *consumed, f"{projected}.")
    )
    if found.residual:
        left = [(row.block, (*_left(row), *_by(row)), *_weight(row)) for row in found.residual]
        caption = (
            r"Residual, positive or of either sign: $\dot V$ may exceed minus the dissipation by the sum of these."
        )
        yield Table(left, ("block", "term", *_TERM_HEADS[2:]), Marked(caption))
    legend = [(Formula(i.symbol), Word(i.label, "code"), i.value, unit_text(i.unit)) for i in found.legend]
    heads = ("symbol", "parameter or signal", "value", "unit")
    yield Table(legend, heads, "The symbols of the weights:", kind="legend")


def _weights_and_kappa(r: Content, found: Terms) -> str:
    text = r"Here $\vert a \vert^2_W = a^\top W a$; a diagonal W is written by its elements."
    if not found.consumption:
        return text
    text += (
        " The cross term of the reference generator is the last in the derivative. The servo level dominates it if its "
        r"weight $\kappa$ is large enough; $\kappa$ is used in this analysis only, not in the controller."
    )
    kappa = r.summary["kappa"]
    if not kappa:
        return text
    where = ", and anywhere in its intervals," if r.uncertain else ""
    least, chosen = f"{kappa['least']:.4g}", f"{kappa['chosen']:.4g}"
    return (
        f"{text} At the parameter values of this graph{where} any $\\kappa$ above {least} suffices; {chosen} is used."
    )


def _weight(row: TermRow) -> tuple[Cell, ...]:
    """Symbol, formula, value and factor of a weight."""
    weight = Formula(row.weight, "display") if row.weight else ""
    return Formula(row.symbol), weight, row.value, _KAPPA if row.factor == "kappa" else "1"


def _square(row: TermRow) -> tuple[str | Formula, ...]:
    if row.kind == "potential":
        return (
            "not a square: potential of saturating springs with deflection ",
            Formula(row.of),
            " and limit ",
            Formula(row.beside),
        )
    if row.kind == "log det":
        return "not a square: the divergence of ", Formula(row.of), " from ", Formula(row.beside)
    if not row.metric:
        return (Formula(row.of),)
    return Formula(row.of), ", in the metric of the matrix ", Formula("G"), " of the block (information matrix)"


def _by(row: TermRow) -> tuple[str | Formula, ...]:
    return (", times ", Formula(row.by)) if row.by else ()


def _lost(row: TermRow) -> tuple[str | Formula, ...]:
    if row.kind == "lemma":
        return "monotone function of ", Formula(row.of), ", never negative"
    return _square(row)


def _left(row: TermRow) -> tuple[str | Formula, ...]:
    clipped = "at most the width times the sum of absolute values of "
    return clipped if row.kind == "clipped" else "square of ", Formula(row.of)


def _projected(symbol: str, name: str, found: Terms) -> tuple[Cell, ...]:
    text = ("projection of ", Word(name, "code"), " onto its set; not positive by the projection lemma")
    return name.partition(".")[0], text, Formula(symbol), (), (), _KAPPA if found.consumption else "1"


def _conditions(r: Content) -> Iterator[Part]:
    if r.conditions:
        over = " and over the intervals that the graph gives for uncertain parameters" if r.uncertain else ""
        yield Paragraph(
            Marked(
                "The theorem holds if all these conditions hold. The margin is the least value over all joints"
                rf"{over}. It must be positive; for a condition with $\ge$ or of membership in a set, not negative."
            )
        )
        rows = [
            (
                Marked(each.text),
                each.margin,
                each.status if each.holds else Word("fails", "strong"),
                "exactly" if each.how == "exact" else each.how,
                Marked(each.source),
            )
            for each in r.conditions
        ]
        failing = [place for place, each in enumerate(r.conditions) if not each.holds]
        heads = ("condition", "margin", (), "decided", "needed for")
        yield Table(rows, heads, kind="conditions", numbers=(1,), failing=failing)
    else:
        yield Paragraph("No condition was evaluated, since there is no proved identity.")
    if r.uncertain:
        items = [(Word(label, "code"), f": {ends}") for label, ends in r.uncertain]
        yield Titled("Uncertain true parameters, with intervals", Bullets(items))
    if r.assumptions:
        assumed = [
            (Marked(text), Word(Marked(f" ({source})") if source else "", "small")) for text, source in r.assumptions
        ]
        yield Titled("Assumed, not checked", Bullets(assumed))


def _follows(follows: Sequence[Follows]) -> Part:
    if not follows:
        return Paragraph("No conclusions: the certificate is not proved.")
    rows = []
    for item in follows:
        assumed = Word(Marked(f"Assuming: {'; '.join(item.assumes)}."), "next") if item.assumes else ""
        rows.append((tuple(_joined(item.signals, "; ")), item.says, (Marked(item.step), assumed)))
    return Table(rows, ("signals", "each", "because"), kind="follows")


def _error_bounds(r: Content) -> Iterator[Part]:
    if r.errors is None or not r.errors.found:
        return
    first = r.errors.found[0]
    rows = [(Formula(f"|{item.signal.latex}|"), _KINDS[item.kind], size_of(item)) for item in r.errors.found]
    yield Table(
        rows,
        ("error", (), "bound"),
        Marked(
            f"Upper limits over a run of {plain(first.over_s, 's')} from the graph's start, in {first.holds}"
            f"{', for all parameters in the intervals' if r.uncertain else ''}; {disturbance_of(first)}. "
            "A clock, a delay or an encoder is not in them."
        ),
        kind="bounds",
    )
    shares = dict.fromkeys(item.dominated_by for item in r.errors.found)
    contributions = [
        ("Largest contribution: ", Formula(share.of.latex) if share.of_start else share.of, f"{lowering_of(share)}.")
        for share in shares
    ]
    remark = useless_of(r.errors.found)
    useless = [f"{remark[0].upper()}{remark[1:]}."] if remark else []
    yield Bullets([*useless, *contributions, *((f"{text[0].upper()}{text[1:]}.",) for text in r.errors.missing)])


def _run(r: Content) -> Iterator[Part]:
    yield Paragraph(Marked(r.measured.sentence))
    if r.measured.facts:
        yield Table([(Marked(key), Marked(value)) for key, value in r.measured.facts], keys=True)
    if r.measured.figure:
        rows = [(f"{time:.4g}", f"{value:.6g}") for time, value in r.measured.table]
        instead = Table(rows, ("time, s", Formula("V")), numbers=(0, 1))
        yield Picture(r.measured.figure, "run-plot", Marked(r.measured.caption), instead=instead)


def _linear(r: Content) -> Iterator[Part]:
    yield Paragraph(Marked(r.linear.sentence))
    if not r.linear.periods:
        return
    caption = "Largest stable sampling period, searched and proved."
    yield Table(r.linear.periods, ("search", "boundary", "what it means"), caption, kind="periods", keys=True)
    caption = "The linearised closed loop, with and without the slope that smooth Coulomb friction has at rest."
    yield Table(r.linear.loop, ((), "at rest", "moving"), caption)
    if r.linear.emulation:
        caption = (
            "Largest adaptation gain at this sampling period, quasi-static estimate: T times the largest eigenvalue of "
            "Γ Y_d′ w Y_d is 2 there. It gives the order of magnitude and is no proof."
        )
        yield Table(r.linear.emulation, EMULATION_HEADS, caption)
    caption = (
        "Joint by joint, the other joints locked: the manufacturer's servo alone, and in series with the inverse at "
        "its true parameters. The certificate requires the passivity of the latter."
    )
    yield Table(r.linear.joints, JOINT_HEADS, caption)
    caption = (
        "Bode diagrams: the loop gain of each joint (left), and servo with inverse "
        "(right), passive if the phase stays between the grey lines."
    )
    yield Picture(r.linear.bode, "bode", caption)
    caption = (
        "Nyquist diagrams: the loop gain about −1 (left), and servo with inverse (right), passive if the curve "
        "stays right of the axis."
    )
    yield Picture(r.linear.nyquist, "nyquist", caption)


def _controls(r: Content) -> Iterator[Part]:
    if not r.controls:
        yield Paragraph("No faults were injected: there is no proof.")
        return
    count = r.summary["mutants"]
    yield Paragraph(
        "To check the test itself, each of these faults was injected into the equations, one at a time; "
        f"{count['refuted']} of {count['tried']} were refuted."
    )
    items: list[Cell] = [
        Marked(text) if refuted else (Marked(text), ": ", Word("not refuted", "strong")) for text, refuted in r.controls
    ]
    yield Bullets(items, [place for place, (_, refuted) in enumerate(r.controls) if not refuted], dense=True)


def _model(r: Content) -> Iterator[Part]:
    if r.model is None:
        return
    yield Paragraph(Marked(r.model.about))
    yield Equations(r.model.rows)
    caption = (
        "Regressor $Y_d$, transposed, one row a parameter: "
        r"$Y_d a_d = M \ddot q_{\mathrm r} + C \dot q_{\mathrm r} + g$."
    )
    rows = [(Formula(name), *map(Formula, column)) for name, column in r.model.regressor]
    heads = ["parameter", *(f"joint {place}" for place in range(1, len(rows[0])))]
    yield Table(rows, heads, Marked(caption), kind="regressor")


def _provenance(r: Content) -> Iterator[Part]:
    summary, made, time = r.summary, r.provenance, r.summary["time"]
    rows: list[tuple[Cell, Cell]] = [("command", Word(r.replay, "command")), ("written", made["time"])]
    if summary["primes"]:
        test = f"{summary['trials']} random points, seed {summary['seed']}, degree at most {summary['degree_bound']}"
        bound = summary["log2_error_bound"]
        wrong = () if bound is None else (", error below ", Formula(f"2^{{{bound:.0f}}}"))
        rows += [("exact test", (test, *wrong)), ("primes", Word(", ".join(summary["primes"]), "long"))]
    rows.append(("graph, SHA-256", Word(made["graph_sha256"], "long")))
    rows.append(("model, SHA-256", Word(made["field_hash"], "long")))
    if made.get("urdf"):
        rows.append(("robot", Word(f"{made['urdf']}, SHA-256 {made['urdf_sha256']}", "long")))
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items() if version)
    rows += [("software", f"Python {made['python']}; {versions}"), ("machine", made["platform"])]
    rows.append(("time taken", f"{time['build']:.2f} s to build V and its derivative, {time['check']:.2f} s to decide"))
    yield Table(rows, keys=True)
    yield Titled("The graph with all defaults", Listing(r.resolved, "yaml"))
