from __future__ import annotations

import casadi as ca
import numpy as np

from dmframe.block.linalg import ldl, solve_spd


def positive_definite(n):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    return root @ root.T + np.eye(n), rng.normal(size=(n, 2))


def test_the_unrolled_solution_agrees_with_numpy():
    for n in (1, 2, 5, 7):
        A, b = positive_definite(n)
        symbol, right = ca.SX.sym("A", n, n), ca.SX.sym("b", n, 2)
        solve = ca.Function("solve", [symbol, right], [solve_spd(symbol, right)])
        np.testing.assert_allclose(np.array(solve(A, b)), np.linalg.solve(A, b), rtol=1e-10)


def test_the_factors_multiply_back_and_the_pivots_are_positive():
    A, _ = positive_definite(6)
    L, d = ldl(ca.SX(A))
    L, d = np.array(ca.DM(L)), np.array(ca.DM(ca.vertcat(*d))).ravel()
    assert np.all(d > 0)
    np.testing.assert_allclose(L, np.tril(L))
    np.testing.assert_allclose(L @ np.diag(d) @ L.T, A, rtol=1e-12)


def test_only_the_lower_triangle_is_read():
    A, b = positive_definite(4)
    np.testing.assert_array_equal(
        np.array(ca.DM(solve_spd(ca.SX(A), ca.SX(b)))), np.array(ca.DM(solve_spd(ca.SX(np.tril(A)), ca.SX(b))))
    )


def test_only_field_operations_occur():
    symbol, right = ca.SX.sym("A", 4, 4), ca.SX.sym("b", 4)
    f = ca.Function("solve", [symbol, right], [solve_spd(symbol, right)])
    allowed = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_SQ}
    assert {f.instruction_id(i) for i in range(f.n_instructions())} <= allowed | {ca.OP_CONST, ca.OP_INV}
