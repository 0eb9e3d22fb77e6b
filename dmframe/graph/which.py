"""Which controller for which task: answers to questions about a robot select a packaged graph.

Questions, conditions and reasons are in the file ``guides/which.yaml`` of a block package, errors in ``which_laws.csv``
next to it, and facts about graphs in ``which.csv``. The first answer whose conditions hold is selected. The page
``docs/how_to/which.md`` is made from the same files.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

from dmframe.catalogue import find_guide
from dmframe.common.errors import UnknownNameError, ValueFault
from dmframe.common.units import seconds
from dmframe.config.document import read_file
from dmframe.config.plausible import doubt_of_period

PERIOD: Final = "period"
"""The question whose answer is a time; its conditions name a class of periods, short or long."""
CLASSES: Final = ("short", "long")


@final
@dataclass(frozen=True)
class Question:
    """A question, its choices with their meanings, and the default answer; without choices the answer is a time."""

    key: str
    text: str
    choices: Mapping[str, str]
    default: str

    def checked(self, answer: str) -> str:
        """The answer, if it is one. Raises `UnknownNameError` or `ValueFault`."""
        if not self.choices:
            if doubt := doubt_of_period(seconds(f"--{self.key}", answer)):
                raise ValueFault(f"--{self.key} {answer}: {doubt}")
        elif answer not in self.choices:
            raise UnknownNameError(f"--{self.key} {answer}", "answer", answer, self.choices)
        return answer


@final
@dataclass(frozen=True)
class Rule:
    """An answer: its conditions by question, what to take under them, and why."""

    when: Mapping[str, Sequence[str]]
    take: str | Mapping[str, str]
    because: str
    adaptation: bool
    others: Sequence[Mapping[str, Any]]

    def graphs(self) -> Sequence[tuple[str, str]]:
        """Each class of periods that the conditions allow, with its graph."""
        return [(kind, graph_for(self.take, kind)) for kind in self.when.get(PERIOD, CLASSES)]


def graph_for(take: str | Mapping[str, str], kind: str) -> str:
    """The graph for a class of periods."""
    return take if isinstance(take, str) else take[kind]


@final
@dataclass(frozen=True)
class Taken:
    """A graph with its facts: the RMS error [m] of the last eighth, ideal and with the reality ``ur``, or None."""

    graph: str
    when: str
    ideal: float | None
    ur: float | None
    own: str
    proved: str

    @property
    def summary(self) -> dict[str, Any]:
        """For JSON; errors in mm."""
        error = None if self.ideal is None else {"ideal": 1e3 * self.ideal, "ur": _mm(self.ur), "unit": "mm"}
        return {"graph": self.graph, "if": self.when or None, "error": error, "own": self.own, "proved": self.proved}

    def __str__(self) -> str:
        """The errors, or that of the graph's own run, and the certificate."""
        if self.ideal is None or self.ur is None:
            error = f"{self.own} in its own run"
        else:
            error = f"{digits(1e3 * self.ideal)} mm; {digits(1e3 * self.ur)} mm with delay, encoders and limits"
        return f"{error}; {self.proved}"


def _mm(metres: float | None) -> float | None:
    return None if metres is None else 1e3 * metres


@final
@dataclass(frozen=True)
class Selection:
    """The selected graph, the reason, and alternatives with their conditions."""

    answers: Mapping[str, str]
    rule: Rule
    plant: str
    take: Taken
    others: Sequence[Taken]
    clock: str

    @property
    def commands(self) -> list[str]:
        """How to continue with the graph."""
        changed = "" if self.clock == self.answers[PERIOD] else f" --set clock='{self.answers[PERIOD]}'"
        return [f"dmframe new {self.take.graph} mine.yaml", f"dmframe run mine.yaml{changed}"]

    @property
    def transfer(self) -> str:
        """What of the answer holds for another robot than that of the graph."""
        return (
            "the kind of law follows from your answers, and its proof from its conditions, which `dmframe verify` "
            "decides for your robot; gains, path and errors do not carry over"
        )

    @property
    def elsewhere(self) -> list[str]:
        """Commands for another robot."""
        if self.answers["servo"] == "torque":  # a design commands velocities
            return [f"dmframe new {self.take.graph} mine.yaml", "dmframe verify mine.yaml"]
        period = self.answers[PERIOD]
        return [f"dmframe design ROBOT --period '{period}' --out DIR", "dmframe race DIR/race.yaml --out DIR/race"]

    @property
    def summary(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "answers": dict(self.answers),
            "take": self.take.graph,
            "adaptation": self.rule.adaptation,
            "because": self.rule.because,
            "plant": self.plant,
            **{key: value for key, value in self.take.summary.items() if key not in ("graph", "if")},
            "others": [each.summary for each in self.others],
            "commands": self.commands,
            "transfer": self.transfer,
            "elsewhere": self.elsewhere,
        }

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"take {self.take.graph}, {'an adaptive law' if self.rule.adaptation else 'a law without adaptation'}"
        yield f"  {self.rule.because}"
        yield f"  error on {self.plant}: {self.take}"
        for each in self.others:
            yield f"or {each.graph}, if {each.when}"
            yield f"  {each}"
        yield "next:"
        yield from (f"  {command}" for command in self.commands)
        yield f"for another robot: {self.transfer}"
        yield from (f"  {command}" for command in self.elsewhere)


