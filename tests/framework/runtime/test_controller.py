"""One step of a controller is the simulation's own."""

from __future__ import annotations

import tracemalloc
from functools import cache
from typing import Any

import numpy as np
import pytest

import dmframe as dm
from dmframe.build import compiler as compilers
from dmframe.catalogue import graphs
from dmframe.common.errors import EngineError, ValueFault
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.runtime import Controller
from dmframe.simulate import Recording, simulate

SAMPLED = [name for name in graphs() if name.startswith(("ur10_fast", "arm2", "observed", "torque", "panda"))]


@cache
def loaded(name: str) -> tuple[Graph, Diagram]:
    graph = Graph.read(name)
    return graph, graph.diagram


@cache
def measured(name: str, clock: float) -> Recording:
    """A short run, for both engines."""
    graph, diagram = loaded(name)
    return simulate(diagram, 40 * clock, clock=clock, start=graph.start, engine="interpreted")


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("name", SAMPLED)
def test_fed_with_what_was_measured_it_commands_what_was_commanded(name: str, engine: Any) -> None:
    graph, diagram = loaded(name)
    clock = graph.file.clock or 0.004
    run = measured(name, clock)
    controller = Controller(diagram, clock, start=graph.start, engine=engine)
    assert controller.engine == engine
    assert controller.commanded
    for k, t in enumerate(run.time[:-1]):
        for label, values in ((label, x) for label, x in controller.states.items() if label in run.states):
            np.testing.assert_allclose(values, run[label][k], rtol=1e-9, atol=1e-12)
        for label, values in controller.measured.items():
            values[:] = run[label][k]
        controller.step(t)
        for label, values in controller.commanded.items():
            np.testing.assert_allclose(values, run[label][k], rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_step_allocates_nothing(engine: Any) -> None:
    graph, diagram = loaded("arm2_joint")
    controller = Controller(diagram, 0.002, start=graph.start, engine=engine)
    controller.step(0.0)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(2000):
            controller.step(0.0)
        assert tracemalloc.get_traced_memory()[0] - before < 2000
    finally:
        tracemalloc.stop()


def test_reset_puts_it_back_to_the_start() -> None:
    graph, diagram = loaded("arm2_joint")
    controller = Controller(diagram, 0.002, start=graph.start)
    first = {label: values.copy() for label, values in controller.states.items()}
    for values in controller.measured.values():
        values[:] = 0.1
    controller.step(0.0)
    assert any(np.any(values != first[label]) for label, values in controller.states.items())
    controller.reset()
    for label, values in controller.states.items():
        np.testing.assert_array_equal(values, first[label])


def test_without_a_compiler_it_is_interpreted_unless_compiled_was_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, diagram = loaded("arm2_joint")
    monkeypatch.setattr(compilers, "NAMES", ())
    monkeypatch.setattr(compilers.importlib.util, "find_spec", lambda name: None)
    monkeypatch.delenv("CC", raising=False)
    assert Controller(diagram, 0.002, start=graph.start).engine == "interpreted"
    with pytest.raises(
        EngineError, match="engine: expected a C compiler for the compiled engine, found none that works"
    ):
        Controller(diagram, 0.002, start=graph.start, engine="compiled")


def test_wrong_calls_are_reported() -> None:
    graph, diagram = loaded("arm2_joint")
    with pytest.raises(ValueFault, match="clock: expected a positive number of seconds, found 0"):
        Controller(diagram, 0, start=graph.start)
    with pytest.raises(ValueFault, match="engine: expected auto, compiled, interpreted, found 'fast'"):
        Controller(diagram, 0.002, start=graph.start, engine="fast")  # type: ignore[arg-type]


@cache
def tuned(engine: Any) -> Controller:
    return dm.load("ur10_fast_tuned").controller(engine=engine)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308])
def test_a_sample_that_is_not_finite_is_refused_without_effect(engine: Any, bad: float) -> None:
    controller = tuned(engine)
    good = {label: np.full_like(array, 0.1) for label, array in controller.measured.items()}
    for label, value in good.items():
        controller.measured[label][:] = value
    assert controller.step(0.0) is True
    states = {label: array.copy() for label, array in controller.states.items()}
    commands = {label: array.copy() for label, array in controller.commanded.items()}
    controller.measured["arm.dq"][1] = bad
    assert controller.step(0.008) is False
    assert controller.refused == 1
    for held, before in ((controller.states, states), (controller.commanded, commands)):
        for label, array in held.items():
            assert np.array_equal(array, before[label])
    controller.measured["arm.dq"][:] = good["arm.dq"]
    assert controller.step(0.016) is True
    assert controller.step(np.nan) is False
    controller.reset()
    assert controller.refused == 0
