"""Terminal page of a verdict: outcome, conditions, assumptions and conclusions."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Sequence
from textwrap import fill
from typing import Any, Final

from dmframe.certify import Verdict
from dmframe.certify.checked import Checked
from dmframe.certify.error_bound import ErrorBound, Share
from dmframe.common.columns import columns
from dmframe.common.names import unicode_name
from dmframe.common.text import DV, KAPPA, Text, joined, text_of
from dmframe.common.units import plain, rounded_up
from dmframe.diagram.fingerprint import short
from dmframe.diagram.wiring import Wire

HARD: Final = "\N{NO-BREAK SPACE}"
WIDEST: Final = 116
NORMS: Final = {"rms": "root mean square of |{}|", "sup": "largest |{}|"}


def verdict_text(
    name: str, verdict: Verdict, *, times: bool = True, notices: Sequence[str] = (), clock: float | None = None
) -> str:
    """Terminal page; `name` is the name of the graph, and `notices` are printed below the headline.

    `clock` is its sampling period [s], which a proof in continuous time does not cover.
    """
    parts = [f"{name}: {verdict.headline}", *(fill(f"  notice: {text}", **_wrapped()) for text in notices)]
    parts.append(fill(f"  {verdict.reason.unicode}", **_wrapped()))
    if clock is not None and verdict.flow_claim is not None and verdict.outcome == "proved":
        parts.append(f"  in continuous time: sampling every {plain(clock, 's')} is not covered; see `dmframe analyse`")
    if verdict.claim is not None:
        parts.append(f"  model {short(verdict.claim.diagram.fingerprint)}: runs, exports and pages store this hash")
    if verdict.test is not None and verdict.test.zero:
        bound = verdict.test.log2_error_bound
        parts.append(
            f"  wrong with probability below 2^{bound:.0f}, over {verdict.test.trials} random points and primes"
        )
    if verdict.bounds:
        parts += [f"  {DV.unicode} may exceed minus the dissipation by", columns(_bounds(verdict), "    ")]
    if verdict.refutation is not None:
        signals = ", ".join(verdict.refutation.signals)
        parts.append(f"  smallest set of non-zero signals: {signals or 'empty; refuted with all signals zero'}")
        parts.append("  exact point: see --json")
    if verdict.conditions:
        rows = [(c.name.unicode, "" if c.value is None else f"{c.value:.4g}", _mark(c)) for c in verdict.conditions]
        parts.append(f"  conditions{_over(verdict)}; a margin must be positive (with ≥: not negative)")
        parts.append(columns(rows, "    "))
    if verdict.controls:
        refuted = sum(control.refuted for control in verdict.controls)
        parts.append(f"  fault injection: {refuted} of {len(verdict.controls)} seeded faults refuted")
    if verdict.flow_claim is not None:
        parts.append("  printed laws: compared with the code at two points; `dmframe check` compares them in full")
    if verdict.assumptions:
        parts += ["  assumptions", *(_line(text_of(item.text)) for item in verdict.assumptions)]
    if verdict.statements and verdict.outcome == "proved":
        parts += ["  conclusions", *_followed(verdict)]
    if verdict.errors is not None and verdict.outcome == "proved":
        parts += list(_error_bounds(verdict))
    if verdict.flow_claim is not None and times:
        parts.append(f"  {verdict.build:.2f} s to build V and {DV.unicode}, {verdict.check:.2f} s to decide")
    return "\n".join(parts)


def _followed(verdict: Verdict) -> Iterator[str]:
    """Signals by proved property, then the final conclusions with their proof steps."""
    for statement in dict.fromkeys(item.says for item in verdict.statements):
        found = [item for item in verdict.statements if item.says == statement and not item.concludes]
        grouped = dict[tuple[str, ...], list[str]]()
        for item in found:
            own = item.assumes == (f"the derivative of {item.signal} is bounded",)
            assumes = ("its own derivative is bounded",) if own else tuple(text.unicode for text in item.assumes)
            grouped.setdefault(assumes, []).append(item.signal.unicode)
        for assumes, signals in grouped.items():
            given = f", each if {' and '.join(assumes)}" if assumes else ""
            yield _items(f"{statement.removeprefix('is ')}{given}: ", dict.fromkeys(signals))
    states = verdict.states
    if states is not None and states.unfelt:
        yield _items(
            "may drift together without an effect on other signals, e.g. whole turns of joints: ", states.unfelt
        )
    if states is not None and states.open:
        yield _items("not proved bounded, so stability of the whole loop is not proved: ", states.open)
    if verdict.flow_claim is not None:
        lines = [(block, line) for block, law in verdict.flow_claim.laws.items() for line in law.definitions]
        meanings = {line.name: {other.whole.text for _, other in lines if other.name == line.name} for _, line in lines}
        named = dict.fromkeys(
            line.whole.unicode + (f" ({block})" if len(meanings[line.name]) > 1 else "") for block, line in lines
        )
        named |= dict.fromkeys(f"{name} of {block} is {goal}" for block, name, goal in _renamed_goals(verdict))
        if named:
            yield _items("where ", named)
    for item in (item for item in verdict.statements if item.concludes):
        assumed = Text(", assuming that ", joined(item.assumes, " and ")) if item.assumes else ""
        yield _line(Text("=> ", item.signal, f" {item.says}: ", item.step, assumed))


def _error_bounds(verdict: Verdict) -> Iterator[str]:
    """The bounds, their largest contributions, and why there are no others."""
    assert verdict.errors is not None
    found = verdict.errors.found
    if not found:
        for reason in verdict.errors.missing:
            yield _wrap(f"no bound on the tracking error: {reason}")
        return
    over, holds = plain(found[0].over_s, "s"), found[0].holds
    yield f"  bounds over {over} from the graph's start, in {holds}; {disturbance_of(found[0])}"
    rows = [(NORMS[bound.kind].format(bound.signal.unicode), size_of(bound)) for bound in found]
    yield columns(rows, "    ")
    if remark := useless_of(found):
        yield _wrap(remark)
    for contribution in dict.fromkeys(map(contribution_of, found)):
        yield _wrap(contribution)
    for reason in verdict.errors.missing:
        yield _wrap(reason)


def disturbance_of(bound: ErrorBound) -> str:
    """The assumed disturbance in words."""
    if not any(bound.disturbance):
        return "no disturbance torque"
    same = len(set(bound.disturbance)) == 1
    torques = ", ".join(f"{each:g}" for each in (bound.disturbance[:1] if same else bound.disturbance))
    return f"disturbance torque at most {torques} N m" + " at each joint" * same


def size_of(bound: ErrorBound) -> str:
    """The bound with its unit, or that it is of no use."""
    value = plain(rounded_up(bound.value), bound.unit)
    return f"≤ {value}" if bound.useful else f"no useful bound ({value})"


def useless_of(found: Sequence[ErrorBound]) -> str:
    """Why bounds are of no use; empty if all are useful."""
    useless = [bound for bound in found if not bound.useful]
    still = [
        f"|{bound.signal.unicode}| ≤ {plain(bound.moved, bound.unit)}"
        for bound in {bound.signal.unicode: bound for bound in useless}.values()
        if bound.moved
    ]
    why = f"a robot at rest at the start of its path has {' and '.join(still)}" if still else ""
    return f"no useful bound: {why or 'it is as large as the robot'}" if useless else ""


def contribution_of(bound: ErrorBound) -> str:
    """The largest contribution to a bound, and what would lower it."""
    return f"largest contribution: {bound.dominated_by.of.unicode}{lowering_of(bound.dominated_by)}"


def lowering_of(share: Share) -> str:
    """What follows the name of a contribution: that it is one of the start, and what would lower it."""
    lowered = f", which {' or '.join(share.lowered_by)} lowers" if share.lowered_by else ""
    return f"{' at the start' * share.of_start}{lowered}"


def _wrap(text: str) -> str:
    return fill(f"    {text}", **_wrapped())


def _renamed_goals(verdict: Verdict) -> Iterator[tuple[str, str, str]]:
    """Inputs ``*_d`` that are wired to an output of another name, with that output."""
    diagram = verdict.flow_claim.diagram if verdict.flow_claim is not None else None
    for (block, port), source in diagram.sources.items() if diagram is not None else ():
        if isinstance(source, Wire) and port.endswith("_d") and source.port != port:
            yield block, port, f"{unicode_name(source.port)} ({source.block})"


def _items(lead: str, items: Iterable[str]) -> str:
    kept = ", ".join(item.replace(" ", HARD) for item in items)  # no line break inside a formula
    return fill(f"    {lead}{kept}", **_wrapped()).replace(HARD, " ")


def _line(text: Text) -> str:
    """Indented, wrapped sentence."""
    return fill(f"    {text.unicode}", **_wrapped())


def _wrapped() -> dict[str, Any]:
    width = min(WIDEST, shutil.get_terminal_size((WIDEST, 24)).columns)
    return {"width": max(width, 40), "subsequent_indent": " " * 8, "break_on_hyphens": False}


def _over(verdict: Verdict) -> str:
    """Uncertain parameters over whose intervals the conditions were decided."""
    return f", over the intervals of {', '.join(verdict.uncertain)}" if verdict.uncertain else ""


def _bounds(verdict: Verdict) -> list[tuple[str, str]]:
    """Terms of the residual with their bounds."""
    rows = []
    for bound in verdict.bounds:
        kappa = f"{KAPPA.unicode}·" if bound.weight == "kappa" else ""
        unknown = "a constant of the motion" if bound.constant else "no known bound"
        number = unknown if bound.value is None else f"≤ {kappa}{bound.value:.4g}"
        value = f"{number} {'times ' if bound.value is None and bound.times else ''}{bound.times.unicode}".strip()
        rows.append((f"{bound.block}: {bound.term.unicode}", value))
    return rows


def _mark(condition: Checked) -> str:
    """Status of a condition; a sampled one is not proved."""
    if condition.holds:
        return "sampled, not proved" if condition.how == "sampled" else "holds"
    return "FAILS"