@final
class Guide:
    """The questions and the answers of a guide file.

    Parameters
    ----------
    file
        ``which.yaml``; ``which.csv`` and ``which_laws.csv`` are next to it.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        data = read_file(file).data
        self.questions = {
            key: Question(key, item["text"], item.get("choices", {}), item["default"])
            for key, item in data["questions"].items()
        }
        self.rules = [Rule(**item) for item in data["answers"]]
        self.plants: Mapping[str, Mapping[str, Sequence[str]]] = data["plants"]
        self.short = seconds("short", data["short"])

    @cached_property
    def facts(self) -> dict[str, dict[str, str]]:
        """The rows of ``which.csv`` by graph."""
        return {row["graph"]: row for row in rows_of(self.file.with_name("which.csv"))}

    @cached_property
    def errors(self) -> dict[tuple[str, str], float | None]:
        """Errors [m] of ``which_laws.csv`` by graph and circle; None where the run diverged or no law applies."""
        rows = rows_of(self.file.with_name("which_laws.csv"))
        return {(row["graph"], row["circle"]): float(row["rms_final"] or "nan") for row in rows if row["rms_final"]}

    def checked(self, answers: Mapping[str, str]) -> dict[str, str]:
        """Answers in the order of the questions; missing ones are the defaults. Raises as `Question.checked`."""
        return {key: item.checked(answers.get(key, item.default)) for key, item in self.questions.items()}

    def period_class(self, period: str) -> str:
        """The class of a sampling period such as ``8 ms``."""
        return CLASSES[seconds(f"--{PERIOD}", period) > self.short * (1 + 1e-9)]

    def rule_for(self, answers: Mapping[str, str]) -> Rule:
        """The first rule whose conditions hold for checked answers."""
        return next(rule for rule in self.rules if self._holds(rule.when, answers))

    def _holds(self, when: Mapping[str, Sequence[str]], answers: Mapping[str, str]) -> bool:
        given = {**answers, PERIOD: self.period_class(answers[PERIOD])}
        return all(given[key] in values for key, values in when.items())

    def select(self, answers: Mapping[str, str]) -> Selection:
        """The graph for the answers, ``{"servo": "stiff", "period": "8 ms"}``. Raises as `checked`."""
        given = self.checked(answers)
        rule, kind = self.rule_for(given), self.period_class(given[PERIOD])
        servo = given["servo"]
        others = [
            self.taken(graph_for(each["take"], kind), servo, kind, each["if"])
            for each in rule.others
            if self._holds(each.get("when", {}), given)
        ]
        take = self.taken(graph_for(rule.take, kind), servo, kind)
        clock = self.facts[take.graph]["clock"]
        return Selection(given, rule, self.plant_text(servo, kind), take, others, clock)

    def plant_of(self, servo: str) -> str:
        """The servo with which the errors for an answer were measured."""
        return servo if servo in self.plants else "soft"

    def plant_text(self, servo: str, kind: str) -> str:
        """What the errors were measured on."""
        period = {"short": "8 ms", "long": "90 ms"}[kind]
        return f"a UR10 with a {'stiff cascade' if self.plant_of(servo) == 'stiff' else 'soft PID servo'}, {period}"

    def taken(self, graph: str, servo: str, kind: str, when: str = "") -> Taken:
        """A graph with its facts for a servo and a class of periods."""
        ideal, ur = (self.errors.get((graph, circle)) for circle in self.plants[self.plant_of(servo)][kind])
        if servo == "torque":
            ideal = ur = None
        fact = self.facts[graph]
        return Taken(graph, when, ideal, ur, fact["error"], short_verdict(fact["proved"]))


def digits(value: float) -> str:
    """Three significant digits without an exponent, at most six after the point."""
    places = max(0, 2 - int(f"{value:e}".partition("e")[2]))
    return f"{value:.{min(places, 6)}f}"


def short_verdict(headline: str) -> str:
    """The headline of a verdict; of a proof over samples its first part, since pages state the restrictions once."""
    return headline.partition(",")[0] if headline.startswith("proved over samples") else headline


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def guide() -> Guide:
    """The guide of the installed packages. Raises `UnknownNameError` if there is none."""
    return Guide(find_guide("which"))
