"""A run as labelled arrays with units."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from dmframe.config.experiment import Experiment
from dmframe.diagram import Diagram
from dmframe.files import encoded, printable
from dmframe.results.resolved import resolved_text
from dmframe.simulate import Recording, Solver
from dmframe.version import version

if TYPE_CHECKING:
    import xarray

PACKED: Final = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_DIMENSIONS = {"n": "joint", "m": "axis", "p": "parameter", "k": "kinematic_parameter"}


@final
@dataclass(frozen=True)
class Labelled:
    """A variable or a coordinate: the names of its dimensions, its values, and what is said of it."""

    dimensions: tuple[str, ...]
    values: Any
    attributes: Mapping[str, str]


@final
@dataclass(frozen=True)
class Table:
    """A run as labelled arrays with units, as xarray and NetCDF have it."""

    coordinates: Mapping[str, Labelled]
    variables: Mapping[str, Labelled]
    attributes: Mapping[str, Any]


def table(run: Recording, experiment: Experiment | None = None, seed: int | None = None) -> Table:
    """Every recorded state and output as a variable ``block.signal`` over time, with its unit.

    The dimensions are named: joint, axis, parameter; a size that is none of these has a dimension of its own.

    Parameters
    ----------
    experiment
        The graph that ran: its name, its title and the SHA-256 of its resolved text become attributes.
    seed
        Of the run's noise, where it has any.
    """
    entries, variables = dict[str, list[str] | list[int]](), dict[str, Labelled]()
    for label, shape, unit, kind in _recorded(run):
        dimensions, values = _labelled(run.diagram, label, shape, run[label], entries)
        said = {"units": unit or "1", "long_name": f"{label.split('.', 1)[1]}, {kind} of {label.split('.')[0]}"}
        said |= _prismatic(run.diagram, dimensions, unit)
        if not unit and dimensions == ("parameter",):
            said["units"] = "see parameter_unit"
        variables[label] = Labelled(("time", *dimensions), values, said)
    coordinates = {"time": Labelled(("time",), run.time, {"units": "s", "long_name": "time"})}
    for name, elements in entries.items():
        coordinates[name] = Labelled((name,), elements, {"long_name": name.split(".")[-1], "units": "1"})
    if "parameter" in entries:
        units = [_parameter_unit(str(name)) for name in entries["parameter"]]
        coordinates["parameter_unit"] = Labelled(("parameter",), units, {"long_name": "unit", "units": "1"})
    return Table(coordinates, variables, _attributes(run, experiment, seed))


def _attributes(run: Recording, experiment: Experiment | None, seed: int | None) -> dict[str, Any]:
    said: dict[str, Any] = {
        "title": printable(experiment.file.title or experiment.name) if experiment else "dmframe run",
        "graph": printable(experiment.name) if experiment else "",
        "clock": "continuous" if run.clock is None else f"{run.clock!r} s",
        "duration": f"{run.duration!r} s",
        "solver": _solver(run.solver, run.clock),
        "source": f"dmframe {version()}",
    }
    if experiment is not None:
        said["graph_sha256"] = hashlib.sha256(encoded(resolved_text(experiment))).hexdigest()
    if seed is not None:
        said["seed"] = seed
    if run.divergence is not None:
        said["divergence"] = str(run.divergence)
    return said


def dataset(run: Recording, experiment: Experiment | None = None, seed: int | None = None) -> xarray.Dataset:
    """`table` as an xarray dataset."""
    import xarray

    held = table(run, experiment, seed)
    return xarray.Dataset(
        {name: (item.dimensions, item.values, dict(item.attributes)) for name, item in held.variables.items()},
        {name: (item.dimensions, item.values, dict(item.attributes)) for name, item in held.coordinates.items()},
        dict(held.attributes),
    )


def netcdf(run: Recording, experiment: Experiment | None = None, seed: int | None = None) -> bytes:
    """`table` as a NetCDF file, compressed; without xarray, which takes half a second to import.

    In memory: on a full disk HDF5 itself prints tracebacks and can take the process down.
    """
    import h5netcdf
    import h5py

    held, file = table(run, experiment, seed), io.BytesIO()
    with h5netcdf.File(file, "w") as made:
        for item in (*held.variables.values(), *held.coordinates.values()):
            for name, size in zip(item.dimensions, np.shape(item.values), strict=True):
                if name not in made.dimensions:
                    made.dimensions[name] = size
        for name, item in (*held.coordinates.items(), *held.variables.items()):
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
            if name not in held.coordinates:
                own = [other for other, c in held.coordinates.items() if other not in c.dimensions]
                beside = [other for other in own if set(held.coordinates[other].dimensions) <= set(item.dimensions)]
                if beside:
                    variable.attrs["coordinates"] = " ".join(beside)
        made.attrs.update(held.attributes)
    return file.getvalue()


def joint_labels(diagram: Diagram) -> tuple[str, ...]:
    """The joints' names, or ``joint 1`` and so on in a diagram without a robot."""
    if diagram.robot is not None:
        return tuple(diagram.robot.joint_names)
    return tuple(f"joint {i}" for i in range(1, diagram.sizes.bound.get("n", (0, ""))[0] + 1))


