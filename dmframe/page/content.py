"""Data of a live page: loop parameters, WebAssembly module, sliders, curves, verdict."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from dmframe.certify import Verdict
from dmframe.certify.checked import Checked
from dmframe.codegen.wasm import loop_module
from dmframe.common.errors import ValueFault
from dmframe.common.names import unicode_name
from dmframe.common.text import Text, text_of
from dmframe.common.version import version
from dmframe.config import BaseGraph
from dmframe.config.resolved import resolved_text, robot_source
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.page.buttons import buttons_of
from dmframe.page.functions import Functions, Group, Place, functions_of, place_of
from dmframe.page.origin import origin_of
from dmframe.page.periods import Periods
from dmframe.page.rivals import Rival, check_rival, rivals_of, shared_parameters
from dmframe.page.scene import meshes_of
from dmframe.page.sliders import sliders_of
from dmframe.report.command import command
from dmframe.report.verdict_text import verdict_text
from dmframe.results.dataset import axis_labels, elements
from dmframe.simulate.bounds import bounds_of
from dmframe.simulate.solver import MOST_SUBSTEPS, PLAIN_STEP, RK4_STABLE
from dmframe.simulate.start import start_state

HORIZON = 20.0
"""Maximum simulated time of a page [s]."""


def content_of(
    graph: BaseGraph, verdict: Verdict, periods: Periods | None = None, rivals: Sequence[Rival] | None = None
) -> dict[str, Any]:
    """Collect the data of a page, with the compressed WebAssembly module in base64.

    Parameters
    ----------
    periods
        Largest stable sampling periods near the set-point; None if not computed.
    rivals
        Controllers simulated next to the graph's own; None for those of the graph.

    Raises
    ------
    EngineError
        If a loop contains an operation that WebAssembly code cannot compute.
    ValueFault
        If a loop uses random numbers, or a rival has other joints or another error.
    """
    diagram = graph.diagram
    check_chance(graph)
    rivals = rivals_of(graph) if rivals is None else rivals
    file = graph.file
    functions = functions_of(diagram, file.clock, graph.start, verdict, graph.intervals(diagram))
    state = start_state(diagram, graph.start)
    horizon = min(HORIZON, file.duration)
    return {
        "dmframe": version(),
        "name": graph.name,
        "field_hash": diagram.fingerprint,
        "command": command(graph, "run")._asdict(),
        "title": file.title,
        "text": resolved_text(graph),
        "periods": None if periods is None else periods.data,
        "fingerprint": diagram.fingerprint,
        "origin": origin_of(graph),
        **_loop(graph, functions, state),
        "starts": {"rows": list(functions.starts[0]), "reads": list(functions.starts[1])},
        "operations": functions.operations,
        "sliders": [slider.data for slider in sliders_of(diagram, verdict, functions.heeded)],
        "enlarge": file.page.enlarge,
        "rivals": [_rival(graph, rival) for rival in rivals],
        "buttons": buttons_of(graph, diagram, verdict, horizon),
        "groups": [_group(diagram, group, verdict) for group in functions.groups],
        "axes": "".join(axis_labels(diagram)) if diagram.robot is not None else "",
        "robot": _robot(graph, functions, state),
        "verdict": _verdict(graph.name, verdict, functions),
    }


def _loop(graph: BaseGraph, functions: Functions, state: np.ndarray) -> dict[str, Any]:
    """What the solver of a page reads of a loop."""
    diagram, file = graph.diagram, graph.file
    loop = diagram.loop
    return {
        "module": _packed(loop_module(functions.parts, functions.exported)),
        "clock": file.clock,
        "tick": file.clock if file.clock is not None else graph.solver.output,
        "step": graph.solver.step,
        "horizon": min(HORIZON, file.duration),
        "solver": {"plain": PLAIN_STEP, "takes": graph.solver.takes, "stable": RK4_STABLE, "most": MOST_SUBSTEPS},
        "sizes": _sizes(functions),
        "p": _numbers(loop.p_values),
        "state": _numbers(state),
        "bounds": _numbers(bounds_of(diagram)),
        "states": [
            {"label": v.label, "name": _signal(v.label), "size": v.symbol.numel(), "unit": v.unit}
            for v in loop.variables
        ],
        "flowing": stack(v.symbol for v in loop.flowing).numel(),
        "pose": _pose(diagram, functions),
        "goal": None if functions.goal is None else _group(diagram, functions.goal),
    }


def _rival(graph: BaseGraph, rival: Rival) -> dict[str, Any]:
    """A rival's loop, which is not judged, and the parameters that it shares with the graph."""
    check_rival(graph, rival)
    check_chance(rival.graph)
    other = rival.graph
    functions = functions_of(other.diagram, other.clock, other.start, Verdict("not_applicable", Text()))
    (error,) = (group for group in functions.groups if group.kind == "error")
    return {
        "name": other.name,
        "title": rival.title,
        "ghost": rival.ghost,
        "note": rival.note,
        "shared": shared_parameters(graph, other),
        "error": _group(other.diagram, error),
        "loop": _loop(other, functions, start_state(other.diagram, other.start)),
    }


def check_chance(graph: BaseGraph) -> None:
    """Raise `ValueFault` for a loop with random numbers; call it before any computation."""
    loop = graph.diagram.loop
    if loop.drawn.numel() or graph.file.jitter:
        why = f"random {loop.noises[0].label}" if loop.noises else "jitter"
        raise ValueFault(f"page: expected a deterministic loop, found {why}; set it to zero first")


