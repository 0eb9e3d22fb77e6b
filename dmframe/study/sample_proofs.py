"""Samples that meet a proof's conditions: by margins at each sample's numbers, or by `verify` of its graph."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Final, final

import casadi as ca
import numpy as np

from dmframe.block.model import SYMBOLIC, symbols_in
from dmframe.block.parameter import PAIRS, specs
from dmframe.certify import Verdict
from dmframe.certify.begun import START
from dmframe.certify.claim import Claim
from dmframe.certify.over import NEEDED, failing_of
from dmframe.certify.parameter_margins import Intervals, ParameterMargin, parameter_margins, same_claims
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.values import with_values
from dmframe.exact.rational import evaluate
from dmframe.robot.rational import decimal
from dmframe.study.box import Box, label_of

if TYPE_CHECKING:
    from dmframe.study.plan import Study

EXAMINED: Final = 20_000
"""Largest number of samples examined if the proof does not hold over the whole box."""
EDGE: Final = 1e-12
"""Margins smaller than this, relative to the largest, are decided exactly, because of rounding."""
EXACT: Final = 200
"""Largest number of samples with margins decided exactly."""
SINGLE: Final = 6
"""Number of samples verified separately if their margins are not decisive."""
SECONDS: Final = 15.0
"""Time after which no further sample is verified, per grid point [s]."""

HOLDS, FAILS, OPEN = 1, 0, -1


@final
@dataclass(frozen=True, eq=False)
class SampleProofs:
    """Whether each of the first samples meets every condition of the proof.

    Parameters
    ----------
    fulfil
        (n,) bool.
    unknown
        (n,) bool: undecided samples.
    """

    fulfil: np.ndarray
    unknown: np.ndarray

    @property
    def known(self) -> bool:
        """True if some sample is decided."""
        return not bool(self.unknown.all())

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of samples that meet all conditions, of all samples, and of undecided ones."""
        return int(self.fulfil.sum()), len(self.fulfil), int(self.unknown.sum())


def sample_proofs_of(study: Study, index: int, diagram: Diagram, box: Box, verdict: Verdict) -> SampleProofs:
    """Examine the samples of a grid point whose box is not proved as a whole."""
    count, graph = min(study.samples, EXAMINED), study.points[index].graph
    stated, values = graph.intervals(diagram), study.values(index, 0, count)
    found = None if box.unknown else conditions_at(diagram, graph.start, values, count, verdict, stated)
    found = np.full(count, OPEN) if found is None else found
    started = time.perf_counter()
    for sample in np.flatnonzero(found == OPEN)[:SINGLE].tolist():
        if time.perf_counter() - started > SECONDS:
            break
        with suppress(DmframeError):
            verdict = study.graph_of(sample * len(study.points) + index).verdict()
            found[sample] = HOLDS if verdict.outcome == "proved" else FAILS
    return SampleProofs(found == HOLDS, found == OPEN)


def conditions_at(
    diagram: Diagram,
    start: Mapping[str, Any],
    values: Mapping[str, np.ndarray],
    count: int,
    verdict: Verdict,
    stated: Intervals | None = None,
) -> np.ndarray | None:
    """Whether `count` samples meet every condition, each at its own numbers: `HOLDS`, `FAILS`, or `OPEN`.

    Parameters
    ----------
    values
        Rows by ``block.parameter``, see `Study.values`.
    verdict
        Over the box of all these values.
    stated
        The graph's own intervals, over which each sample's proof must hold.

    Returns
    -------
    (count,) int
        None if no sample can be decided: the claim fails for other reasons than its conditions, or a value changes the
        equations.
    """
    claim = verdict.claim
    if claim is None or diagram.unit_faults or not _only_conditions_fail(verdict):
        return None
    with SYMBOLIC:
        rows = _rows_of(diagram, claim, start, values, count)
        if rows is None:
            return None
        moved = {label.removeprefix(START) for label in rows if label.startswith(START)}
        everything = parameter_margins(verdict.conditions, claim, stated or {}, moved)
    silent = {item.checked.name for item in everything if item.tacit}
    # conditions that were undecided over the box are evaluated again at each sample
    judged = [
        item for item in everything if item.tacit or not (item.checked.source == NEEDED and item.checked.name in silent)
    ]
    bounded = all(bound.known for bound in verdict.bounds)
    found = _Samples(claim, rows, count).judged(judged)
    return found if bounded else np.where(found == HOLDS, OPEN, found)


def _only_conditions_fail(verdict: Verdict) -> bool:
    """True if the identity is proved and only conditions fail, if anything does."""
    if verdict.test is None or not verdict.test.zero or not verdict.conditions:
        return False
    if verdict.outcome == "proved":
        return True
    whole = verdict.states is not None or verdict.samples is not None
    caught = bool(verdict.controls) and all(control.refuted for control in verdict.controls)
    failing = failing_of(verdict.conditions)
    return whole and caught and bool(failing) and verdict.reason == failing


