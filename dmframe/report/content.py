"""Content of a report, collected once for HTML, Markdown and JSON."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

from dmframe.block.parameter import specs
from dmframe.block.prose import About, about
from dmframe.certify import Verdict
from dmframe.certify.checked import Checked
from dmframe.certify.error_bound import ErrorBounds
from dmframe.certify.statements import Statement
from dmframe.certify.summary import summary
from dmframe.common.text import Text, text_of
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.formula import PrintedLaw, laws_of
from dmframe.formula.where import where
from dmframe.report.linear import LinearView, linear_view
from dmframe.report.measured import Measured, measure
from dmframe.report.parts import Row, Section
from dmframe.report.planar import RobotModel, robot_model
from dmframe.report.terms import Terms, parameter_text, rows_of_lines, terms_of
from dmframe.report.words import Meaning, meaning_of


@final
@dataclass(frozen=True)
class Value:
    """Parameter of a block in this graph; `says` is its description, marked text."""

    name: str
    value: str
    unit: str
    says: str


@final
@dataclass(frozen=True)
class BlockLaw:
    """Block of the graph: equations printed from its code, and parameter values."""

    name: str
    type: str
    side: str
    law: About
    equations: tuple[Row, ...]
    values: tuple[Value, ...]


@final
@dataclass(frozen=True)
class Condition:
    """Condition of the certificate with its margin; `text` is marked."""

    text: str
    margin: str
    holds: bool
    how: str
    source: str

    @property
    def status(self) -> str:
        """``holds`` only for a proved condition."""
        return "sampled, not proved" if self.how == "sampled" else "holds"


@final
@dataclass(frozen=True)
class Follows:
    """Conclusion of one proof step on several signals (LaTeX); `assumes` are marked texts."""

    says: str
    step: str
    signals: tuple[str, ...]
    assumes: tuple[str, ...]


@final
@dataclass(frozen=True)
class Witness:
    """Counterexample of a refuted identity: non-zero signals and the residue."""

    blame: tuple[str, ...]
    signals: tuple[str, ...]
    prime: str
    residue: str
    point: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class Opening:
    """First page of a report: verdict, meaning, conclusions and assumptions."""

    name: str
    title: str
    outcome: str
    meaning: Meaning
    follows: tuple[Follows, ...]
    assumptions: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class Content:
    """Report on one graph.

    Parameters
    ----------
    summary
        Data that ``verify --json`` prints.
    signs
        Legend of the operations, robot quantities and conventions in the laws.
    picture
        Block diagram as stand-alone SVG.
    mermaid
        Block diagram for Markdown.
    provenance
        See `dmframe.results.folder.provenance`.
    resolved
        The graph with all defaults written out, as YAML.
    errors
        Bounds on the tracking errors of a proved graph.
    own
        Further sections, which the caller of the report gave.
    """

    name: str
    title: str
    outcome: str
    meaning: Meaning
    facts: tuple[tuple[str, str], ...]
    picture: str
    mermaid: str
    laws: tuple[BlockLaw, ...]
    signs: tuple[tuple[str, str], ...]
    terms: Terms | None
    conditions: tuple[Condition, ...]
    assumptions: tuple[tuple[str, str], ...]
    follows: tuple[Follows, ...]
    controls: tuple[tuple[str, bool], ...]
    witness: Witness | None
    uncertain: tuple[tuple[str, str], ...]
    measured: Measured
    linear: LinearView
    model: RobotModel | None
    summary: Mapping[str, Any]
    provenance: Mapping[str, Any]
    replay: str
    resolved: str
    errors: ErrorBounds | None = None
    own: tuple[Section, ...] = ()


def opening(graph: BaseGraph, verdict: Verdict) -> Opening:
    """First page of a report, without a simulation."""
    last = [item for item in verdict.statements if item.concludes]
    return Opening(
        name=graph.name,
        title=graph.file.title,
        outcome=verdict.outcome,
        meaning=meaning_of(verdict, graph.file.clock),
        follows=tuple(_follows(last)) if verdict.outcome == "proved" else (),
        assumptions=_assumptions(verdict),
    )


def gather(
    graph: BaseGraph,
    verdict: Verdict,
    *,
    command: list[str],
    seed: int,
    tell: Callable[[str], None] = lambda _: None,
) -> Content:
    """Collect the report on one graph, which is simulated for it; `tell` receives progress messages."""
    diagram = graph.diagram
    from dmframe.config.resolved import resolved_text
    from dmframe.drawing import mermaid, svg
    from dmframe.results.folder import provenance

    resolved = resolved_text(graph)
    laws = verdict.flow_claim.laws if verdict.flow_claim is not None else laws_of(diagram)
    return Content(
        name=graph.name,
        title=graph.file.title,
        outcome=verdict.outcome,
        meaning=meaning_of(verdict, graph.file.clock),
        facts=tuple(_facts(graph)),
        picture=svg(diagram),
        mermaid=mermaid(diagram),
        laws=tuple(_law(diagram, name, law) for name, law in laws.items()),
        signs=where(line for law in laws.values() for line in law.lines),
        terms=terms_of(verdict.flow_claim) if verdict.flow_claim is not None else None,
        conditions=tuple(map(_condition, verdict.conditions)),
        assumptions=_assumptions(verdict),
        follows=tuple(_follows(verdict.statements)) if verdict.outcome == "proved" else (),
        controls=tuple((control.fault.marked, control.refuted) for control in verdict.controls),
        witness=_witness(verdict),
        uncertain=tuple((label, _interval_text(ends)) for label, ends in graph.file.uncertain.items()),
        measured=measure(graph, verdict, tell),
        linear=linear_view(graph, tell),
        model=robot_model(diagram.robot),
        summary=summary(graph.name, verdict),
        provenance=provenance(graph, resolved, field_hash=diagram.fingerprint, seed=seed, command=command),
        replay=shlex.join(command),
        resolved=resolved,
        errors=verdict.errors if verdict.outcome == "proved" else None,
    )


def _assumptions(verdict: Verdict) -> tuple[tuple[str, str], ...]:
    return tuple((text_of(item.text).marked, text_of(item.source).marked) for item in verdict.assumptions)


def _facts(graph: BaseGraph) -> list[tuple[str, str]]:
    diagram = graph.diagram
    clock = graph.file.clock
    own = sum(variable.symbol.numel() for variable in diagram.loop.controller)
    facts = [
        ("controller", "in continuous time" if clock is None else f"sampled every {plain(clock, 's')}"),
        ("states", f"{diagram.loop.state.numel()}, of which {own} in the controller"),
    ]
    if diagram.robot is not None:
        robot = diagram.robot
        facts.insert(0, ("robot", f"{robot.name}, joints {', '.join(robot.joint_names)}"))
        change = (
            f"the largest change of an entry is {robot.rotation_change:.1e}" if robot.rotation_change else "no change"
        )
        facts.append(("robot model", f"rotations made exactly orthogonal, with rational entries: {change}"))
    return facts


def _law(diagram: Diagram, name: str, printed: PrintedLaw) -> BlockLaw:
    block = diagram.blocks[name]
    law, units = about(type(block)), {key: spec.unit for key, spec in specs(type(block)).items()}
    values, model = list[Value](), diagram.models[name]
    for key in type(block).model_fields:
        if key in model.values:
            spec = specs(type(block))[key]
            text = parameter_text(model.values[key], spec)
            values.append(Value(key, text, units[key], law.parameters.get(key, "")))
        elif key not in units:
            option = getattr(block, key)
            text = ", ".join(map(str, option)) if isinstance(option, tuple) else str(option)
            values.append(Value(key, text or "none", "", law.parameters.get(key, "")))
    rows = [replace(row, tag=str(place)) for place, row in enumerate(rows_of_lines(printed.lines), start=1)]
    return BlockLaw(name, diagram.type_of(name), block.side.value, law, tuple(rows), tuple(values))


def _condition(checked: Checked) -> Condition:
    margin = f"{checked.value:.4g}" if checked.value is not None else "" if checked.holds else "not found"
    detail = "" if checked.expression in checked.name else Text(": ", checked.expression)
    text, source = Text(checked.name, detail), text_of(checked.source)
    return Condition(text.marked, margin, checked.holds, checked.how, source.marked)


def _follows(statements: Sequence[Statement]) -> list[Follows]:
    """Statements grouped by text and proof step; conclusions last."""
    grouped = dict[tuple[str, Text, bool], list[Statement]]()
    for item in sorted(statements, key=lambda item: item.concludes):
        grouped.setdefault((item.says, item.step, item.concludes), []).append(item)
    return [
        Follows(
            says,
            step.marked,
            tuple(item.signal.latex for item in items),
            tuple(dict.fromkeys(text.marked for item in items for text in item.assumes)),
        )
        for (says, step, _), items in grouped.items()
    ]


def _interval_text(ends: Any) -> str:
    return f"one factor for all elements, {ends['factor']}" if isinstance(ends, Mapping) else str(ends)


def _witness(verdict: Verdict) -> Witness | None:
    found = verdict.refutation
    if found is None:
        return None
    nonzero = [(label, values) for label, values in found.point if label in found.signals and any(values)]
    return Witness(
        found.blame,
        found.signals,
        str(found.prime),
        str(found.residue),
        tuple((label, ", ".join(map(str, values))) for label, values in nonzero),
    )
