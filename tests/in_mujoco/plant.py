"""A closed robot in MuJoCo: the arm from MuJoCo's own compiler of the URDF, a servo and friction by hand.

It uses no equation of dmframe: links and axes come from the file, the numbers of servo and friction from the caller.
"""

from __future__ import annotations

import importlib
import importlib.util
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.in_mujoco.servos import Array, Servo

mujoco: Any = importlib.import_module("mujoco") if importlib.util.find_spec("mujoco") else None
needs_mujoco = pytest.mark.skipif(mujoco is None, reason="MuJoCo is not installed: pip install --group mujoco")

STEP = 1e-3
"""Largest step of MuJoCo's RK4 [s]."""

Law = Callable[[dict[str, Array], float], Array]
"""The command [rad/s], a function of the measurements and the time of a sample."""


@dataclass(frozen=True)
class Load:
    """A body fixed to the tool from a time on: mass [kg], centre from the tool point [m] in the last joint's axes."""

    at: float
    mass: float
    center: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Motion:
    """The samples of a run, the last instant included: time [s], joint angles [rad], tool position [m]."""

    time: Array
    q: Array
    x: Array


@dataclass(frozen=True)
class Plant:
    """A robot whose servo is closed.

    Parameters
    ----------
    urdf, tool
        The robot's file, and the link whose origin is the tool point.
    hold
        Joints that are fixed, by their angles [rad]; the others move.
    viscous, coulomb, v_0
        Friction of each joint: B dq + D tanh(dq / v_0) [N m].
    sticking, slow, per_torque, uneven
        More friction: (sticking exp(-(dq / slow)^2) + per_torque |tau|) s + uneven D s^2, s = tanh(dq / v_0) [N m].
    rotor
        Inertia of each rotor about its joint's axis [kg m^2].
    mass_scale
        Factors of links' masses and inertias, by name.
    loads
        Bodies held by the tool, each until the next.
    """

    urdf: Path
    tool: str
    hold: Mapping[str, float]
    servo: Servo
    viscous: Array
    coulomb: Array
    v_0: float
    sticking: float = 0.0
    slow: float = 0.05
    per_torque: float = 0.0
    uneven: float = 0.0
    rotor: Sequence[float] = ()
    mass_scale: Mapping[str, float] = field(default_factory=dict)
    loads: Sequence[Load] = ()
    step: float = STEP

    def model(self, load: Load | None = None) -> Any:
        """MuJoCo's model; each state of the servo is the activation of an actuator without force."""
        spec = mujoco.MjSpec.from_string(_without_shapes(self.urdf))
        for joint in list(spec.joints):
            if joint.name in self.hold:
                _fix(spec, joint, self.hold[joint.name])
        for j, joint in enumerate(spec.joints):
            joint.armature = self.rotor[j] if self.rotor else 0.0
        for name, factor in self.mass_scale.items():
            body = spec.body(name)
            body.mass, body.inertia = factor * body.mass, factor * np.array(body.inertia)
        if load is not None:
            _add(spec, load, self.tool)
        for row in range(self.servo.rows):
            for j, joint in enumerate(spec.joints):
                _state(spec, f"{row}_{j}", joint.name)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        return spec.compile()

    def run(self, law: Law, q: Sequence[float], T: float, seconds: float) -> Motion:
        """From rest at q, with the law called every T seconds."""
        stages = [(0.0, self.model()), *((load.at, self.model(load)) for load in self.loads)]
        ticks, cycles = round(seconds / T), round(T / self.servo.cycle) if self.servo.cycle else 1
        substeps = int(np.ceil(round(T / cycles / self.step, 9)))
        n, data, command = stages[0][1].nq, None, np.zeros(stages[0][1].nq)
        found = Motion(T * np.arange(ticks + 1), np.empty((ticks + 1, n)), np.empty((ticks + 1, 3)))

        def torques(_: Any, now: Any) -> None:
            dq, rates = now.qvel, now.ctrl.reshape(-1, n)
            tau, rates[:] = self.servo.law(now.qpos, dq, now.act.reshape(-1, n), command)
            now.qfrc_applied[:] = tau - self.friction(dq, tau)

        for k in range(ticks + 1):
            while stages and stages[0][0] <= k * T + 1e-9:
                model = stages.pop(0)[1]
                data = self._moved(model, data, q, T / cycles / substeps)
            mujoco.mj_kinematics(model, data)
            states = data.act.reshape(-1, n)
            found.q[k], found.x[k] = data.qpos, data.xpos[model.body(self.tool).id]
            measured = {"arm.q": data.qpos, "arm.dq": data.qvel, "arm.x": found.x[k], "servo.q_c": states[0]}
            command = law(measured, k * T)
            mujoco.set_mjcb_control(torques)
            try:
                for _ in range(cycles):
                    states[:] = self.servo.sample(data.qpos, data.qvel, states, command)
                    mujoco.mj_step(model, data, substeps)
            finally:
                mujoco.set_mjcb_control(None)
        return found

    def friction(self, dq: Array, tau: Array) -> Array:
        """The total friction torque [N m] for a servo's torque."""
        dry = self.coulomb
        if self.sticking or self.per_torque:
            dry = dry + self.sticking * np.exp(-((dq / self.slow) ** 2)) + self.per_torque * np.abs(tau)
        sign = np.tanh(dq / self.v_0)
        return self.viscous * dq + dry * sign + self.uneven * self.coulomb * sign * sign

    def _moved(self, model: Any, before: Any, q: Sequence[float], step: float) -> Any:
        """The data of a model, at the state of another, or at rest at q."""
        model.opt.timestep = step
        data = mujoco.MjData(model)
        if before is not None:
            data.qpos[:], data.qvel[:], data.act[:], data.time = before.qpos, before.qvel, before.act, before.time
            return data
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        data.act[:] = self.servo.start(np.array(q), data.qfrc_bias.copy()).ravel()
        return data


def _without_shapes(urdf: Path) -> str:
    """The URDF without meshes, with options of MuJoCo's compiler that keep each link and its inertia as they are."""
    root = ET.parse(urdf).getroot()
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false", balanceinertia="false")
    return ET.tostring(root, encoding="unicode")


def _fix(spec: Any, joint: Any, angle: float) -> None:
    """Replace a joint by its rotation."""
    turn, quat = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(turn, np.array(joint.axis), angle)
    body = joint.parent
    mujoco.mju_mulQuat(quat, np.array(body.quat), turn)
    body.quat = quat
    spec.delete(joint)


def _add(spec: Any, load: Load, tool: str) -> None:
    """A body at the tool, in the axes of the last joint that moves."""
    bare = spec.copy().compile()
    data = mujoco.MjData(bare)
    mujoco.mj_kinematics(bare, data)
    last = spec.joints[-1].parent
    turn = data.xmat[bare.body(last.name).id].reshape(3, 3)
    point = turn.T @ (data.xpos[bare.body(tool).id] - data.xpos[bare.body(last.name).id])
    last.add_body(name="load", pos=point + load.center, mass=load.mass, ipos=[0, 0, 0], inertia=[0, 0, 0])


def _state(spec: Any, name: str, joint: str) -> None:
    """An integrator whose rate is its control."""
    spec.add_actuator(
        name=name,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        dyntype=mujoco.mjtDyn.mjDYN_INTEGRATOR,
        gainprm=[0.0] * 10,
    )
