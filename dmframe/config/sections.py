"""Objects made from the sections of a graph file: blocks, robot, start."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dmframe.block import AbstractBlock, type_name
from dmframe.catalogue import find_block
from dmframe.common.errors import DmframeError, MissingError, UnknownNameError, ValueFault
from dmframe.common.units import joint_place, to_unit
from dmframe.config.document import Document
from dmframe.config.grammar import GraphFile, RobotSection, robot_name, shown
from dmframe.config.places import placed

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def kinds_of(section: Any, base: Path) -> dict[str, type[AbstractBlock]]:
    """The classes of a section's blocks, by name; one that cannot be found is reported where blocks are created."""
    found = dict[str, type[AbstractBlock]]()
    for name, spec in section.items() if isinstance(section, dict) else ():
        with suppress(DmframeError):
            found[name] = find_block(str(spec.get("type") if isinstance(spec, dict) else None), base, "type")
    return found


def check_replaced(key: str, section: Any, stated: Any, base: Path, faults: list[DmframeError]) -> None:
    """Check that the blocks of a section can be created, and that those it removes exist in ``blocks``, `stated`.

    `key` is the dotted place of the section: ``baseline``, or ``page.rivals.NAME.blocks``.
    """
    entries, blocks = (item if isinstance(item, dict) else {} for item in (section, stated))
    if entries:
        made = {name: spec for name, spec in entries.items() if spec is not None}
        blocks_of(key, made or None, base, faults)
    faults += [
        UnknownNameError(f"{key}.{name}", "block", name, blocks, path=(*key.split("."), name))
        for name, spec in entries.items()
        if spec is None and name not in blocks
    ]


def blocks_of(key: str, section: Any, base: Path, faults: list[DmframeError]) -> dict[str, AbstractBlock]:
    """The blocks of a section; `key` is its dotted place, such as ``blocks``."""
    made = dict[str, AbstractBlock]()
    for name, spec in section.items() if isinstance(section, dict) else ():
        where, path = f"{key}.{name}", (*key.split("."), name)
        if not NAME.fullmatch(name) or name == "robot":
            faults.append(ValueFault(f"{where}: expected a name of letters, digits and _, other than robot", path=path))
        elif isinstance(spec, dict) and "type" not in spec:
            faults.append(MissingError(f"{where}: expected a key type, for example {{type: circle, ...}}", path=path))
        elif isinstance(spec, dict) and not isinstance(spec["type"], str):
            found = shown(spec["type"])
            faults.append(
                ValueFault(f"{where}.type: expected the name of a block type, found {found}", path=(*path, "type"))
            )
        elif isinstance(spec, dict):
            try:
                made[name] = _block(path, spec, base)
            except DmframeError as error:
                for fault in error.faults:
                    faults.append(fault)
    if isinstance(section, dict) and not section:
        faults.append(MissingError(f"{key}: expected at least one block, found none", path=tuple(key.split("."))))
    return made


def _block(path: tuple[str, ...], spec: Mapping[str, Any], base: Path) -> AbstractBlock:
    where = ".".join(path)
    try:
        kind = find_block(spec["type"], base, f"{where}.type")
    except DmframeError as error:
        error.path = (*path, "type")
        raise
    values = {key: value for key, value in spec.items() if key != "type"}
    try:
        return kind(**values)
    except DmframeError as error:
        for fault in error.faults:
            fault.path = (*path, *fault.path)
            fault.text = where + fault.text.removeprefix(type_name(kind))
        raise


def robot_of(given: Any, base: Path, faults: list[DmframeError]) -> Any:
    """The robot's chain of joints; None without a section or for an invalid one, whose faults are added to `faults`."""
    if (value := robot_name(given)) is None:
        return None
    try:
        section = RobotSection.model_validate(value)
    except ValidationError:
        return None
    from dmframe.config.cached_robot import cached_robot

    try:
        return cached_robot(
            section.model,
            base,
            free=section.free,
            hold=section.hold,
            tool=section.tool,
            axes=section.axes,
            friction_velocity=section.friction_velocity,
        )
    except DmframeError as error:
        for fault in error.faults:
            fault.path = fault.path or ("robot", "model")
            faults.append(fault)
        return None


def tolerance_in(unit: str, file: GraphFile, document: Document) -> float | None:
    """The `tolerance` of a graph in the unit of its error, if it has one. Raises `DmframeError` for another unit."""
    if file.tolerance is None:
        return None
    try:
        return to_unit(file.tolerance, unit)
    except DmframeError as error:
        raise placed(ValueFault(f"tolerance: {error.text}", path=("tolerance",)), document) from None


def at_name(fault: DmframeError) -> DmframeError:
    """The fault, located at the robot's name if the graph gives the robot as a name only."""
    if fault.path == ("robot", "model"):
        fault.path = ("robot",)
    return fault


def start_of(section: Any, faults: list[DmframeError]) -> dict[str, Any]:
    """Start values as numbers; angles may have a unit."""
    values = dict[str, Any]()
    for key, value in section.items() if isinstance(section, dict) else ():
        try:
            values[key] = _start_numbers(value)
        except DmframeError as error:
            faults.append(ValueFault(f"start.{key}: {error.text}", path=("start", key)))
    return values


def _start_numbers(item: Any, depth: int = 0) -> Any:
    """A number, a list, or the rows of a matrix."""
    if isinstance(item, list) and depth < 2:
        return [_start_numbers(below, depth + 1) for below in item]
    if isinstance(item, str):
        return joint_place(item)
    if isinstance(item, bool) or not isinstance(item, int | float):
        raise ValueFault(f"expected numbers, found {shown(item)}")
    try:
        return float(item)
    except OverflowError:
        raise ValueFault("expected a finite number, found one of hundreds of digits") from None
