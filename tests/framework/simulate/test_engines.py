"""Compiled and interpreted engines give the same numbers up to rounding, for all graphs."""

from __future__ import annotations

import ctypes
import re
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy
from structures import structures

import dmframe.codegen.function
from dmframe.build import load
from dmframe.build.library import address
from dmframe.codegen import loop_source
from dmframe.codegen.function import written
from dmframe.codegen.source import shipped
from dmframe.common.errors import DmframeError, EngineError, UnknownNameError, ValueFault
from dmframe.diagram.parts import Parts
from dmframe.graph.graph import Graph
from dmframe.results.metrics import tracking_error
from dmframe.simulate import Log, Recording, Solver, simulate, step
from dmframe.simulate.run import prepare


def ran(name: str, engine: Any, duration: float, **options: Any) -> Recording:
    graph = Graph.read(name)
    return simulate(
        graph.diagram,
        duration,
        clock=graph.file.clock,
        solver=graph.solver,
        start=graph.start,
        engine=engine,
        **options,
    )


def difference(one: Recording, other: Recording) -> float:
    """The largest over all signals, relative to each signal's size."""
    worst = 0.0
    for kind in ("states", "outputs"):
        first, second = getattr(one, kind), getattr(other, kind)
        assert first.keys() == second.keys()
        for label, values in first.items():
            assert values.shape == second[label].shape
            worst = max(
                worst, np.max(np.abs(values - second[label]), initial=0) / (1e-6 + np.max(np.abs(values), initial=0))
            )
    return worst


@pytest.mark.parametrize("name", structures())
def test_every_packaged_graph_runs_alike_on_both_engines(name: str) -> None:
    compiled, interpreted = (ran(name, engine, 0.4) for engine in ("compiled", "interpreted"))
    assert (compiled.engine, interpreted.engine) == ("compiled", "interpreted")
    np.testing.assert_array_equal(compiled.time, interpreted.time)
    assert difference(compiled, interpreted) < 1e-9
    assert [rank.time for rank in compiled.ranks] == [rank.time for rank in interpreted.ranks]


def test_auto_compiles_a_long_run_and_interprets_a_short_one() -> None:
    assert ran("arm2_joint", "auto", 0.1).engine == "interpreted"
    assert ran("arm2_joint", "auto", 200).engine == "compiled"


def test_an_adaptive_solver_is_interpreted_and_gives_a_notice_where_compiled_was_requested() -> None:
    graph = Graph.read("pendulum")
    diagram, solver = graph.diagram, Solver("cvodes", tolerance=1e-6)
    requested, chosen = (
        simulate(diagram, 0.1, solver=solver, start=graph.start, engine=e) for e in ("compiled", "auto")
    )
    assert (requested.engine, chosen.engine) == ("interpreted", "interpreted")
    assert any("cvodes runs interpreted" in notice for notice in requested.notices)
    assert not any("interpreted" in notice for notice in chosen.notices)


def test_an_unknown_engine_is_refused() -> None:
    with pytest.raises(ValueFault, match="engine: expected auto, compiled, interpreted, found 'fast'"):
        ran("pendulum", "fast", 0.1)


def test_a_second_run_of_a_diagram_builds_no_functions_and_one_without_a_clock_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, build = list[str](), step._evaluated
    monkeypatch.setattr(step, "_evaluated", lambda name, *given: made.append(name) or build(name, *given))
    diagram = Graph.read("pendulum").diagram

    def run(clock: float | None, *signals: str) -> Recording:
        return simulate(diagram, 0.1, clock=clock, engine="compiled", log=Log(signals=signals))

    first, again = run(0.002, "arm.ddq"), run(0.002, "arm.ddq")
    assert made.count("outputs") == 1
    np.testing.assert_array_equal(first["arm.ddq"], again["arm.ddq"])
    assert "arm.ddq" not in run(0.002, "inverse.dq_c").outputs
    assert made.count("outputs") == 1
    run(None, "arm.ddq")
    assert made.count("outputs") == 2


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_what_is_kept_is_every_kth_row_of_the_whole(engine: Any) -> None:
    whole = ran("arm2_joint", engine, 3.0)
    some = ran("arm2_joint", engine, 3.0, log=Log(every=0.1, signals=("inverse.dq_c",)))
    every = 50  # of 2 ms
    np.testing.assert_array_equal(some.time, whole.time[::every])
    np.testing.assert_array_equal(some["inverse.dq_c"], whole["inverse.dq_c"][::every])
    assert set(some.outputs) | set(some.states) == {"inverse.dq_c", "path.q_d", "arm.q"}


