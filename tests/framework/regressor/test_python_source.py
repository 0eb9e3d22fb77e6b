"""The NumPy module: stand-alone, vectorised, and compared with Pinocchio."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dmframe.common.errors import OutputError
from dmframe.regressor.base_parameters import base_parameters
from dmframe.regressor.export import export_c, kinematic_function, kinematic_values, polarised_regressor, tool_velocity
from dmframe.regressor.python_source import python_difference, python_source, write_python
from dmframe.robot.library import load


def module(source: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    exec(compile(source, "module", "exec"), found)
    return found


@pytest.mark.parametrize("name", ["pendulum", "arm2", "ur10", "xarm7"])
def test_the_module_computes_pinocchios_regressor_for_many_motions_at_once(name: str) -> None:
    chain = load(name)
    made = module(python_source(chain))
    motions = np.random.default_rng(0).uniform(-2, 2, (4, 2, 3, chain.n))
    Y_d = made["Y_d"](*motions)
    assert Y_d.shape == (2, 3, chain.n, 10 * chain.n)
    for i, j in np.ndindex(2, 3):
        assert np.allclose(Y_d[i, j], polarised_regressor(chain, *motions[:, i, j]), rtol=1e-9, atol=1e-8)
    assert len(made["PARAMETERS"]) == len(made["VALUES"]) == 10 * chain.n
    assert made["VALUES"][0] == pytest.approx(chain.model.inertias[1].mass)


def test_values_and_base_columns_give_the_torque() -> None:
    chain = load("arm2")
    made = module(python_source(chain, base=True))
    motion = np.random.default_rng(1).uniform(-2, 2, (4, 2))
    full = np.concatenate([body.toDynamicParameters() for body in list(chain.model.inertias)[1:]])
    assert np.allclose(made["Y_d"](*motion) @ made["VALUES"], polarised_regressor(chain, *motion) @ full)
    assert made["PARAMETERS"] == base_parameters(chain).kept


def test_friction_has_columns_and_no_values() -> None:
    made = module(python_source(load("arm2"), ["viscous", "coulomb"]))
    dq_ref = np.array([0.001, -2.0])
    Y_d = made["Y_d"](np.zeros(2), np.zeros(2), dq_ref, np.zeros(2))
    assert np.allclose(Y_d[:, 20:22], np.diag(dq_ref))
    assert np.allclose(Y_d[:, 22:], np.diag(np.tanh(dq_ref / 0.005)))
    assert np.isnan(made["VALUES"][20:]).all()
    assert not np.isnan(made["VALUES"][:20]).any()


def test_the_kinematic_module_gives_the_tools_velocity() -> None:
    chain = load("ur10")
    made = module(python_source(chain, kinematic=True))
    q, dq = np.random.default_rng(2).uniform(-2, 2, (2, chain.n))
    assert np.allclose(made["Y_k"](q, dq) @ made["VALUES"], tool_velocity(chain, q, dq), atol=1e-9)
    assert made["PARAMETERS"][3:6] == ("p_x2", "p_y2", "p_z2")
    Y_k = np.asarray(kinematic_function(chain)(q, dq))
    assert np.allclose(Y_k, made["Y_k"](q, dq))
    assert made["VALUES"].tolist() == list(kinematic_values(chain))


def test_the_file_imports_numpy_alone_and_runs_by_itself(tmp_path: Path) -> None:
    difference = write_python(load("arm2"), tmp_path / "arm.py")
    assert 0 < difference < 1e-12
    tree = ast.parse((tmp_path / "arm.py").read_text())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert [ast.unparse(node) for node in imports] == ["import numpy as np"]
    code = "import arm; print(arm.Y_d([0, 0], [0, 0], [0, 0], [0, 0])[0, 1])"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert float(done.stdout) == pytest.approx(9.81)


@pytest.mark.parametrize("options", [{}, {"base": True}, {"kinematic": True}, {"friction": ("viscous",)}])
def test_the_self_test_detects_a_changed_number(options: dict[str, Any]) -> None:
    chain = load("arm2")
    source = python_source(chain, **options)
    own = {key: value for key, value in options.items() if key != "kinematic"}
    assert python_difference(chain, source, **own) < 1e-12
    assert python_difference(chain, source.replace("0.45", "0.46"), **own) > 1e-4


def test_c_of_the_kinematic_regressor_states_what_it_is(tmp_path: Path) -> None:
    names = export_c(load("arm2"), tmp_path / "k.c", kinematic=True)
    text = (tmp_path / "k.c").read_text()
    assert names[3] == "p_x2"
    assert "void dmframe_kinematic_regressor(const double *q, const double *psi, double *Y_k)" in text
    assert "Y_k: 2 x 9 doubles, row-major" in text


def test_a_folder_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"arm\.py: the folder .*nowhere does not exist; create it first"):
        write_python(load("arm2"), tmp_path / "nowhere" / "arm.py")
