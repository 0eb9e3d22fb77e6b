"""Result of a design: what is handed over, with its figures and checks."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, final

from dmframe.design.decide import Candidate, Ranking

Outcome = Literal["adaptive", "simple", "blocked"]
GRAPH: Final = "graph.yaml"
"""The graph of designs before 0.3; later ones are named by `graph_name`."""
REPORT: Final = "report.html"
SUMMARY: Final = "design.json"
RACE: Final = "race.yaml"
RESULTS: Final = "race"
PAGE: Final = "page.html"
CONTROLLER: Final = "controller"
COMMANDS: Final = "commands.txt"
LIMITS: Final = "limits.yaml"


@final
@dataclass(frozen=True)
class Check:
    """A check of the handed-over graph: what was checked, its conclusion, and whether it passed.

    `whole` is false for a proof that does not cover the stability of the loop.
    """

    of: str
    text: str
    passed: bool
    whole: bool = True


@final
@dataclass(frozen=True)
class Designed:
    """Result of a design.

    Parameters
    ----------
    outcome
        ``adaptive``: an adaptive law, proved and rehearsed; ``simple``: a tuned law without a model that is not
        stopped in a rehearsal;
        ``blocked``: nothing is handed over.
    reason
        One sentence.
    chosen, other
        The handed-over law, and the best one of the other kind.
    clock, payload
        Sampling period [s] and largest load [kg].
    checks
        Of the handed-over graph.
    files
        Files of the folder, each with what it is.
    log
        The log from which the servo was identified; empty without one.
    notes
        How the user's path was changed.
    assumed
        What was chosen and assumed of the robot, such as the inertia of a link.
    task
        What follows the path.
    seconds
        Duration of the runs of the comparison [s].
    """

    outcome: Outcome
    reason: str
    folder: Path
    robot: str
    clock: float
    payload: float
    ranking: Ranking | None = None
    chosen: Candidate | None = None
    other: Candidate | None = None
    checks: Sequence[Check] = ()
    files: Sequence[tuple[str, str]] = ()
    command: str = ""
    log: str = ""
    notes: Sequence[str] = ()
    assumed: Sequence[str] = ()
    task: str = "joints"
    seconds: float = 48.0

    @property
    def unit(self) -> str:
        """Unit of the errors."""
        return self.ranking.unit if self.ranking else "mm" if self.task in ("position", "pose") else "mrad"

    @property
    def graph(self) -> Path | None:
        """File of the handed-over graph."""
        if self.outcome == "blocked":
            return None
        return self.folder / (GRAPH if self.chosen is None else graph_name(self.robot, self.chosen.law, self.clock))

    @property
    def report(self) -> Path:
        """File of the report."""
        return self.folder / REPORT

    @property
    def headline(self) -> str:
        """The verdict in a few words."""
        law = self.chosen.law if self.chosen else ""
        among = ", with the servo of its log" if self.log else ", on an assumed family of servos"
        return {
            "adaptive": f"{law}: worth it on {self.robot}{among}",
            "simple": f"{law}: a simple law is the better choice for {self.robot}{among}",
            "blocked": f"no controller for {self.robot}",
        }[self.outcome]

    @property
    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "outcome": self.outcome,
            "graph": None if self.graph is None else str(self.graph),
            "report": str(self.report),
            "error": finite(self.chosen),
            "rival_error": finite(self.other),
            "unit": self.unit,
            "reason": self.reason,
            "law": self.chosen.law if self.chosen else None,
            "rival": self.other.law if self.other else None,
            "clock": self.clock,
            "payload": self.payload,
            "task": self.task,
            "notes": list(self.notes),
            "assumed": list(self.assumed),
            "checks": [vars(check) for check in self.checks],
        }

    def __str__(self) -> str:
        lines = [f"{self.outcome}: {self.headline}", f"  {self.reason}"]
        lines += [f"  {check.of}: {check.text}" for check in self.checks]
        lines += [f"  assumed: {text}" for text in self.assumed]
        lines += [f"  {name:<14} {about}" for name, about in self.files]
        return "\n".join(lines)


def graph_name(robot: str, law: str, clock: float) -> str:
    """File of a graph, ``ur5e_experts_8ms.yaml``; `robot` is a name or a file, `clock` in s."""
    words = [robot.partition(".")[0], law, f"{1000 * clock:.6g}ms"]
    return re.sub(r"\W+", "_", "_".join(words)) + ".yaml"


def finite(candidate: Candidate | None) -> float | None:
    """Median error of a law; None if it diverged somewhere or does not exist."""
    return None if candidate is None or not math.isfinite(candidate.error) else candidate.error
