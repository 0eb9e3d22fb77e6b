"""A graph's verdict, as a person holds it: the terminal's page, the report's first page, the report."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from dmframe.certify import Verdict
from dmframe.certify.summary import summary
from dmframe.config import Experiment
from dmframe.diagram import Diagram
from dmframe.files import expanded
from dmframe.report.verdict_text import verdict_text

if TYPE_CHECKING:
    from dmframe.certificate import Assumption
    from dmframe.certify.checked import Checked
    from dmframe.certify.statements import Statement


@final
@dataclass(frozen=True, repr=False, eq=False)
class Verification:
    """What was found of a graph's certificate.

    ``str`` of it is the terminal's page, a notebook shows the report's first page, and `report` writes all of it.

    Parameters
    ----------
    experiment, diagram
        What was proved.
    verdict
        The outcome with everything it rests on.
    seed
        Of the random points and primes.
    label
        What tells it from others of its graph's name.
    """

    experiment: Experiment
    diagram: Diagram
    verdict: Verdict
    seed: int = 0
    label: str = ""

    @property
    def name(self) -> str:
        """What pages call it: the graph's name, or a label that tells it from others of that name."""
        return self.label or self.experiment.name

    @property
    def outcome(self) -> str:
        """``proved``, ``refuted`` or ``not_applicable``."""
        return self.verdict.outcome

    @property
    def proved(self) -> bool:
        """True for a graph that is proved."""
        return self.verdict.outcome == "proved"

    @property
    def headline(self) -> str:
        """The outcome in words, with what a proof does not reach."""
        return self.verdict.headline

    @property
    def reason(self) -> str:
        """Why the outcome is what it is, in a sentence."""
        return self.verdict.reason

    @property
    def conditions(self) -> tuple[Checked, ...]:
        """What had to hold at the graph's numbers, with margins."""
        return self.verdict.conditions

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """What is assumed and not proved."""
        return self.verdict.assumptions

    @property
    def conclusions(self) -> tuple[Statement, ...]:
        """What follows in the end, such as that x - x_d goes to zero; none unless it is proved."""
        return tuple(item for item in self.verdict.statements if item.concludes) if self.proved else ()

    @property
    def summary(self) -> dict[str, Any]:
        """What ``dmframe verify --json`` prints of it."""
        return summary(self.name, self.verdict)

    def report(self, path: str | Path) -> Path:
        """Write the report, a web page, Markdown or JSON by the ending of `path`; the graph is simulated for it.

        Raises
        ------
        OutputError
            Another ending, or a file that cannot be written.
        """
        from dmframe.report.write import write_report

        path = expanded(path)
        write_report(path, [self])
        return path

    def __repr__(self) -> str:
        return f"<Verification of {self.name}: {self.headline}>"

    def __reduce__(self) -> Any:
        """Pickled without its diagram, which is made anew of the graph; the verdict goes as it was found."""
        import casadi as ca

        with ca.global_pickle_context():  # its margins are expressions
            verdict = pickle.dumps(self.verdict)
        return _again, (self.experiment, verdict, self.seed, self.label)

    def __str__(self) -> str:
        return verdict_text(self.name, self.verdict)

    def _repr_html_(self) -> str:
        from dmframe.report.content import opening
        from dmframe.report.page import first_page

        return first_page(opening(self.experiment, self.verdict))


def command(found: Sequence[Verification], path: Path) -> list[str]:
    """The command that writes the same report, of graphs that have names of their own."""
    from dmframe.catalogue import graphs

    known = graphs()

    def place(item: Verification) -> str:
        own = item.experiment.name
        packaged = own in known and str(known[own]) == item.experiment.document.name
        return own if packaged else item.experiment.document.name

    same = len({item.experiment.overrides for item in found}) == 1
    changes = [
        f"{'' if same else f'{place(item)}:'}{text}"
        for item in (found[:1] if same else found)
        for text in item.experiment.overrides
    ]
    said = [word for text in changes for word in ("--set", text)]
    return ["dmframe", "verify", *map(place, found), *said, "--seed", str(found[0].seed), "--report", path.name]


def _again(experiment: Experiment, verdict: bytes, seed: int, label: str) -> Verification:
    """A verification that was pickled."""
    import casadi as ca

    with ca.global_unpickle_context():
        found = pickle.loads(verdict)
    return Verification(experiment, experiment.diagram(), found, seed, label)
