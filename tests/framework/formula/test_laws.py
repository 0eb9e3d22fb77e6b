"""The laws of blocks, printed from the code, compared with the paper's; and faults that would print another law."""

from __future__ import annotations

from copy import copy
from dataclasses import fields, replace
from itertools import chain, repeat
from typing import ClassVar, final

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Square
from dmframe.block.naming import named
from dmframe.block.parameter import Diagonal, Positive
from dmframe.block.port import Output, Side, State
from dmframe.catalogue import block_types
from dmframe.certify import NotApplicableError, claim_of
from dmframe.common.errors import BlockError
from dmframe.common.names import unicode_name
from dmframe.diagram import Diagram
from dmframe.formula import laws_of, printed
from dmframe.formula.alone import law_of_type, options_of, read_type, simplest, variants
from dmframe.formula.points import Draw, Pair, agree, in_balls
from dmframe.formula.tree import Applied, Name, Node, Unprinted
from dmframe.formula.where import where
from dmframe.graph.graph import Graph
from dmframe_blocks.adaptive_kinematics import links, tool
from dmframe_blocks.regressor import heavy
from dmframe_blocks.sampled_inverse import SampledInverse

KINDS = block_types()


def ports_of(kind):
    return {port.name for port in (*kind.inputs, *kind.outputs, *kind.states, *kind.truth)} | set(kind.model_fields)


@pytest.mark.parametrize("name", list(KINDS))
def test_every_block_type_prints_each_symbol_defined_or_states_that_it_needs_a_graph(name):
    found = simplest(KINDS[name])
    assert found is not None or name == "waypoints"
    if found is not None:
        assert found[1].matrices
        check_symbols(found[1], ports_of(KINDS[name]))


def names(node, kind):
    """All nodes of a kind in a tree."""
    if isinstance(node, tuple):
        return [found for item in node for found in names(item, kind)]
    if not isinstance(node, Node):
        return []
    inside = [found for item in fields(node) for found in names(getattr(node, item.name), kind)]
    return [node] * isinstance(node, kind) + inside


@pytest.mark.parametrize("name", list(KINDS))
def test_every_symbol_of_an_options_law_is_defined_and_none_by_itself(name):
    for read, _ in variants(KINDS[name]):
        check_symbols(read.law(), ports_of(KINDS[name]), complete=name not in OMITTED)


OMITTED = {"expert_aggregation", "sampled_inverse"}
"""Blocks with an option of whose law an expression is too long to print: the periodic columns, an identified delay."""


def check_symbols(law, given, complete=True):
    """From the trees: no packaged block omits an expression, and two objects of a law have different names."""
    known = given | {line.name for line in law.lines}
    defined = {sign for sign, _ in where(law.lines)}
    for line in law.lines:
        right, left = line.right.node, line.left.node
        assert names(right, Unprinted) == [] or not complete
        functions = names(right, Applied)
        own = isinstance(left, Name) and left.name in {item.name for item in names(right, Name)}
        assert not own, line.whole.text
        assert known.isdisjoint(item.function for item in functions), line.whole.text
        for item in names(right, Name):
            assert item.name in known or unicode_name(item.name) in defined, (line.whole.text, item.name)
        for item in functions:
            standard = item.function in ("sin", "cos", "tanh", "abs", "exp", "sqrt", "min", "max")
            assert standard or any(sign.startswith(f"{unicode_name(item.function)}(") for sign in defined)


def test_the_block_that_cannot_be_created_with_its_defaults_prints_every_way_in_which_it_can():
    kind = KINDS["filtered_regressor"]
    label, law = simplest(kind)
    assert label == "Gamma_b"
    lines = {line.name: line.right.text for line in (*law.outputs, *law.rates, *law.definitions)}
    assert lines["b_hat"] == "-Gamma_b e_f"
    assert lines["Y_z"] == "bandwidth (Y_r - Y_f)"
    assert lines["Y_r"] == "[Y_inertia(q, 0, 0, 0) - (d(Y_p' dq/2)/dq)', diag(dq)]"
    options = dict(options_of(kind))
    assert list(options) == ["friction: [viscous, coulomb]", "friction: [coulomb]", "bias: true, without Gamma_b"]
    alone = law_of_type(kind, bias=True)
    assert "b_hat" not in {line.name for line in alone.rates}
    assert "b_hat" not in " ".join(line.whole.text for line in alone.lines)


def test_an_option_that_needs_another_one_is_shown_with_it():
    assert "forgetting with R" in dict(options_of(KINDS["adaptive_kinematics"]))


