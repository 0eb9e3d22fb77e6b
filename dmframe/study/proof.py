"""Whether the proof holds over all that a study draws: decided exactly, over intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

from dmframe.block.model import SYMBOLIC
from dmframe.certify import Verdict, verify
from dmframe.certify.checked import Checked
from dmframe.certify.over import NEEDED
from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.errors import DmframeError
from dmframe.exact.rational import Interval
from dmframe.study.box import HELD, Box, box_of
from dmframe.study.drawn import Drawn, drawn_of
from dmframe.study.plan import Study
from dmframe.study.table import Loops

MOST: Final = 12
"""Grid points at which the proof is decided; it takes about two seconds each."""

State = Literal["proved", "refuted", "not_applicable", "not_known"]


@final
@dataclass(frozen=True, eq=False)
class Proof:
    """What the proof says of one grid point, over a box.

    Parameters
    ----------
    verdict
        None where the point could not be built; `why` says the reason.
    drawn
        Where the box as a whole is not proved: which of the first samples fulfil every condition by themselves.
    """

    index: int
    name: str
    box: Box
    verdict: Verdict | None
    why: str = ""
    drawn: Drawn | None = None

    @property
    def state(self) -> State:
        """``not_known`` where intervals are too wide to decide, or a drawn number makes another loop."""
        if self.verdict is None:
            return "not_known"
        if self.verdict.outcome == "refuted":
            return "refuted"
        if self.verdict.outcome == "proved":
            return "not_known" if self.box.unknown else "proved"
        return "not_known" if self.failing and not self.failed else "not_applicable"

    @property
    def proved(self) -> bool:
        """Every condition holds anywhere in the box, and no sample is another loop."""
        return self.state == "proved"

    @property
    def failing(self) -> tuple[Checked, ...]:
        """The conditions that are not known to hold everywhere in the box."""
        return () if self.verdict is None else tuple(item for item in self.verdict.conditions if not item.holds)

    @property
    def failed(self) -> tuple[Checked, ...]:
        """Those of them that fail somewhere; the others are not decided."""
        return tuple(item for item in self.failing if NEEDED not in item.expression)


def proofs_of(study: Study, names: Sequence[str]) -> list[Proof]:
    """Decide the certificates of a study's first grid points over all that it draws. A fault is told, not raised."""
    loops, found = Loops(), list[Proof]()
    for point in study.points[:MOST]:
        name = names[point.index]
        try:
            experiment = point.graph.experiment
            diagram, numbers = loops.of(experiment)
            diagram = with_values(diagram, numbers) if numbers else diagram
            found.append(_proof(study, point.index, name, diagram, experiment))
        except DmframeError as error:
            found.append(Proof(point.index, name, Box({}, {}, 1.0, ()), None, str(error)))
    return found


def _proof(study: Study, index: int, name: str, diagram: Diagram, experiment: Experiment) -> Proof:
    start = experiment.start
    box = box_of(diagram, study.factors, start)
    with SYMBOLIC:
        verdict = verify(diagram, uncertain=_intervals(box, experiment.intervals(diagram)), start=start)
    drawn = None
    if (verdict.outcome != "proved" or box.unknown) and study.samples > 1 and study.factors:
        drawn = drawn_of(study, index, diagram, box, verdict)
    return Proof(index, name, box, verdict, drawn=drawn)


def _intervals(box: Box, stated: Mapping[str, Sequence[Interval]]) -> dict[str, Sequence[Interval]]:
    """What is drawn, and what the graph knows up to an interval: of a number that is both, all that either holds."""
    found: dict[str, Sequence[Interval]] = {**box.intervals}
    for label, given in stated.items():
        drawn = found.get(label, given)
        pairs = zip(drawn, given, strict=True)
        found[label] = [Interval(min(a.lower, b.lower), max(a.upper, b.upper)) for a, b in pairs]
    return found


__all__ = ["HELD", "MOST", "Box", "Proof", "State", "box_of", "proofs_of"]
