"""Proof over the box of everything that a study samples, decided exactly with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

from dmframe.block.model import SYMBOLIC
from dmframe.certify import Verdict, verify
from dmframe.certify.checked import Checked
from dmframe.certify.over import NEEDED
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.graph.graph import Graph
from dmframe.study.box import Box, box_of, hull
from dmframe.study.plan import Study
from dmframe.study.sample_proofs import SampleProofs, sample_proofs_of

MOST: Final = 12
"""Largest number of grid points at which the proof is decided, about two seconds each."""

State = Literal["proved", "refuted", "not_applicable", "not_known"]


@final
@dataclass(frozen=True, eq=False)
class Proof:
    """Verdict over the box at one grid point.

    Parameters
    ----------
    verdict
        None if the graph could not be built, for the reason `why`.
    drawn
        If the whole box is not proved: the first samples that meet every condition.
    """

    index: int
    name: str
    box: Box
    verdict: Verdict | None
    why: str = ""
    drawn: SampleProofs | None = None

    @property
    def state(self) -> State:
        """``not_known`` if the intervals are too wide to decide, or a sampled number changes the equations."""
        if self.verdict is None:
            return "not_known"
        if self.verdict.outcome == "refuted":
            return "refuted"
        if self.verdict.outcome == "proved":
            return "not_known" if self.box.unknown else "proved"
        return "not_known" if self.failing and not self.failed else "not_applicable"

    @property
    def proved(self) -> bool:
        """Every condition holds in the whole box, and no sample changes the equations."""
        return self.state == "proved"

    @property
    def failing(self) -> tuple[Checked, ...]:
        """The conditions that fail in the box or are undecided."""
        return () if self.verdict is None else tuple(item for item in self.verdict.conditions if not item.holds)

    @property
    def failed(self) -> tuple[Checked, ...]:
        """The conditions that fail somewhere in the box."""
        return tuple(item for item in self.failing if NEEDED not in item.expression)


def proofs_of(study: Study, names: Sequence[str]) -> list[Proof]:
    """Decide the certificates of a study's first grid points over their boxes; faults are in `Proof.why`."""
    found = list[Proof]()
    for point in study.points[:MOST]:
        name = names[point.index]
        try:
            graph = point.graph
            diagram, numbers = study.runner.loop_of(graph)
            diagram = with_values(diagram, numbers) if numbers else diagram
            found.append(_proof(study, point.index, name, diagram, graph))
        except DmframeError as error:
            found.append(Proof(point.index, name, Box({}, {}, 1.0, ()), None, str(error)))
    return found


def _proof(study: Study, index: int, name: str, diagram: Diagram, graph: Graph) -> Proof:
    start = graph.start
    box = box_of(diagram, study.factors, start)
    with SYMBOLIC:
        verdict = verify(diagram, uncertain=hull(box.intervals, graph.intervals(diagram)), start=start)
    drawn = None
    if (verdict.outcome != "proved" or box.unknown) and study.samples > 1 and study.factors:
        drawn = sample_proofs_of(study, index, diagram, box, verdict)
    return Proof(index, name, box, verdict, drawn=drawn)
