"""Equations of the paper that no block states, since they follow from others: for a planar arm, at random states.

This file uses NumPy only and no part of the framework, so it checks the paper's own chain of equations, and the
readings that differ. All products of columns are element by element. Derivatives of V are complex steps, exact up to
rounding: Im V(x + i h dx/dt) / h.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[Any]
SEEDS = range(5)


def kinematic_regressor(q: Array, psi: Array) -> Array:
    """Y_k of eq. (4); the kinematic parameters are the two lengths."""
    c, s, turn = np.cos(np.cumsum(q)), np.sin(np.cumsum(q)), np.cumsum(psi)
    return np.array([-s * turn, c * turn])


def jacobian(q: Array, lengths: Array) -> Array:
    return np.column_stack([kinematic_regressor(q, psi) @ lengths for psi in np.eye(2)])


def position(q: Array, lengths: Array) -> Array:
    return np.array([np.cos(np.cumsum(q)) @ lengths, np.sin(np.cumsum(q)) @ lengths])


def Y_d(q: Array, dq: Array, v: Array, a: Array) -> Array:
    """Y_d of eq. (5): three inertial parameters, two weights, two of viscous friction."""
    c, s, (c_1, c_12) = np.cos(q[1]), np.sin(q[1]), np.cos(np.cumsum(q))
    third = [
        c * (2 * a[0] + a[1]) - s * dq[1] * v[0] - s * (dq[0] + dq[1]) * v[1],
        c * a[0] + s * dq[0] * v[0],
    ]
    return np.array(
        [
            [a[0], a[1], third[0], c_1, c_12, v[0], 0],
            [0, a[0] + a[1], third[1], 0, c_12, 0, v[1]],
        ]
    )


def mass(q: Array, a_d: Array) -> Array:
    zero = np.zeros(2)
    free = a_d * [1, 1, 1, 0, 0, 0, 0]
    return np.column_stack([Y_d(q, zero, zero, axis) @ free for axis in np.eye(2)])


def coriolis(q: Array, dq: Array, a_d: Array) -> Array:
    free = a_d * [1, 1, 1, 0, 0, 0, 0]
    return np.column_stack([Y_d(q, dq, axis, np.zeros(2)) @ free for axis in np.eye(2)])


def square(vector: Array, weight: Array | float = 1.0) -> Any:
    return np.sum(weight * vector * vector)


Motion = Mapping[str, Array]


def rate_of(V: Callable[[SimpleNamespace], Any], x: Motion, dx: Motion) -> float:
    """dV/dt along dx/dt."""
    h = 1e-30
    return float(V(SimpleNamespace(**{name: x[name] + 1j * h * dx[name] for name in x})).imag / h)


def drawn(seed: int, **shapes: int) -> dict[str, Array]:
    draw = np.random.default_rng(seed)
    return {name: draw.uniform(-1, 1, size) for name, size in shapes.items()}


def truth(seed: int) -> SimpleNamespace:
    """True parameters and gains, all positive; K_c above the bound given by M_bar."""
    draw = np.random.default_rng(100 + seed)
    names = ("K", "K_P", "K_I", "K_D", "Lambda", "Lambda_P", "Lambda_I", "K_1", "K_2", "K_c", "lengths", "Gamma_k")
    t = SimpleNamespace(**{name: draw.uniform(0.5, 2, 2) for name in names})
    t.a_d, t.Gamma = np.array([2.5, 0.4, 0.3, 9.0, 4.0, 1.2, 0.7]) * draw.uniform(0.8, 1.2, 7), draw.uniform(0.5, 2, 7)
    t.B, t.alpha, t.K_c = t.a_d[5:], 1.7, t.K_c + 2
    t.beta, t.gamma = 1.5, 0.9
    return t


def acceleration(t: SimpleNamespace, q: Array, dq: Array, u: Array) -> Array:
    """Eq. (3)."""
    rest = Y_d(q, dq, dq, np.zeros(2)) @ t.a_d
    return np.linalg.solve(mass(q, t.a_d), t.K * u - rest)


def filtered(t: SimpleNamespace, x: Motion) -> SimpleNamespace:
    """Eqs. (8), (9) and (13): -K_2 y, its derivative, dy, J_hat, Dx and the rate of the lengths' estimate."""
    x_d = np.array([0.3, 0.2])
    J_hat, Dx = jacobian(x["q"], x["a_k"]), position(x["q"], t.lengths) - x_d
    dy = -t.K_1 * x["y"] + t.K_1 * (J_hat.T @ Dx)
    da_k = t.Gamma_k * (kinematic_regressor(x["q"], x["dq"]).T @ Dx)
    return SimpleNamespace(v=-t.K_2 * x["y"], a=-t.K_2 * dy, dy=dy, J_hat=J_hat, Dx=Dx, da_k=da_k, x_d=x_d)


