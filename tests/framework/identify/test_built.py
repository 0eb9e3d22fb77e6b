"""Robots whose links the log hardly shows: their twins have physical bodies, or are not written."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import dmframe as dm
from dmframe.identification.built import SAME, built, moved
from dmframe.identification.choose import Choice, floor_of
from dmframe.identification.drawn import Plant, bodies_of, buildable, held_covariance, thetas
from dmframe.identification.found import Identified
from dmframe.identification.log import Log
from dmframe.identification.model import model_of
from dmframe.identification.nearest import nearest
from dmframe.identification.page import as_html
from dmframe.identification.race_text import not_applicable
from dmframe.identification.solve import Fit
from dmframe.identification.twin import Twins, schedule, twins_of
from dmframe.identification.unknowns import Unknowns
from dmframe.identification.write import written
from tests.framework.identify.plants import QUANTUM, START, steps, write
from tests.framework.identify.test_verdict import known

Array = np.ndarray
ROTORS = np.array([11.0, 11.0, 2.4])


@cache
def twins() -> Twins:
    return twins_of(model_of(dm.load("ur10_slow").diagram.robot))


def base(unknowns: Unknowns, links: float, rotors: Array) -> Array:
    """The beta of theta of the links of the robot's file times a factor."""
    parameters = unknowns.model.base.parameters
    values = links * np.array([0.0 if value is None else float(value) for value in parameters.values])
    values[parameters.places("rotor")] = rotors
    return np.asarray(np.linalg.solve(unknowns.bodies, unknowns.model.grouping @ values - unknowns.center))


def stiff(links: float, spread: float) -> Identified:
    """A fit of a log of rotors with links of a negative mass; `spread` is the deviation of the base parameters."""
    u, n = steps(0.008, 6.0, 0), 3
    t = 0.008 * np.arange(len(u))
    log = Log(t, np.tile(START, (len(u), 1)), u[:-1], np.zeros(n))
    unknowns = Unknowns(twins().model, log, "pid")
    theta, at = unknowns.prior[0].copy(), unknowns.places
    theta[at["w"]], theta[at["k_P"]], theta[at["k_I"]] = -np.log(50 * ROTORS), np.log(25.0), np.log(4.0)
    theta[at["D"]], theta[at["v_0"]] = 0.01, np.log(0.01)
    theta[at["beta"]] = base(unknowns, links, ROTORS)
    q = twins().positions(schedule(log, 0.0), unknowns.numbers(theta[:, None], 0.0))[:, :, 0]
    q = q + np.random.default_rng(0).normal(0, 1e-5, q.shape)
    log = replace(log, q=q)
    unknowns = Unknowns(unknowns.model, log, "pid")
    q_0 = twins().positions(schedule(log, 0.0), unknowns.numbers(theta[:, None], 0.0))[:, :, 0]
    deviation = np.full(unknowns.size, 1e-4)
    deviation[at["beta"]] = spread
    fit = Fit(unknowns, theta, np.diag(deviation**2), q - q_0, np.ones(n))
    return Identified(Choice({"pid": fit}, floor_of(log), log.noise), (), {"sha256": "of the log"})


def test_a_twin_whose_links_the_log_hardly_shows_has_the_nearest_physical_bodies(tmp_path: Path) -> None:
    fitted = stiff(-0.002, 0.3)
    assert fitted.known
    found = built(fitted, twins())
    assert found.twin
    assert "no physical bodies have the base parameters with the least residual" in found.notices[-1]
    written(found, tmp_path)
    graph = dm.load(tmp_path / "twin.yaml")
    assert graph.run("0.5 s", progress=False).recording.divergence is None
    model, rotors = model_of(graph.diagram.robot), Plant.of(found.fit.unknowns, found.fit.theta).rotors
    beta = model.nominal + model.grouping[:, model.base.parameters.places("rotor")] @ rotors
    assert beta == pytest.approx(found.number("beta")[0], abs=1e-3)
    assert dm.load(tmp_path / "adaptive.yaml").diagram.robot.n == 3
    assert "dmframe run twin.yaml" in as_html(found)


