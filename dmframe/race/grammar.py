"""Grammar of a race file: its keys and their values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal, TypeAlias, final

from pydantic import BaseModel, BeforeValidator, Field, PlainValidator, WithJsonSchema

from dmframe.config.document import Document, Kind
from dmframe.config.grammar import Length, Path, Seconds, Section, seed_of, shown
from dmframe.config.grammar import version as checked_version
from dmframe.config.places import placed
from dmframe.errors import DmframeError, Faults
from dmframe.study.grammar import Count, Labels
from dmframe.units import to_unit

RACE: Final = Kind("race", "dmframe-race: 1")
VERSION: Final = "dmframe-race"


def _bounds(value: Any) -> Any:
    numbers = isinstance(value, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    if not numbers or len(value) != 2 or not 0 < value[0] < value[1]:
        raise ValueError(f"expected two numbers above zero, the lower one first, found {shown(value)}")
    return tuple(map(float, value))


def _range(value: Any) -> Any:
    return {"between": value} if isinstance(value, list) else value


def _named(value: Any) -> Any:
    if not isinstance(value, dict) or not value:
        raise ValueError(f"expected named entries, at least one, found {shown(value)}")
    return value


Bounds: TypeAlias = Annotated[tuple[float, float], BeforeValidator(_bounds), WithJsonSchema({"type": "array"})]
Named: TypeAlias = Annotated[dict[str, Any], BeforeValidator(_named)]


@final
class RangeSection(Section):
    """Range in which a parameter is searched, evenly in its logarithm; one of the two keys."""

    between: Bounds | None = Field(None, description="bounds of the value, in the parameter's own unit")
    per_clock: Bounds | None = Field(None, description="bounds of the value times the sampling period in seconds")


Range: TypeAlias = Annotated[RangeSection, BeforeValidator(_range)]


def _graphs(value: Any) -> Any:
    """Graphs by the longest sampling period in s; one alone is for all."""
    if isinstance(value, str):
        return {math.inf: value}
    if not isinstance(value, dict) or not value or not all(isinstance(name, str) for name in value.values()):
        raise ValueError(f"expected a graph, or {{20 ms: a graph, 90 ms: another}}, found {shown(value)}")
    try:
        return {to_unit(clock, "s"): name for clock, name in value.items()}
    except DmframeError as error:
        raise ValueError(error.text) from None


Graphs: TypeAlias = Annotated[dict[float, str], PlainValidator(_graphs), WithJsonSchema({"type": ["string", "object"]})]


@final
class LawSection(Section):
    """One law: a graph whose controller takes part, and what is searched."""

    graph: Graphs = Field(
        description="name of a packaged graph, or path of a graph file relative to the race; or several, each by the "
        "longest sampling period for which it is taken"
    )
    set: dict[str, Any] = Field({}, description="values that differ from the graph, in the form of --set")
    tune: Annotated[dict[str, Range], BeforeValidator(_named)] = Field(description="searched parameters with bounds")
    delay: Labels = Field((), description="parameters that are given the transport delay of the cell, in samples")
    rate: Labels = Field((), description="parameters that are given the rate at which the path repeats, if it does")

    def graph_at(self, clock: float) -> str:
        """The graph for a sampling period: the first whose longest period reaches it, else the last."""
        return next((name for most, name in sorted(self.graph.items()) if clock <= most), self.graph[max(self.graph)])


@final
class TrainingSection(Section):
    """The cells on which the laws are tuned; other plants and paths are held out."""

    plants: Labels = Field(description="names of plants")
    paths: Labels = Field(description="names of paths")
    realities: Labels = Field(description="names of realities")


@final
class MarginsSection(Section):
    """The perturbation under which a candidate must not diverge on the training cells."""

    gain: Annotated[float, Field(gt=0)] = Field(1.3, description="factor of its command")
    delay: Annotated[int, Field(ge=0)] = Field(1, description="further samples of transport delay")


@final
class QuickSection(Section):
    """A part of the race for ``--quick``."""

    clocks: tuple[Seconds, ...] | None = None
    plants: Labels = ()
    paths: Labels = ()
    realities: Labels = ()
    laws: Labels = ()
    budget: Count | None = None


@final
class RaceFile(Section):
    """The keys of a race file."""

    version: Annotated[Literal[1], BeforeValidator(checked_version)] = Field(alias=VERSION)
    title: str = Field("", description="description in one line")
    robot: Any = Field(description="as in a graph")
    start: dict[str, Any] = Field({}, description="as in a graph; near selects a branch of the inverse kinematics")
    duration: Seconds = Field(description="simulated time of each run; the error is that of its last eighth")
    limit: Length = Field(0.1, description="a run with a larger error counts as diverged")
    seed: Annotated[int, BeforeValidator(seed_of)] = Field(
        0, description="of random numbers in training; held-out cells use the next one"
    )
    entrant: str = Field(description="the law that is compared with the best of the others")
    plants: Named = Field(description="blocks of the plant, and optionally wires, by name of the plant")
    clocks: tuple[Seconds, ...] = Field(min_length=1, description="sampling periods of the controllers")
    paths: Named = Field(description="the source of the path, and optionally the rate at which it repeats, by name")
    realities: Named = Field(description="channel models between controller and robot, as a graph's key reality")
    laws: Annotated[dict[str, LawSection], BeforeValidator(_named)] = Field(description="the laws by name")
    training: TrainingSection
    budget: Count = Field(12, description="candidates of each law at each clock")
    margins: MarginsSection = MarginsSection()
    quick: QuickSection = QuickSection()


KEYS: Final = tuple(field.alias or name for name, field in RaceFile.model_fields.items())
_SECTIONS: Final[Mapping[str, type[BaseModel]]] = {
    "training": TrainingSection,
    "margins": MarginsSection,
    "quick": QuickSection,
}


def keys_at(path: Path) -> Sequence[str]:
    """Keys that a section of a race file may have."""
    if not path:
        return KEYS
    if path[0] == "laws":
        return list((LawSection if len(path) == 2 else RangeSection).model_fields)
    return list(_SECTIONS[str(path[0])].model_fields) if path[0] in _SECTIONS else []


def raise_placed(faults: Sequence[DmframeError], document: Document) -> None:
    """Raise the faults, if there are any, at their places in the race's file."""
    if faults:
        raise placed(faults[0] if len(faults) == 1 else Faults(faults), document, KEYS)