def task_storage(t: SimpleNamespace, x: SimpleNamespace, x_d: Array) -> Any:
    """The terms of the task level in eqs. (18) and (41)."""
    error = square(position(x.q, t.lengths) - x_d) + square(x.y, t.K_2 / t.K_1)
    return t.alpha * (error + square(x.a_k - t.lengths, 1 / t.Gamma_k)) / 2


PI = {"q": 2, "dq": 2, "q_c": 2, "q_r": 2, "y": 2, "a_k": 2, "w": 2, "w_I": 2, "a": 7}


def theorem_1(t: SimpleNamespace, x: Motion) -> tuple[SimpleNamespace, Motion]:
    """Eqs. (6), (8)-(10) and (12)-(16)."""
    f = filtered(t, x)
    s, Y = x["dq"] - f.v, Y_d(x["q"], x["dq"], f.v, f.a)
    tau = -t.alpha * f.J_hat.T @ f.Dx + Y @ x["a"]
    dq_c = f.v + x["w_I"] * (x["q_r"] - x["q_c"]) + x["w"] * tau
    u = -t.K_P * (x["dq"] - dq_c) - t.K_I * (x["q"] - x["q_c"])
    dx = {
        "q": x["dq"],
        "dq": acceleration(t, x["q"], x["dq"], u),
        "q_c": dq_c,
        "q_r": f.v,
        "y": f.dy,
        "a_k": f.da_k,
        "w": -t.Lambda * tau * s,
        "w_I": t.Lambda_I * (x["q_c"] - x["q_r"]) * s,
        "a": -t.Gamma * (Y.T @ s),
    }
    return SimpleNamespace(s=s, Y=Y, tau=tau, f=f), dx