def test_the_error_by_eighths_hardly_changes_with_what_is_kept() -> None:
    whole, some = (tracking_error(ran("arm2_joint", "compiled", 40.0, log=Log(every))) for every in (None, 0.05))
    assert whole is not None
    assert some is not None
    assert len(some.norm) == 801
    # the first contains a transient of a few recorded instants
    np.testing.assert_allclose(some.rms_by_eighth[1:], whole.rms_by_eighth[1:], rtol=0.01)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_divergence_between_kept_instants_is_found_at_its_tick(engine: Any) -> None:
    graph = Graph.read("arm2_joint", ["inverse.w_box=null", "dynamics.Gamma=1e9"])
    diagram = graph.diagram
    runs = [
        simulate(diagram, 50, clock=graph.file.clock, start=graph.start, engine=engine, log=Log(every))
        for every in (None, 1.0)
    ]
    assert runs[0].divergence is not None
    assert runs[0].divergence == runs[1].divergence
    assert np.all(np.isfinite(runs[1]["arm.q"]))
    assert runs[1].time[-1] <= runs[1].divergence.time < runs[1].time[-1] + 1.01


def test_an_hour_at_8_ms_keeps_at_most_160_megabytes() -> None:
    graph = Graph.read("ur10_fast")
    prepared = prepare(graph.diagram, 3600, clock=0.008, solver=Solver(), log=Log())
    assert prepared.ticks == 450_000
    numbers = prepared.keeping.rows(prepared.ticks) * prepared.keeping.kept.size
    assert numbers * 8 < 165e6
    assert prepared.keeping.notices == (
        "a long run: one of 3 instants is recorded, every 0.024 s; set log.every to change it",
    )


@pytest.mark.parametrize(
    ("log", "kind", "text"),
    [
        ({"every": -1.0}, ValueFault, "log.every: expected a positive time, found -1.0"),
        ({"signals": ("arm.qq",)}, UnknownNameError, "log.signals: unknown signal; did you mean arm.q?"),
    ],
)
def test_an_impossible_log_is_refused(log: dict[str, Any], kind: type[DmframeError], text: str) -> None:
    with pytest.raises(kind, match=re.escape(text)):
        ran("arm2_joint", "interpreted", 0.1, log=Log(**log))


def test_more_than_memory_holds_is_refused_with_what_would_do() -> None:
    with pytest.raises(EngineError, match=r"log.every: .* is too long to keep, expected at most \d+ instants; take"):
        ran("arm2_joint", "interpreted", 1e7, log=Log(every=0.001))


def test_no_name_but_the_entry_is_seen_outside_and_all_begin_alike() -> None:
    graph = Graph.read("ur10_fast")
    source = loop_source(prepare(graph.diagram, 1, clock=0.008, solver=Solver(), log=Log()).step.parts)
    found = re.findall(r"^(static inline |static |DM_EXPORT )\w+ (\w+)\(", source, re.MULTILINE)
    assert {name for _, name in found} >= {"dm_run", "dm_rate", "dm_sample", "dm_tanh"}
    assert all(name.startswith("dm_") for _, name in found)
    assert [name for kind, name in found if kind == "DM_EXPORT "] == ["dm_run"]
    assert not re.findall(r"^(?!static|DM_EXPORT|typedef)\w+ [\w*]+\(", source, re.MULTILINE)


UNARY = (
    "sin cos tan asin acos atan sinh cosh tanh asinh atanh exp log sqrt log1p expm1 floor ceil fabs sign erf".split()
)
BINARY = "fmin fmax atan2 copysign fmod hypot power".split()


def tabulated(function: Any) -> np.ndarray:
    """An SX function of x and y at some points, by its C."""
    text = (
        written(function) + "\nDM_EXPORT void dm_table(const double *x, const double *y, double *r) { dm_f(x, y, r); }"
    )
    head = shipped("arithmetic.h") + '\n#define DM_EXPORT __attribute__((visibility("default")))\n'
    library = load(head + text).library
    assert isinstance(library, ctypes.CDLL)
    results = []
    for x, y in POINTS:
        at, result = (np.array([x]), np.array([y])), np.zeros(function.numel_out(0))
        library.dm_table(address(at[0]), address(at[1]), address(result))
        results.append(result)
    return np.array(results)


