"""Grammar of a study file: its keys and their values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal, TypeAlias, final

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema, model_validator

from dmframe.common.errors import DmframeError, Faults
from dmframe.config.document import Document, Kind
from dmframe.config.grammar import Path, Section, seed_of, shown
from dmframe.config.grammar import version as checked_version
from dmframe.config.places import placed

STUDY: Final = Kind("study", "dmframe-study: 1")
VERSION: Final = "dmframe-study"
MOST_RUNS: Final = 10**9
"""Largest number of samples, trials and saved runs."""

_QUANTITY: Final = {"type": ["number", "string"]}
_PAIR: Final = {"type": "array", "items": _QUANTITY, "minItems": 2, "maxItems": 2}
_BOUNDS: Final = {
    "type": "array",
    "items": {"anyOf": [_QUANTITY, {"type": "array", "items": _QUANTITY, "minItems": 1}]},
    "minItems": 2,
    "maxItems": 2,
}


def _quantity(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number, or a text with a unit, found {shown(value)}")
    return value


def _pair(value: Any) -> Any:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"expected two numbers, for example [0.8, 1.25], found {shown(value)}")
    return tuple(_quantity(item) for item in value)


def _bounds(value: Any) -> Any:
    """Two numbers, or two lists of numbers, one for each element."""
    if not isinstance(value, list) or len(value) != 2 or not any(isinstance(item, list) for item in value):
        return _pair(value)
    if not all(isinstance(item, list) for item in value) or len(value[0]) != len(value[1]) or not value[0]:
        raise ValueError(f"expected two lists of one length, for example [[1, 2], [3, 4]], found {shown(value)}")
    return tuple(tuple(map(_quantity, item)) for item in value)


def _factors(value: Any) -> Any:
    """Two numbers are the bounds of a uniform distribution."""
    return {"uniform": value} if isinstance(value, list) else value


def _labels(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


def _maps(value: Any) -> Any:
    """One pair of names, or several."""
    return [value] if isinstance(value, list) and all(isinstance(item, str) for item in value) else value


Quantity: TypeAlias = Annotated[float | str, BeforeValidator(_quantity), WithJsonSchema(_QUANTITY)]
Pair: TypeAlias = Annotated[tuple[float | str, float | str], BeforeValidator(_pair), WithJsonSchema(_PAIR)]
Bounds: TypeAlias = Annotated[
    tuple[float | str | tuple[float | str, ...], float | str | tuple[float | str, ...]],
    BeforeValidator(_bounds),
    WithJsonSchema(_BOUNDS),
]
Labels: TypeAlias = Annotated[
    tuple[str, ...],
    BeforeValidator(_labels),
    WithJsonSchema({"type": ["string", "array"], "items": {"type": "string"}}),
]
"""A name, or a list of names."""

KINDS: Final = ("uniform", "log", "normal")
_DRAWN: Final = {
    "type": "object",
    "properties": {**dict.fromkeys((*KINDS, "clip"), _PAIR), "uniform": _BOUNDS},
    "additionalProperties": False,
    "minProperties": 1,
}


class Distribution(Section):
    """Distribution of a number; one of three kinds."""

    uniform: Bounds | None = Field(
        None, description="uniform between two bounds; with per: element, each may be a list with one for each element"
    )
    log: Pair | None = Field(None, description="log-uniform between two bounds above zero")
    normal: Pair | None = Field(None, description="mean and standard deviation")
    clip: Pair | None = Field(None, description="truncates the normal distribution to these bounds")

    @model_validator(mode="after")
    def _one_kind(self) -> Distribution:
        if len(self.kinds) != 1:
            found = " and ".join(self.kinds) or "none"
            raise ValueError(f"expected one of {', '.join(self.choices())}, found {found}")
        if self.clip is not None and self.kinds != ["normal"]:
            raise ValueError(f"clip goes with normal, found it with {self.kinds[0]}, which has bounds already")
        return self

    @classmethod
    def choices(cls) -> tuple[str, ...]:
        """Keys of which exactly one is required."""
        return KINDS

    @property
    def kinds(self) -> list[str]:
        """Kinds that are given."""
        return [kind for kind in self.choices() if getattr(self, kind) is not None]


Factors: TypeAlias = Annotated[
    Distribution | None,
    BeforeValidator(_factors),
    WithJsonSchema({"anyOf": [_BOUNDS, _DRAWN]}),
]
"""A distribution of factors or differences, or the two bounds of a uniform one."""


@final
class Variation(Distribution):
    """Variation of a parameter: its value, or a factor of the graph's own value or a difference from it."""

    scale: Factors = Field(None, description="a factor of the graph's own value")
    shift: Factors = Field(None, description="a difference from the graph's own value")
    of: Labels = Field((), description="the parameters that vary together, by one draw, under a name of your choice")
    per: Literal["joint", "element"] | None = Field(
        None, description="a draw for each joint, or for each element; by default, one for all"
    )

    @classmethod
    def choices(cls) -> tuple[str, ...]:
        """Keys of which exactly one is required."""
        return (*KINDS, "scale", "shift")


