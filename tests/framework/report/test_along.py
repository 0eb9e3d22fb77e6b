from __future__ import annotations

import numpy as np
import pytest

from dmframe.common.errors import ValueFault
from dmframe.common.text import Text
from dmframe.results.along import StorageTrace, TermAlong, along
from dmframe_plants.arm2.closed_form import mass_matrix


def run_of(case, duration):
    return case.graph.until(duration).simulate(case.diagram)


def test_v_along_a_run_is_the_v_of_the_textbook(proved):
    run, kappa = run_of(proved, 0.2), 0.7
    found = along(proved.verdict.claim, run, kappa)
    blocks = proved.diagram.blocks
    K_P, K_I = np.array(blocks["servo"].K_P), np.array(blocks["servo"].K_I)
    inverse, path = blocks["inverse"], blocks["path"]
    t = run.time[:, None]
    rate, amplitude = np.array(path.rate), np.array(path.amplitude)
    q_d = np.array(path.center) + amplitude * np.sin(rate * t)
    q, dq = run["arm.q"], run["arm.dq"]
    sigma = dq - amplitude * rate * np.cos(rate * t) + blocks["task"].alpha_bar * (q - q_d)
    e = run["servo.i"] + run["servo.q_c"] - run["inverse.q_r"]
    inertia = [float(x) for row in proved.diagram.robot.inertia for x in row]
    a_d = np.array([*inertia, *blocks["arm"].viscous])
    servo_level = (
        np.einsum("ti,tij,tj->t", sigma, np.array([mass_matrix(x) for x in q]), sigma)
        + (K_I * e**2).sum(1)
        + (K_P / inverse.Lambda * (run["inverse.w"] - 1 / K_P) ** 2).sum(1)
        + (K_P / inverse.Lambda_I * (run["inverse.w_I"] - K_I / K_P) ** 2).sum(1)
        + ((run["dynamics.a_d_hat"] - a_d) ** 2 / blocks["dynamics"].Gamma).sum(1)
    )
    V = kappa * servo_level / 2 + ((q - q_d) ** 2).sum(1) / 2
    np.testing.assert_allclose(found.V, V, rtol=1e-10)


def test_the_terms_add_up_to_v_and_have_the_names_of_the_certificate(proved):
    found = along(proved.verdict.claim, run_of(proved, 0.1), 0.5)
    np.testing.assert_allclose(sum(term.values for term in found.terms), found.V, rtol=1e-12)
    assert next((term.block, term.of) for term in found.terms) == ("task", "q - q_d")
    assert len(found.terms) == 6
    assert all((term.values >= 0).all() for term in found.terms)


def test_kappa_weighs_the_servo_level_and_not_the_cascade(proved):
    run = run_of(proved, 0.1)
    one, ten = (along(proved.verdict.claim, run, kappa) for kappa in (1.0, 10.0))
    for first, second in zip(one.terms, ten.terms, strict=True):
        factor = 1 if first.block == "task" else 10
        np.testing.assert_allclose(second.values, factor * first.values, rtol=1e-12)


def test_in_continuous_time_v_never_rises_beyond_the_integrators_error(continuous):
    found = along(continuous.verdict.claim, run_of(continuous, 8.0), float(continuous.verdict.kappa.chosen))
    assert found.V[0] > found.V[-1] > 0
    assert found.largest_increase < 1e-9 * found.V[0]


def test_the_largest_increase_is_reported_with_its_time():
    found = StorageTrace(np.array([0.0, 1.0, 2.0, 3.0]), 1.0, np.array([5.0, 5.5, 3.0, 4.5]), ())
    assert (found.largest_increase, found.increase_at, found.rises) == (1.5, 2.0, 2)


@pytest.mark.parametrize("V", [[3.0, 2.0, 2.0], [1.0]])
def test_a_v_that_never_rises_has_no_increase(V):
    found = StorageTrace(np.arange(float(len(V))), 1.0, np.array(V), (TermAlong("a", Text("x"), np.array(V)),))
    assert (found.largest_increase, found.increase_at, found.rises) == (0.0, None, 0)


def test_a_run_of_other_blocks_is_refused(proved, failing):
    with pytest.raises(ValueFault) as caught:
        along(proved.verdict.claim, run_of(failing, 0.1))
    expected = "V along a run: expected a run of the certificate's blocks, with 22 of dynamics.a_d_hat, found 11 of"
    assert caught.value.text == expected
