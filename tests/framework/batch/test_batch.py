"""SIMD batches: figures of many runs, compared with those of the same runs computed one by one."""

from __future__ import annotations

import ctypes
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import dmframe as dm
import dmframe.batch.batch
import dmframe.batch.simd
from dmframe.batch.batch import Batch
from dmframe.batch.figures import Measured, MeasuredSignals
from dmframe.batch.starts import starts_of
from dmframe.batch.values import columns_of, parameters_of, varied
from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.parameter import Real, Scalar, specs
from dmframe.block.port import TIME, Access, Output, Side, State
from dmframe.build.compiler import find_compiler
from dmframe.codegen import simd_source
from dmframe.codegen.function import ONE, SIMD, written
from dmframe.codegen.source import shipped
from dmframe.common.errors import NeedsDiagramError, UnknownNameError, ValueFault
from dmframe.diagram import Diagram
from dmframe.simulate.run import prepare
from dmframe.simulate.start import start_state

PARTS = ("rms_by_eighth", "least", "most", "last", "crossed")
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def batch(
    name: str | dm.Graph, until: float, engine: Any = "compiled", wanted: MeasuredSignals | None = None, **keys: Any
) -> Batch:
    graph = dm.load(name).set(**keys) if keys else dm.load(name)
    return Batch.of(graph.diagram, until, wanted=wanted, engine=engine, **graph.settings)


def spread(runs: int, **ranges: tuple[float, float]) -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    return {label.replace("__", "."): random.uniform(*ends, runs) for label, ends in ranges.items()}


def furthest(one: Measured, other: Measured) -> float:
    """The largest difference of any figure, relative to the largest figure of its kind."""
    assert one.signals.keys() == other.signals.keys()
    np.testing.assert_array_equal(one.diverged, other.diverged)
    worst = 0.0
    for label, figures in one.signals.items():
        for part in PARTS:
            mine, theirs = getattr(figures, part), getattr(other.signals[label], part)
            np.testing.assert_array_equal(np.isnan(mine), np.isnan(theirs))
            size = 1e-9 + np.max(np.abs(theirs), initial=0.0, where=np.isfinite(theirs))
            worst = max(worst, float(np.max(np.abs(mine - theirs), initial=0.0, where=np.isfinite(theirs)) / size))
    return worst


@needs_compiler
@pytest.mark.parametrize(
    ("name", "values", "signals"),
    [
        ("arm2_joint", {"servo__K_P": (20, 60), "dynamics__Gamma": (1, 100)}, ("servo.u", "dynamics.a_d_hat")),
        ("pendulum", {"dynamics__Gamma": (1, 20)}, ("arm.q",)),
        ("ur10_fast", {"servo__K_D": (500, 900), "arm__viscous": (1, 9)}, ("arm.x",)),
        ("observed_regulation_pid", {"servo__K_I": (300, 600)}, ("arm.dq",)),
    ],
)
def test_simd_batches_measure_what_whole_runs_measure(name: str, values: Any, signals: tuple[str, ...]) -> None:
    wanted = MeasuredSignals(signals, {"error": 1e-3, signals[0]: 1e-2})
    columns = spread(11, **values)  # more than one group, the last of them incomplete
    simd, whole = (batch(name, 0.5, engine, wanted).measure(columns) for engine in ("compiled", "interpreted"))
    assert simd.engine.startswith("SIMD batch of ")
    assert whole.engine == "interpreted"
    assert furthest(simd, whole) < 1e-9
    assert np.isfinite(simd.signals[signals[0]].crossed).any()
    assert simd.error is not None
    one = dm.load(name).set({label: column[3] for label, column in columns.items()}).run(0.5)
    assert one.error is not None
    np.testing.assert_allclose(simd.error.rms_by_eighth[3, 0], one.error.rms_by_eighth, rtol=1e-9)


@needs_compiler
def test_a_long_log_and_an_end_between_two_kept_instants_are_those_of_a_run() -> None:
    columns = spread(3, dynamics__Gamma=(1, 100))
    simd, whole = (
        batch("arm2_joint", 0.3, engine, MeasuredSignals(("arm.q",)), log={"every": "14 ms"}).measure(columns)
        for engine in ("compiled", "interpreted")
    )
    assert furthest(simd, whole) < 1e-9


