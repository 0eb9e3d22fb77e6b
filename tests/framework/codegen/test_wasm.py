"""Closed loops as WebAssembly: compared with CasADi, the interpreter, and C without fused operations, bit by bit."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Real, Scalar
from dmframe.block.port import PERIOD, Access, Input, Output, Side, State
from dmframe.catalogue import graphs
from dmframe.codegen import function as c
from dmframe.codegen import loop_module, loop_source, wasm
from dmframe.codegen.source import shipped
from dmframe.codegen.wasm import HOST, written
from dmframe.codegen.wasm_arithmetic import ARITHMETIC
from dmframe.codegen.wasm_binary import I32, Function, Whole, module, number, signed, unsigned, whole
from dmframe.common.errors import EngineError
from dmframe.diagram import Diagram
from dmframe.graph.graph import Graph
from dmframe.program import OPERATIONS
from dmframe.simulate import Log, Solver
from dmframe.simulate.engine import Compiled, Interpreted
from dmframe.simulate.march import march
from dmframe.simulate.run import Prepared, prepare
from dmframe.simulate.start import start_state
from dmframe.simulate.step import Step

pytest.importorskip("wasmtime", reason="wasmtime is not installed")

from in_wasm import Loaded

GCC: Final = shutil.which("gcc")
needs_gcc = pytest.mark.skipif(GCC is None, reason="needs gcc")


class InWasm:
    """An engine."""

    elastic = True

    def __init__(self, step: Step, kept: np.ndarray, every: int) -> None:
        self.step, self.kept, self.every = step, kept, every
        self.loaded = Loaded(loop_module(step.parts))

    def advance(self, state: np.ndarray, p: np.ndarray, first: int, ticks: int, rows: np.ndarray) -> int:
        period, substeps, kept = self.step.period, self.step.substeps, self.kept.astype(np.int32)
        kept = np.append(kept, np.zeros(kept.size % 2, np.int32))  # the following data begin at a multiple of 8
        given = self.step.instants.rows(first, max(1, ticks))
        numbers = (state, np.array(p, float), period, substeps, first, ticks, given, self.every, kept, self.kept.size)
        return int(self.loaded("run", *numbers, rows, self.step.bounds))


def compiled(source: str, folder: Path) -> Any:
    """C without fused multiply-add; with -march=native gcc 12's vectoriser still fuses some products."""
    (folder / "f.c").write_text(source, encoding="utf-8")
    flags = ("-std=gnu11", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-w")
    subprocess.run([str(GCC), *flags, "f.c", "-o", "f.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "f.so"))


def in_c(step: Step, kept: np.ndarray, every: int, folder: Path) -> Compiled:
    library = compiled(loop_source(step.parts), folder)
    library.dm_run.restype = ctypes.c_int64
    return Compiled(step, kept, every, library.dm_run)


CODES: Final = [code for code in sorted(OPERATIONS) if code != ca.OP_ERFINV]
POINTS: Final = ((0.375, 0.75), (-0.375, 0.75), (1.75, -2.25), (2.5, 2.5), (0.0, 0.625), (0.625, 0.0), (-3.0, -0.5))


def function(code: int) -> Any:
    """One operation of two inputs; the second is read in any case."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    if code == ca.OP_CONSTPOW:
        return ca.Function("f", [x, y], [x**2.5])
    value = ca.SX.unary(code, x) if OPERATIONS[code].arity == 1 else ca.SX.binary(code, x, y)
    return ca.Function("f", [x, y], [value])


def whole_table() -> Any:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    return ca.Function("f", [x, y], [ca.vertcat(*(function(code)(x, y) for code in CODES))])


def alone(body: Function) -> Loaded:
    return Loaded(module({**ARITHMETIC, "f": body}, ("f",), HOST, 0))


def at_points(points: Any) -> np.ndarray:
    """A column for each point."""
    loaded, columns = alone(written(whole_table())), []
    for x, y in points:
        columns.append(np.full(len(CODES), 7.0))
        loaded("f", np.array([x]), np.array([y]), columns[-1])
    return np.array(columns).T


def by_casadi(points: Any) -> np.ndarray:
    return np.array([whole_table()(x, y).full()[:, 0] for x, y in points]).T


def test_each_rule_gives_what_casadi_gives() -> None:
    assert sorted(wasm.RULES) == CODES
    np.testing.assert_allclose(at_points(POINTS), by_casadi(POINTS), rtol=4e-16, atol=0)


def another(code: int) -> int:
    """The next operation with as many operands; not a power, of which there are two equal ones."""
    alike = [k for k in CODES if OPERATIONS[k].arity == OPERATIONS[code].arity and k != ca.OP_CONSTPOW]
    return next((k for k in alike if k > code), alike[0])


def test_wrong_rules_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wasm, "RULES", {code: wasm.RULES[another(code)] for code in CODES})
    same = np.isclose(at_points(POINTS), by_casadi(POINTS), rtol=1e-13, atol=0, equal_nan=True).all(axis=1)
    assert [OPERATIONS[code].name for code, alike in zip(CODES, same, strict=True) if alike] == []


def test_an_operation_without_a_rule_is_refused() -> None:
    with pytest.raises(EngineError, match=f"f has CasADi's instruction {ca.OP_ERFINV}, which cannot be translated"):
        written(function(ca.OP_ERFINV))


def edges() -> list[tuple[float, float]]:
    rng = np.random.default_rng(0)
    many = rng.normal(size=(300, 2)) * 10 ** rng.uniform(-9, 9, (300, 2))
    special = [0.0, -0.0, 1.0, -1.0, 1e5, 99999.9, 5e-324, 1.7e308, math.inf, -math.inf, math.nan, math.pi, 19.99, 20.1]
    return [*map(tuple, many), *((x, y) for x in special for y in special)]


@needs_gcc
def test_each_rule_gives_the_very_bits_of_c_that_fuses_nothing(tmp_path: Path) -> None:
    source = f"{shipped('arithmetic.h')}{c.written(whole_table())}\n"
    library = compiled(source + "void all(const double *x, const double *y, double *r) { dm_f(x, y, r); }", tmp_path)
    expected, points = list[np.ndarray](), edges()
    for pair in points:
        given, result = [np.array([value]) for value in pair], np.zeros(len(CODES))
        library.all(*(ctypes.c_void_p(array.ctypes.data) for array in (*given, result)))
        expected.append(result)
    found = at_points(points)
    np.testing.assert_array_equal(found, np.array(expected).T)
    zero = found == 0
    np.testing.assert_array_equal(np.signbit(found[zero]), np.signbit(np.array(expected).T[zero]))


def test_no_number_loses_a_bit() -> None:
    values = [0.1, -0.0, 5e-324, math.nextafter(1, 2), 1.7976931348623157e308, math.inf, -math.inf, math.nan]
    body = Function([I32])
    for k, value in enumerate(values):
        body.store(Whole((0,)), 8 * k, number(value))
    found = np.zeros(len(values))
    alone(body)("f", found)
    assert found.tobytes() == np.array(values).tobytes()


def test_whole_numbers_are_encoded_as_in_the_standard() -> None:
    assert (unsigned(624485), signed(-123456)) == (bytes.fromhex("e58e26"), bytes.fromhex("c0bb78"))
    for value in (0, 1, 63, 64, 127, 128, 8191, 8192, 2**31 - 1, -1, -64, -65, -(2**31)):
        body = Function([], [I32])
        body.write(whole(value))
        assert alone(body)("f") == value


def test_sines_and_cosines_of_one_angle_are_one_call_and_locals_are_used_again() -> None:
    x = at = ca.SX.sym("x")
    for _ in range(40):
        at = ca.sin(at) * ca.cos(at) + ca.cos(at)
    f = ca.Function("f", [x], [at, ca.cos(x + 1) + ca.sin(x * x + x)])
    body, found = written(f), [np.zeros(1), np.zeros(1)]
    assert len([piece for piece in body._pieces if piece == "sincos"]) == 42
    assert len(body._kinds) < 10
    alone(body)("f", np.array([0.7]), *found)
    np.testing.assert_allclose(found, [value.full()[0] for value in f(0.7)], rtol=1e-13)


def test_functions_that_browsers_refuse_are_refused_here() -> None:
    most, long = Function([I32]), Function([])
    for _ in range(50_000):
        most.keep(number(1))
    long.write(b"\x01" * 7_654_320)
    for body, text in (
        (most, "50001 locals, expected at most 50000"),
        (long, "7654322 bytes, expected at most 7654321"),
    ):
        with pytest.raises(EngineError, match=f"WebAssembly: f has {text} in one function"):
            alone(body)


def prepared_graph(name: str, duration: float) -> tuple[Prepared, Diagram, np.ndarray]:
    graph = Graph.read(name)
    diagram = graph.diagram
    prepared = prepare(diagram, duration, clock=graph.file.clock, solver=graph.solver, log=Log())
    return prepared, diagram, start_state(diagram, graph.start, prepared.starts)


def marched(engine: Any, prepared: Prepared, diagram: Diagram, state: np.ndarray) -> np.ndarray:
    p, ticks = diagram.loop.p_values, prepared.ticks
    rows, end, done = march(engine, prepared.step, prepared.keeping, state.copy(), p, ticks, None)
    assert (end.name, done) == ("DONE", prepared.ticks)
    return rows


def difference(one: np.ndarray, other: np.ndarray, prepared: Prepared) -> float:
    """The largest of all signals, relative to each one's size."""
    assert one.shape == other.shape
    parts = [part for _, part in prepared.keeping.columns]
    return max(np.max(np.abs(one - other)[:, part]) / (1e-6 + np.max(np.abs(other[:, part]))) for part in parts)


POWERS = ("ur10_slow_best", "ur10_fast_best")
"""Graphs with weights that are powers of losses."""


@pytest.mark.parametrize("name", graphs())
def test_every_packaged_graph_runs_as_interpreted_and_imports_nothing_else_from_the_host(name: str) -> None:
    prepared, *given = prepared_graph(name, 0.2)
    step, kept = prepared.step, prepared.keeping
    engine = InWasm(step, kept.kept, kept.every)
    rows = marched(engine, prepared, *given)
    assert len(rows) > 2
    interpreted = marched(Interpreted(step, kept.kept, kept.every), prepared, *given)
    assert difference(rows, interpreted, prepared) < 1e-10
    assert engine.loaded.imported <= {"sin", "cos"} | ({"exp", "log", "pow"} if name in POWERS else set())


@needs_gcc
@pytest.mark.parametrize("name", ["arm2_joint", "pendulum", "theorem_4", "ur10_fast"])
def test_a_graph_gives_the_very_bits_of_c_that_fuses_nothing(name: str, tmp_path: Path) -> None:
    prepared, *given = prepared_graph(name, 4.0)
    step, kept = prepared.step, prepared.keeping
    one = marched(InWasm(step, kept.kept, kept.every), prepared, *given)
    other = marched(in_c(step, kept.kept, kept.every, tmp_path), prepared, *given)
    assert np.all(np.isfinite(one))
    assert one.tobytes() == other.tobytes()


def test_a_module_is_small() -> None:
    prepared, *_ = prepared_graph("ur10_fast", 0.2)
    assert 5_000 < len(loop_module(prepared.step.parts)) < 25_000  # the boxes on all estimates take about 6500 of it


class Law(AbstractBlock):
    """v = -2 y_m - i, i+ = i + T y_m: in discrete time."""

    inputs = (Input("y_m"), PERIOD)
    outputs = (Output("v", access=Access.COMMANDED),)
    states = (State("i", sampled=True),)
    i: Scalar = Real(default=0.3)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"v": -2 * u.y_m - x.i}, next={"i": x.i + u.T * u.y_m})


class Cart(AbstractBlock):
    """dy = v - sin y exp y, dz = y - z/3; y is measured with noise."""

    side = Side.PLANT
    inputs = (Input("v"), Input("n", drawn="normal"), Input("r", drawn="uniform"))
    outputs = (Output("y_m", access=Access.MEASURED),)
    states = (State("y"), State("z"))
    y: Scalar = Real(default=1.0)
    z: Scalar = Real(default=0.5)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(
            outputs={"y_m": x.y + 0.1 * u.n + 0.2 * u.r},
            rates={"y": u.v - ca.sin(x.y) * ca.exp(x.y), "z": x.y - x.z / 3},
        )


@pytest.fixture
def cart() -> tuple[Prepared, Diagram, np.ndarray]:
    diagram = Diagram.build({"law": Law(), "cart": Cart()})
    prepared = prepare(diagram, 2.0, clock=0.05, solver=Solver(step=0.02), log=Log(), seed=3, jitter=0.02)
    return prepared, diagram, start_state(diagram, {}, {})


def test_a_sampled_state_drawn_inputs_and_jitter_run_as_interpreted(cart: Any) -> None:
    step, kept = cart[0].step, cart[0].keeping
    given = step.instants.rows(0, 40)
    assert given.shape[1] == 4
    assert np.ptp(given[:, 1]) > 0.01
    one, other = (marched(engine(step, kept.kept, 1), *cart) for engine in (InWasm, Interpreted))
    assert np.min(np.ptp(one, axis=0)) > 0.1
    assert difference(one, other, cart[0]) < 1e-13


# of samples: the first, their number
PORTIONS: Final = ((0, 40), (4, 7), (5, 1), (6, 0), (2**31 - 50, 9))


def portions(engine: Any, start: np.ndarray, p: np.ndarray) -> list[Any]:
    """For each portion of samples: how many were done, the resulting state, and the written rows."""
    found = list[Any]()
    for first, ticks in PORTIONS:
        state, rows = start.copy(), np.full((16, engine.kept.size), 7.0)
        found += [engine.advance(state, p, first, ticks, rows), state.tolist(), rows.tolist()]
    return found


BOUNDS: Final = {"wide": [9.0, 9.0, 9.0], "narrow": [9.0, 9.0, 0.6], "none": [9.0, 9.0, 0.0]}


@needs_gcc
@pytest.mark.parametrize("bounds", BOUNDS)
def test_bounds_portions_every_and_kept_are_those_of_loop_c(cart: Any, bounds: str, tmp_path: Path) -> None:
    prepared, diagram, start = cart
    step = replace(prepared.step, bounds=np.array(BOUNDS[bounds]))
    kept = np.array([3, 1, 1, 4, 0])
    found = portions(InWasm(step, kept, 3), start, diagram.loop.p_values)
    assert found == portions(in_c(step, kept, 3, tmp_path), start, diagram.loop.p_values)
    assert [found[k] for k in (0, 9)] == {"wide": [40, 0], "narrow": [5, 0], "none": [0, 0]}[bounds]


def test_a_state_that_is_not_a_number_has_left_its_bounds(cart: Any) -> None:
    prepared, diagram, start = cart
    engine = InWasm(prepared.step, prepared.keeping.kept, 1)
    start[2], rows = math.nan, np.zeros((4, engine.kept.size))
    assert engine.advance(start, diagram.loop.p_values, 0, 3, rows) == 0


@needs_gcc
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("_integrate", lambda right: lambda at, size: right(at, size - 1)),
        ("_integrate", lambda right: lambda at, size: right({**at, "k3": at["k2"]}, size)),
        ("_record", lambda right: lambda at, size: right(at, size + 1)),
        ("_within_bounds", lambda right: lambda size: right(size - 1)),
        ("_slope", lambda right: lambda at, moved: right({**at, "u": at["z"]}, moved)),
        ("_run", lambda right: lambda at, sizes: right(at, {**sizes, "N": 1})),
        ("_run", lambda right: lambda at, sizes: right({**at, "T": at["u"]}, sizes)),
    ],
)
def test_a_fault_in_the_loop_is_caught(
    cart: Any, name: str, fault: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared, diagram, start = cart
    step, kept = replace(prepared.step, bounds=np.array([9.0, 9.0, 0.6])), np.array([3, 1, 1, 4, 0])
    expected = portions(in_c(step, kept, 3, tmp_path), start, diagram.loop.p_values)
    assert portions(InWasm(step, kept, 3), start, diagram.loop.p_values) == expected
    monkeypatch.setattr(wasm, name, fault(getattr(wasm, name)))
    assert portions(InWasm(step, kept, 3), start, diagram.loop.p_values) != expected
