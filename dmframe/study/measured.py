"""What a study measures of its closed loops: the table's columns, and what is asked of each loop."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from dmframe.batch import Wanted
from dmframe.batch.figures import ERROR, TURN
from dmframe.config.document import Document
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, UnknownNameError
from dmframe.results.metrics import TurnError, goal_of
from dmframe.simulate.keep import apart_of
from dmframe.study.table import Column, columns_of, wanted_of
from dmframe.units import to_unit

if TYPE_CHECKING:
    from dmframe.study.plan import Study


def measures_of(study: Study) -> tuple[Column, ...]:
    """See `Study.measures`."""
    section, known = study.file.measure, set[str]().union(*map(_units_of, study._diagrams))
    signals = known - {ERROR, TURN}
    faults = [_unknown("signals", label, signals) for label in section.signals if label not in signals]
    faults += [_unknown("limits", label, known) for label in section.limits if label not in known]
    raise_at([*faults, *(fault for each in study._diagrams for fault in _limits(study, each)[1])], study.document)
    found = dict[str, Column]()
    for diagram in study._diagrams:
        for column in columns_of(diagram, asked_of(study, diagram)):
            found.setdefault(column.name, column)
    return tuple(found.values())


def asked_of(study: Study, diagram: Diagram) -> Wanted:
    """What is measured of a loop: the asked signals that it has, limits in their units."""
    units, (limits, faults) = _units_of(diagram), _limits(study, diagram)
    raise_at(faults, study.document)
    signals = study.file.measure.signals
    return wanted_of([label for label in signals if label in units and label not in (ERROR, TURN)], limits)


def _limits(study: Study, diagram: Diagram) -> tuple[dict[str, float], list[DmframeError]]:
    """The limits of what a loop has, in its units; and the faults of those that do not fit."""
    units, faults, limits = _units_of(diagram), list[DmframeError](), dict[str, float]()
    for label, value in study.file.measure.limits.items():
        if label in units:
            try:
                limits[label] = to_unit(value, units[label])
            except DmframeError as error:
                text = f"measure.limits.{label}: {error.text}"
                faults.append(type(error)(text, path=("measure", "limits", label)))
    return limits, faults


def _units_of(diagram: Diagram) -> dict[str, str]:
    """Of all that can be measured of a loop."""
    loop = diagram.loop
    units = {signal.label: signal.unit for signal in loop.outputs}
    units |= {variable.label: variable.unit for variable in loop.variables}
    goal = goal_of(loop)
    units |= {} if goal is None else {ERROR: units[goal.actual]}
    return units if apart_of(loop) is None else units | {TURN: TurnError.unit}


def _unknown(section: str, label: str, known: Iterable[str]) -> DmframeError:
    return UnknownNameError(f"measure.{section}", "signal", label, known, path=("measure", section))


def raise_at(faults: Sequence[DmframeError], document: Document) -> None:
    """Raise faults at their places in the study's file, where there are any."""
    from dmframe.study.read import raise_placed

    raise_placed(faults, document)
