r"""A docstring with another law than the code: twenty kinds of difference, each reported with its line."""

from __future__ import annotations

import importlib.util
import itertools
import textwrap

import pytest

from dmframe.catalogue import block_types
from dmframe.common.errors import BlockError
from dmframe.formula.alone import law_of_type
from dmframe.formula.docstring import check_docstring, check_docstrings
from dmframe.formula.laws import laws_of, read_blocks

LAW = r"""
    With :math:`e = q - q_r`, :math:`\tilde w = w - 1/K_\star` and :math:`K_\star = K K_D`:

    .. math::

        \dot q_{ref} &= \dot q_r - K_c e, \quad \sigma = \dot q - \dot q_{ref}   \tag{1} \\
        \dot w &= -\Lambda \tau_{dc} \sigma                                       \tag{2} \\
        \dot{\hat a}_d &= -\Gamma Y_d^\top \sigma                                 \tag{3} \\
        \tau_d &= Y_d \hat a_d + \tfrac34 \hat J^\top (x - x_d)                   \tag{4}

    .. math::

        S &= \tfrac12 |\tilde w|^2_{K_\star/\Lambda} + \tfrac12 |\hat a_d - a_d|^2_{\Gamma^{-1}}  \tag{5} \\
        \dot S &= -|\tilde w|^2_{K_\star}
                  - \sigma^\top (\tau_{dc} - K \sigma)                            \tag{6}
"""

CODE = '''
from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations
from dmframe.block.certificate import Certificate, Square
from dmframe.block.naming import named
from dmframe.block.parameter import Diagonal, Positive, Scalar
from dmframe.block.port import Input, Output, State


@final
class Mixed(AbstractBlock):
    r"""A law of its own.
LAW
    Notes
    -----
    None.
    """

    inputs = (
        Input("q", "n"), Input("q_r", "n"), Input("dq", "n"), Input("dq_r", "n"), Input("tau_dc", "n"),
        Input("Y_d", "n p"),
        Input("J_hat", "m n"), Input("x", "m"), Input("x_d", "m"),
    )
    outputs = (Output("dq_ref", "n"), Output("sigma", "n"), Output("tau_d", "n"))
    states = (State("w", "n"), State("a_d_hat", "p"))
    truth = (Input("K", "n"), Input("K_D", "n"), Input("a_d", "p"))

    K_c: Diagonal = Positive("n")
    Lambda: Diagonal = Positive("n")
    Gamma: Diagonal = Positive("p")
    leak: Scalar | None = Positive("", default=None)

    def equations(self, u, x, p):
        dq_ref = u.dq_r - p.K_c * (u.q - u.q_r)
        sigma = u.dq - dq_ref
        rate = -p.Lambda * u.tau_dc * sigma
        if "leak" in p:
            rate = rate - p.leak * x.w
        return Equations(
            outputs={"dq_ref": dq_ref, "sigma": sigma, "tau_d": u.Y_d @ x.a_d_hat + 3 * u.J_hat.T @ (u.x - u.x_d) / 4},
            rates={"w": rate, "a_d_hat": -p.Gamma * (u.Y_d.T @ sigma)},
        )

    def certificate(self, u, x, p, truth):
        K_star = named("K_star", truth.K * truth.K_D)
        sigma = u.dq - u.dq_r + p.K_c * (u.q - u.q_r)
        w_err = x.w - 1 / K_star
        return Certificate(
            storage=(Square(w_err, K_star / p.Lambda), Square(x.a_d_hat - truth.a_d, 1 / p.Gamma)),
            dissipation=(Square(w_err, K_star),),
            supply=-ca.dot(sigma, u.tau_dc - truth.K * sigma),
        )
'''
_count = itertools.count()


