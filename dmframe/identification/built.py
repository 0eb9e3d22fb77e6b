"""An identified robot that can be built: its links are physical bodies."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from dmframe.identification.choose import Choice
from dmframe.identification.drawn import bodies_of, buildable, held_covariance
from dmframe.identification.found import Identified
from dmframe.identification.model import Array
from dmframe.identification.nearest import nearest
from dmframe.identification.solve import Fit, difference, fine_step, inflation_of
from dmframe.identification.twin import Twins, schedule
from dmframe.identification.unknowns import Unknowns

SAME: Final = 1e-3
"""Difference of base parameters, in prior deviations, that does not count."""


def built(found: Identified, twins: Twins) -> Identified:
    """The result with the nearest base parameters of physical bodies, if they explain the log too; else without a twin.

    The nearest ones are those of `dmframe.identification.nearest`, in the metric of the fit's covariance.
    """
    fit = found.fit
    if not found.known or _physical(fit.unknowns, fit.theta):
        return found
    theta, far = nearest(fit.unknowns, held_covariance(found), fit.theta)
    other = _simulated(twins, fit, theta, found.choice.floor)
    choice = Choice({**found.choice.fits, found.choice.best: other}, found.choice.floor, found.choice.noise)
    if choice.best == found.choice.best and choice.explained(choice.best) and _physical(fit.unknowns, theta):
        text = (
            "no physical bodies have the base parameters with the least residual, since the log hardly shows the "
            f"links: those of the nearest bodies are reported, {far:.2g} standard deviations away"
        )
        return replace(found, choice=choice, notices=(*found.notices, text))
    text = (
        "no physical bodies have base parameters that explain the log: no twin is written, and there is no verdict; "
        "check the robot's file, tool and mounting"
    )
    return replace(found, notices=(*found.notices, text), twin=False)


def moved(found: Identified, thetas: Array) -> Array:
    """Draws of the unknowns, (size, count), each moved to the nearest robot with physical bodies."""
    unknowns, covariance = found.fit.unknowns, held_covariance(found)
    return np.column_stack(
        [theta if _physical(unknowns, theta) else nearest(unknowns, covariance, theta)[0] for theta in thetas.T]
    )


def _physical(unknowns: Unknowns, theta: Array) -> bool:
    """True if physical bodies have the base parameters of theta."""
    model = unknowns.model
    beta = unknowns.numbers(theta[:, None], 0.0)[model.places["beta"], 0]
    values = np.zeros(model.base.parameters.size)
    bodies, rotors = bodies_of(unknowns, beta)
    values[model.base.parameters.inertial], values[model.base.parameters.places("rotor")] = bodies.ravel(), rotors
    away = np.linalg.solve(unknowns.bodies, model.grouping @ values - beta)
    return buildable(values, model.base.parameters) and bool(np.max(np.abs(away)) < SAME)


def _simulated(twins: Twins, fit: Fit, theta: Array, floor: Array) -> Fit:
    """The fit with other unknowns, and their residual."""
    log, delay = fit.unknowns.log, float(theta[fit.unknowns.places["delay"].start]) * fit.unknowns.log.period
    plan = schedule(log, delay, fine_step(twins, fit, floor))
    residual = difference(log, twins.positions(plan, fit.unknowns.numbers(theta[:, None], delay))[:, :, 0])
    return replace(fit, theta=theta, residual=residual, inflation=inflation_of(residual))
