"""The loop in MuJoCo with its RK4; servo and friction in a Python control callback at each stage."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer


class Loop(Peer):
    """The servo's integrator is the activation of an integrating actuator, so that RK4 integrates it too."""

    title: ClassVar[str] = "MuJoCo"
    package: ClassVar[str] = "mujoco"
    module: ClassVar[str] = "mujoco"
    integrator: ClassVar[str] = "RK4"
    note: ClassVar[str] = "it has no element for smooth friction, so Python runs at each of the four stages"

    def build(self) -> None:
        import mujoco

        self.model = mujoco.MjModel.from_xml_string(self.xml())
        self.data = mujoco.MjData(self.model)

    def xml(self) -> str:
        """A chain with the numbers of the loop."""

        def text(values: Any) -> str:
            return " ".join(f"{value:.17g}" for value in values)

        import mujoco

        bodies, ends = "", ""
        for j, link in enumerate(self.loop.links):
            about, quat = link["I"], np.empty(4)
            mujoco.mju_mat2Quat(quat, link["R"].ravel())
            six = (about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2])
            bodies += (
                f'<body pos="{text(link["r"])}" quat="{text(quat)}">'
                f'<inertial pos="{text(link["c"])}" mass="{link["m"][0]:.17g}" fullinertia="{text(six)}"/>'
                f'<joint name="q_{j}" axis="{text(link["axis"])}"/>'
            )
            ends += "</body>"
        actuators = "".join(
            f'<general joint="q_{j}" dyntype="integrator" gaintype="fixed" gainprm="{-K_I:.17g}"/>'
            for j, K_I in enumerate(self.loop.K_I)
        )
        h, gravity = self.loop.T / self.loop.substeps(self.step), self.loop.model.gravity.linear
        return (
            f'<mujoco><compiler angle="radian" balanceinertia="false"/>'
            f'<option timestep="{h:.17g}" integrator="{self.integrator}" gravity="{text(gravity)}">'
            f'<flag contact="disable" constraint="disable"/></option>'
            f"<worldbody>{bodies}{ends}</worldbody><actuator>{actuators}</actuator></mujoco>"
        )

    def run(self, seconds: float) -> Array:
        import mujoco

        from tests.benchmarks.controller import Controller

        loop, model, data, law = self.loop, self.model, self.data, Controller(self.loop)
        K_D, K_P, B, D, v_0 = loop.K_D, loop.K_P, loop.B, loop.D, loop.v_0
        mujoco.mj_resetData(model, data)
        q, dq, control, applied, act = data.qpos, data.qvel, data.ctrl, data.qfrc_applied, data.act
        q[:], dq[:], act[:] = loop.start["q"], loop.start["dq"], loop.start["i"]
        q_c, dq_c, since = loop.start["q_c"].copy(), np.zeros(loop.n), 0.0

        def servo(_: Any, now: Any) -> None:
            error = q - q_c - (now.time - since) * dq_c
            control[:] = error
            applied[:] = -K_D * (dq - dq_c) - K_P * error - B * dq - D * np.tanh(dq / v_0)

        ticks, substeps = loop.ticks(seconds), loop.substeps(self.step)
        found = np.empty((ticks + 1, loop.n))
        found[0] = q
        mujoco.set_mjcb_control(servo)
        try:
            for k in range(ticks):
                since, dq_c = data.time, law.step(k * loop.T, q.copy(), dq.copy(), q_c)
                mujoco.mj_step(model, data, substeps)
                q_c = q_c + loop.T * dq_c
                found[k + 1] = q
        finally:
            mujoco.set_mjcb_control(None)
        return found