@pytest.fixture
def faults(tmp_path):
    """The faults of a block whose docstring has one replacement."""

    def found_in(old="", new="", law=LAW):
        assert old in law
        path = tmp_path / "mixed.py"
        path.write_text(CODE.replace("LAW", law.replace(old, new, 1) if old else law))
        spec = importlib.util.spec_from_file_location(f"mixed_{next(_count)}", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return [fault.text for fault in check_docstring(module.Mixed)]

    return found_in


def test_a_docstring_that_states_what_the_code_computes_has_no_fault(faults):
    assert faults() == []


SEEDED = {
    "a sign": (r"\dot w &= -\Lambda", r"\dot w &= \Lambda", r"\dot{w}"),
    "a sign inside": (r"\dot q - \dot q_{ref}", r"\dot q + \dot q_{ref}", "sigma"),
    "a factor": (r"\tfrac34", r"\tfrac12", "tau_d"),
    "an index": (r"\tau_{dc} \sigma  ", r"\tau_d \sigma  ", r"\dot{w}"),
    "a missing term": (r" + \tfrac34 \hat J^\top (x - x_d)", "", "tau_d"),
    "a term too many": (r"Y_d^\top \sigma  ", r"Y_d^\top \sigma - \hat a_d  ", r"\dot{\hat{a_d}}"),
    "swapped names": ("(x - x_d)", "(x_d - x)", "tau_d"),
    "a missing transposition": (r"\hat J^\top (x", r"\hat J (x", "cannot be"),
    "a missing transposition of the regressor": (r"Y_d^\top", "Y_d", "cannot be"),
    "the gain of another law": (r"-\Gamma Y_d", r"-\Lambda Y_d", "cannot be"),
    "an inverse gain": (r"-\Gamma Y_d", r"-\Gamma^{-1} Y_d", r"\dot{\hat{a_d}}"),
    "an optional term as if it were always there": (
        r"-\Lambda \tau_{dc} \sigma  ",
        r"-\Lambda \tau_{dc} \sigma - \mathrm{leak}\, w  ",
        "no equation for it holds with the options at their defaults",
    ),
    "a rate of another state": (r"\dot w &=", r"\dot v &=", "no state v"),
    "the second derivative": (r"\dot w &=", r"\ddot w &=", r"\ddot{w}"),
    "a wrong weight in S": (r"K_\star/\Lambda}", r"K_\star \Lambda}", "S: the docstring's law is not that of the cert"),
    "a missing half in S": (r"S &= \tfrac12 |\tilde w|", r"S &= |\tilde w|", "S: the docstring"),
    "a weight of the dissipation": (r"-|\tilde w|^2_{K_\star}", r"-|\tilde w|^2_{K}", r"\dot{S}"),
    "a supply's sign": (r"(\tau_{dc} - K \sigma)", r"(\tau_{dc} + K \sigma)", r"\dot{S}"),
    "a definition in the text": (r"\tilde w = w - 1/K_\star", r"\tilde w = w - K_\star", "the docstring"),
    "a definition of what the code names": (r"K_\star = K K_D", r"K_\star = K_D", "K_star"),
    "a term without its square": (r"|\tilde w|^2_{K_\star}", r"|\tilde w|_{K_\star}", "square"),
    "an equation for an input": (r"\dot w &=", r"\tau_{dc} &=", "the block does not compute it"),
    "a new name that nothing uses": (r"\tau_d &=", r"\tau_x &=", "no other equation uses it"),
    "a name that nothing bears": (r"\dot q_r - K_c e", r"\dot q_r - K_d e", "the name K_d is unknown"),
    "a bracket that is not closed": ("(x - x_d) ", "(x - x_d ", "missing"),
    "a function of too few arguments": (r"\dot w &= -\Lambda", r"\dot w &= \max \Lambda", "cannot be read"),
    "a left side that ends too early": (r"\dot w &=", r"\dot &=", "cannot be read"),
    "a number that is none": (r"\dot w &= -\Lambda", r"\dot w &= \sqrt{-1} \Lambda", r"\dot{w}"),
    "no equation at all": (r"\dot w &= -\Lambda", r"-\Lambda", "not an equation"),
    "another order of the product": (r"-\Gamma Y_d^\top \sigma  ", r"-Y_d^\top \Gamma \sigma  ", "cannot be"),
}


@pytest.mark.parametrize("what", SEEDED)
def test_a_docstring_that_differs_from_the_code_is_reported_with_its_line(faults, what):
    old, new, reported = SEEDED[what]
    found = faults(old, new)
    assert found
    assert any(reported in text for text in found), found
    assert all(text.startswith("mixed.py:") for text in found)
    lines = CODE.replace("LAW", LAW.replace(old, new, 1)).splitlines()
    if new and not what.startswith("a definition"):  # a definition is reported where it is used
        changed = next(number for number, line in enumerate(lines, 1) if new in line)
        assert {changed, changed - 1} & {int(text.split(":")[1]) for text in found}


def test_an_option_may_have_a_law_of_its_own_next_to_the_one_of_the_defaults(faults):
    more = LAW + textwrap.indent(
        "\n.. math::\n\n    \\dot w = -\\Lambda \\tau_{dc} \\sigma - \\mathrm{leak}\\, w \\tag{7}\n", "    "
    )
    assert faults(law=more) == []
    assert faults("\\mathrm{leak}\\, w \\tag", "2 \\mathrm{leak}\\, w \\tag", law=more)


def test_an_integral_of_a_state_is_checked_against_its_rate(faults):
    right = LAW.replace("With :math", ":math:`w = \\int -\\Lambda \\tau_{dc} \\sigma`. With :math", 1)
    assert faults(law=right) == []
    assert any("rate of w" in text for text in faults("\\int -", "\\int ", law=right))


KINDS = block_types()


@pytest.mark.parametrize("name", list(KINDS))
def test_the_docstrings_of_all_packaged_blocks_state_what_they_compute(name):
    assert [fault.text for fault in check_docstring(KINDS[name])] == []


def test_a_graph_with_a_block_whose_docstring_is_wrong_is_refused(tmp_path):
    from dmframe.catalogue import find_block
    from dmframe.diagram import Diagram

    path = tmp_path / "spring.py"
    path.write_text(
        "from typing import ClassVar\nfrom dmframe.block import *\nfrom dmframe.block.port import *\n"
        "class Spring(AbstractBlock):\n"
        '    r"""A spring.\n\n    .. math:: \\dot q = 2 q\n    """\n'
        "    side: ClassVar = Side.PLANT\n"
        '    states: ClassVar = (State("q", "1"),)\n'
        '    def equations(self, u, x, p): return Equations(rates={"q": -2 * x.q})\n'
    )
    diagram = Diagram.build({"spring": find_block("spring.py:Spring", tmp_path)()})
    assert laws_of(diagram)["spring"].rates[0].whole.text == "dq/dt = -2 q"
    with pytest.raises(BlockError, match=r"spring\.py:7: \\dot\{q\}: the docstring's law is not what the equations"):
        check_docstrings(read_blocks(diagram))


DELAY = '''
from typing import ClassVar
from dmframe.block import *
from dmframe.block.port import *
class Delay(AbstractBlock):
    r"""One sample late.

    .. math:: u_{late} = x_{held}, \\quad x_{held}^+ = RIGHT
    """
    side: ClassVar = Side.PLANT
    inputs = (Input("u", "n"),)
    outputs = (Output("u_late", "n"),)
    states = (State("x_held", "n", sampled=True),)
    def equations(self, u, x, p): return Equations(outputs={"u_late": x.x_held}, next={"x_held": 3 * u.u})
'''


@pytest.mark.parametrize(("right", "faults"), [("3 u", []), ("u", [r"x_held^+: the docstring's law is not what"])])
def test_a_sampled_states_next_value_prints_and_is_checked_against_the_docstring(tmp_path, right, faults):
    from dmframe.catalogue import find_block

    tmp_path.joinpath("delay.py").write_text(DELAY.replace("RIGHT", right))
    kind = find_block("delay.py:Delay", tmp_path)
    (line,) = law_of_type(kind).rates
    assert (line.whole.text, line.whole.unicode) == ("x_held+ = 3 u", "x_held⁺ = 3 u")
    assert line.whole.latex == r"x_{\mathrm{held}}^{+} = 3 u"
    found = [fault.text for fault in check_docstring(kind)]
    assert len(found) == len(faults)
    assert all(wanted in text for wanted, text in zip(faults, found, strict=True))


LIAR = '''
from typing import ClassVar, final

import casadi as ca

from dmframe.block import AbstractBlock, Equations
from dmframe.block.parameter import Positive, Scalar
from dmframe.block.port import Side, State


@final
class Liar(AbstractBlock):
    r"""A state.

    DOC
    """

    side: ClassVar = Side.PLANT
    states = (State("x", ""),)
    k: Scalar = Positive()
    FIELD

    def equations(self, u, x, p):
        CODE
'''

DISPLAYED = ".. math::\n\n        \\dot x = "


@pytest.mark.parametrize(
    ("doc", "field", "code"),
    [
        (DISPLAYED + r"-k x + 3 \max(x - 2, 0)", "", "return Equations(rates={'x': -p.k * x.x})"),
        (DISPLAYED + r"-k x", "", "return Equations(rates={'x': -p.k * x.x * ca.fmin(1, ca.fmax(9 - x.x, 0.5))})"),
        (r"With :math:`\dot x = -2 x` it falls.", "", "return Equations(rates={'x': -x.x})"),
        (DISPLAYED.replace("math", "Math") + "-2 x", "", "return Equations(rates={'x': -x.x})"),
        (DISPLAYED + "-7 x", "label: str = None", "return Equations(rates={'x': -x.x if self.label else -7 * x.x})"),
        (DISPLAYED + "-7 x", "label: str", "return Equations(rates={'x': -x.x})"),
    ],
    ids=["far", "code", "inline", "capital", "option", "required"],
)
def test_a_docstring_is_checked_against_the_block_of_the_graph_and_far_away(tmp_path, doc, field, code):
    from dmframe.catalogue import find_block
    from dmframe.diagram import Diagram

    path = tmp_path / "liar.py"
    path.write_text(LIAR.replace("DOC", doc).replace("FIELD", field).replace("CODE", code))
    values = {"label": "hi"} if field else {}
    diagram = Diagram.build({"liar": find_block("liar.py:Liar", tmp_path)(k=2.0, **values)})
    if "None" in field:  # an option that no variant has: statements for the defaults are not compared with it
        assert any(
            "no equation for it is what liar computes" in text for text in check_docstrings(read_blocks(diagram))
        )
        return
    with pytest.raises(BlockError, match=r"liar\.py:\d+: \\dot"):
        check_docstrings(read_blocks(diagram))


@pytest.mark.parametrize("name", ["lambda_", "λ"])
@pytest.mark.parametrize(("sign", "faults"), [("-", 0), ("+", 1)])
def test_a_gain_that_the_paper_calls_lambda_prints_and_is_read_as_that_letter(tmp_path, name, sign, faults):
    from dmframe.catalogue import find_block

    code = f"return Equations(rates={{'x': {sign}p.{name} * x.x}})"
    text = LIAR.replace("DOC", DISPLAYED + r"-\lambda x").replace("FIELD", "").replace("CODE", code)
    tmp_path.joinpath("liar.py").write_text(text.replace("k: Scalar", f"{name}: Scalar"))
    kind = find_block("liar.py:Liar", tmp_path)
    (line,) = law_of_type(kind).rates
    assert line.whole.unicode == f"ẋ = {'−' if sign == '-' else ''}λ x"
    assert len(check_docstring(kind)) == faults


@pytest.mark.parametrize(
    "code",
    [
        "return Equations(rates={'x': -x.x / (self.k > 1.5)})",
        "return Equations(rates={'x': -(5 if self.k > 1.5 else 1) * p.k * x.x})",
    ],
    ids=["raises", "value"],
)
def test_a_docstring_of_one_value_of_a_number_has_no_block_to_be_checked_against(tmp_path, code):
    from dmframe.catalogue import find_block
    from dmframe.diagram import Diagram

    path = tmp_path / "liar.py"
    path.write_text(LIAR.replace("DOC", DISPLAYED + "-k x").replace("FIELD", "").replace("CODE", code))
    with pytest.raises(BlockError, match="liar: its methods read the number k from self"):
        Diagram.build({"liar": find_block("liar.py:Liar", tmp_path)(k=2.0)})