@pytest.mark.parametrize("seed", SEEDS)
def test_theorem_1s_closed_loop_and_lyapunov_function_are_eqs_11_17_and_18(seed: int) -> None:
    t, x = truth(seed), drawn(seed, **PI)
    found, dx = theorem_1(t, x)
    s, f, e, K_star = found.s, found.f, x["q"] - x["q_r"], t.K * t.K_P
    J, Dw, Dw_I = jacobian(x["q"], t.lengths), x["w"] - 1 / K_star, x["w_I"] - t.K_I / t.K_P
    Y_k = kinematic_regressor(x["q"], x["dq"])
    eq_11 = -f.J_hat @ (t.K_2 * x["y"]) - Y_k @ (x["a_k"] - t.lengths) + f.J_hat @ s
    np.testing.assert_allclose(J @ x["dq"], eq_11, atol=1e-12)
    left = mass(x["q"], t.a_d) @ (dx["dq"] - f.a) + coriolis(x["q"], x["dq"], t.a_d) @ s
    eq_17 = -(K_star + t.B) * s - t.alpha * f.J_hat.T @ f.Dx - t.K * t.K_I * e + found.tau * K_star * Dw
    eq_17 = eq_17 - K_star * (x["q_c"] - x["q_r"]) * Dw_I + found.Y @ (x["a"] - t.a_d)
    np.testing.assert_allclose(left, eq_17, atol=1e-10)

    def V(x: SimpleNamespace) -> Any:
        s = x.dq + t.K_2 * x.y
        servo = s @ mass(x.q, t.a_d) @ s + square(x.q - x.q_r, t.K * t.K_I)
        estimates = square(x.w - 1 / K_star, K_star / t.Lambda) + square(x.w_I - t.K_I / t.K_P, K_star / t.Lambda_I)
        return task_storage(t, x, f.x_d) + (servo + estimates + square(x.a - t.a_d, 1 / t.Gamma)) / 2

    spent = t.alpha * square(x["y"], t.K_2) + square(s, K_star + t.B)
    assert rate_of(V, x, dx) == pytest.approx(-spent, abs=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_observers_cascade_is_eqs_24_25_and_29(seed: int) -> None:
    """With dq_r of eq. (20) and any s; the two terms that (29) drops are squares, so it is an inequality."""
    t, x = truth(seed), drawn(seed, q=2, dq=2, x_o=2, a_k=2)
    x_d, J, J_hat = np.array([0.3, 0.2]), jacobian(x["q"], t.lengths), jacobian(x["q"], x["a_k"])
    Dx, Dx_o = position(x["q"], t.lengths) - x_d, x["x_o"] - position(x["q"], t.lengths)
    dq_r = -t.gamma * J_hat.T @ (x["x_o"] - x_d)
    s, Y_k, Da_k = x["dq"] - dq_r, kinematic_regressor(x["q"], x["dq"]), x["a_k"] - t.lengths
    dx_o = J_hat @ dq_r - t.beta * J_hat @ J_hat.T @ Dx_o  # (19)
    eq_24 = -t.beta * J_hat @ J_hat.T @ Dx_o + Y_k @ Da_k - J_hat @ s
    eq_25 = -t.gamma * J_hat @ J_hat.T @ (x["x_o"] - x_d) - Y_k @ Da_k + J_hat @ s
    np.testing.assert_allclose(dx_o - J @ x["dq"], eq_24, atol=1e-12)
    np.testing.assert_allclose(J @ x["dq"], eq_25, atol=1e-12)
    da_k = t.Gamma_k * (Y_k.T @ (Dx - Dx_o))  # (22)

    def V(x: SimpleNamespace) -> Any:  # V** of the proof, less the integral of |s|^2
        here = position(x.q, t.lengths)
        return (square(x.x_o - here) + square(here - x_d) + square(x.a_k - t.lengths, 1 / t.Gamma_k)) / 2

    a, b = J_hat.T @ Dx_o, J_hat.T @ Dx
    rate = rate_of(V, x, {"q": x["dq"], "dq": x["dq"], "x_o": dx_o, "a_k": da_k}) - (1 / t.beta + 1 / t.gamma) * s @ s
    form = 0.75 * t.beta * a @ a + t.gamma * a @ b + 0.75 * t.gamma * b @ b
    assert rate <= -form
    dropped = t.beta * square(a / 2 + s / t.beta) + t.gamma * square(b / 2 - s / t.gamma)
    assert rate == pytest.approx(-form - dropped, abs=1e-12)
    Q = np.array([[0.75 * t.beta, t.gamma / 2], [t.gamma / 2, 0.75 * t.gamma]])
    assert (np.linalg.eigvalsh(Q)[0] > 0) == (t.beta > 4 * t.gamma / 9)  # (26)


PID = {**PI, "z": 2, "i": 2, "w_P": 2}


def theorem_4(t: SimpleNamespace, x: Motion) -> tuple[SimpleNamespace, Motion]:
    """Eqs. (7), (8), (13) and (32)-(39); i is the servo's integral of q - q_c, z that of q_c - q_r."""
    f, e, h = filtered(t, x), x["q"] - x["q_r"], x["q_c"] - x["q_r"]
    dq_r = -t.K_c * x["q_r"] - t.K_2 * x["y"] + t.K_c * x["q"]  # (34)
    v = dq_r - t.K_c * e  # (32)
    ddq_r = t.K_c * (x["dq"] - dq_r) + f.a
    a = ddq_r - t.K_c * (x["dq"] - dq_r)  # (33)
    s, xi, Y = x["dq"] - dq_r, x["dq"] - v, Y_d(x["q"], x["dq"], v, a)
    tau = -t.alpha * f.J_hat.T @ f.Dx + Y @ x["a"]
    dq_c = v + x["w_P"] * x["q_r"] + x["w"] * tau - x["w_P"] * x["q_c"] - x["w_I"] * x["z"]  # (35)
    u = -t.K_D * (x["dq"] - dq_c) - t.K_P * (x["q"] - x["q_c"]) - t.K_I * x["i"]
    dx = {
        "q": x["dq"],
        "dq": acceleration(t, x["q"], x["dq"], u),
        "q_c": dq_c,
        "q_r": dq_r,
        "y": f.dy,
        "a_k": f.da_k,
        "z": h,
        "i": x["q"] - x["q_c"],
        "w": -t.Lambda * tau * xi,
        "w_P": t.Lambda_P * h * xi,
        "w_I": t.Lambda_I * x["z"] * xi,
        "a": -t.Gamma * (Y.T @ xi),
    }
    return SimpleNamespace(s=s, xi=xi, Y=Y, tau=tau, f=f, e=e, h=h, a=a, dq_r=dq_r), dx


def storage_41(t: SimpleNamespace, x_d: Array, weight: Array) -> Callable[[SimpleNamespace], Any]:
    """V of eq. (41), with the weight of its term in the integral of xi."""
    K_star, M_bar = t.K * t.K_D, (t.K_D + t.B / t.K) * t.K_c + t.K_P - t.K_I / t.K_c

    def V(x: SimpleNamespace) -> Any:
        e, xi = x.q - x.q_r, x.dq + t.K_2 * x.y
        servo = xi @ mass(x.q, t.a_d) @ xi + square(e + t.K_c * (x.i + x.z), weight)
        servo += square(e, t.K * M_bar + t.K * t.K_c * t.K_D + t.K_c * t.B)
        estimates = square(x.w - 1 / K_star, K_star / t.Lambda) + square(x.w_P - t.K_P / t.K_D, K_star / t.Lambda_P)
        estimates += square(x.w_I - t.K_I / t.K_D, K_star / t.Lambda_I) + square(x.a - t.a_d, 1 / t.Gamma)
        return task_storage(t, x, x_d) + (servo + estimates) / 2

    return V


@pytest.mark.parametrize("seed", SEEDS)
def test_theorem_4s_closed_loop_and_lyapunov_function_are_eqs_40_to_42(seed: int) -> None:
    t, x = truth(seed), drawn(seed, **PID)
    found, dx = theorem_4(t, x)
    s, xi, e, h, K_star = found.s, found.xi, found.e, found.h, t.K * t.K_D
    M_bar = (t.K_D + t.B / t.K) * t.K_c + t.K_P - t.K_I / t.K_c
    np.testing.assert_allclose(xi, s + t.K_c * e, atol=1e-12)
    left = mass(x["q"], t.a_d) @ (dx["dq"] - found.a) + coriolis(x["q"], x["dq"], t.a_d) @ xi
    eq_40 = found.tau * K_star * (x["w"] - 1 / K_star) - K_star * h * (x["w_P"] - t.K_P / t.K_D)
    eq_40 = eq_40 - K_star * x["z"] * (x["w_I"] - t.K_I / t.K_D) + found.Y @ (x["a"] - t.a_d)
    eq_40 = eq_40 - t.alpha * found.f.J_hat.T @ found.f.Dx - t.K * ((t.K_D + t.B / t.K) * s + M_bar * e)
    eq_40 = eq_40 - t.K * t.K_I / t.K_c * (e + t.K_c * (x["i"] + x["z"]))
    np.testing.assert_allclose(left, eq_40, atol=1e-10)
    spent = t.alpha * square(x["y"], t.K_2) + square(s, K_star + t.B) + square(e, t.K * M_bar * t.K_c)
    right, printed = (storage_41(t, found.f.x_d, weight) for weight in (t.K * t.K_I / t.K_c, t.K * t.K_I))
    assert rate_of(right, x, dx) == pytest.approx(-spent, abs=1e-10)
    missed = rate_of(printed, x, dx) + spent  # eq. (41) as our source prints it, without 1/K_c
    assert missed == pytest.approx(np.sum(t.K * t.K_I * (1 - 1 / t.K_c) * (e + t.K_c * (x["i"] + x["z"])) * xi))
    assert abs(missed) > 1e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_the_command_is_a_filter_of_what_v_bounds_eq_44(seed: int) -> None:
    t, x = truth(seed), drawn(seed, **PID)
    found, dx = theorem_4(t, x)
    left = dx["q_c"] - dx["q_r"] + x["w_P"] * found.h + x["w_I"] * x["z"]
    np.testing.assert_allclose(left, x["w"] * found.tau - t.K_c * found.e, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_users_torque_through_a_pi_servo_is_eqs_48_to_60(seed: int) -> None:
    t = truth(seed)
    x = drawn(seed, q=2, dq=2, q_c=2, w=2, w_I=2, a=7, Dq=2, dDq=2, ddq_d=2)
    K_star, h, alpha_bar = t.K * t.K_P, x["q_c"] - x["q"], 1.3
    a_hat = t.a_d * (1 + 0.2 * x["a"])  # near the true values, so that M_hat is invertible
    wish = x["ddq_d"] - 2 * alpha_bar * x["dDq"] - alpha_bar**2 * x["Dq"]
    tau_d = Y_d(x["q"], x["dq"], x["dq"], wish) @ a_hat  # (59)
    dq_c = x["dq"] - x["w_I"] * h + x["w"] * tau_d  # (49)
    u = -t.K_P * (x["dq"] - dq_c) - t.K_I * (x["q"] - x["q_c"])
    Dw, Dw_I, Da = x["w"] - 1 / K_star, x["w_I"] - t.K_I / t.K_P, a_hat - t.a_d
    eq_51 = tau_d / K_star + Dw * tau_d - Dw_I * h
    np.testing.assert_allclose(dq_c - x["dq"] + t.K_I / t.K_P * h, eq_51, atol=1e-12)
    off = K_star * (Dw * tau_d - Dw_I * h)
    np.testing.assert_allclose(t.K * u, tau_d + off, atol=1e-11)  # (48), (52)
    ddq = acceleration(t, x["q"], x["dq"], u)
    Y = Y_d(x["q"], x["dq"], x["dq"], ddq)
    np.testing.assert_allclose(Y @ t.a_d, tau_d + off, atol=1e-10)  # (53)
    e = Y @ a_hat - tau_d  # (54)
    np.testing.assert_allclose(e, Y @ Da + off, atol=1e-10)  # (55)
    s_star, ds_star = x["dDq"] + alpha_bar * x["Dq"], ddq - x["ddq_d"] + alpha_bar * x["dDq"]
    eq_60 = np.linalg.solve(mass(x["q"], a_hat), Y @ Da + off)
    np.testing.assert_allclose(ds_star + alpha_bar * s_star, eq_60, atol=1e-9)
    da, dw, dw_I = -t.Gamma * (Y.T @ e), -t.Lambda * tau_d * e, t.Lambda_I * h * e  # (56)-(58)
    rate = Da @ (da / t.Gamma) + Dw @ (K_star / t.Lambda * dw) + Dw_I @ (K_star / t.Lambda_I * dw_I)
    assert rate == pytest.approx(-e @ e, abs=1e-9)