@needs_compiler
def test_a_divergence_has_a_time_and_does_not_affect_other_runs() -> None:
    wild = np.array([1.0, 1e6, 2.0, 3.0, 1e6, 4.0, 5.0, 6.0, 7.0])
    tame = np.where(wild > 1e5, 1.0, wild)
    free = dm.load("arm2_joint").set({"dynamics.a_d_hat_box": None})  # its box bounds each estimate
    made = batch(free, 1.0, wanted=MeasuredSignals(("arm.q",)))
    found, calm = (made.measure({"dynamics.Gamma": column}) for column in (wild, tame))
    whole = batch(free, 1.0, "interpreted", MeasuredSignals(("arm.q",))).measure({"dynamics.Gamma": wild})
    np.testing.assert_array_equal(np.isfinite(found.diverged), wild > 1e5)
    np.testing.assert_allclose(found.diverged, whole.diverged, rtol=0.2)
    for part in PARTS:
        one, other = (getattr(measured.signals["arm.q"], part)[wild < 1e5] for measured in (found, calm))
        np.testing.assert_array_equal(one, other)
    assert found.error is not None
    assert np.isnan(found.error.rms_final[1, 0])
    assert np.isfinite(found.error.rms_by_eighth[1, 0, 0])


class Late(AbstractBlock):
    """dy = -speed tanh(t) y: stiffer later than at the start."""

    side = Side.PLANT
    inputs = (TIME,)
    outputs = (Output("y", "2", "", Access.MEASURED),)
    states = (State("y", "2"),)
    speed: Scalar = Real(default=1.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(outputs={"y": x.y}, rates={"y": -p.speed * ca.tanh(u.t) * x.y})


@needs_compiler
def test_what_the_integrator_alone_blew_up_is_done_again_at_shorter_steps() -> None:
    made = Batch.of(
        Diagram.build({"plant": Late()}),
        20.0,
        wanted=MeasuredSignals(("plant.y",)),
        clock=0.01,
        start={"y": [1.0, 1.0]},
        engine="compiled",
    )
    found = made.measure({"plant.speed": [4e3, 4.0, -4.0]})
    assert found.engine.startswith("SIMD batch of ")
    np.testing.assert_array_equal(np.isfinite(found.diverged), [False, False, True])
    assert "the integrator diverged at longer steps in 1 of 3 runs" in found.notices
    # of log cosh t the last squares dominate: y = exp(-speed log cosh t)
    np.testing.assert_allclose(found.signals["plant.y"].last[1], np.exp(-4 * np.log(np.cosh(20.0))), rtol=1e-3)


@needs_compiler
def test_a_stiff_run_goes_into_a_simd_batch_by_the_linearly_implicit_method() -> None:
    gains = np.array([[8e5, 800, 400], [800, 800, 400], [9e5, 800, 400]])
    wanted = MeasuredSignals(("arm.q",))
    found, whole = (
        batch("ur10_fast", 0.2, engine, wanted).measure({"servo.K_D": gains}) for engine in ("compiled", "interpreted")
    )
    assert any("ros34pw2" in notice for notice in found.notices)
    assert furthest(found, whole) < 1e-9


UNLIKE = {"servo.K_D": np.array([80, 8000, 800, 2400, 4000, 6000, 500, 1000, 3000, 90, 5000.0])}
"""Servos that need from one step of rk4 per millisecond to seven."""


@needs_compiler
def test_runs_of_unlike_stiffness_fill_the_batches_each_with_the_steps_that_it_takes_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    groups, start = list[list[int]](), dmframe.batch.simd.SimdLoop.start

    def noted(loop: Any, states: Any, p: Any, substeps: Any) -> Any:
        groups.append(list(substeps))
        return start(loop, states, p, substeps)

    made, whole = (
        batch("ur10_fast", 0.2, engine, MeasuredSignals(("arm.q",))) for engine in ("compiled", "interpreted")
    )
    made.measure({"servo.K_D": UNLIKE["servo.K_D"][:1]})  # so that the library's own trial is finished
    monkeypatch.setattr(dmframe.batch.simd.SimdLoop, "start", noted)
    found = made.measure(UNLIKE)
    monkeypatch.undo()
    runs, width = UNLIKE["servo.K_D"], int(found.engine.removeprefix("SIMD batch of "))
    steps = [step for group in groups for step in group]
    assert len(groups) == -(-runs.size // width), "an element was left empty"
    assert steps == sorted(steps, reverse=True)
    assert len(set(steps)) > 4
    assert furthest(found, whole.measure(UNLIKE)) < 1e-9
    for k in (0, 1, 4):
        one = made.measure({"servo.K_D": runs[k : k + 1]})
        for part in PARTS:
            mine, alone = (getattr(each.signals["arm.q"], part) for each in (found, one))
            np.testing.assert_array_equal(mine[k], alone[0])

    def wrong(loop: Any, states: Any, p: Any, substeps: Any) -> Any:
        return start(loop, states, p, np.full_like(substeps, min(steps)))

    monkeypatch.setattr(dmframe.batch.simd.SimdLoop, "start", wrong)
    spoilt = made.measure(UNLIKE).signals["arm.q"].last
    missed = ~(np.abs(spoilt - found.signals["arm.q"].last) < 1e-9).all(axis=1)
    assert missed[runs > 2000].all(), "steps of another run would pass unseen"


@needs_compiler
def test_blocks_of_runs_and_threads_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    columns = spread(21, servo__K_D=(600, 900))
    whole = batch("ur10_fast", 0.2).measure(columns)
    monkeypatch.setattr(dmframe.batch.batch, "BLOCK", 10)
    monkeypatch.setattr("dmframe.batch.groups.TICKS", 7)
    assert furthest(batch("ur10_fast", 0.2).measure(columns), whole) == 0.0


def test_a_run_with_values_that_are_not_allowed_has_a_fault_of_its_own() -> None:
    found = batch("pendulum", 0.1, "auto").measure({"dynamics.Gamma": [1.0, -1.0, np.nan, 2.0]})
    assert {run: str(fault) for run, fault in found.faults.items()} == {
        1: "dynamics.Gamma: expected a number > 0, found -1.0",
        2: "dynamics.Gamma: expected a plain number, found nan: the number must be finite",
    }
    assert found.error is not None
    assert np.isnan(found.error.last[1, 0])
    assert np.isfinite(found.error.last[3, 0])


@needs_compiler
@pytest.mark.parametrize(
    ("values", "faulty", "text"),
    [
        ({"dynamics.Gamma": [-1.0, 1.0, 2.0]}, [0], "expected a number > 0, found -1.0"),
        ({"inverse.w_I_box": [[3.0, 4.0], [0.5, 20.0], [1.9, 2.1]]}, [0], "expected a start inside w_I_box, 3 to 4"),
    ],
)
def test_the_first_runs_fault_is_not_that_of_others_who_start_where_it_would(
    values: Any, faulty: list[int], text: str
) -> None:
    found = batch("arm2_joint", 0.1).measure(values)
    assert list(found.faults) == faulty
    assert text in str(found.faults[0])
    assert found.error is not None
    assert np.isfinite(found.error.last[1:]).all()


@pytest.mark.parametrize(
    ("values", "wanted", "kind", "text"),
    [
        ({"dynamics.Gama": [1]}, MeasuredSignals(), UnknownNameError, "did you mean dynamics.Gamma?"),
        (
            {"dynamics.Gamma": 1},
            MeasuredSignals(),
            ValueFault,
            "values.dynamics.Gamma: expected a row per run, found one number",
        ),
        ({"dynamics.Gamma": ["a"]}, MeasuredSignals(), ValueFault, "expected an array of numbers with a row per run"),
        ({"dynamics.Gamma": [1], "servo.K_D": [1, 2]}, MeasuredSignals(), ValueFault, "dynamics.Gamma 1, servo.K_D 2"),
        ({"dynamics.Gamma": [1]}, MeasuredSignals(("arm.qq",)), UnknownNameError, "signals: unknown signal"),
        (
            {"dynamics.Gamma": [1]},
            MeasuredSignals((), {"arm.q": 1.0}),
            UnknownNameError,
            "limits: unknown measured signal",
        ),
    ],
)
@pytest.mark.parametrize("engine", ["interpreted", "compiled"])
def test_values_that_are_wrong_for_all_runs_are_refused(
    values: Any, wanted: MeasuredSignals, kind: Any, text: str, engine: Any
) -> None:
    with pytest.raises(kind) as caught:
        batch("pendulum", 0.1, engine, wanted).measure(values)
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "name", ["arm2_joint", "ur10_full", "pendulum", "observed_regulation_pid", "torque_direct_pid"]
)
def test_the_numbers_and_starts_of_many_runs_are_those_of_each(name: str) -> None:
    """Values of every parameter that is a number."""
    graph = dm.load(name)
    diagram = graph.diagram
    settings = {key: value for key, value in graph.settings.items() if key != "start"}
    prepared = prepare(diagram, 0.1, **settings)
    instants, start = prepared.step.instants, graph.start
    seen = 0
    for block, model in diagram.models.items():
        for key in specs(type(model.block)):
            if key not in model.values or model.values[key].ndim > 1:
                continue
            base = model.values[key]
            columns = columns_of({f"{block}.{key}": np.stack([base, base * 0.99 + 1e-6])})
            try:
                p, faults = parameters_of(diagram, columns, 2)
            except NeedsDiagramError:
                continue
            for run in range(2):
                if run in faults:
                    continue
                one = varied(diagram, columns, run)
                np.testing.assert_array_equal(p[:, run], one.loop.p_values)
                if not seen % 5 and not faults:
                    of_run = partial(varied, diagram, columns)
                    states, wrong = starts_of(diagram, columns, of_run, p, start, instants, {})
                    if run in wrong:
                        with pytest.raises(type(wrong[run])):
                            start_state(one, start, {}, instants)
                        continue
                    np.testing.assert_allclose(states[:, run], start_state(one, start, {}, instants), atol=1e-9)
            seen += 1
    assert seen > 2


_X = ca.SX.sym("x")
_Y = ca.SX.sym("y")
_OPERATIONS = [
    ca.sin(_X), ca.cos(_X), ca.tanh(_X), ca.sign(_X), ca.fabs(_X), ca.fmin(_X, _Y), ca.fmax(_X, _Y), ca.exp(_X),
    ca.sqrt(_X), ca.log(_X), ca.atan2(_X, _Y), _X**2.5, ca.if_else(_X < _Y, _X, _Y), ca.if_else(_X <= _Y, 1, _Y),
    ca.logic_and(_X < 1, _Y > 0), ca.logic_or(_X < 1, _Y > 0), ca.logic_not(_X), _X == _Y, _X != _Y, 1 / _X, -_X,
    ca.floor(_X), ca.erf(_X), ca.copysign(_X, _Y), _X + 0.1, 3 * _X, ca.SX(0.25), ca.fmod(_X, _Y),
]  # fmt: skip
_SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, 20.5, -30.0, 99999.0, 1e5, -3e7, 1e300, np.inf, -np.inf, np.nan, 1e-300, 5e-324]


