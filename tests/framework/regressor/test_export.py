from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dmframe.common.errors import OutputError, ShapeError, UnknownNameError
from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.export import export_c, polarised_regressor, regressor_function, self_test, write_c
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import load


@cache
def ur10() -> SerialChain:
    free = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    return load("ur10", free=free, hold={"wrist_2_joint": -math.pi / 2}, tool="ee_link")


def compiled(source: Path) -> ctypes.CDLL:
    library = source.with_suffix(".so")
    compiler = shutil.which("gcc") or shutil.which("cc")
    assert compiler is not None, "no C compiler: install gcc to check the generated source"
    command = [compiler, "-std=c99", "-pedantic", "-Wall", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run([*command, "-o", str(library), str(source), "-lm"], check=True, capture_output=True)
    return ctypes.CDLL(str(library))


def call(library: ctypes.CDLL, motion: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    def pointer(values: np.ndarray) -> object:
        return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    Y_d = np.full(shape, np.nan)
    library.dmframe_regressor(*(pointer(np.ascontiguousarray(row)) for row in motion), pointer(Y_d))
    return Y_d


def test_compiled_c_is_pinocchios_regressor_in_rows(tmp_path: Path) -> None:
    names = export_c(ur10(), tmp_path / "full.c")
    library = compiled(tmp_path / "full.c")
    rng = np.random.default_rng(3)
    for _ in range(5):
        motion = rng.uniform(-2, 2, (4, 3))
        expected = polarised_regressor(ur10(), *motion)
        assert np.allclose(call(library, motion, (3, 30)), expected, rtol=1e-10, atol=1e-10)
    assert len(names) == 30


def test_compiled_base_regressor_gives_pinocchios_torque(tmp_path: Path) -> None:
    friction = ("viscous", "coulomb")
    names = export_c(ur10(), tmp_path / "base.c", friction, base=True)
    library = compiled(tmp_path / "base.c")
    base = base_parameters(ur10(), friction)
    assert names == base.kept
    assert "ur10 in base parameters, each named after its kept" in (tmp_path / "base.c").read_text()
    rng = np.random.default_rng(4)
    motion, full = rng.uniform(-2, 2, (4, 3)), rng.uniform(0, 1, 36)
    beta = np.array([[float(x) for x in row] for row in base.grouping]) @ full
    torque = polarised_regressor(ur10(), *motion) @ full[:30]
    torque += full[30:33] * motion[2] + full[33:] * np.tanh(motion[2] / 0.005)
    assert np.allclose(call(library, motion, (3, 21)) @ beta, torque, rtol=1e-10)


def test_the_header_states_what_the_numbers_mean(tmp_path: Path) -> None:
    from dmframe import __version__

    export_c(ur10(), tmp_path / "full.c", ["viscous"])
    text = (tmp_path / "full.c").read_text()
    comment = text[: text.index("*/")]
    for expected in ("ur10", "q, dq, dq_ref, ddq_ref", "3 x 33 doubles, row-major", "I_zz3", "B_3", __version__):
        assert expected in comment
    assert "void dmframe_regressor(const double *q, const double *dq, const double *dq_ref" in text
    assert list(tmp_path.iterdir()) == [tmp_path / "full.c"]


def test_names_from_outside_cannot_end_the_comment_or_collide_with_c(tmp_path: Path) -> None:
    f = regressor_function(ur10())
    signals = [ca.SX.sym(name, 3) for name in f.name_in()]
    renamed = ca.Function("exp", signals, [f(*signals)], f.name_in(), ["Y_d"])
    write_c(renamed, tmp_path / "odd.c", robot="*/ int x;\n", parameters=[f"y{k}" for k in range(30)])
    motion = np.ones((4, 3))
    assert np.allclose(call(compiled(tmp_path / "odd.c"), motion, (3, 30)), polarised_regressor(ur10(), *motion))


def test_the_function_names_its_arguments() -> None:
    f = regressor_function(ur10(), ["coulomb"], base=True)
    assert f.name_in() == ["q", "dq", "dq_ref", "ddq_ref"]
    assert f.name_out() == ["Y_d"]
    assert f.size_out(0) == (3, 18)
    with pytest.raises(UnknownNameError, match="unknown kind of friction"):
        regressor_function(ur10(), ["stribeck"])


def test_a_file_that_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    f = regressor_function(ur10())
    with pytest.raises(
        OutputError, match=r"nowhere/regressor\.c: the folder .*nowhere does not exist; create it first"
    ):
        write_c(f, tmp_path / "nowhere" / "regressor.c")
    (tmp_path / "taken.c").mkdir()
    with pytest.raises(OutputError, match="expected a file, found a folder"):
        write_c(f, tmp_path / "taken.c")
    assert list(tmp_path.iterdir()) == [tmp_path / "taken.c"]


def test_a_function_that_is_not_a_regressor_is_refused(tmp_path: Path) -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ShapeError, match="C source of f: expected inputs q, dq, dq_ref, ddq_ref and one output, found"):
        write_c(ca.Function("f", [x], [x]), tmp_path / "f.c")
    with pytest.raises(ShapeError, match="C source of Y_d: expected 30 parameter names, found 2"):
        write_c(regressor_function(ur10()), tmp_path / "f.c", parameters=["a", "b"])


@pytest.mark.parametrize("name", ["ur10", "xarm7", "z1"])
def test_the_self_test_agrees_with_pinocchio(name: str) -> None:
    outcome = self_test(load(name), points=3)
    assert 0 < outcome.Y_d < 1e-10
    assert 0 < outcome.Y_k < 1e-10
    assert outcome.points == 3


def test_the_self_test_catches_a_model_with_another_mass() -> None:
    robot = load("arm2")
    model = robot.model.copy()
    model.jointPlacements[2].translation = model.jointPlacements[2].translation * 1.001
    from dataclasses import replace

    outcome = self_test(replace(robot, model=model), points=3)
    assert outcome.Y_d > 1e-5
    assert outcome.Y_k > 1e-5


def test_a_robot_of_one_joint_is_tested_too() -> None:
    outcome = self_test(load("pendulum"), points=3)
    assert outcome.Y_d < 1e-10
    assert 0 < outcome.Y_k < 1e-10
    assert polarised_regressor(load("pendulum"), *np.ones((4, 1))).shape == (1, 10)
