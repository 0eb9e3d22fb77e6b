"""Result of `verify` on a graph, with its terminal page, notebook view and report."""

from __future__ import annotations

import pickle
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.certify import Verdict
from dmframe.certify.summary import summary
from dmframe.common.errors import DmframeError
from dmframe.common.files import expanded
from dmframe.config import BaseGraph
from dmframe.config.about import AboutGraph
from dmframe.config.plausible import implausible
from dmframe.report.clock_text import clock_text
from dmframe.report.verdict_text import verdict_text

if TYPE_CHECKING:
    from dmframe.analysis.held_proof import ClockProof
    from dmframe.block.certificate import Assumption
    from dmframe.certify.checked import Checked
    from dmframe.certify.statements import Statement
    from dmframe.report.content import Content
    from dmframe.report.parts import Section

ADAPTIVE: Final = "adaptive.yaml"
"""Name of a graph with a proof next to a graph without one."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Verification(AboutGraph):
    """Verdict on the certificate of a graph.

    ``str`` gives the terminal page, a notebook shows the first page of the report, `report` writes the whole report.

    Parameters
    ----------
    graph
        The verified graph.
    verdict
        Outcome with conditions, assumptions and conclusions.
    seed
        Seed of the random points and primes.
    label
        Distinguishes several verifications of graphs with one name.
    sampling
        Proof on a clock, or None.
    """

    graph: BaseGraph
    verdict: Verdict
    seed: int = 0
    label: str = ""
    sampling: ClockProof | None = None

    @property
    def name(self) -> str:
        """Label, or the name of the graph."""
        return self.label or self.graph.name

    @property
    def outcome(self) -> str:
        """``proved``, ``refuted`` or ``not_applicable``."""
        return self.verdict.outcome

    @property
    def proved(self) -> bool:
        """True if the outcome is ``proved``."""
        return self.verdict.outcome == "proved"

    @property
    def stable(self) -> bool:
        """True if the proof bounds all states of the closed loop, in continuous time; `proved` alone may cover less."""
        return self.verdict.stable

    @property
    def headline(self) -> str:
        """Outcome in words, with the limits of the proof."""
        return self.verdict.headline

    @property
    def reason(self) -> str:
        """Reason for the outcome, in a sentence."""
        return self.verdict.reason

    @property
    def conditions(self) -> tuple[Checked, ...]:
        """Conditions at the parameter values of the graph, with margins."""
        return self.verdict.conditions

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """Assumptions that are not proved."""
        return self.verdict.assumptions

    @property
    def conclusions(self) -> tuple[Statement, ...]:
        """Final conclusions, such as that x - x_d goes to zero; empty unless proved."""
        return tuple(item for item in self.verdict.statements if item.concludes) if self.proved else ()

    @property
    def summary(self) -> dict[str, Any]:
        """Data that ``dmframe verify --json`` prints."""
        more = {} if self.sampling is None else {"sampling": self.sampling.summary}
        return {**summary(self.name, self.verdict), "notices": list(self.notices), **more}

    @property
    def notices(self) -> tuple[str, ...]:
        """Times and rates of the graph outside of plausible ranges."""
        return implausible(self.graph)

    def report(self, path: str | Path, *, sections: Sequence[Callable[[Content], Section]] = ()) -> Path:
        """Simulate the graph and write the report: web page, Markdown or JSON by the ending of `path`.

        Parameters
        ----------
        sections
            Functions that make further sections of a page from its content.

        Raises
        ------
        DmframeError
            If the ending is unknown, the file cannot be written, or a function returns no section.
        """
        from dmframe.report.write import write_report

        path = expanded(path)
        write_report(path, [self], sections=sections)
        return path

    def __repr__(self) -> str:
        return f"<Verification of {self.name}: {self.headline}>"

    def __reduce__(self) -> Any:
        """Pickle without the diagram, which is rebuilt from the graph."""
        import casadi as ca

        with ca.global_pickle_context():  # margins are CasADi expressions
            verdict = pickle.dumps(self.verdict)
        return _restored, (self.graph, verdict, self.seed, self.label, self.sampling)

    def __str__(self) -> str:
        covered = self.sampling is not None and self.sampling.covers_clock  # printed below, with the intervals
        clock = None if covered else self.graph.clock
        text = verdict_text(self.name, self.verdict, notices=self.notices, clock=clock)
        if self.sampling is not None:
            text = f"{text}\n{clock_text(self.sampling)}"
        return f"{text}\n  {self._advice}" if self._advice else text

    @property
    def _advice(self) -> str:
        """For a graph that a proof does not reach: the graph with a proof that `identify` writes next to a twin."""
        if self.outcome != "not_applicable":
            return ""
        from dmframe.config.document import read_file

        other = Path(self.graph.document.name).with_name(ADAPTIVE)
        try:
            data = read_file(other).data
        except DmframeError:  # most graphs have none
            return ""
        own = self.graph.document.data.get("robot")
        if other.samefile(self.graph.document.name) or not own or data.get("robot") != own:
            return ""
        return (
            f"{ADAPTIVE}, in the same folder, is this robot under an adaptive law, without what a proof excludes\n"
            f"        (delay, other friction than viscous and Coulomb): dmframe verify {shlex.quote(str(other))}"
        )

    def _repr_html_(self) -> str:
        from dmframe.report.content import opening
        from dmframe.report.page import first_page

        return first_page(opening(self.graph, self.verdict))


def command(found: Sequence[Verification], path: Path) -> list[str]:
    """Command that writes the same report, for graphs with different names."""
    from dmframe.catalogue import graphs

    known = graphs()

    def place(item: Verification) -> str:
        own = item.graph.name
        packaged = own in known and str(known[own]) == item.graph.document.name
        return own if packaged else item.graph.document.name

    same = len({item.graph.overrides for item in found}) == 1
    changes = [
        f"{'' if same else f'{place(item)}:'}{text}"
        for item in (found[:1] if same else found)
        for text in item.graph.overrides
    ]
    options = [word for text in changes for word in ("--set", text)]
    return ["dmframe", "verify", *map(place, found), *options, "--seed", str(found[0].seed), "--report", path.name]


def _restored(
    graph: BaseGraph, verdict: bytes, seed: int, label: str, sampling: ClockProof | None = None
) -> Verification:
    """Restore a pickled verification."""
    import casadi as ca

    with ca.global_unpickle_context():
        found = pickle.loads(verdict)
    return Verification(graph, found, seed, label, sampling)
