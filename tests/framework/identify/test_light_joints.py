"""Light joints with geared motors: a rotor that has many times the inertia of the links that it moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.identification.checked import checked_log
from dmframe.identification.columns import signals_of
from dmframe.identification.identify import chain_of
from dmframe.identification.log import Log
from dmframe.identification.model import model_of
from dmframe.identification.rows import rows_of, starts
from dmframe.identification.solve import solved
from dmframe.identification.table import read_table
from dmframe.identification.twin import twins_of
from dmframe.identification.unknowns import Unknowns
from tests.framework.identify.test_experiment import check_servo

UR10E = np.array([2.5, 4.7, 1.2, 0.4, 0.3, 0.4])
"""Rotors of a UR10e [kg m^2], fitted to recorded currents: github.com/shamilmamedov/dynamic_calibration."""
GRAPH = """dmframe: 1
title: A heavy joint and a wrist
robot: {model: ur5e, free: [shoulder_lift_joint, wrist_2_joint], hold: {elbow_joint: 1.2, wrist_1_joint: 1.2}, axes: xz}
clock: 8 ms
duration: 10 s
start: {q: [-1.2, 1.7]}
blocks:
  path: {type: sinusoid, center: [-1.2, 1.7], amplitude: 0.2, rate: 1}
  task: {type: joint_tracking, alpha_bar: 3}
  inverse: {type: kinematic_command}
  servo: {type: pid_servo, K_D: [545.6, 10.48], K_P: [1200, 23.06], K_I: [381.9, 7.338]}
  arm: {type: manipulator, viscous: [13.64, 0.2621], coulomb: [10.91, 0.2097], rotor: [1.665, 0.1249]}
"""


def test_rotors_of_a_ur10e_are_plausible_before_the_log_is_seen() -> None:
    chain, t = chain_of("ur10e"), 0.008 * np.arange(10)
    q = np.tile([0.0, -1.2, 1.2, 0.3, 1.5, 0.0], (10, 1))
    unknowns = Unknowns(model_of(chain), Log(t, q, 0 * q[:-1], np.zeros(6)), "pid")
    places = unknowns.model.base.parameters.places("rotor")
    deviation = np.sqrt(np.sum(unknowns.full[places] ** 2, axis=1))
    mean = unknowns.rotors
    assert np.all(np.abs(UR10E - mean) < 3 * deviation)
    assert np.all(mean > 0)


def test_the_gain_of_a_wrist_is_inside_its_interval_although_its_rotor_dominates(tmp_path: Path) -> None:
    (tmp_path / "two.yaml").write_text(GRAPH)
    dm.experiment(str(tmp_path / "two.yaml"), out=tmp_path / "e", seconds=8)
    graph = tmp_path / "e" / "experiment.yaml"
    dm.load(graph).drive("sim").save(tmp_path / "log")
    chain = chain_of(str(graph))
    table = read_table(tmp_path / "log", chain.joint_names)
    log, model = checked_log(signals_of(table, chain.n, ())[0], chain, table.name).log, model_of(chain)
    unknowns = Unknowns(model, log, "pid")
    fit = solved(twins_of(model), unknowns, starts(unknowns, rows_of(model, log))[0][1])
    place = unknowns.places["w"]
    deviation = np.sqrt(np.diag(fit.covariance)[place])
    assert np.all(np.abs(fit.theta[place] + np.log([545.6, 10.48])) < 2 * deviation)
    assert np.all(deviation < 1)  # a factor of e


@pytest.mark.parametrize("robot", ["sim", "sim:1"])
def test_the_log_of_a_driven_ur5e_determines_the_servos_of_its_wrists(tmp_path: Path, robot: str) -> None:
    dm.experiment("ur5e", out=tmp_path / "e")
    graph = tmp_path / "e" / "experiment.yaml"
    dm.load(graph).drive(robot).save(tmp_path / "log")
    check_servo(tmp_path / "log", graph, 1 if robot == "sim:1" else 0)