def counted(most: int) -> BeforeValidator:
    """Accepts whole numbers from 1 to a largest one."""

    def count(value: Any) -> Any:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(f"expected a whole number, found {shown(value)}")
        if not 1 <= value <= most:
            raise ValueError(f"expected a number from 1 to {most}, found {value}")
        return value

    return BeforeValidator(count)


Count: TypeAlias = Annotated[int, counted(MOST_RUNS)]


class _Open(BaseModel):
    """A section with variations of parameters in addition to its own keys."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, Variation]

    @property
    def variations(self) -> dict[str, Variation]:
        """By ``block.parameter``, or a name of the user's choice."""
        return dict(self.__pydantic_extra__ or {})


@final
class SampleSection(_Open):
    """Section ``sample``: what is drawn at random, and how often."""

    runs: Count = Field(1, description="how many samples; each is run at every point of the grid")
    method: Literal["random", "latin_hypercube", "sobol"] = Field(
        "random",
        description="random: independent; sobol: evenly spread, extensible; latin_hypercube: even, of fixed size",
    )
    seed: Annotated[int, BeforeValidator(seed_of)] = Field(0, description="seed of all random numbers")


@final
class MeasureSection(Section):
    """Section ``measure``: what is measured in each run, in addition to the tracking error."""

    signals: Labels = Field((), description="block.signal whose extremes and RMS are kept")
    limits: dict[str, Quantity] = Field(
        {}, description="absolute values whose first crossing is recorded, {error: 10 mm, servo.u: 100 V}"
    )


def _fraction(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise ValueError(f"expected a number between 0 and 1, found {shown(value)}")
    return float(value)


@final
class ReportSection(Section):
    """Section ``report``: what the report shows."""

    probability: Labels = Field(
        ("diverged",), description="events whose probability is estimated: diverged, or a figure beyond a limit"
    )
    quantiles: tuple[Annotated[float, BeforeValidator(_fraction)], ...] = Field(
        (0.5, 0.95, 0.99), description="probabilities of the quantiles, between 0 and 1"
    )
    worst: dict[str, Count] = Field({"rms_final": 3}, description="how many of the worst runs by a figure are saved")
    map: Annotated[tuple[tuple[str, str], ...], BeforeValidator(_maps)] = Field(
        (), description="pairs of varied quantities over which figures are drawn"
    )


@final
class TuneSection(_Open):
    """Section ``tune``: what is searched, with which objectives and constraints."""

    minimise: Labels = Field(description="objectives over the sampled family, such as worst rms_final")
    subject_to: Labels = Field(("conditions",), description="conditions, stable period, or an inequality of a figure")
    trials: Count = Field(100, description="how many sets of values are tried")
    seed: Annotated[int, BeforeValidator(seed_of)] = Field(0, description="decides which are tried")
    fresh: Count | None = Field(None, description="how many plants the result is checked on; as many as runs")
    screen: Annotated[float, BeforeValidator(_fraction)] | None = Field(
        0.25, description="fraction of the plants that runs first; the rest is skipped for candidates that cannot win"
    )


@final
class StudyFile(Section):
    """The keys of a study file."""

    version: Annotated[Literal[1], BeforeValidator(checked_version)] = Field(
        alias=VERSION, description="version of this format"
    )
    title: str = Field("", description="description in one line")
    graph: str = Field(description="name of a packaged graph, or path of a graph file relative to the study")
    set: dict[str, Any] = Field({}, description="values that the whole study changes, in the form of --set")
    sample: SampleSection = SampleSection()
    grid: dict[str, Any] = Field({}, description="values whose combinations are run: lists by key, or named cases")
    measure: MeasureSection = MeasureSection()
    report: ReportSection = ReportSection()
    tune: TuneSection | None = None


KEYS: Final = tuple(field.alias or name for name, field in StudyFile.model_fields.items())
"""Keys of a study file."""


def keys_at(path: Path) -> Sequence[str]:
    """Keys that a section of a study file may have."""
    sections: dict[Path, type[BaseModel]] = {
        ("sample",): SampleSection,
        ("measure",): MeasureSection,
        ("report",): ReportSection,
        ("tune",): TuneSection,
    }
    if not path:
        return KEYS
    if path in sections:
        return list(sections[path].model_fields)
    within = path[0] in ("sample", "tune")
    if len(path) == 2 and within:
        return list(Variation.model_fields)
    return list(Distribution.model_fields) if len(path) == 3 and within else []


def is_user_name(key: str) -> bool:
    """True for a name other than ``block.parameter``."""
    return "." not in key


def raise_placed(faults: Sequence[DmframeError], document: Document) -> None:
    """Raise the faults, if there are any, at their places in the study's file."""
    if faults:
        raise placed(faults[0] if len(faults) == 1 else Faults(faults), document, KEYS)


def study_schema() -> dict[str, Any]:
    """The JSON Schema of study files, for an editor."""
    schema = StudyFile.model_json_schema(by_alias=True)
    values = {"type": "array", "minItems": 1}
    scaled = {
        "type": "object",
        "properties": {"scale": values, "of": {"type": ["string", "array"]}},
        "required": ["scale"],
        "additionalProperties": False,
    }
    named = {"type": "object", "additionalProperties": {"type": "object"}}
    schema["properties"]["grid"]["additionalProperties"] = {"anyOf": [values, scaled, named]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "dmframe study"}
