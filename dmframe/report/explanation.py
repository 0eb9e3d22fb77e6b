"""Description of a graph in sentences: each block, the signal flow, and the certificate."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import Any, Final, NamedTuple, final

from dmframe.block.parameter import specs
from dmframe.block.port import Access, Side
from dmframe.certify import Verdict
from dmframe.common import notebook
from dmframe.common.columns import page_width
from dmframe.common.errors import listed
from dmframe.common.names import unicode_name
from dmframe.common.text import text_of
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.config.about import AboutGraph
from dmframe.diagram.knowledge import WORDS
from dmframe.exact.rational import as_float
from dmframe.formula.unmarked import unmarked
from dmframe.formula.wrap import wrapped
from dmframe.report.command import command
from dmframe.report.explained import BlockFacts, exchange, facts_of
from dmframe.report.sentences import Sentence, described, signal, supplies
from dmframe.report.verdict_text import HARD
from dmframe.report.words import everywhere, meaning_of

_INDENT: Final = 2
_UNIT: Final = re.compile(r" \[[^\]]*\]")
"""Unit of a signal; no line break before it."""
_RATE: Final = r"\tfrac{d}{d t}"
"""Fraction that `unmarked` leaves in the sentence of a verdict."""


@final
class Section(NamedTuple):
    """Heading with its sentences and formulas."""

    heading: str
    sentences: tuple[Sentence, ...]


@final
@dataclass(frozen=True, repr=False, eq=False)
class Explanation(AboutGraph):
    """Description of a graph; ``str`` gives the terminal page, a notebook shows the same content.

    Parameters
    ----------
    graph
        The graph.
    verdict
        Result of `verify`.
    """

    graph: BaseGraph
    verdict: Verdict

    @cached_property
    def blocks(self) -> tuple[BlockFacts, ...]:
        """Facts about each block, in signal-flow order."""
        return facts_of(self.graph, self.verdict)

    @cached_property
    def sections(self) -> tuple[Section, ...]:
        """Overview, one section a block, measured and hidden signals, certificate."""
        blocks = [
            Section(f"{place}. {block.name} ({block.type}): {', '.join(block.roles)}", tuple(described(block)))
            for place, block in enumerate(self.blocks, start=1)
        ]
        head = f"{self.name}: {self.graph.file.title}".rstrip(": ")
        seen = Section("Signals of the plant that the controller reads", tuple(map(Sentence, self._seen())))
        return (
            Section(head, tuple(map(Sentence, self._whole()))),
            *blocks,
            *[seen] * bool(seen.sentences),
            Section("Certificate", tuple(self._certificate())),
        )

    @property
    def summary(self) -> dict[str, Any]:
        """Data that ``dmframe explain --json`` prints: facts by block, and the sentences."""
        return {
            "graph": self.name,
            "title": self.graph.file.title,
            "order": [block.name for block in self.blocks],
            "blocks": [_data(block) for block in self.blocks],
            "verdict": self.verdict.outcome,
            "command": self.command,
            "sections": [
                {"heading": section.heading, "text": [item.text for item in section.sentences]}
                for section in self.sections
            ],
        }

    @property
    def command(self) -> str:
        """Command that prints the full verdict."""
        return command(self.graph, "verify").text

    def _whole(self) -> Iterator[str]:
        robot, file = self.diagram.robot, self.graph.file
        if robot is not None:
            many = "joint moves" if robot.n == 1 else "joints move"
            yield f"The robot is {robot.name}; {robot.n} {many}: {listed(list(robot.joint_names))}."
        if any(block.side is Side.CONTROLLER for block in self.blocks):
            runs = "in continuous time" if file.clock is None else f"every {plain(file.clock, 's')}"
            yield f"The controller runs {runs}."
        back = list(dict.fromkeys(item.block for b in self.blocks for item in b.taken if item.how == "measured"))
        closed = f"; the controller reads measurements of {listed(back)}" if back else ""
        yield f"Signal flow: {' → '.join(block.name for block in self.blocks)}{closed}."
        if any(block.law is not None and block.law.S is not None for block in self.blocks):
            yield "V is an energy-like function of the errors. Each block has a storage function and terms of dV/dt."

    def _seen(self) -> Iterator[str]:
        plant = [block for block in self.blocks if block.side is Side.PLANT]
        if not plant:
            return
        read, unread = (
            [f"{listed(names)} of {block.name}" for block in plant if (names := self._measured(block, read=used))]
            for used in (True, False)
        )
        yield f"Measured and read: {'; '.join(read)}." if read else "The controller reads no measurement."
        if unread:
            yield f"Measured, but read by no block of the controller: {'; '.join(unread)}."
        own = [f"{listed(names)} of {block.name}" for block in plant if (names := self._hidden(block))]
        if own:
            yield (f"Not available to the controller: {'; '.join(own)}. Only plant, proof and results use them.")
        known = {word for block in self.blocks for word in block.knows}
        known |= {WORDS["tool_rotation"]}  # not in the plant's equations
        if self.diagram.robot is not None and (unknown := [word for word in WORDS.values() if word not in known]):
            yield f"No block of the controller contains these robot parameters: {', '.join(unknown)}."

    def _hidden(self, block: BlockFacts) -> list[str]:
        """Outputs and parameters of a plant block that the controller cannot read."""
        kind = type(self.diagram.blocks[block.name])
        hidden = [unicode_name(item.name) for item in block.given if item.access is not Access.MEASURED]
        return list(dict.fromkeys([*hidden, *map(unicode_name, specs(kind))]))

    def _measured(self, block: BlockFacts, *, read: bool) -> list[str]:
        """Outputs of a plant block that the controller may read: those that it does, or does not."""
        sides = {other.name: other.side for other in self.blocks}
        return [
            signal(item.name, item.unit)
            for item in block.given
            if item.access is Access.MEASURED
            and any(sides[reader] is Side.CONTROLLER for reader, _ in item.readers) is read
        ]

    def _certificate(self) -> Iterator[Sentence]:
        verdict = self.verdict
        yield from map(Sentence, self._energy())
        shown = command(self.graph, "verify")
        given = f", with {shown.before}" if shown.before else ""
        yield Sentence(f"Verdict: {verdict.headline} ({shown.text}{given}).".replace("`", ""))
        clock = self.graph.file.clock
        meaning = unmarked(meaning_of(verdict, clock).sentence).replace(_RATE, "d/dt ")
        yield Sentence(meaning[:1].upper() + meaning[1:])
        if clock is not None and verdict.outcome == "proved" and verdict.samples is None:
            yield Sentence(
                f"The proof holds in continuous time; the effect of sampling every {plain(clock, 's')} is not proved."
            )
        if verdict.conditions:
            failing = [item.name.unicode for item in verdict.conditions if not item.holds]
            met = f"All {len(verdict.conditions)} conditions hold {unmarked(everywhere(verdict))}."
            yield Sentence(f"Conditions that fail: {listed(failing)}." if failing else met)
        if verdict.assumptions:
            yield Sentence("Assumptions:")
            yield from (Sentence(f"- {text_of(item.text).unicode}") for item in verdict.assumptions)

    def _energy(self) -> Iterator[str]:
        claim = self.verdict.flow_claim
        if claim is None:
            return
        servo = [part.block for part in claim.parts if part.certificate.storage and not part.cascade]
        above = [part.block for part in claim.parts if part.certificate.storage and part.cascade]
        weighted = [f"κ times {_storages(servo)}"] * bool(servo) if claim.cascaded else [_storages(servo + above)]
        yield f"V is {' plus '.join([_storages(above)] * (claim.cascaded and bool(above)) + weighted)}."
        found = exchange(self.verdict)
        for group in found.groups if found is not None else ():
            if len(group) == 1:
                yield f"The supply rate of {group[0]} is zero."
            else:
                yield f"The supply rates of {listed(group)} sum to zero."
        if found is not None and found.left:
            yield f"The supply rate of {listed(found.left)} is not cancelled by any other block."
        if self.verdict.kappa is not None:
            dominators = dict.fromkeys(other.block for _, other in claim.cross_terms if other is not None)
            consumers = [part.block for part, _ in claim.cross_terms]
            terms = f"the cross term{'s' * (len(consumers) > 1)} of {listed(consumers)}"
            least = as_float(self.verdict.kappa.least)
            yield f"With any κ above {least:.4g}, the dissipation of {listed(list(dominators))} dominates {terms}."

    def __repr__(self) -> str:
        return f"<Explanation of {self.name}: {len(self.blocks)} blocks, {self.verdict.headline}>"

    def __str__(self) -> str:
        wide = page_width()
        return "\n\n".join("\n".join(_lines(section, wide)) for section in self.sections)

    def _repr_html_(self) -> str:
        parts = []
        for section in self.sections:
            parts.append(notebook.heading(section.heading))
            parts += [f"<p><code>{escape(s.text)}</code></p>" if s.formula else f"<p>{escape(s.text)}</p>"
                      for s in section.sentences]  # fmt: skip
        return "".join(parts)


def _storages(blocks: list[str]) -> str:
    """Sum of storage functions, in words."""
    many = f"s of {listed(blocks)}" if len(blocks) > 1 else f" of {listed(blocks)}"
    return f"the {'sum of the ' * (len(blocks) > 1)}storage function{many}"


def _lines(section: Section, wide: int) -> Iterator[str]:
    yield from textwrap.wrap(section.heading, wide, subsequent_indent=" " * _INDENT)
    lead, deep = " " * _INDENT, " " * 2 * _INDENT
    for item in section.sentences:
        if item.formula:
            first, *more = wrapped(item.text, wide - 3 * _INDENT)
            yield from (f"{deep}{first}", *(f"{deep}{lead}{text}" for text in more))
        else:
            below = deep if item.text.startswith("- ") else lead
            text = _UNIT.sub(lambda unit: unit[0].replace(" ", HARD), item.text)
            lines = textwrap.wrap(text, wide, initial_indent=lead, subsequent_indent=below, break_on_hyphens=False)
            yield from (line.replace(HARD, " ") for line in lines)


def _data(block: BlockFacts) -> dict[str, Any]:
    law = block.law
    return {
        "name": block.name,
        "type": block.type,
        "side": block.side.value,
        "roles": list(block.roles),
        "does": block.does,
        "takes": [
            {
                "name": item.name,
                "printed": unicode_name(item.name),
                "unit": item.unit,
                "how": item.how,
                "from": f"{item.block}.{item.signal}" if item.block else item.signal,
            }
            for item in block.taken
        ],
        "hands_on": [
            {
                "name": item.name,
                "printed": unicode_name(item.name),
                "unit": item.unit,
                "access": item.access.value,
                "to": [f"{reader}.{port}" for reader, port in item.readers],
            }
            for item in block.given
        ],
        "states": [name for name, _ in block.states],
        "estimates": [
            {
                "name": item.name,
                "unit": item.unit,
                "of": item.of.text if item.of is not None else None,
                "true": None if item.true is None else item.true.tolist(),
                "start": None if item.start is None else item.start.tolist(),
            }
            for item in block.estimates
        ],
        "stores": law.S.right.text if law is not None and law.S is not None else None,
        "spends": [term.whole.text for term in law.dissipation] if law is not None else [],
        "supply": law.supply.text if law is not None and law.supply is not None and supplies(law) else None,
        "consumes": law.consumption.whole.text if law is not None and law.consumption is not None else None,
        "payer": block.dominator or None,
        "knows": list(block.knows),
    }