def axis_labels(diagram: Diagram) -> tuple[str, ...]:
    """x, y, z: the robot's task coordinates, or the first m."""
    m = diagram.sizes.bound.get("m", (0, ""))[0]
    names = diagram.robot.axes if diagram.robot is not None else "xyz"
    return tuple(names) if len(names) == m else tuple(names[:m]) if m <= 3 else tuple(str(i + 1) for i in range(m))


def parameter_labels(diagram: Diagram) -> tuple[str, ...]:
    """m_1, mc_x1 and so on where the dynamic parameters are the robot's full set, else 1, 2, ..."""
    size = diagram.sizes.bound.get("p", (0, ""))[0]
    if diagram.robot is not None:
        from dmframe.regressor.full import parameter_names

        for block in diagram.blocks.values():
            if "p" in block.sizes(diagram.robot):
                names = parameter_names(diagram.robot.n, getattr(block, "friction", ()))
                if len(names) == size:
                    return names
    return tuple(str(i) for i in range(1, size + 1))


def translation_labels(diagram: Diagram) -> tuple[str, ...]:
    """``shoulder_pan_joint x`` and so on, of the kinematic parameters that are adapted: all, links or tool."""
    size = diagram.sizes.bound.get("h", (0, ""))[0]
    joints = joint_labels(diagram)
    places = {3 * len(joints) + 3: (*joints, "tool"), 3 * len(joints): joints, 3: ("tool",)}
    return tuple(f"{place} {axis}" for place in places.get(size, ()) for axis in "xyz")


def _parameter_unit(name: str) -> str:
    """Of a dynamic parameter by its name, in the full set; empty where it has no name."""
    kinds = {"m": "kg", "mc": "kg m", "I": "kg m^2", "B": "N m s/rad", "D": "N m"}
    return kinds.get(name.split("_")[0], "")


def element_labels(diagram: Diagram, letter: str, size: int) -> tuple[str, ...]:
    """Names for the elements of a dimension that a shape calls `letter`."""
    named = {"n": joint_labels, "m": axis_labels, "p": parameter_labels, "h": translation_labels}
    found = named[letter](diagram) if letter in named else ()
    return found if len(found) == size else tuple(str(i) for i in range(1, size + 1))


def _recorded(run: Recording) -> list[tuple[str, str, str, str]]:
    """Label, shape, unit and kind of all that was recorded, in the order of the diagram."""
    loop = run.diagram.loop
    states = [(v.label, v.shape, v.unit, "state") for v in loop.variables if v.label in run.states]
    outputs = [(s.label, s.shape, s.unit, "output") for s in loop.outputs if s.label in run.outputs]
    return states + outputs


def _labelled(
    diagram: Diagram, label: str, shape: str, rows: np.ndarray, coordinates: dict[str, Any]
) -> tuple[tuple[str, ...], np.ndarray]:
    words, sizes = shape.split(), diagram.sizes.of(shape)
    dimensions = list[str]()
    for word, size in zip(words, sizes, strict=True):
        name = _DIMENSIONS.get(word, f"{label}.{word}")
        name = f"{name}_{dimensions.count(name) + 1}" if name in dimensions else name  # netCDF wants them distinct
        dimensions.append(name)
        entries = element_labels(diagram, word, size)
        coordinates[name] = [int(entry) for entry in entries] if all(map(str.isdigit, entries)) else list(entries)
    # states are kept column by column
    values = rows.reshape(len(rows), *reversed(sizes)).transpose(0, *range(len(sizes), 0, -1))
    return tuple(dimensions), values


def _prismatic(diagram: Diagram, dimensions: tuple[str, ...], unit: str) -> dict[str, str]:
    """Units joint by joint where some joint slides: a port's unit is a revolute joint's."""
    joints = () if diagram.robot is None else diagram.robot.joints
    if "joint" not in dimensions or all(joint.kind == "revolute" for joint in joints):
        return {}
    units = (f"{joint.name}: {sliding(unit) if joint.kind == 'prismatic' else unit}" for joint in joints)
    return {"units_per_joint": "; ".join(units)}


def sliding(unit: str) -> str:
    """A revolute joint's unit as that of a prismatic one: read m for rad, and N for N m.

    >>> sliding("N m s/rad")
    'N s/m'
    """
    force = re.sub(r"\bN(\^\d)? m(\^\d)?(?![\w])", r"N\1", unit)
    return re.sub(r"\brad\b", "m", force)


def _solver(solver: Solver, clock: float | None) -> str:
    how = f"step {solver.step!r} s" if solver.method == "rk4" else f"tolerance {solver.tolerance!r}"
    return f"{solver.method}, {how}" + (f", output {solver.output!r} s" if clock is None else "")