def _rows_of(
    diagram: Diagram, claim: Claim, start: Mapping[str, Any], values: Mapping[str, np.ndarray], count: int
) -> dict[str, np.ndarray] | None:
    """(elements, count) of each varied parameter and initial state; None if a value changes the equations."""
    shapes = {item.label: item.value.shape for item in claim.loop.parameters}
    shapes |= {f"{START}{label}": (symbol.numel(),) for label, symbol in claim.starts.items()}
    rows, written = dict[str, np.ndarray](), dict[str, Any]()
    for name, column in values.items():
        label = label_of(diagram, name, start)
        if label not in shapes:
            continue
        try:
            rows[label] = _rows(_in_loop_layout(diagram, label, column), shapes[label], count)
        except ValueError:  # a matrix that the loop stores in another form
            return None
        if not name.startswith(START) and name.partition(".")[0] in diagram.blocks:
            written[name] = column[0].tolist()
    return rows if _only_numbers_differ(diagram, claim, written, rows) else None


def _only_numbers_differ(
    diagram: Diagram, claim: Claim, written: Mapping[str, Any], rows: Mapping[str, np.ndarray]
) -> bool:
    """True if the first sample's graph has the same claim, and differs in the drawn numbers only."""
    try:
        changed = with_values(diagram, written)
    except DmframeError:
        return False
    for new, old in zip(changed.loop.parameters, diagram.loop.parameters, strict=True):
        if new.label in rows and new.label not in written:
            continue  # a parameter of the robot model, not of a block
        wanted = rows[new.label][:, 0] if new.label in rows else old.value.ravel(order="F")
        if not np.array_equal(new.value.ravel(order="F"), wanted):
            return False
    blocks = dict.fromkeys(label.partition(".")[0] for label in written)
    return all(same_claims(claim, changed, block) for block in blocks)


def _in_loop_layout(diagram: Diagram, label: str, values: np.ndarray) -> np.ndarray:
    """Values in the loop's layout: a row of two ends per element, where a file has two rows of ends."""
    block, _, name = label.partition(".")
    spec = specs(type(diagram.blocks[block])).get(name) if block in diagram.blocks else None
    if spec is None or spec.form not in PAIRS:
        return values
    return np.moveaxis(values, 1, -1) if values.ndim > 2 else values[:, None, :]


def _rows(values: np.ndarray, shape: tuple[int, ...], count: int) -> np.ndarray:
    """(elements, count): each sample's parameter in column-major order; one number is repeated for all elements."""
    if values.ndim == 1:
        values = values.reshape(count, *(1 for _ in shape))
    full = np.broadcast_to(values, (count, *shape))
    return np.stack([each.ravel(order="F") for each in full], axis=1) if count else np.zeros((0, 0))


@final
class _Samples:
    """Numbers of all samples, for the evaluation of margins."""

    def __init__(self, claim: Claim, rows: Mapping[str, np.ndarray], count: int) -> None:
        self._count, self._starts = count, [label for label in rows if label.startswith(START)]
        parameters = claim.loop.parameters
        self._symbols = [stack([item.symbol]) for item in parameters]
        self._symbols += [claim.starts[label.removeprefix(START)] for label in self._starts]
        fixed = {item.label: item.value.ravel(order="F")[:, None] for item in parameters}
        self._columns = [rows[k] if k in rows else np.repeat(fixed[k], count, axis=1) for k in fixed]
        self._columns += [rows[label] for label in self._starts]
        labels = [item.label for item in parameters] + self._starts
        self._moved = symbols_in(symbol for label, symbol in zip(labels, self._symbols, strict=True) if label in rows)

    def judged(self, items: Sequence[ParameterMargin]) -> np.ndarray:
        """Conjunction of all conditions, for each sample."""
        found = np.full(self._count, HOLDS)
        for item in items:
            each = self._of(item)
            found = np.where((found == FAILS) | (each == FAILS), FAILS, np.minimum(found, each))
        return found

    def _of(self, item: ParameterMargin) -> np.ndarray:
        if item.margin is None:
            stays = item.reads is not None and not symbols_in([item.reads]) & self._moved
            return np.full(self._count, OPEN if not stays else HOLDS if item.checked.holds else FAILS)
        if item.margin.is_empty() or item.margin.is_zero():
            return np.full(self._count, HOLDS if item.margin.is_empty() or not item.checked.strict else FAILS)
        function = ca.Function("margin", self._symbols, [item.margin])
        values = function.map(self._count)(*self._columns) if self._count else ca.DM(0, 0)
        values = np.array(values).reshape(-1, self._count)
        least = np.min(values, axis=0)
        above = np.where(least > 0 if item.checked.strict else least >= 0, HOLDS, OPEN if item.opens else FAILS)
        endless = np.isinf(values).any(axis=0)  # a margin with a zero divisor is undecided
        size = np.where(np.isfinite(values), np.abs(values), 0)
        near = endless | (np.abs(least) <= EDGE * (1 + np.max(size, initial=0)))
        for place, sample in enumerate(np.flatnonzero(near).tolist()):
            above[sample] = self._exactly(function, item, sample) if place < EXACT else OPEN
        return above

    def _exactly(self, function: Any, item: ParameterMargin, sample: int) -> int:
        """Decide one sample exactly, with the decimal numbers of its graph."""
        given = [[decimal(float(x)) for x in column[:, sample]] for column in self._columns]
        try:
            values = evaluate(function, given)[0]
        except (ValueFault, ZeroDivisionError):
            return OPEN
        least = min(value for value in values if isinstance(value, Fraction))
        if least > 0 if item.checked.strict else least >= 0:
            return HOLDS
        return OPEN if item.opens else FAILS
