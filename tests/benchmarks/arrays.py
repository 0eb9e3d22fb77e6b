"""The robot's equations in arrays, as a first version in JAX: 3 x 3 matrices, cross products, a linear solver."""

from __future__ import annotations

from typing import Any

from tests.benchmarks.loop import Loop


class Robot:
    """A chain of revolute joints; as `scalars.Robot`."""

    def __init__(self, loop: Loop, xp: Any) -> None:
        self.n, self.xp = loop.n, xp
        self.R = [xp.asarray(link["R"]) for link in loop.links]
        self.r = [xp.asarray(link["r"]) for link in loop.links]
        self.axis = [xp.asarray(link["axis"]) for link in loop.links]
        self.point, self.gravity = xp.asarray(loop.point), xp.asarray(loop.model.gravity.linear)
        self.inertia = [xp.asarray(body.toDynamicParameters()) for body in list(loop.model.inertias)[1:]]

    def skew(self, a: Any) -> Any:
        """[a x]."""
        zero = self.xp.zeros_like(a[0])
        return self.xp.array([[zero, -a[2], a[1]], [a[2], zero, -a[0]], [-a[1], a[0], zero]])

    def rotations(self, q: Any) -> list[Any]:
        """Rotation of each link relative to its parent, by Rodrigues' formula."""
        xp, found = self.xp, []
        for j in range(self.n):
            K = self.skew(self.axis[j])
            found.append(self.R[j] @ (xp.eye(3) + xp.sin(q[j]) * K + (1 - xp.cos(q[j])) * (K @ K)))
        return found

    def torque(self, E: list[Any], dq: Any, dq_ref: Any, ddq: Any, inertia: Any, *, heavy: bool = True) -> Any:
        """M ddq + C(q, dq) dq_ref + g by the Slotine-Li recursion, linear in `inertia` [link][10]."""
        xp = self.xp
        cross, none = xp.cross, xp.zeros(3)
        a, alpha, w, v = (-self.gravity if heavy else none), none, none, none
        wrenches = []
        for j in range(self.n):
            k, r = self.axis[j], self.r[j]
            a = a + cross(alpha, r) + (cross(w, cross(v, r)) + cross(v, cross(w, r))) / 2
            a, alpha, w, v = (E[j].T @ b for b in (a, alpha, w, v))
            alpha = alpha + k * ddq[j] + (cross(w, k) * dq_ref[j] + cross(v, k) * dq[j]) / 2
            w, v = w + k * dq[j], v + k * dq_ref[j]
            m, mc, six = inertia[j][0], xp.stack([*inertia[j][1:4]]), inertia[j][4:10]
            about = xp.array([[six[0], six[1], six[3]], [six[1], six[2], six[4]], [six[3], six[4], six[5]]])
            force = m * a + cross(alpha, mc) + (cross(w, cross(v, mc)) + cross(v, cross(w, mc))) / 2
            moment = about @ alpha + cross(mc, a) + (cross(w, about @ v) + cross(v, about @ w)) / 2
            wrenches.append((force, moment))
        out, force, moment = [], none, none
        for j in reversed(range(self.n)):
            force, moment = force + wrenches[j][0], moment + wrenches[j][1]
            out.append(self.axis[j] @ moment)
            force, moment = E[j] @ force, E[j] @ moment
            moment = moment + cross(self.r[j], force)
        return xp.stack(out[::-1])

    def acceleration(self, q: Any, dq: Any, torque: Any) -> Any:
        """ddq under joint torques."""
        import jax

        xp, still, E = self.xp, self.xp.zeros(self.n), self.rotations(q)
        dq, torque = xp.stack(dq), xp.stack(torque)
        moving = self.torque(E, dq, dq, still, self.inertia)
        M = jax.vmap(lambda b: self.torque(E, still, still, b, self.inertia, heavy=False))(xp.eye(self.n))
        return xp.linalg.solve(M, torque - moving)

    def kinematics(self, q: Any) -> tuple[Any, list[Any]]:
        """The tool's position and its Jacobian's columns."""
        xp, E = self.xp, self.rotations(q)
        A, p, places = xp.eye(3), xp.zeros(3), []
        for j in range(self.n):
            p, A = p + A @ self.r[j], A @ E[j]
            places.append((p, A @ self.axis[j]))
        x = p + A @ self.point
        return x, [xp.cross(axis, x - origin) for origin, axis in places]