def test_what_prints_as_a_word_takes_the_parameters_that_it_states():
    """Known places: mass and first moments of each link; the tool's translation is last."""
    a = ca.DM(range(20))
    assert [float(x) for x in heavy(a).nonzeros()] == [0, 1, 2, 3, 10, 11, 12, 13]
    assert [float(x) for x in heavy(a.T).nonzeros()] == [0, 1, 2, 3, 10, 11, 12, 13]
    assert [float(x) for x in links(a[:9]).nonzeros()] == [0, 1, 2, 3, 4, 5]
    assert [float(x) for x in tool(ca.horzcat(a[:9], a[:9]).T).nonzeros()] == [6, 6, 7, 7, 8, 8]


def test_a_start_that_is_the_truth_and_an_error_leaves_the_error():
    law = law_of_type(KINDS["adaptive_kinematics"], leak=0.1)
    assert [term.whole.text for term in law.residual] == ["|start_error|^2_(task_weight leak/(2 Gamma_k))"]


def test_one_function_has_one_sign():
    """tanh(v / v_0) of a lemma is phi; a dead zone in a lemma is beyond, with its width."""
    law = law_of_type(KINDS["manipulator"])
    assert [term.whole.text for term in law.dissipation] == ["(dq - dq_ref)' coulomb (phi(dq) - phi(dq_ref))"]
    assert "tanh(q̇/v_0)" in dict(where(law.lines))["φ(q̇)"]
    law = law_of_type(KINDS["indirect_adaptation"], dead_zone=0.1)
    assert law.dissipation[0].whole.text == "(Y_d a_d_hat - tau_d)' beyond(Y_d a_d_hat - tau_d, dead_zone)"


PAPER = {
    "pid_inverse": {
        "dq_ref": "dq_r - K_c (q - q_r)",
        "dq_c": "dq_ref + w_P q_r + w tau_dc - w_P q_c - w_I z",
        "sigma": "dq - dq_ref",
        "w": "-Lambda tau_dc sigma",
        "w_P": "Lambda_P (q_c - q_r) sigma",
        "w_I": "Lambda_I z sigma",
        "K_star": "K K_D",
        "M_bar": "(K_D + B/K) K_c + K_P - K_I/K_c",
    },
    "pi_servo": {"u": "-K_P (dq - dq_c) - K_I (i - q_step)", "i": "dq - dq_c"},
    "pid_servo": {"u": "-K_D (dq - dq_c) - K_P (q - q_c - q_step) - K_I i"},
    "task_observer": {"x_o": "J_hat (dq_r - beta J_hat'(x_o - x))"},
    "observed_tracking": {
        "dq_r": "J_hat'((J_hat J_hat')^-1 (dx_d - J_hat dq_null) - gamma (x_o - x_d)) + dq_null",
    },
    "joint_tracking": {"dq_r": "dq_d - alpha_bar (q - q_d)"},
    "dynamic_compensator": {
        "tau_dc": "Y_d a_d_hat + tau_known + tau_task",
        "a_d_hat": "-Gamma (Y_d' sigma + Y_f' e_f)",
    },
    "passive_filter": {"y": "K_1 (J_hat'(x - x_d) - y)"},
    "adaptive_kinematics": {"J_hat": "J(q, a_k_hat)", "a_k_hat": "Gamma_k Y_k(q, dq)' e_k"},
    "computed_torque": {"ddq_ref": "ddq_d - 2 alpha_bar (dq - dq_d) - alpha_bar^2 (q - q_d)"},
    "manipulator": {"ddq": "M(q)^-1 (K u + tau_ext - (B dq + coulomb phi(dq)) - (C(q, dq) dq + g))", "x": "f(q)"},
}


@pytest.mark.parametrize("name", PAPER)
def test_a_law_prints_as_the_paper_writes_it(name):
    law = law_of_type(KINDS[name])
    found = {line.name: line.right.text for line in (*law.outputs, *law.rates, *law.definitions)}
    assert {key: found[key] for key in PAPER[name]} == PAPER[name]


def test_energies_print_with_their_weights():
    law = law_of_type(KINDS["task_observer"])
    assert [term.vector.text for term in law.dissipation] == ["J_hat'(x_o - x)/2 + s/beta"]
    assert law.dissipation[0].weight.text == "beta"
    assert law.consumption.whole.text == "|s|^2/beta"
    pid = law_of_type(KINDS["pid_inverse"])
    assert [term.vector.text for term in pid.storage][2:] == ["w - 1/K_star", "w_P - K_P/K_D", "w_I - K_I/K_D"]
    assert pid.storage[2].weight.text == "K_star/Lambda"
    assert pid.storage[2].whole.unicode == "|w − 1/K_⋆|²_(K_⋆/Λ)"


def test_an_option_prints_exactly_when_it_is_switched_on():
    block = KINDS["dynamic_compensator"]
    rate = {line.name: line.right.text for line in law_of_type(block).rates}["a_d_hat"]
    assert "leak" not in rate
    leaking = {line.name: line.right.text for line in law_of_type(block, leak=0.1).rates}["a_d_hat"]
    assert leaking == f"{rate} - leak (a_d_hat - a_d_nominal)"
    assert {"leak", "error_leak", "dead_zone"} <= {label for label, _ in options_of(block)}