@pytest.mark.parametrize("piece", [1, 2, 7, 1000])
def test_a_long_function_in_pieces_gives_the_same_numbers(piece: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dmframe.codegen.function, "PIECE", piece)
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    first, values = x * y + 2, list[Any]()
    for k in range(20):
        first = ca.sin(first) * ca.cos(first) + y / (k + 1)
        values += [first, x, ca.SX(k), first - values[0] if values else first]
    function = ca.Function("f", [x, y], [ca.vertcat(*values)])
    assert written(function).count("noinline") == (0 if piece == 1000 else -(-function_lines(function) // piece))
    np.testing.assert_allclose(tabulated(function), [function(*point).full().ravel() for point in POINTS], rtol=1e-12)


def function_lines(function: Any) -> int:
    return len(dmframe.codegen.function._lines(function)[0])


def test_a_function_in_pieces_may_write_over_its_argument(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dmframe.codegen.function, "PIECE", 1)
    a = ca.SX.sym("a", 2)
    function = ca.Function("f", [a], [ca.vertcat(a[1] + 1, a[0] * 2 + a[1])])
    text = written(function) + "\nDM_EXPORT void dm_over(double *a) { dm_f(a, a); }"
    head = shipped("arithmetic.h") + '\n#define DM_EXPORT __attribute__((visibility("default")))\n'
    library = load(head + text).library
    assert isinstance(library, ctypes.CDLL)
    values = np.array([3.0, 5.0])
    library.dm_over(address(values))
    assert values.tolist() == [6, 11]


POINTS = [(0.3, 0.7), (-0.9, 0.2), (1e-9, -3.0), (0.99, 1e-3), (-0.5, -0.5)]


def test_every_operation_means_in_c_what_it_means_in_casadi() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    terms = [getattr(ca, name)(x) for name in UNARY] + [ca.acosh(1 + x * x)]
    terms += [getattr(ca, name)(x * x if name == "power" else x, y) for name in BINARY]
    terms += [x < y, x <= y, x == y, x != y, ca.logic_and(x, y), ca.logic_or(x, y), ca.logic_not(x - 0.3)]
    terms += [ca.if_else(x < y, x, 7), x / y, 1 / y, -x, x * x, 2 * x, x**3, x**2.5, x - -0.0, ca.SX(ca.inf) * y]
    function = ca.Function("f", [x, y], [ca.vertcat(*terms)])
    expected = np.array([function(*point).full().ravel() for point in POINTS])
    np.testing.assert_allclose(tabulated(function), expected, rtol=4e-16, atol=0, equal_nan=True)
    column = UNARY.index("erf")
    np.testing.assert_allclose(expected[:, column], scipy.special.erf([point[0] for point in POINTS]), rtol=1e-14)


def test_sine_cosine_and_tanh_are_right_to_rounding_everywhere() -> None:
    rng = np.random.default_rng(1)
    size = 4000
    near = np.pi / 2 * rng.integers(-1000, 1000, size) + rng.normal(size=size) * 1e-9
    sizes = np.concatenate([rng.uniform(-30, 30, size), near, 10 ** rng.uniform(-300, 6, size), [0.0, -0.0, 1e5, 1e22]])
    with np.errstate(all="ignore"):
        expected = np.concatenate([np.sin(sizes), np.cos(sizes), np.tanh(sizes)])
    np.testing.assert_allclose(of_table(sizes).ravel(), expected, rtol=5e-16, atol=1e-300)
    sine, cosine, tangent = of_table(np.array([np.nan, np.inf, -np.inf]))
    assert np.all(np.isnan([sine, cosine]))
    np.testing.assert_array_equal(tangent, [np.nan, 1, -1])


def of_table(values: np.ndarray) -> np.ndarray:
    """Rows of sines, cosines and hyperbolic tangents."""
    text = (
        '__attribute__((visibility("default"))) void dm_table(const double *x, long n, double *r) {\n'
        "  for (long i = 0; i < n; i++) { dm_sincos(x[i], r + i, r + n + i); r[2 * n + i] = dm_tanh(x[i]); }\n}\n"
    )
    library, result = load(shipped("arithmetic.h") + text).library, np.zeros((3, values.size))
    assert library is not None
    library.dm_table(address(values), ctypes.c_long(values.size), address(result))
    return result


def test_an_operation_without_a_word_in_c_leaves_the_interpreter() -> None:
    t, p, state = ca.SX.sym("t"), ca.SX.sym("p"), ca.SX.sym("x")
    none, period = ca.SX.sym("u", 0), ca.SX.sym("T")
    parts = Parts(
        trajectory=ca.Function("trajectory", [t, p], [t]),
        sample=ca.Function("sample", [state, t, none, period, p], [ca.SX(0, 1), ca.SX(0, 1)]),
        rate=ca.Function("rate", [state, none, t, p], [ca.erfinv(state)]),
        outputs=ca.Function("outputs", [state, t, none, period, p], [ca.SX(0, 1)]),
        clip=ca.Function("clip", [state, p], [state]),
    )
    with pytest.raises(EngineError, match=r"engine: rate has CasADi's instruction \d+, which cannot be translated"):
        loop_source(parts)