def _packed(module: bytes) -> str:
    """Compress for DecompressionStream("deflate") of a browser."""
    return base64.b64encode(zlib.compress(module, 9)).decode()


def _sizes(functions: Functions) -> dict[str, int]:
    return {
        **functions.parts.sizes,
        "pose": functions.begin.numel_in(0),
        "shown": functions.shown.numel_out(0),
        "judged": functions.judged.numel_out(0),
        "reach": 0 if functions.reach is None else functions.reach.numel_out(0),
        "stored": 0 if functions.stored is None else functions.stored.numel_out(0),
        "scene": functions.scene,
    }


def _pose(diagram: Diagram, functions: Functions) -> dict[str, Any] | None:
    """Position of the pose in the state, joint names and limits; `sought`: solve for a pose on the path."""
    if functions.posed is None:
        return None
    joints = diagram.robot.joints if diagram.robot is not None else ()
    return {
        "at": place_of(diagram.loop, functions.posed),
        "size": functions.posed.symbol.numel(),
        "names": [joint.name.removesuffix("_joint").replace("_", " ") for joint in joints],
        "units": ["m" if joint.kind == "prismatic" else "rad" for joint in joints],
        "lower": [_finite(joint.lower) for joint in joints],
        "upper": [_finite(joint.upper) for joint in joints],
        "sought": functions.reach is not None,
    }


def _finite(number: float) -> float | None:
    return number if np.isfinite(number) else None


def _numbers(values: np.ndarray) -> list[float | str]:
    """Numbers for JSON; non-finite ones as strings that JavaScript's ``Number`` parses."""
    words = {np.inf: "Infinity", -np.inf: "-Infinity"}
    return [value if np.isfinite(value) else words.get(value, "NaN") for value in values.tolist()]


def _group(diagram: Diagram, group: Group, verdict: Verdict | None = None) -> dict[str, Any]:
    names = _rows(diagram, group)
    if group.kind == "storage" and verdict is not None and verdict.flow_claim is not None:
        claim = verdict.flow_claim
        names = [
            f"{law.vector.unicode} ({part.block})" for part in claim.parts for law in claim.laws[part.block].storage
        ]
    return {
        "kind": group.kind,
        "label": group.label,
        "name": _signal(group.label),
        "of": group.of,
        "at": group.first,
        "size": group.size,
        "unit": group.unit,
        "names": names,
        "true": group.true,
    }


def _signal(label: str) -> str:
    return unicode_name(label.rpartition(".")[2]) if label else ""


def _rows(diagram: Diagram, group: Group) -> list[str]:
    """Names of the rows: joints, axes, parameters."""
    shapes = {variable.label: variable.shape for variable in diagram.loop.variables}
    shapes |= {signal.label: signal.shape for signal in diagram.loop.outputs}
    letter = shapes.get(group.label, "")
    return [element.name for element in elements(diagram, letter, group.size)] if letter else []


def _robot(graph: BaseGraph, functions: Functions, state: np.ndarray) -> dict[str, Any] | None:
    chain = graph.robot
    if chain is None or not functions.scene or functions.posed is None:
        return None
    section = graph.file.robot
    source = robot_source(graph)
    hold = {**(source.hold if source else {}), **(section.hold or {} if section is not None else {})}
    return {
        "name": chain.name,
        "joints": chain.n,
        "reach": float(np.abs(_places(graph.diagram, functions, state)).max()),
        "prismatic": [joint.kind == "prismatic" for joint in chain.joints],
        "meshes": meshes_of(chain, source.urdf if source else None, hold),
    }


def _places(diagram: Diagram, functions: Functions, state: np.ndarray) -> np.ndarray:
    """Origins of joints and tool at a state [m], a column each."""
    found = functions.shown(ca.DM(state), 0, 1, diagram.loop.p_values).full().ravel()[: functions.scene]
    joints = found[:-3].reshape(-1, 12)[:, 9:]
    return np.vstack([joints, found[-3:]]).T


def _verdict(name: str, verdict: Verdict, functions: Functions) -> dict[str, Any]:
    return {
        "outcome": verdict.outcome,
        "headline": verdict.headline,
        "sampled": verdict.samples is not None,
        "reason": verdict.reason.unicode,
        "text": verdict_text(name, verdict, times=False),  # the same graph gives the same page
        "conclusions": [f"{item.signal.unicode} {item.says}" for item in verdict.statements if item.concludes]
        if verdict.outcome == "proved"
        else [],
        "assumptions": [text_of(item.text).unicode for item in verdict.assumptions],
        "kappa": functions.kappa,
        "uncertain": list(verdict.uncertain),
        "bounded": verdict.states is not None and not verdict.states.open and not verdict.bounds,
        "conditions": [
            {**_condition(condition, place, reads), "opens": condition.sufficient}
            for condition, place, reads in zip(functions.conditions, functions.margins, functions.reads, strict=False)
        ],
        "tacit": [
            {**_condition(item.checked, place, reads), "opens": item.opens}
            for (item, place), reads in zip(functions.tacit, functions.reads[len(functions.conditions) :], strict=True)
        ],
    }


def _condition(condition: Checked, place: Place | None, reads: tuple[int, ...] | None) -> dict[str, Any]:
    """Condition at the parameter values of the file, position of its margins, or the values it depends on."""
    return {
        "name": condition.name.unicode,
        "how": condition.how,
        "strict": condition.strict,
        "value": None if condition.value is None else _finite(condition.value),
        "holds": condition.holds,
        "at": None if place is None else place[0],
        "size": None if place is None else place[1],
        "reads": None if reads is None else list(reads),
    }
