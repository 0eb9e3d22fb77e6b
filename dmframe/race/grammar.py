"""Grammar of a race file: its keys and their values."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, Final, Literal, TypeAlias, final

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, WithJsonSchema

from dmframe.common.errors import DmframeError, Faults
from dmframe.common.units import plain, to_unit
from dmframe.config.document import Document, Kind
from dmframe.config.grammar import Path, RobotSection, Seconds, Section, Speed, robot_name, seed_of, shown
from dmframe.config.grammar import version as checked_version
from dmframe.config.places import placed
from dmframe.study.grammar import Labels, counted

RACE: Final = Kind("race", "dmframe-race: 1")
VERSION: Final = "dmframe-race"
MOST: Final = 10_000
"""Largest number of candidates."""


def _bounds(value: Any) -> Any:
    numbers = isinstance(value, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    if not numbers or len(value) != 2 or not 0 < value[0] < value[1] <= sys.float_info.max:
        raise ValueError(f"expected two numbers above zero, the lower one first, found {shown(value)}")
    return tuple(map(float, value))


def _range(value: Any) -> Any:
    if not isinstance(value, list | dict):
        raise ValueError(f"expected bounds, [0.1, 100] or {{per_clock: [0.01, 1]}}, found {shown(value)}")
    return {"between": value} if isinstance(value, list) else value


def _named(value: Any) -> Any:
    if not isinstance(value, dict) or not value:
        raise ValueError(f"expected named entries, at least one, found {shown(value)}")
    for name in value:  # names are joined by commas in that of a cell
        if not name.isprintable() or name != name.strip() or not name or "," in name:
            raise ValueError(f"expected names without commas and spaces around them, found {name!r}")
    return value


def _clocks(value: Any) -> Any:
    if value == []:
        raise ValueError("expected at least one sampling period, found none")
    return value


def _once(values: Any) -> Any:
    again = [value for place, value in enumerate(values or ()) if value in values[:place]]
    if again:
        text = again[0] if isinstance(again[0], str) else plain(again[0], "s")
        raise ValueError(f"expected each once, found {text} twice")
    return values


def _next_seed(value: Any) -> Any:
    if seed_of(value) == 2**64 - 1:
        raise ValueError("expected at most 2^64 - 2, since held-out cells use the next one, found 2^64 - 1")
    return value


def _distance(value: Any) -> float:
    """A distance of the tool [m] or of the joints [rad]."""
    found = math.nan
    for unit in ("m", "rad"):
        with suppress(DmframeError):
            found = to_unit(value, unit)
            break
    if not 0 < found < math.inf:
        raise ValueError(f"expected a length or an angle above zero, such as 0.1 m or 0.1 rad, found {shown(value)}")
    return found


_BOUNDS: Final = {"type": "array", "items": {"type": "number", "exclusiveMinimum": 0}, "minItems": 2, "maxItems": 2}
_NAMED: Final = {"type": "object", "minProperties": 1}

Bounds: TypeAlias = Annotated[tuple[float, float], BeforeValidator(_bounds), WithJsonSchema(_BOUNDS)]
Named: TypeAlias = Annotated[dict[str, Any], BeforeValidator(_named), WithJsonSchema(_NAMED)]
Names: TypeAlias = Annotated[Labels, AfterValidator(_once)]
Clocks: TypeAlias = Annotated[tuple[Seconds, ...], BeforeValidator(_clocks), AfterValidator(_once)]
Distance: TypeAlias = Annotated[
    float, PlainValidator(_distance), WithJsonSchema({"type": ["number", "string"], "description": "in m or rad"})
]
Candidates: TypeAlias = Annotated[int, counted(MOST)]


@final
class RangeSection(Section):
    """Search range of a parameter, uniform in its logarithm; one of the two keys."""

    between: Bounds | None = Field(None, description="bounds of the value, in the parameter's own unit")
    per_clock: Bounds | None = Field(None, description="bounds of the value times the sampling period in seconds")

    def at(self, clock: float) -> Sequence[float]:
        """Bounds of the value at a sampling period."""
        return self.between or [bound / clock for bound in self.per_clock or ()]


Range: TypeAlias = Annotated[
    RangeSection,
    BeforeValidator(_range),
    WithJsonSchema(
        {
            "anyOf": [
                _BOUNDS,
                *(
                    {"type": "object", "properties": {key: _BOUNDS}, "required": [key], "additionalProperties": False}
                    for key in ("between", "per_clock")
                ),
            ]
        }
    ),
]


def _graphs(value: Any) -> Any:
    """Graphs by largest sampling period [s]; a single graph is for all periods."""
    if isinstance(value, str):
        return {math.inf: value}
    if not isinstance(value, dict) or not value or not all(isinstance(name, str) for name in value.values()):
        raise ValueError(f"expected a graph, or {{20 ms: a graph, 90 ms: another}}, found {shown(value)}")
    try:
        found = {to_unit(clock, "s"): name for clock, name in value.items()}
    except DmframeError as error:
        raise ValueError(error.text) from None
    if min(found) <= 0 or len(found) < len(value):
        raise ValueError(f"expected different sampling periods above zero, found {', '.join(value)}")
    return found


Graphs: TypeAlias = Annotated[
    dict[float, str],
    PlainValidator(_graphs),
    WithJsonSchema({"type": ["string", "object"], "additionalProperties": {"type": "string"}, "minProperties": 1}),
]


@final
class LawSection(Section):
    """Control law: a graph that contains the controller, and the searched parameters."""

    graph: Graphs = Field(
        description="name of a packaged graph, or path of a graph file relative to the race; or several, each by the "
        "longest sampling period for which it is taken"
    )
    set: dict[str, Any] = Field({}, description="values that differ from the graph, in the form of --set")
    tune: Annotated[dict[str, Range], BeforeValidator(_named)] = Field(
        min_length=1, description="searched parameters with bounds"
    )
    delay: Names = Field((), description="parameters that are given the transport delay of the cell, in samples")
    rate: Names = Field((), description="parameters that are given the rate at which the path repeats, if it does")
    seed: Names = Field((), description="parameters that are given the seed of the run, such as that of an excitation")

    def graph_at(self, clock: float) -> str:
        """Graph for a sampling period: the first whose largest period is not below it, else the last."""
        return next((name for most, name in sorted(self.graph.items()) if clock <= most), self.graph[max(self.graph)])


@final
class PlantSection(BaseModel):
    """Blocks of a plant by name, and wires."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, dict[str, Any]]

    wires: dict[str, str] = Field({}, description="input: output, where the names differ, with this plant alone")
    transport_delay: Annotated[float, Field(strict=True, ge=0)] = Field(
        0.0, description="transport delay of this plant in samples, in addition to that of the reality"
    )

    @property
    def blocks(self) -> dict[str, dict[str, Any]]:
        """Block by name."""
        return dict(self.__pydantic_extra__ or {})


