"""Linear analysis of a graph, with its terminal page and its notebook view."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.common import notebook
from dmframe.common.columns import columns
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.config.about import AboutGraph
from dmframe.report.linear import EMULATION_HEADS, JOINT_HEADS, LinearView, rows_of

if TYPE_CHECKING:
    from dmframe.analysis import LoopAnalysis, ReferenceGain

LOOP_HEADS: Final = ("", "at rest", "moving (no slope of Coulomb friction)")
GAIN_HEADS: Final = ("joint", "K_c of the graph", "least K_c", "least without friction")


@final
@dataclass(frozen=True, repr=False, eq=False)
class Analysis(AboutGraph):
    """Margins and passivity of the servo, poles, the largest stable sampling period, and the least K_c.

    ``str`` of it is the terminal's page.

    Parameters
    ----------
    graph
        The graph.
    found
        The numbers.
    """

    graph: BaseGraph
    found: LoopAnalysis

    @property
    def summary(self) -> dict[str, Any]:
        """Data that ``dmframe analyse --json`` prints."""
        return dict(self._view.numbers)

    @property
    def conclusion(self) -> str:
        """Stability of the linearised loop and of the simulated run, in one sentence."""
        return f"{self._near} {self._run}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """What blocks remark on their parameters, such as a gain that follows from margins."""
        found = {name: block.remark() for name, block in self.graph.blocks.items()}
        return tuple(f"{name}: {text}" for name, text in found.items() if text)

    @cached_property
    def _view(self) -> LinearView:
        return rows_of(self.name, self.found)

    @property
    def _near(self) -> str:
        found = self.found
        if found.clock is None:
            poles = (*found.at_rest.poles, *found.moving.poles)
            slowest = max((float(pole.real) for pole in poles), default=0.0)
            if slowest < 0:
                least = min(found.periods.at_rest, found.periods.moving, key=lambda bracket: bracket.stable)
                most = plain(least.stable, "s", 4)
                until = "" if math.isinf(least.unstable) else f", and at all tested sampling periods up to {most}"
                return f"Near the set-point the loop is stable in continuous time{until};"
            return f"Near the set-point the loop is unstable: a pole has the real part {slowest:.3g} 1/s;"
        radius = max(linear.spectral_radius(found.clock) for linear in (found.at_rest, found.moving))
        least = min(found.periods.at_rest, found.periods.moving, key=lambda bracket: bracket.stable)
        clock = plain(found.clock, "s")
        if radius > 1:
            most = plain(least.stable, "s", 4)
            until = "at no tested period" if least.stable == 0 else f"at the tested periods up to {most}"
            return f"Sampled every {clock} the loop is unstable near its set-point; it is stable {until};"
        if math.isinf(least.unstable):
            return f"Sampled every {clock} the loop is stable near its set-point, as at every tested period;"
        room = least.stable / found.clock
        return (
            f"Sampled every {clock} the loop is stable near its set-point, and at each longer tested period up "
            f"to {plain(least.stable, 's', 4)}, {room:.2g} times as long;"
        )

    @property
    def _run(self) -> str:
        bracket, clock = self.found.periods.simulated, self.found.clock
        if bracket.stable == 0:
            return "the simulated run stays bounded at no tested period."
        if math.isinf(bracket.unstable):
            return f"the simulated run stays bounded up to {plain(bracket.stable, 's', 4)}, the longest tested period."
        text = f"the simulated run stays bounded up to about {plain(bracket.stable, 's', 4)}"
        return f"{text}." if clock is None or bracket.stable >= clock else f"{text}, less than its sampling period."

    def __repr__(self) -> str:
        return f"<Analysis of {self.name}: {self.conclusion}>"

    def __str__(self) -> str:
        view = self._view
        parts = [
            f"{self.name}: {self.graph.file.title}".rstrip(": "),
            "",
            *(line for remark in self.remarks for line in (*textwrap.wrap(remark, 112), "")),
            "joint loops: servo, motor, diagonal of M and viscous friction at the set-point, other joints locked",
            *(line for friction in self.found.left_out for line in textwrap.wrap(str(friction), 112)),
            columns([JOINT_HEADS, *view.joints]),
            "",
            "closed loop, linearised at the set-point, estimates at their true values",
            columns([LOOP_HEADS, *view.loop]),
            "",
            "largest stable sampling period",
            columns([row[:2] for row in view.periods]),
            *(f"    {line}" for line in textwrap.wrap(self.found.periods.simulated.meaning, 106)),
            "",
            *self._proofs(),
            *self._emulation(),
            *self._least_K_c(),
            *(f"  {line}" for line in textwrap.wrap(view.numbers["note"], 110)),
            "",
            *textwrap.wrap(self.conclusion, 112),
        ]
        return "\n".join(parts)

    def _repr_html_(self) -> str:
        view, gains = self._view, self.found.reference_gains
        return (
            notebook.heading(self.name, self.graph.file.title)
            + notebook.paragraphs([*self.remarks, self.conclusion])
            + notebook.table([row[:2] for row in view.periods], ("largest stable sampling period", ""))
            + notebook.table(view.loop, LOOP_HEADS)
            + notebook.table(view.joints, JOINT_HEADS)
            + (notebook.table(view.emulation, EMULATION_HEADS) if view.emulation else "")
            + (notebook.table(map(_gain, gains), GAIN_HEADS) if gains else "")
        )

    def _proofs(self) -> Iterator[str]:
        """Stability proofs in words, or why there is none."""
        rows = self._view.periods[2:4]
        meanings = {meaning: name.removeprefix("proved, ") for name, _, meaning in reversed(rows)}
        for meaning, name in reversed(meanings.items()):
            text = meaning if len(meanings) == 1 else f"{name}: {meaning}"
            yield from (f"  {line}" for line in textwrap.wrap(f"{text[:1].upper()}{text[1:]}.", 110))
        yield ""

    def _emulation(self) -> Iterator[str]:
        if self._view.emulation:
            yield "largest adaptation gain at this period, quasi-static estimate T λ_max(Γ Y_d' w Y_d) < 2; no proof"
            yield columns([EMULATION_HEADS, *self._view.emulation])
            yield ""

    def _least_K_c(self) -> Iterator[str]:
        gains: Sequence[ReferenceGain] = self.found.reference_gains
        if gains:
            over = "the intervals of uncertain:" if self.graph.file.uncertain else "the graph's own servo gains"
            yield f"K_c of the PID inverse [1/s]: the least that makes M̄ ≥ 0 over {over}, rounded upwards"
            yield columns([GAIN_HEADS, *map(_gain, gains)])
            yield ""


def _gain(gain: ReferenceGain) -> tuple[str, ...]:
    own = f"{float(gain.own):.6g}" + ("" if gain.holds else ", too small")
    return gain.joint, own, f"{float(gain.least):g}", f"{float(gain.least_without_friction):g}"
