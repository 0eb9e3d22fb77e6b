"""Labelled arrays with units of a run: tables, xarray datasets and NetCDF files."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.block.faults import fault_context
from dmframe.common.files import encoded, printable
from dmframe.common.names import Element
from dmframe.common.units import sliding
from dmframe.common.version import version
from dmframe.config import BaseGraph
from dmframe.config.resolved import resolved_text
from dmframe.diagram import Diagram
from dmframe.simulate import Recording, Solver
from dmframe.simulate.solver import FIXED

if TYPE_CHECKING:
    import xarray

# with checksums, so that every HDF5 reader detects changed data
PACKED: Final = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
_DIMENSIONS = {"n": "joint", "m": "axis", "p": "parameter", "k": "kinematic_parameter"}


@final
@dataclass(frozen=True)
class Labelled:
    """Variable or coordinate: dimension names, values, attributes."""

    dimensions: tuple[str, ...]
    values: Any
    attributes: Mapping[str, str]


@final
@dataclass(frozen=True)
class Table:
    """Labelled arrays of a run, in the data model of xarray and NetCDF."""

    coordinates: Mapping[str, Labelled]
    variables: Mapping[str, Labelled]
    attributes: Mapping[str, Any]


def table(run: Recording, graph: BaseGraph | None = None) -> Table:
    """Every recorded state and output as a variable ``block.signal`` over time, with its unit.

    Dimensions are named joint, axis, parameter; any other size gets its own dimension.

    Parameters
    ----------
    graph
        The graph of the run; name, title, seed, SHA-256 of the resolved text and model hash (`Diagram.fingerprint`)
        become attributes.
    """
    entries, variables = dict[str, tuple[Element, ...]](), dict[str, Labelled]()
    for label, shape, unit, kind in _recorded(run):
        dimensions, values = _labelled(run.diagram, label, shape, run[label], entries)
        attributes = {"units": unit or "1", "long_name": f"{label.split('.', 1)[1]}, {kind} of {label.split('.')[0]}"}
        attributes |= _prismatic(run.diagram, dimensions, unit)
        if not unit and dimensions == ("parameter",):
            attributes["units"] = "see parameter_unit"
        variables[label] = Labelled(("time", *dimensions), values, attributes)
    for label, item in run.beside.items():
        dimensions, values = _labelled(run.diagram, label, item.shape, item.values, entries)
        variables[label] = Labelled(("time", *dimensions), values, {"units": item.unit or "1", "long_name": item.about})
    coordinates = {"time": Labelled(("time",), run.time, {"units": "s", "long_name": "time"})}
    for name, counted in entries.items():
        names = [element.name for element in counted]
        labels = [int(each) for each in names] if all(map(str.isdigit, names)) else names
        coordinates[name] = Labelled((name,), labels, {"long_name": name.split(".")[-1], "units": "1"})
    if "parameter" in entries:
        units = [element.unit for element in entries["parameter"]]
        coordinates["parameter_unit"] = Labelled(("parameter",), units, {"long_name": "unit", "units": "1"})
    return Table(coordinates, variables, _attributes(run, graph))


def _attributes(run: Recording, graph: BaseGraph | None) -> dict[str, Any]:
    attributes: dict[str, Any] = {
        "title": printable(graph.file.title or graph.name) if graph else "dmframe run",
        "graph": printable(graph.name) if graph else "",
        "clock": "continuous" if run.clock is None else f"{run.clock!r} s",
        "duration": f"{run.duration!r} s",
        "solver": _solver(run.solver, run.clock),
        "source": f"dmframe {version()}",
        "engine": run.engine,
    }
    if run.estimate is not None:
        share = f"compared in {run.estimate.share:.3g} of the run"
        attributes["integration_error"] = f"{run.estimate.error:.3g} {run.estimate.unit}, {share}"
    if run.drive:
        attributes["drive"] = json.dumps(dict(run.drive))
    if graph is not None:
        attributes["seed"] = graph.file.seed
        attributes["field_hash"] = run.diagram.fingerprint
        attributes["graph_sha256"] = hashlib.sha256(encoded(resolved_text(graph))).hexdigest()
    if run.divergence is not None:
        attributes["divergence"] = str(run.divergence)
    return attributes


def dataset(run: Recording, graph: BaseGraph | None = None) -> xarray.Dataset:
    """`table` as an xarray dataset."""
    import xarray

    source = table(run, graph)
    return xarray.Dataset(
        {name: (item.dimensions, item.values, dict(item.attributes)) for name, item in source.variables.items()},
        {name: (item.dimensions, item.values, dict(item.attributes)) for name, item in source.coordinates.items()},
        dict(source.attributes),
    )


def netcdf(run: Recording, graph: BaseGraph | None = None) -> bytes:
    """`table` as a compressed NetCDF file, without xarray, whose import takes half a second.

    Written in memory: on a full disk HDF5 prints tracebacks and can abort the process.
    """
    import h5netcdf
    import h5py

    source, file = table(run, graph), io.BytesIO()
    with h5netcdf.File(file, "w") as made:
        for item in (*source.variables.values(), *source.coordinates.values()):
            for name, size in zip(item.dimensions, np.shape(item.values), strict=True):
                if name not in made.dimensions:
                    made.dimensions[name] = size
        for name, item in (*source.coordinates.items(), *source.variables.items()):
            values = np.asarray(item.values)
            text = values.dtype.kind == "U"
            variable = made.create_variable(
                name,
                item.dimensions,
                h5py.string_dtype() if text else values.dtype,
                data=values.astype(object) if text else values,
                **({} if text else PACKED),
            )
            variable.attrs.update(item.attributes)
            if name not in source.coordinates:
                known = ((key, c.dimensions) for key, c in source.coordinates.items())
                auxiliary = [key for key, of in known if key not in of and set(of) <= set(item.dimensions)]
                if auxiliary:
                    variable.attrs["coordinates"] = " ".join(auxiliary)
        made.attrs.update(source.attributes)
    return file.getvalue()


def joint_labels(diagram: Diagram) -> tuple[str, ...]:
    """Joint names, or ``joint 1`` and so on without a robot."""
    if diagram.robot is not None:
        return tuple(diagram.robot.joint_names)
    return tuple(f"joint {i}" for i in range(1, diagram.sizes.bound.get("n", (0, ""))[0] + 1))


def axis_labels(diagram: Diagram) -> tuple[str, ...]:
    """Names of the task coordinates, such as x, y, z."""
    m = diagram.sizes.bound.get("m", (0, ""))[0]
    names = diagram.robot.axes if diagram.robot is not None else "xyz"
    return tuple(names) if len(names) == m else tuple(names[:m]) if m <= 3 else tuple(str(i + 1) for i in range(m))


def elements(diagram: Diagram, letter: str, size: int) -> tuple[Element, ...]:
    """Elements of the dimension `letter`: joints, axes, or those that a block declares; else numbers."""
    if letter in ("n", "m"):
        known = [Element(label) for label in (joint_labels if letter == "n" else axis_labels)(diagram)]
        return tuple(known) if len(known) == size else _numbered(size)
    for name, block in diagram.blocks.items():
        with fault_context(name, "elements()"):
            found = tuple(Element(each.name, each.unit) for each in block.elements(diagram.robot).get(letter, ()))
        if found and len(found) == size:
            return found
    return _numbered(size)


def _numbered(size: int) -> tuple[Element, ...]:
    return tuple(Element(str(i)) for i in range(1, size + 1))


def element_labels(diagram: Diagram, letter: str, size: int) -> tuple[str, ...]:
    """Names of `elements`."""
    return tuple(element.name for element in elements(diagram, letter, size))


def _recorded(run: Recording) -> list[tuple[str, str, str, str]]:
    """Label, shape, unit and kind of the recorded signals, in diagram order."""
    loop = run.diagram.loop
    states = [(v.label, v.shape, v.unit, "state") for v in loop.variables if v.label in run.states]
    outputs = [(s.label, s.shape, s.unit, "output") for s in loop.outputs if s.label in run.outputs]
    return states + outputs


def _labelled(
    diagram: Diagram, label: str, shape: str, rows: np.ndarray, entries: dict[str, tuple[Element, ...]]
) -> tuple[tuple[str, ...], np.ndarray]:
    words, sizes = shape.split(), diagram.sizes.of(shape)
    dimensions = list[str]()
    for word, size in zip(words, sizes, strict=True):
        name = _DIMENSIONS.get(word, f"{label}.{word}")
        name = f"{name}_{dimensions.count(name) + 1}" if name in dimensions else name  # NetCDF requires distinct names
        dimensions.append(name)
        entries[name] = elements(diagram, word, size)
    # column-major
    values = rows.reshape(len(rows), *reversed(sizes)).transpose(0, *range(len(sizes), 0, -1))
    return tuple(dimensions), values


def _prismatic(diagram: Diagram, dimensions: tuple[str, ...], unit: str) -> dict[str, str]:
    """Units joint by joint for a robot with prismatic joints: port units refer to revolute joints."""
    joints = () if diagram.robot is None else diagram.robot.joints
    if "joint" not in dimensions or all(joint.kind == "revolute" for joint in joints):
        return {}
    units = (f"{joint.name}: {sliding(unit) if joint.kind == 'prismatic' else unit}" for joint in joints)
    return {"units_per_joint": "; ".join(units)}


def _solver(solver: Solver, clock: float | None) -> str:
    how = f"step {solver.step!r} s" if solver.method in FIXED else f"tolerance {solver.tolerance!r}"
    return f"{solver.method}, {how}" + (f", output {solver.output!r} s" if clock is None else "")