@final
class PathSection(BaseModel):
    """Source block of a path, with its parameters."""

    model_config = ConfigDict(frozen=True, extra="allow")

    type: str = Field(description="type of the source")
    repeats: Speed | None = Field(None, description="angular frequency with which the path repeats")

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the source, by name."""
        return dict(self.__pydantic_extra__ or {})


@final
class TrainingSection(Section):
    """Training cells, on which the laws are tuned; other plants and paths are held out."""

    plants: Names = Field(min_length=1, description="names of plants")
    paths: Names = Field(min_length=1, description="names of paths")
    realities: Names = Field(min_length=1, description="names of realities")


@final
class MarginsSection(Section):
    """Margins: perturbations under which a candidate must not diverge on the training cells."""

    gain: Annotated[float, Field(strict=True, gt=0)] = Field(1.3, description="factor of its command")
    delay: Annotated[int, Field(strict=True, ge=0)] = Field(1, description="further samples of transport delay")


@final
class QuickSection(Section):
    """Subset of the race for ``--quick``."""

    clocks: Clocks | None = Field(None, description="some of the sampling periods")
    plants: Names = Field((), description="names of plants, those of training included or not")
    paths: Names = Field((), description="names of paths, those of training included or not")
    realities: Names = Field((), description="names of realities")
    laws: Names = Field((), description="names of laws, the entrant among them")
    budget: Candidates | None = Field(None, description="candidates of each law at each clock")


@final
class RaceFile(Section):
    """Keys of a race file."""

    version: Annotated[Literal[1], BeforeValidator(checked_version)] = Field(
        alias=VERSION, description="version of this format"
    )
    title: str = Field("", description="description in one line")
    robot: Annotated[RobotSection, BeforeValidator(robot_name)] = Field(description="as in a graph")
    start: dict[str, Any] = Field({}, description="as in a graph; near selects a branch of the inverse kinematics")
    duration: Seconds = Field(description="simulated time of each run; the error is that of its last eighth")
    error: Literal["tool", "joints"] = Field(
        "tool", description="whose error is compared: of the tool's position in mm, or of the joints in mrad"
    )
    limit: Distance = Field(0.1, description="a run with a larger error, 0.1 m or 0.1 rad, counts as diverged")
    seed: Annotated[int, BeforeValidator(_next_seed)] = Field(
        0, description="of random numbers in training; held-out cells use the next one"
    )
    entrant: str = Field(description="the law that is compared with the best of the others")
    plants: Annotated[dict[str, PlantSection], BeforeValidator(_named)] = Field(
        min_length=1, description="blocks of the plant, and optionally wires, by name of the plant"
    )
    clocks: Clocks = Field(description="sampling periods of the controllers")
    paths: Annotated[dict[str, PathSection], BeforeValidator(_named)] = Field(
        min_length=1, description="the source of the path, and optionally the rate at which it repeats, by name"
    )
    realities: Named = Field(description="channel models between controller and robot, as a graph's key reality")
    laws: Annotated[dict[str, LawSection], BeforeValidator(_named)] = Field(
        min_length=1, description="the laws by name"
    )
    training: TrainingSection
    budget: Candidates = Field(12, description="candidates of each law at each clock")
    margins: MarginsSection = MarginsSection()
    quick: QuickSection = QuickSection()

    @property
    def base_unit(self) -> str:
        """Unit of the path: m or rad."""
        return {"tool": "m", "joints": "rad"}[self.error]

    @property
    def unit(self) -> str:
        """Unit of errors: mm or mrad."""
        return f"m{self.base_unit}"


KEYS: Final = tuple(field.alias or name for name, field in RaceFile.model_fields.items())
_SECTIONS: Final[Mapping[str, type[BaseModel]]] = {
    "robot": RobotSection,
    "training": TrainingSection,
    "margins": MarginsSection,
    "quick": QuickSection,
}


def race_schema() -> dict[str, Any]:
    """JSON Schema of race files, for editors."""
    schema = RaceFile.model_json_schema(by_alias=True)
    schema["properties"]["robot"] = {"anyOf": [{"type": "string"}, schema["properties"]["robot"]]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "dmframe race"}


def keys_at(path: Path) -> Sequence[str]:
    """Allowed keys of a section of a race file."""
    if not path:
        return KEYS
    if path[0] == "laws":
        return list((LawSection if len(path) == 2 else RangeSection).model_fields)
    return list(_SECTIONS[str(path[0])].model_fields) if path[0] in _SECTIONS else []


def raise_placed(faults: Sequence[DmframeError], document: Document) -> None:
    """Raise faults with their places in the race file."""
    if faults:
        raise placed(faults[0] if len(faults) == 1 else Faults(faults), document, KEYS)
