"""The loop in JAX for tools that trace it: (control, rate) in double precision."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.benchmarks.arrays import Robot as Arrays
from tests.benchmarks.controller import STATES
from tests.benchmarks.loop import Loop
from tests.benchmarks.scalars import Robot, dot, plus, times


def functions(loop: Loop, *, arrays: bool = False) -> tuple[Any, Any, Any, Any]:
    """The sampled law (t, z, x, gains) -> (dq_c, z after T), the rate (x, dq_c) -> dx, and both initial states.

    The robot's equations are in arrays, or in scalars, which XLA fuses into a few kernels.
    z holds the controller's states in the order of `STATES`, x the servo's and the robot's: (q_c, i, q, dq).
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    n, T = loop.n, loop.T
    robot: Any = Arrays(loop, jnp) if arrays else Robot(loop, jnp.sin, jnp.cos)
    sizes = [loop.start[name].size for name in STATES]
    ends = np.cumsum(sizes)[:-1].tolist()
    boxes = {name: (np.full(size, -np.inf), np.full(size, np.inf)) for name, size in zip(STATES, sizes, strict=True)}
    boxes |= loop.boxes
    lower, upper = (np.concatenate([boxes[name][end] for name in STATES]) for end in (0, 1))
    boxed = bool(np.isfinite(lower).any())
    c, r, w = loop.center.tolist(), loop.radius, loop.rate

    def reference(t: Any, q: Any, gamma: Any) -> Any:
        """dq_ref(t, q)."""
        x, J = robot.kinematics([q[j] for j in range(n)])
        x_d = [c[0] + r * jnp.sin(w * t), c[1] + r * jnp.cos(w * t), c[2]]
        dx_d = [r * w * jnp.cos(w * t), -r * w * jnp.sin(w * t), 0.0]
        A = [[sum(J[k][i] * J[k][j] for k in range(n)) for j in range(3)] for i in range(3)]
        adjoint = [
            [A[(j + 1) % 3][(i + 1) % 3] * A[(j + 2) % 3][(i + 2) % 3]
             - A[(j + 1) % 3][(i + 2) % 3] * A[(j + 2) % 3][(i + 1) % 3] for j in range(3)]
            for i in range(3)
        ]  # fmt: skip
        determinant = dot(A[0], [adjoint[k][0] for k in range(3)])
        forward = times(1 / determinant, [dot(row, dx_d) for row in adjoint])
        wanted = plus(forward, [-gamma * (a - b) for a, b in zip(x, x_d, strict=True)])
        return jnp.stack([dot(J[k], wanted) for k in range(n)])

    def control(t: Any, z: Any, x: Any, gain: Any) -> Any:
        a, q_r, integral, scale, w_P, w_I = jnp.split(z, ends)
        q_c, q, dq = x[:n], x[2 * n : 3 * n], x[3 * n :]
        dq_r, ddq_r = jax.jvp(lambda t, q: reference(t, q, gain["gamma"]), (t, q), (jnp.ones_like(t), dq))
        dq_ref, ddq_ref = dq_r - gain["K_c"] * (q - q_r), ddq_r - gain["K_c"] * (dq - dq_r)
        smooth = jnp.tanh(dq_ref / loop.v_0)
        E = robot.rotations([q[j] for j in range(n)])

        def compensation(a: Any) -> Any:
            inertia = [[a[10 * j + k] for k in range(10)] for j in range(n)]
            lists = [[v[j] for j in range(n)] for v in (dq, dq_ref, ddq_ref)]
            tau = jnp.stack(robot.torque(E, *lists, inertia))
            return tau + dq_ref * a[10 * n : 11 * n] + smooth * a[11 * n :]

        sigma = dq - dq_ref
        tau, transposed = jax.vjp(compensation, a)
        e_c = q_c - q_r
        dq_c = dq_ref - w_P * e_c + scale * tau - w_I * integral
        rates = [
            -gain["Gamma"] * transposed(sigma)[0],
            dq_r,
            e_c,
            -gain["Lambda"] * tau * sigma,
            gain["Lambda_P"] * e_c * sigma,
            gain["Lambda_I"] * integral * sigma,
        ]
        after = z + T * jnp.concatenate(rates)
        return dq_c, jnp.clip(after, lower, upper) if boxed else after

    def rate(x: Any, dq_c: Any) -> Any:
        q, dq = x[2 * n : 3 * n], x[3 * n :]
        error = q - x[:n]
        u = -loop.K_D * (dq - dq_c) - loop.K_P * error - loop.K_I * x[n : 2 * n]
        torque = u - loop.B * dq - loop.D * jnp.tanh(dq / loop.v_0)
        ddq = robot.acceleration(*([v[j] for j in range(n)] for v in (q, dq, torque)))
        return jnp.concatenate([dq_c, error, dq, jnp.stack(ddq)])

    z = jnp.concatenate([jnp.asarray(loop.start[name]) for name in STATES])
    x = jnp.concatenate([jnp.asarray(loop.start[name]) for name in ("q_c", "i", "q", "dq")])
    return control, rate, z, x


def integrated(rate: Callable[[Any, Any], Any], x: Any, dq_c: Any, h: float, substeps: int) -> Any:
    """x after some steps of the classical Runge-Kutta method with a held command."""
    import jax

    def step(_: Any, x: Any) -> Any:
        k1 = rate(x, dq_c)
        k2 = rate(x + h / 2 * k1, dq_c)
        k3 = rate(x + h / 2 * k2, dq_c)
        k4 = rate(x + h * k3, dq_c)
        return x + h / 6 * (k1 + 2 * (k2 + k3) + k4)

    return jax.lax.fori_loop(0, substeps, step, x)
