"""The loop in Jaxonomy: servo and robot as one continuous block, the sampled controller as another."""

from __future__ import annotations

import logging
from typing import Any, ClassVar

import numpy as np

from tests.benchmarks.loop import Array
from tests.benchmarks.loop import Loop as Numbers
from tests.benchmarks.peer import Peer


def diagram(loop: Numbers, *, arrays: bool = False) -> tuple[Any, Any]:
    """The diagram, and the port of (q_c, i, q, dq); the robot in scalars, or in arrays."""
    import jaxonomy as jx
    from jaxonomy.framework import DependencyTicket

    from tests.benchmarks.jax_loop import functions

    jx.set_backend("jax")
    control, rate, z_start, x_start = functions(loop, arrays=arrays)
    n = loop.n

    class Plant(jx.LeafSystem):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(name="plant")
            self.declare_input_port(name="dq_c")
            self.declare_continuous_state(
                default_value=x_start, ode=lambda time, state, dq_c, **_: rate(state.continuous_state, dq_c)
            )
            self.declare_continuous_state_output(name="x")

    class Controller(jx.LeafSystem):  # type: ignore[misc]
        """Its discrete state is (z, dq_c): the held command is a state, as in a zero-order hold."""

        def __init__(self) -> None:
            super().__init__(name="controller")
            for key, value in loop.gains.items():
                self.declare_dynamic_parameter(key, value)
            self.declare_input_port(name="x")
            self.declare_discrete_state(default_value=np.concatenate([z_start, np.zeros(n)]))
            self.declare_periodic_update(self.update, period=loop.T, offset=0.0)
            self.declare_output_port(
                lambda time, state, *_, **__: state.discrete_state[-n:],
                name="dq_c",
                requires_inputs=False,
                prerequisites_of_calc=[DependencyTicket.xd],
            )

        def update(self, time: Any, state: Any, x: Any, **gains: Any) -> Any:
            import jax.numpy as jnp

            dq_c, z = control(time, state.discrete_state[:-n], x, gains)
            return jnp.concatenate([z, dq_c])

    builder = jx.DiagramBuilder()
    plant, controller = builder.add(Plant()), builder.add(Controller())
    builder.connect(plant.output_ports[0], controller.input_ports[0])
    builder.connect(controller.output_ports[0], plant.input_ports[0])
    return builder.build(), plant.output_ports[0]


class Loop(Peer):
    """Fixed-step RK4."""

    title: ClassVar[str] = "Jaxonomy, scalar code"
    arrays: ClassVar[bool] = False
    package: ClassVar[str] = "jaxonomy"
    module: ClassVar[str] = "jaxonomy"
    note: ClassVar[str] = "the same functions as the row of JAX in scalar code; without its compilation"

    def build(self) -> None:
        logging.getLogger("jaxonomy").setLevel(logging.WARNING)
        self.diagram, self.port = diagram(self.loop, arrays=self.arrays)
        self.context = self.diagram.create_context()

    def warm(self, seconds: float) -> None:
        """Compiles for one length of a run, and caches the result."""
        self.run(seconds)

    def run(self, seconds: float) -> Array:
        import jaxonomy as jx

        loop, n = self.loop, self.loop.n
        ticks = loop.ticks(seconds)
        options = jx.SimulatorOptions(
            math_backend="jax",
            ode_solver_method="rk4",
            max_minor_step_size=loop.T / loop.substeps(self.step),
            max_major_steps=2 * ticks + 10,
            buffer_length=ticks * (loop.substeps(self.step) + 2) + 10,
        )
        found = jx.simulate(
            self.diagram, self.context, (0.0, ticks * loop.T), options=options, recorded_signals={"x": self.port}
        )
        time, x = np.asarray(found.time), np.asarray(found.outputs["x"])
        at = np.searchsorted(time, np.arange(ticks + 1) * loop.T - 1e-9)
        return x[at, 2 * n : 3 * n]
