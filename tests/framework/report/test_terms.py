from __future__ import annotations

import numpy as np
import pytest

from dmframe.block.parameter import Spec
from dmframe.certify.claim import claim_of
from dmframe.graph.graph import Graph
from dmframe.report.terms import parameter_text, shown, terms_of


def test_weights_are_those_of_the_theory_and_their_numbers_those_of_the_graph(proved):
    terms = terms_of(proved.verdict.claim)
    found = {(row.block, row.of): (row.weight, row.value, row.factor) for row in terms.storage}
    assert found["task", "q - q_{d}"] == ("1", "1", "1")
    assert found["dynamics", r"\hat{a}_{d} - a_{d}"] == (r"1/\Gamma", "0.01", "kappa")
    assert found["inverse", "i + q_{c} - q_{r}"] == ("K K_{I}", "240, 120", "kappa")
    assert found["inverse", r"w - 1/K_{\star}"] == (r"K_{\star}/\Lambda", "6000, 3000", "kappa")
    assert found["arm", r"\sigma"] == ("M(q)", "varies with the pose", "kappa")
    lost = {row.of: (row.kind, row.weight, row.value) for row in terms.dissipation if row.block in ("inverse", "arm")}
    assert lost[r"\sigma"] == ("square", r"K_{\star} + B", "61, 30.5")
    assert lost[r"\dot{q} - \dot{q}_{\mathrm{ref}}"] == ("lemma", r"\mathrm{coulomb}", "0")


def test_the_formulas_hold_every_term_once_and_kappa_with_the_servo_level_alone(proved):
    terms = terms_of(proved.verdict.claim)
    assert terms.V[0].right == (
        r"= \tfrac12 |q - q_{d}|^2_{W_{1}} + \tfrac{\kappa}{2} |\hat{a}_{d} - a_{d}|^2_{W_{2}}"
        r" + \tfrac{\kappa}{2} |i + q_{c} - q_{r}|^2_{W_{3}} + \tfrac{\kappa}{2} |w - 1/K_{\star}|^2_{W_{4}}"
        r" + \tfrac{\kappa}{2} |w_{I} - K_{I}/K_{P}|^2_{W_{5}} + \tfrac{\kappa}{2} |\sigma|^2_{W_{6}}"
    )
    assert terms.rate[0].right == (
        r"= - |q - q_{d}|^2_{D_{1}} - |\tfrac{1}{2} (q - q_{d}) - s/\bar{\alpha}|^2_{D_{2}}"
        r" - \kappa\, |\sigma|^2_{D_{3}} - \kappa\, \ell_{1} + \kappa\,\pi_{1} + \kappa\,\pi_{2} + \kappa\,\pi_{3}"
        r" + |s|^2/\bar{\alpha}"
    )
    assert [name for _, name in terms.projections] == ["dynamics.a_d_hat", "inverse.w", "inverse.w_I"]


def test_the_inertia_of_a_single_joint_is_called_m_too(continuous):
    arm = next(row for row in terms_of(continuous.verdict.claim).storage if row.block == "arm")
    assert (arm.weight, arm.value) == ("M(q)", "0.24")


def test_the_legend_names_each_symbol_of_the_weights(proved):
    legend = {item.symbol: (item.label, item.value, item.unit) for item in terms_of(proved.verdict.claim).legend}
    assert legend["K"] == ("arm.K", "1", "N m/V")
    assert legend[r"\Lambda_{I}"] == ("inverse.Lambda_I", "1", "1/(rad^2 s)")


@pytest.mark.parametrize(
    ("values", "expected"),
    [([2.0, 2.0], "2"), ([1.0, 2.5], "1, 2.5"), (np.arange(6.0), "6 values from 0 to 5"), ([], "none")],
)
def test_numbers_are_shown_as_a_table_shows_them(values, expected):
    assert shown(np.array(values)) == expected


GAIN = "[[2, 1, 0], [1, 2, 0], [0, 0, 1]]"


def test_a_gain_that_is_a_matrix_is_written_out_and_so_is_its_inverse_in_v():
    graph = Graph.read("observed_regulation_pi", ["geometry.adapt=tool", f"geometry.Gamma_k={GAIN}"])
    terms = terms_of(claim_of(graph.diagram))
    assert [item.value for item in terms.legend if item.label == "geometry.Gamma_k"] == [GAIN]
    (weight,) = [row.value for row in terms.storage if row.block == "geometry"]
    found = np.array([[float(number) for number in row.split(",")] for row in weight[2:-2].split("], [")])
    np.testing.assert_allclose(found, np.linalg.inv([[2, 1, 0], [1, 2, 0], [0, 0, 1]]), atol=5e-5)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (np.diag([1.0, 2, 3, 4]) + 0.5, "4 x 4, diagonal from 1.5 to 4.5, off the diagonal 0.5"),
        (np.diag([3.0, 3, 3, 3]), "4 x 4, diagonal 3, off the diagonal 0"),
        (np.arange(12.0).reshape(4, 3), "4 x 3, from 0 to 11"),
        (np.arange(16.0).reshape(4, 4), "4 x 4, from 0 to 15"),
        (np.array([[2.0, -1.0], [-1.0, 2.0]]), "[[2, -1], [-1, 2]]"),
        (np.array([[7.0]]), "7"),
    ],
)
def test_a_large_matrix_is_printed_by_its_size_and_its_entries_on_and_off_the_diagonal(values, expected):
    assert shown(values) == expected


@pytest.mark.parametrize(
    ("form", "value", "expected"),
    [
        ("box", [[0.0, 0.004]], "0 to 0.004"),
        ("box", [[0.0, 1], [0, 2]], "0 to [1, 2]"),
        ("ball", [[1.0, 2], [3, 2]], "[1, 3] plus or minus 2"),
        ("diagonal", [1.0, 2], "1, 2"),
    ],
)
def test_a_box_and_a_ball_are_printed_by_both_parts_and_brackets_hold_lists_alone(form, value, expected):
    assert parameter_text(np.array(value), Spec("n", "", "", form)) == expected


def test_a_symbol_that_another_block_states_has_its_row():
    legend = {item.symbol: (item.label, item.value, item.unit) for item in terms_of(theorem("theorem_1")).legend}
    assert legend["K_{2}"] == ("task.K_2", "3", "rad^2/(m^2 s)")
    assert legend[r"\mathrm{task\_weight}"] == ("task.alpha", "200", "N/m")
    assert legend["B"] == ("arm.B", "5, 5, 2", "N m s/rad")


def theorem(name):
    return claim_of(Graph.read(name).diagram)