def test_an_input_without_a_source_does_not_print():
    law = printed(Graph.read("known_tracking_pid").diagram, "dynamics")
    assert {line.name: line.right.text for line in law.outputs} == {"tau_dc": "Y_d a_d_hat"}


@final
class Spring(AbstractBlock):
    """A block of a user; its methods differ between tests."""

    side = Side.PLANT
    outputs = (Output("f", "n", "N"),)
    states = (State("q", "n", "m"), State("v", "n", "m/s"))
    how: ClassVar[list] = []

    k: Diagonal = Positive("n", "1/s^2")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        force = self.how[0](x, p)
        return Equations(outputs={"f": force}, rates={"q": x.v, "v": force})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(storage=(Square(self.how[-1](x, p)),))


def spring(*how):
    Spring.how[:] = how
    return Diagram.build({"spring": Spring(k=[1.0, 2.0])})


def test_equations_that_differ_the_second_time_are_refused_with_file_and_line():
    answers = chain([1, 1, 1], repeat(-1))  # a diagram is built on the first three
    diagram = spring(lambda x, p: next(answers) * p.k * x.q)
    with pytest.raises(BlockError, match=r"spring: test_laws\.py:\d+: the output f differs when equations\(\)"):
        printed(diagram, "spring")


def test_a_law_that_is_another_one_for_matrices_is_refused():
    diagram = spring(lambda x, p: (-p.k if isinstance(x.q, ca.SX) else p.k) * x.q)
    with pytest.raises(BlockError, match="the output f differs"):
        printed(diagram, "spring")


def test_a_certificate_that_is_another_one_for_matrices_is_refused():
    diagram = spring(lambda x, p: -p.k * x.q, lambda x, p: x.q if isinstance(x.q, ca.SX) else x.v)
    with pytest.raises(BlockError, match="Square 1 of its storage differs when certificate"):
        printed(diagram, "spring")


def knows_the_proof_by_its_names(x):
    return x.q if str(x.q[0]).startswith("spring.") else x.v


def knows_the_proof_by_counting():
    calls = chain([True], repeat(False))
    return lambda x: x.q if next(calls) else x.v


@pytest.mark.parametrize("vector", [knows_the_proof_by_its_names, knows_the_proof_by_counting()])
def test_a_certificate_that_is_another_one_for_the_proof_is_no_claim(vector):
    """It stores v when it prints, and q, which would be proved, when the proof evaluates it."""
    claim_of(spring(lambda x, p: -p.k * x.q, lambda x, p: x.q))
    with pytest.raises(NotApplicableError, match=r"spring: test_laws\.py:\d+: Square 1 of its storage differs"):
        claim_of(spring(lambda x, p: -p.k * x.q, lambda x, p: vector(x)))


def test_a_block_that_insists_on_scalars_prints_element_by_element():
    law = printed(spring(lambda x, p: -p.k * (x.q + ca.SX([0, 1]) * x.v[0])), "spring")
    assert not law.matrices
    assert law.outputs[0].right.text == "(-k_1 q_1, -k_2 (q_2 + v_1))"
    lifted = printed(spring(lambda x, p: -p.k * (x.q + ca.SX(2) * x.v)), "spring")
    assert lifted.outputs[0].right.text == "-k (q + 2 v)"


def test_a_name_replaces_its_subexpression_and_is_defined_next_to_the_law():
    law = printed(spring(lambda x, p: -p.k * named("a", x.q + x.v)), "spring")
    assert law.outputs[0].right.text == "-k a"
    assert [line.whole.text for line in law.definitions] == ["a = q + v"]


@pytest.mark.parametrize(
    ("give", "reported"),
    [
        (lambda x, p: named("k", x.q), "the name k is taken, by a parameter of the block"),
        (lambda x, p: named("q", x.q), "the name q is taken, by a state"),
        (lambda x, p: named("S", x.q), "the name S is taken, by the storage of the block"),
        (
            lambda x, p: named("у", x.q),
            r"the name '\\u0443' has '\\u0443', which is neither a Latin nor a known Greek letter",
        ),
        (lambda x, p: named("a_1", x.q) + named("a1", x.v), "the names a_1 and a1 both print as a_1"),
        (lambda x, p: named("2a", x.q), "expected a name such as K_star, found '2a'"),
        (lambda x, p: named("a", x.q) + named("a", x.v), "a, named twice, differs"),
        (lambda x, p: named("a", x.q) + named("a", x.v[0]), "named twice, with different shapes"),
        (lambda x, p: named("f", x.q) * p.k, "f, named twice, differs"),
    ],
)
def test_an_invalid_name_is_refused_with_file_and_line(give, reported):
    with pytest.raises(BlockError, match=reported) as caught:
        printed(spring(give), "spring")
    assert "test_laws.py:" in caught.value.text