def test_draws_of_such_a_robot_are_physical() -> None:
    found = built(stiff(-0.002, 0.3), twins())
    unknowns = found.fit.unknowns
    parameters = unknowns.model.base.parameters
    for theta in moved(found, thetas(found, 4)).T:
        plant, values = Plant.of(unknowns, theta), np.zeros(parameters.size)
        values[parameters.inertial], values[parameters.places("rotor")] = plant.bodies.ravel(), plant.rotors
        assert buildable(values, parameters)
        beta = unknowns.numbers(theta[:, None], 0.0)[unknowns.model.places["beta"], 0]
        assert unknowns.model.grouping @ values == pytest.approx(beta, abs=1e-3)


def test_no_other_physical_bodies_are_nearer() -> None:
    found = stiff(-0.002, 0.3)
    fit, unknowns = found.fit, found.fit.unknowns
    _, least = nearest(unknowns, held_covariance(found), fit.theta)
    own = held_covariance(found)[unknowns.places["beta"], unknowns.places["beta"]]
    random, target = np.random.default_rng(0), fit.theta[unknowns.places["beta"]]
    others = [
        base(unknowns, links, ROTORS * random.uniform(0.97, 1.03, 3)) - target
        for links in (*np.geomspace(1e-4, 1, 20), *random.uniform(0, 0.1, 200))
    ]
    tried = [np.sqrt(away @ np.linalg.solve(own, away)) for away in others]
    assert 0 < least < 1.02 * min(tried)


def test_no_twin_is_written_if_no_physical_bodies_explain_the_log(tmp_path: Path) -> None:
    found = built(stiff(-0.3, 1e-3), twins())
    assert found.known
    assert not found.twin
    assert "no twin is written" in found.notices[-1]
    for name in ("identified.json", "twin.urdf", "twin.yaml"):
        (tmp_path / name).write_text('{"record": {"sha256": "of the log"}}')
    assert {path.name for path in written(found, tmp_path)} == {"identified.json", "report.html"}
    assert not (tmp_path / "twin.urdf").exists()
    assert "dmframe run twin.yaml" not in as_html(found)
    assert "no twin" in not_applicable(found)


def test_bodies_have_a_base_parameter_that_is_zero_in_the_robots_file() -> None:
    model = model_of(dm.load("arm2_joint").diagram.robot)
    log = Log(0.008 * np.arange(3), np.zeros((3, 2)), np.zeros((2, 2)), np.zeros(2))
    unknowns = Unknowns(model, log, "pid")
    zero = np.isclose(model.nominal, 0, atol=1e-12)
    assert zero.any()  # the links are symmetric about their axes
    beta = unknowns.center + 3e-9 * zero  # a deviation that the log of a symmetric link has
    bodies, rotors = bodies_of(unknowns, beta)
    values = np.zeros(model.base.parameters.size)
    values[model.base.parameters.inertial], values[model.base.parameters.places("rotor")] = bodies.ravel(), rotors
    assert buildable(values, model.base.parameters)
    assert np.linalg.solve(unknowns.bodies, model.grouping @ values - beta) == pytest.approx(0, abs=SAME)


def test_physical_base_parameters_are_kept() -> None:
    found = known()
    assert built(found, twins()) is found


def decoupled(T: float = 0.008) -> tuple[Array, Array, Array]:
    """A log of joints of second order without a robot's coupling or weight, as of an arm with high gear ratios."""
    u, x, v = steps(T, 16.0, 3), START.copy(), np.zeros(3)
    q, q_c, gain = np.empty_like(u), START.copy(), np.array([25.0, 22.0, 30.0])
    for k in range(len(u)):
        q[k], command, h = x, u[max(k - 2, 0)], T / 10
        for _ in range(10):
            rate = 0.85 * command + gain * (q_c - x)
            v = v + h * ((rate - v) / 0.02 - 0.8 * np.tanh(v / 0.01))
            x, q_c = x + h * v, q_c + h * command
    return T * np.arange(len(u)), np.round(q / QUANTUM) * QUANTUM, u


def test_a_log_of_decoupled_joints_gives_a_twin_that_runs(tmp_path: Path) -> None:
    found = dm.identify(write(tmp_path / "log.csv", *decoupled()), "ur10_slow", out=tmp_path / "out")
    assert found.known
    assert found.twin
    assert dm.load(tmp_path / "out" / "twin.yaml").run("0.5 s", progress=False).recording.divergence is None
    assert dm.load(tmp_path / "out" / "adaptive.yaml").diagram.robot.n == 3
