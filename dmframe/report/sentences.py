"""Facts about a block as sentences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple, final

from dmframe.block.port import Side
from dmframe.common.errors import listed
from dmframe.common.names import unicode_name
from dmframe.formula import Line, PrintedLaw
from dmframe.report.explained import BlockFacts, Estimated
from dmframe.report.flow import Taken
from dmframe.report.terms import names_in, shown

FROM: Final = {
    "measured": "{names}, measured at {block}",
    "commanded": "{names}, commanded by {block}",
    "wired": "{names} from {block}",
    "time": "the time {names}",
    "period": "the sampling period {names}",
    "drawn": "{names}, random at each sample",
    "ahead": "{names}, future samples of {block}",
}
"""Origin of an input, in words."""


@final
class Sentence(NamedTuple):
    """Sentence, or displayed formula."""

    text: str
    formula: bool = False


def described(block: BlockFacts) -> list[Sentence]:
    """Sentences about a block."""
    sentences = [Sentence(block.does or "Its docstring has no summary.")]
    sentences += [Sentence(text) for text in (*_takes(block), *_outputs(block), *_states(block))]
    if block.side is not Side.SOURCE:
        sentences += _energy(block)
    return sentences


def signal(name: str, unit: str) -> str:
    """``q̇_r [rad/s]``, with the symbols of the printed law."""
    return f"{unicode_name(name)} [{unit}]" if unit else unicode_name(name)


def _takes(block: BlockFacts) -> Iterator[str]:
    grouped = dict[tuple[str, str], list[str]]()
    for item in block.taken:
        if item.how == "derivative":
            grouped.setdefault((item.how, item.name), []).append(_named(item))
        elif item.how != "zero":
            grouped.setdefault((item.how, item.block), []).append(_named(item))
    clauses = [
        names[0] if how == "derivative" else FROM[how].format(names=listed(names), block=source)
        for (how, source), names in grouped.items()
    ]
    yield f"Inputs: {_joined(clauses)}." if clauses else "It has no inputs."
    if zero := [unicode_name(item.name) for item in block.taken if item.how == "zero"]:
        yield f"Unconnected, so zero: {listed(zero)}."


def _named(item: Taken) -> str:
    """Signal under the name of its source, and its port name if different."""
    if item.how == "derivative":
        return f"{signal(item.name, item.unit)}, the time derivative of {unicode_name(item.signal)}"
    if item.signal and item.signal != item.name:
        return f"{signal(item.signal, item.unit)} as {unicode_name(item.name)}"
    return signal(item.name, item.unit)


def _joined(clauses: Sequence[str]) -> str:
    """List of clauses; semicolons separate clauses that contain lists."""
    if len(clauses) < 2 or not any("," in clause or " and " in clause for clause in clauses):
        return listed(clauses)
    return "; ".join([*clauses[:-1], f"and {clauses[-1]}"])


def _outputs(block: BlockFacts) -> Iterator[str]:
    read = dict[tuple[str, ...], list[str]]()
    unread = list[str]()
    for item in block.given:
        if item.readers:
            readers = tuple(dict.fromkeys(reader for reader, _ in item.readers))
            read.setdefault(readers, []).append(signal(item.name, item.unit))
        elif block.side is not Side.PLANT:  # the page lists the hidden signals of the plant separately
            unread.append(unicode_name(item.name))
    if read:
        yield f"Outputs: {_joined([f'{listed(names)} to {listed(blocks)}' for blocks, names in read.items()])}."
    if unread:
        yield f"No block reads {_either(unread)}."


def _either(names: Sequence[str]) -> str:
    """``a, b or c``."""
    *most, last = names
    return f"{', '.join(most)} or {last}" if most else last


def _states(block: BlockFacts) -> Iterator[str]:
    if block.states:
        many = "states are" if len(block.states) > 1 else "state is"
        yield f"Its {many} {listed([signal(*state) for state in block.states])}."
    yield from map(_estimate, block.estimates)
    if block.knows:
        yield f"Its equations contain {listed(block.knows)} of the true robot: the controller must know them exactly."


def _estimate(item: Estimated) -> str:
    name = signal(item.name, item.unit)
    text = f"It estimates {item.of.unicode} by {name}" if item.of is not None else f"It adapts {name}"
    text += "" if item.start is None else f", initially {shown(item.start)}"
    if item.true is not None:
        return f"{text}; true value {shown(item.true)}."
    return f"{text}; the true value depends on signals." if item.of is not None else f"{text}."


def _energy(block: BlockFacts) -> Iterator[Sentence]:
    law = block.law
    if not block.certified:
        yield Sentence("It has no certificate, so a graph with it cannot be proved.")
    if law is None or not block.certified:
        return
    if law.S is not None:
        yield Sentence("Storage function, its part of V:")
        yield Sentence(f"S = {law.S.right.unicode}", formula=True)
    if law.dissipation:
        yield Sentence("Dissipation, negative in dV/dt:")
        yield Sentence(" + ".join(_bracketed(term.whole.unicode) for term in law.dissipation), formula=True)
    if law.residual:
        yield Sentence("Residual of the robust adaptation, which may increase dV/dt:")
        yield Sentence(" + ".join(_bracketed(term.whole.unicode) for term in law.residual), formula=True)
    if supplies(law):
        yield Sentence("Supply rate from other blocks, in dV/dt:")
        yield Sentence(law.supply.unicode if law.supply is not None else "0", formula=True)
    if law.consumption is not None:
        by = f"the dissipation of {block.dominator} must dominate it" if block.dominator else "no block dominates it"
        yield Sentence(f"Its cross term in dV/dt is {law.consumption.whole.unicode}; {by}.")
    if law.S is None and not law.dissipation and not supplies(law) and law.consumption is None:
        yield Sentence("It has no term in V and dV/dt.")
    if parts := _parts(law):
        yield Sentence(f"where {', '.join(line.whole.unicode for line in parts)}", formula=True)


def supplies(law: PrintedLaw) -> bool:
    """True for a block with a non-zero supply rate."""
    return law.supply is not None and law.supply.text != "0"


def _bracketed(text: str) -> str:
    """Term as a summand, in brackets if it starts with a minus."""
    return f"({text})" if text.startswith(("-", "−")) else text


def _parts(law: PrintedLaw) -> list[Line]:
    """Definitions used, directly or not, in the energy terms of a law."""
    formulas = [term.whole for term in (*law.storage, *law.dissipation, *law.residual)]
    formulas += [item for item in (law.supply, law.consumption and law.consumption.whole) if item is not None]
    formulas += [line.right for line in law.estimates]
    used = set(_names(formula.node for formula in formulas))
    for line in reversed(law.definitions):
        if line.name in used:
            used |= set(names_in(line.right.node))
    return [line for line in law.definitions if line.name in used]


def _names(nodes: Iterable[object]) -> Iterator[str]:
    for node in nodes:
        yield from names_in(node)