@final
class Far(AbstractBlock):
    """Prints one law, and runs another for large x."""

    side: ClassVar = Side.PLANT
    states = (State("x", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        r = 1 if isinstance(x.x, ca.MX) else ca.fmax(0, ca.fmin(1, 2 - x.x * x.x / 25))
        return Equations(rates={"x": -x.x * r})


@final
class FarTwice(AbstractBlock):
    """Gives one name to two expressions that are equal for small x."""

    states = (State("x", ""),)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations(rates={"x": -x.x})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        r = ca.fmax(0, ca.fmin(1, 2 - x.x * x.x / 25))
        return Certificate(storage=(Square(named("s", x.x)),), dissipation=(Square(named("s", x.x * r)),))


@pytest.mark.parametrize("block", [Far(), FarTwice()])
def test_a_difference_that_lives_far_away_is_seen(block):
    with pytest.raises(BlockError, match="differs when"):
        laws_of(Diagram.build({"far": block}))


def test_where_floats_are_no_witnesses_more_digits_are():
    """At some points a matrix of this law is singular up to rounding, and rounding determines signs."""
    assert law_of_type(SampledInverse, delay=2) is not None


@pytest.mark.parametrize("name", ["dq_c", "q_start"])
def test_an_error_in_the_eighth_digit_is_reported_there_too(name):
    read = read_type(SampledInverse, delay=2)
    outputs = {**read.stated.outputs, name: read.stated.outputs[name] * (1 + 3e-7)}
    lying = copy(read)
    lying.stated = replace(read.stated, outputs=outputs)
    with pytest.raises(BlockError, match=f"the output {name}[^;]*differs"):
        lying.compare()


def test_digits_are_as_many_as_the_expression_loses():
    x = ca.MX.sym("x", 2)
    lost = ca.Function("lost", [x], [ca.sin(x), ca.inv(ca.vertcat(ca.horzcat(x[0], 1), ca.horzcat(1, 1 / x[0]))) @ x])
    lost_less = ca.Function("less", [x], [(x[0] + 1e25 * x) - 1e25 * x])
    assert in_balls(lost, [[3, 1]], 1) is None  # singular: no number of digits helps
    assert in_balls(lost_less, [[3, 1]], 0) == pytest.approx(np.full((2, 1), 3), rel=1e-15)
    assert not agree(None, None)


def test_a_quotient_of_zeros_that_the_code_continues_is_no_difference():
    assert law_of_type(KINDS["sampled_inverse"], time_stamps=True) is not None  # T is a difference of two signals
    printed(spring(lambda x, p: x.q * x.q / size_of(x.q, guarded=not isinstance(x.q, ca.MX))), "spring")


@pytest.mark.parametrize("guarded", [ca.SX, ca.MX])
def test_a_value_at_zero_that_only_one_form_has_is_a_difference(guarded):
    """A sign, guarded against 0/0 in the code that runs, or in the code that prints."""
    diagram = spring(lambda x, p: x.q / size_of(x.q, guarded=isinstance(x.q, guarded)))
    with pytest.raises(BlockError, match="the output f differs"):
        printed(diagram, "spring")


def size_of(q, *, guarded):
    return ca.fabs(q) + (q == 0) if guarded else ca.fabs(q)


def test_an_undefined_value_is_a_difference_where_signals_are_not_zero():
    def found(undefined):
        def at(values):
            there = np.full((1, 1), np.nan if round(float(values["seed"])) in undefined else 0.0)
            return [there], [np.zeros((1, 1))], [np.zeros(1)]

        return Pair(lambda seed: {"seed": seed}, at, lambda values, place: (None, None)).compared(near=False)

    vanishing = {seed for seed in range(16, 100) if seed % 4 > 1}
    assert found(vanishing) == (None, False)
    assert found(vanishing | {17}) == (0, False)


@pytest.mark.parametrize(("seeds", "second", "found"), [("far", 0.0, 0), ("far", np.nan, None), ("near", np.nan, 0)])
def test_a_printed_number_may_be_missing_only_where_what_runs_overflows(seeds, second, found):
    def at(values):
        near = Draw(round(float(values["seed"]))).moderate
        missing = near if seeds == "near" else not near
        printed = np.array([[np.nan if missing else 0.0], [0.0 if not missing else second]])
        runs = np.array([[0.0], [0.0 if not missing else second]])
        return [printed], [runs], []

    pair = Pair(lambda seed: {"seed": float(seed)}, at, lambda *_: (None, None))
    assert pair.compared(near=False)[0] == found