@needs_compiler
@pytest.mark.parametrize(("flags", "width"), [("-mno-avx", 2), ("-mavx -mno-avx512f", 4), ("-mavx512f", 8)])
def test_vector_arithmetic_is_that_of_one_run_bit_by_bit(tmp_path: Path, flags: str, width: int) -> None:
    cpu = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").exists() else ""
    if width > 2 and {4: " avx ", 8: " avx512f "}[width] not in cpu:
        pytest.skip("this processor has no such registers")
    f = ca.Function("f", [_X, _Y], [ca.vertcat(*_OPERATIONS)])
    one, simd = (written(f, dialect) for dialect in (ONE, SIMD))
    loops = """
void each(const double *x, const double *y, double *r) { dm_one(x, y, r); }
void together(const double *x, const double *y, double *r) {
  dm_real a, b, c[ROWS];
  memcpy(&a, x, sizeof a);
  memcpy(&b, y, sizeof b);
  dm_f(&a, &b, c);
  memcpy(r, c, sizeof c);
}
"""
    text = [shipped(name) for name in SIMD.arithmetic] + [f"#define ROWS {len(_OPERATIONS)}"]
    text += [one.replace("dm_f(", "dm_one("), simd, loops]
    (tmp_path / "f.c").write_text("\n".join(text), encoding="utf-8")
    compiler = find_compiler()
    assert compiler is not None
    words = [*compiler.command, "-std=gnu11", "-fPIC", "-shared", "-w", "-O2", "-ffp-contract=off", *flags.split()]
    subprocess.run([*words, "f.c", "-o", "f.so", "-lm"], cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "f.so"))
    random = np.random.default_rng(1)
    x = np.concatenate([_SPECIAL, random.normal(size=48) * 10.0 ** random.integers(-6, 6, 48)])
    y = np.concatenate([random.permutation(_SPECIAL), random.normal(size=48)])

    def called(function: Any, *arrays: np.ndarray, rows: int) -> np.ndarray:
        result = np.empty((len(_OPERATIONS), rows))
        given = [np.ascontiguousarray(array) for array in arrays]
        function(*(ctypes.c_void_p(array.ctypes.data) for array in (*given, result)))
        return result

    for first in range(0, x.size, width):
        some = slice(first, first + width)
        together = called(library.together, x[some], y[some], rows=width)
        for k in range(width):
            alone = called(library.each, x[first + k : first + k + 1], y[first + k : first + k + 1], rows=1)
            np.testing.assert_array_equal(together[:, k], alone[:, 0], err_msg=str((x[first + k], y[first + k])))
            signs = np.signbit(together[:, k]) == np.signbit(alone[:, 0])
            assert np.all(signs | np.isnan(alone[:, 0]))


@needs_compiler
@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("f->last = dm_choose(alive, v, f->last)", "f->last = dm_choose(alive, v + 1, f->last)"),
        ("memcpy(x, k.z, DM_Z * sizeof *x);", ""),
    ],
)
def test_a_library_with_one_wrong_element_is_not_used(
    right: str, wrong: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("DMFRAME_CACHE", str(tmp_path))
    source = simd_source

    def spoilt(parts: Any, *, implicit: bool) -> str:
        text = source(parts, implicit=implicit)
        assert right in text
        return text.replace(right, wrong)

    monkeypatch.setattr(dmframe.batch.simd, "simd_source", spoilt)
    found = batch("arm2_joint", 0.02).measure({"dynamics.Gamma": [1.0, 2.0]})
    assert found.engine == "compiled"
    assert any("a library that does not work" in notice for notice in found.notices)
