"""Time and error bound of certificates: ``python tests/benchmarks/certify.py [--sympy SECONDS]``.

Every combination of {task, joint} tracking, {PI, PID} servo, with and without projection, on robots of 2 to 7 joints
with viscous and Coulomb friction; then SymPy on the smallest of them, in a separate process with a time limit.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from dmframe.certify import Verdict, verify
from dmframe.certify.assemble import assembled
from dmframe.config.document import read_document
from dmframe.graph.graph import Graph
from dmframe.prove import identity as exact

ROBOTS = {
    "arm2": ("arm2", 2, 2),
    "ur10 (3)": (
        "{model: ur10, free: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint], "
        "hold: {wrist_2_joint: -90 deg}, tool: ee_link}",
        3,
        3,
    ),
    "ur10 (6)": ("ur10", 6, 3),
    "panda": ("panda", 7, 3),
    "xarm7": ("xarm7", 7, 3),
}
INVERSES = {
    "PI": ("pi_inverse", "Lambda: 0.01, Lambda_I: 0.02, w_I: 1", "w_I_box: [0.5, 2]"),
    "PID": (
        "pid_inverse",
        "K_c: 0.8, Lambda: 0.01, Lambda_P: 10, Lambda_I: 10, w_P: 2, w_I: 1",
        "w_P_box: [1, 3], w_I_box: [0.5, 2]",
    ),
}
SERVOS = {"PI": "{type: pi_servo, K_P: 800, K_I: 560}", "PID": "{type: pid_servo, K_D: 800, K_P: 1760, K_I: 560}"}


@dataclass(frozen=True)
class Case:
    """One configuration."""

    robot: str
    task: str
    servo: str
    projection: bool

    def graph(self) -> str:
        """Graph file of a configuration; the certificate is independent of the trajectory, so any source suffices."""
        robot, n, m = ROBOTS[self.robot]
        kind, gains, boxes = INVERSES[self.servo]
        goal = f"q_d: {[0.5] * n}" if self.task == "joint" else f"x_d: {[0.3] * m}"
        task = "{type: joint_tracking, alpha_bar: 2}" if self.task == "joint" else "{type: known_tracking, gamma: 0.8}"
        extra = f", w_box: [0, 0.01], {boxes}" if self.projection else ""
        estimate = ", a_d_hat_box: [-100, 100]" if self.projection else ""
        lines = [
            "dmframe: 1",
            f"robot: {robot}",
            "clock: continuous",
            "duration: 1 s",
            "blocks:",
            f"  path:     {{type: setpoint, {goal}}}",
            *(["  geometry: {type: kinematics}"] if self.task == "task" else []),
            f"  task:     {task}",
            "  model:    {type: regressor, friction: [viscous, coulomb]}",
            f"  dynamics: {{type: dynamic_compensator, Gamma: 10{estimate}}}",
            f"  inverse:  {{type: {kind}, {gains}{extra}}}",
            f"  servo:    {SERVOS[self.servo]}",
            "  arm:      {type: manipulator, viscous: 5, coulomb: 8}",
        ]
        return "\n".join(lines) + "\n"

    def verdict(self) -> tuple[Verdict, float]:
        """The verdict, and the seconds from the text of the graph to it."""
        begin = time.perf_counter()
        graph = Graph.of(read_document(self.graph(), f"{self.robot}.yaml"))
        return verify(graph.diagram), time.perf_counter() - begin


def rows(robots: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """The table, row by row."""
    yield "robot", "tracking", "servo", "projection", "verdict", "in all", "write dV/dt", "identity", "error below"
    for robot, task, servo, projection in product(robots, ("task", "joint"), INVERSES, (False, True)):
        verdict, seconds = Case(robot, task, servo, projection).verdict()
        bound = "-" if verdict.test is None else f"2^{verdict.test.log2_error_bound:.0f}"
        times = (f"{1e3 * value:.0f} ms" for value in (seconds, verdict.build, identity(verdict)))
        yield robot, task, servo, "yes" if projection else "no", verdict.outcome, *times, bound


def identity(verdict: Verdict) -> float:
    """Seconds of the exact test with three points, without conditions and fault injection."""
    if verdict.claim is None:
        return float("nan")
    claim = assembled(verdict.claim)
    begin = time.perf_counter()
    exact.identity(claim, trials=3, seed=0)
    return time.perf_counter() - begin


def residual() -> Any:
    """dV/dt plus the claimed dissipation of the planar arm with PI servo and joint tracking, written by hand in SymPy.

    Five base parameters and viscous friction; every gain and trajectory is a symbol.
    """
    import sympy as sp

    def pair(name: str) -> Any:
        return sp.Matrix(sp.symbols(f"{name}_1:3", real=True))

    q, dq, i, q_c, q_r, w, w_I = (pair(name) for name in ("q", "dq", "i", "qc", "qr", "w", "wI"))
    q_d, dq_d, ddq_d, K, K_P, K_I, B, L, L_I = (
        pair(name) for name in ("qd", "dqd", "ddqd", "K", "KP", "KI", "B", "L", "LI")
    )
    a, a_hat, G = (sp.Matrix(sp.symbols(f"{name}_1:8", real=True)) for name in ("a", "ahat", "G"))
    alpha, kappa, g_0 = sp.symbols("alpha kappa g_0", real=True)
    c_1, c_2, s_2, c_12 = sp.cos(q[0]), sp.cos(q[1]), sp.sin(q[1]), sp.cos(q[0] + q[1])
    M = sp.Matrix([[a[0] + 2 * a[1] * c_2, a[2] + a[1] * c_2], [a[2] + a[1] * c_2, a[2]]])
    C = a[1] * s_2 * sp.Matrix([[-dq[1], -dq[0] - dq[1]], [dq[0], 0]])
    g = g_0 * sp.Matrix([a[3] * c_1 + a[4] * c_12, a[4] * c_12])
    B = sp.Matrix([a[5], a[6]])
    dq_ref = dq_d - alpha * (q - q_d)
    ddq_ref = ddq_d - alpha * (dq - dq_d)
    sigma = dq - dq_ref

    def times(*columns: Any) -> Any:
        return sp.Matrix([sp.prod([column[k] for column in columns]) for k in range(2)])

    torque = M @ ddq_ref + C @ dq_ref + g + times(B, dq_ref)
    Y = torque.jacobian(a)
    tau = Y @ a_hat
    dq_c = dq_ref + times(w_I, q_r) + times(w, tau) - times(w_I, q_c)
    u = -times(K_P, dq - dq_c) - times(K_I, i)
    ddq = M.inv() @ (times(K, u) - C @ dq - times(B, dq) - g)
    K_star = times(K, K_P)
    e = i + q_c - q_r
    halves = [sigma.dot(M @ sigma)]
    halves += [K[k] * K_I[k] * e[k] ** 2 + K_star[k] / L[k] * (w[k] - 1 / K_star[k]) ** 2 for k in range(2)]
    halves += [K_star[k] / L_I[k] * (w_I[k] - K_I[k] / K_P[k]) ** 2 for k in range(2)]
    halves += [(a_hat[k] - a[k]) ** 2 / G[k] for k in range(7)]
    V = kappa * sum(halves) / 2 + (q - q_d).dot(q - q_d) / 2
    rates = [
        (q, dq), (dq, ddq), (i, dq - dq_c), (q_c, dq_c), (q_r, dq_ref), (q_d, dq_d), (dq_d, ddq_d),
        (w, -times(L, tau, sigma)), (w_I, times(L_I, q_c - q_r, sigma)),
        (a_hat, -sp.diag(*G) @ Y.T @ sigma),
    ]  # fmt: skip
    dV = sum((sp.Matrix([V]).jacobian(x) @ rate)[0] for x, rate in rates)
    q_err = q - q_d
    half = q_err / 2 - sigma / alpha
    spent = kappa * sum((K_star[k] + B[k]) * sigma[k] ** 2 for k in range(2)) - sigma.dot(sigma) / alpha
    return dV + spent + sp.Rational(3, 4) * alpha * q_err.dot(q_err) + alpha * half.dot(half)


def simplified(way: str, answer: Any) -> None:
    """Decide with SymPy whether the residual vanishes; write the answer and the seconds to a pipe."""
    import sympy as sp

    begin = time.perf_counter()
    R = residual()
    if way == "simplify":
        zero = sp.simplify(R) == 0
    elif way == "trigsimp":
        zero = sp.trigsimp(sp.expand(R)) == 0
    else:  # hint for SymPy: sin^2 = 1 - cos^2 of two angles is the only identity that is required
        zero = with_a_hint(R) == 0
    answer.send((bool(zero), time.perf_counter() - begin))


def with_a_hint(R: Any) -> Any:
    """One quotient of polynomials with sines and cosines as symbols, reduced by s^2 + c^2 = 1."""
    import sympy as sp

    q_1, q_2 = sp.symbols("q_1:3", real=True)
    s, c, free = sp.Symbol("s"), sp.Symbol("c"), sp.symbols("c_1 c_12")
    R = R.subs([(sp.cos(q_1 + q_2), free[1]), (sp.cos(q_1), free[0]), (sp.sin(q_2), s), (sp.cos(q_2), c)])
    numerator = sp.expand(sp.numer(sp.together(R)))
    return sp.expand(sp.rem(sp.Poly(numerator, s), sp.Poly(s**2 + c**2 - 1, s)).as_expr())


def by_sympy(way: str, limit: float) -> str:
    """SymPy's answer within a time limit."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=simplified, args=(way, theirs))
    process.start()
    try:
        if not ours.poll(limit):
            return f"no answer within {limit:.0f} s"
        zero, seconds = ours.recv()
        return f"{'zero' if zero else 'not recognised as zero'} after {seconds:.1f} s"
    except EOFError:
        return "failed"
    finally:
        process.kill()
        process.join()


def table(lines: Iterator[tuple[str, ...]]) -> None:
    """Print rows as they arrive, in columns wide enough for the headings and the usual entries."""
    widths = [9, 8, 5, 10, 14, 7, 11, 8, 11]
    for line in lines:
        say("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> int:
    """Print the table, then the answers of SymPy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS), choices=list(ROBOTS))
    parser.add_argument("--sympy", type=float, default=60, metavar="SECONDS", help="time limit; 0 leaves SymPy out")
    chosen = parser.parse_args()
    table(rows(chosen.robots))
    if chosen.sympy:
        Case("arm2", "joint", "PI", False).verdict()  # once, so that the measured run imports nothing
        verdict, seconds = Case("arm2", "joint", "PI", False).verdict()
        alone = f"the identity alone in {1e3 * identity(verdict):.0f} ms"
        say(f"\narm2, joint tracking, PI servo\n  engine: {verdict.outcome} after {1e3 * seconds:.0f} ms, {alone}")
        for way in ("simplify", "trigsimp", "by hand"):
            say(f"  SymPy, {way}: {by_sympy(way, chosen.sympy)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
