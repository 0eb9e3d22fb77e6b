"""The loop as a Drake diagram: MultibodyPlant, PidController, and the controller as a LeafSystem in Python."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.peer import Peer


class Loop(Peer):
    """Continuous MultibodyPlant; friction as a SymbolicVectorSystem, so that no Python runs between samples."""

    title: ClassVar[str] = "Drake"
    package: ClassVar[str] = "drake"
    module: ClassVar[str] = "pydrake"
    method: ClassVar[str] = "RK3, fixed step"
    note: ClassVar[str] = "has no fixed-step RK4, so one evaluation fewer a step; regressor and Jacobians by Pinocchio"

    def build(self) -> None:
        from pydrake.all import (
            Adder,
            DiagramBuilder,
            Integrator,
            LeafSystem,
            LogVectorOutput,
            Multiplexer,
            PidController,
            ResetIntegratorFromFlags,
            Simulator,
            SymbolicVectorSystem,
            Variable,
            tanh,
        )

        from tests.benchmarks.controller import Controller

        loop, n, law = self.loop, self.loop.n, Controller(self.loop)

        class Sampled(LeafSystem):  # type: ignore[misc]
            """Reads (q, dq) and q_c, outputs dq_c with zero-order hold."""

            def __init__(self) -> None:
                super().__init__()
                self.DeclareVectorInputPort("state", 2 * n)
                self.DeclareVectorInputPort("q_c", n)
                held = self.DeclareDiscreteState(n)
                self.DeclareStateOutputPort("dq_c", held)
                self.DeclarePeriodicDiscreteUpdateEvent(loop.T, 0.0, self.update)

            def update(self, context: Any, values: Any) -> None:
                state = self.get_input_port(0).Eval(context)
                q_c = self.get_input_port(1).Eval(context)
                dq_c = law.step(context.get_time(), state[:n], state[n:], q_c)
                values.set_value(dq_c)

        builder = DiagramBuilder()
        plant = builder.AddSystem(self.robot())
        controller = builder.AddSystem(Sampled())
        command = builder.AddSystem(Integrator(n))
        desired = builder.AddSystem(Multiplexer([n, n]))
        servo = builder.AddSystem(PidController(kp=loop.K_P, ki=loop.K_I, kd=loop.K_D))
        x = [Variable(f"x_{j}") for j in range(2 * n)]
        losses = [-loop.B[j] * x[n + j] - loop.D[j] * tanh(x[n + j] / loop.v_0) for j in range(n)]
        # Drake refuses a system without continuous states, so it has a constant one.
        still = Variable("still")
        friction = builder.AddSystem(SymbolicVectorSystem(state=[still], input=x, dynamics=[0], output=losses))
        torque = builder.AddSystem(Adder(2, n))
        state = plant.get_state_output_port()
        builder.Connect(state, controller.get_input_port(0))
        builder.Connect(command.get_output_port(), controller.get_input_port(1))
        builder.Connect(controller.get_output_port(), command.get_input_port())
        builder.Connect(command.get_output_port(), desired.get_input_port(0))
        builder.Connect(controller.get_output_port(), desired.get_input_port(1))
        builder.Connect(state, servo.get_input_port_estimated_state())
        builder.Connect(desired.get_output_port(), servo.get_input_port_desired_state())
        builder.Connect(state, friction.get_input_port())
        builder.Connect(servo.get_output_port_control(), torque.get_input_port(0))
        builder.Connect(friction.get_output_port(), torque.get_input_port(1))
        builder.Connect(torque.get_output_port(), plant.get_applied_generalized_force_input_port())
        self.log = LogVectorOutput(state, builder, loop.T)
        self.diagram = builder.Build()
        self.parts = (plant, command, servo, controller)
        self.law = law
        self.simulator = Simulator(self.diagram)
        integrator = ResetIntegratorFromFlags(self.simulator, "runge_kutta3", loop.T / loop.substeps(self.step))
        integrator.set_fixed_step_mode(True)

    def robot(self) -> Any:
        """A chain with the numbers of the loop."""
        from pydrake.all import (
            FixedOffsetFrame,
            MultibodyPlant,
            RevoluteJoint,
            RigidTransform,
            RotationMatrix,
            SpatialInertia,
            UnitInertia,
        )

        plant = MultibodyPlant(time_step=0.0)
        plant.mutable_gravity_field().set_gravity_vector(np.array(self.loop.model.gravity.linear))
        parent = plant.world_frame()
        for j, link in enumerate(self.loop.links):
            mass, c, moment = float(link["m"][0]), link["c"], link["I"]
            about = (moment + mass * (float(c @ c) * np.eye(3) - np.outer(c, c))) / mass
            unit = UnitInertia(about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2])
            body = plant.AddRigidBody(f"link_{j}", SpatialInertia(mass, c, unit, skip_validity_check=True))
            place = RigidTransform(RotationMatrix(link["R"]), link["r"])
            frame = plant.AddFrame(FixedOffsetFrame(f"joint_{j}", parent, place))
            plant.AddJoint(RevoluteJoint(f"q_{j}", frame, body.body_frame(), link["axis"]))
            parent = body.body_frame()
        plant.Finalize()
        return plant

    def run(self, seconds: float) -> Array:
        loop, n = self.loop, self.loop.n
        plant, command, servo, _ = self.parts
        self.law.reset()
        root = self.simulator.get_mutable_context()
        root.SetTime(0.0)
        start = np.concatenate([loop.start["q"], loop.start["dq"]])
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(root), start)
        command.set_integral_value(command.GetMyMutableContextFromRoot(root), loop.start["q_c"])
        integral = servo.GetMyMutableContextFromRoot(root).get_mutable_continuous_state_vector()
        integral.SetFromVector(-loop.start["i"])
        self.log.FindMutableLog(root).Clear()
        self.simulator.Initialize()
        self.simulator.AdvanceTo(loop.ticks(seconds) * loop.T)
        q: Array = self.log.FindLog(root).data()[:n].T
        return q
