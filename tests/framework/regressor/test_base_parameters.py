from __future__ import annotations

import math
import random
import re
import sys
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from dmframe.common.errors import RobotError, UnknownNameError
from dmframe.exact import Trial, random_prime
from dmframe.regressor.base_parameters import BaseParameters, base_parameters
from dmframe.regressor.export import polarised_regressor
from dmframe.regressor.full import Sampler, full_regressor
from dmframe.regressor.listing import listing
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import load
from dmframe.robot.parameters import DynamicParameters

if TYPE_CHECKING:
    import sympy

FIRST_THREE = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
BOTH = ("viscous", "coulomb")


@cache
def chain(name: str) -> SerialChain:
    if name == "ur10 of three joints":
        return load("ur10", free=FIRST_THREE, hold={"wrist_2_joint": -math.pi / 2}, tool="ee_link")
    return load(name)


@cache
def base(name: str, friction: tuple[str, ...] = ()) -> BaseParameters:
    return base_parameters(chain(name), friction)


@pytest.mark.parametrize(
    ("name", "friction", "count"),
    [
        ("ur10 of three joints", (), 15),
        ("ur10 of three joints", ("viscous",), 18),
        ("ur10 of three joints", BOTH, 21),
        ("ur10", (), 36),
        ("panda", (), 43),
        ("arm2", (), 6),
    ],
)
def test_counts_are_the_known_ones(name: str, friction: tuple[str, ...], count: int) -> None:
    found = base(name, friction)
    assert found.count == len(found.independent) == len(found.symbolic) == len(found.kept) == count


@pytest.mark.parametrize("name", ["ur10 of three joints", "ur10", "panda", "xarm7", "arm2"])
def test_the_kept_columns_span_the_whole_regressor_exactly(name: str) -> None:
    found = base(name, BOTH)
    sampler = Sampler(full_regressor(chain(name), BOTH))
    rng = random.Random(99)
    trial = Trial(random_prime(rng), rng)
    grouping = [[trial.residue(x) for x in row] for row in found.grouping]
    for row in sampler.rows(trial, sampler.constants(trial)):
        kept = [row[column] for column in found.independent]
        carried = [sum(x * g[j] for x, g in zip(kept, grouping, strict=True)) for j in range(len(row))]
        assert [x % trial.prime for x in carried] == row


@pytest.mark.parametrize("name", ["ur10 of three joints", "ur10", "panda", "xarm7"])
def test_pinocchios_regressor_is_carried_and_its_numerical_rank_is_the_count(name: str) -> None:
    robot, found = chain(name), base(name)
    rng = np.random.default_rng(7)
    Y = np.vstack([polarised_regressor(robot, *rng.uniform(-2, 2, (4, robot.n))) for _ in range(40)])
    grouping = np.array([[float(x) for x in row] for row in found.grouping])
    assert np.max(np.abs(Y[:, found.independent] @ grouping - Y)) < 1e-8 * np.max(np.abs(Y))
    if name != "xarm7":  # its rpy of 1.5708 makes columns that differ by 4e-6 only: no numerical rank separates them
        assert np.linalg.matrix_rank(Y, tol=1e-8 * np.max(np.abs(Y))) == found.count


def evaluate(text: str, values: dict[str, Fraction]) -> dict[str, sympy.Expr]:
    """Read a printed grouping with SymPy, an independent parser."""
    import sympy

    product = re.sub(r"(?<=[\w)]) (?=[\w(])", "*", text).replace("^", "**")
    names = {name: sympy.Symbol(name) for name in re.findall(r"[A-Za-z]\w*", product)}
    lengths = {names[name]: sympy.Rational(x.numerator, x.denominator) for name, x in values.items() if name in names}
    e = sympy.expand(sympy.sympify(product, locals=names, rational=False).subs(lengths))
    return {str(symbol): e.coeff(symbol) for symbol in e.free_symbols}


@pytest.mark.parametrize("name", ["ur10 of three joints", "ur10", "panda", "arm2"])
def test_printed_groupings_have_the_value_of_the_exact_ones(name: str) -> None:
    import sympy

    found = base(name, BOTH)
    for text, row in zip(found.symbolic, found.grouping, strict=True):
        coefficients = evaluate(text, dict(found.translations))
        for column, value in zip(found.names, row, strict=True):
            assert sympy.Rational(value.numerator, value.denominator) == coefficients.get(column, 0), (text, column)


def test_groupings_read_like_the_textbooks() -> None:
    assert base("arm2").symbolic == (
        "mc_x1 + p_x2 m_2",
        "mc_z1",
        "I_yy1 + p_x2^2 m_2",
        "mc_x2",
        "mc_z2",
        "I_yy2",
    )
    ur10 = base("ur10 of three joints", BOTH)
    assert "mc_z2 + p_z3 m_3" in ur10.symbolic
    assert "I_xx2 - I_zz2 + p_z3^2 m_3" in ur10.symbolic
    assert ur10.symbolic[-6:] == ("B_1", "B_2", "B_3", "D_1", "D_2", "D_3")
    assert dict(ur10.translations)["p_z3"] == Fraction(153, 250)
    assert "m_1" in ur10.unidentifiable
    assert "m_2" not in ur10.unidentifiable


def test_coefficients_of_general_rotations_are_printed_as_numbers() -> None:
    found = base("xarm7")
    assert found.count == 43
    for text, row in zip(found.symbolic, found.grouping, strict=True):
        coefficients = evaluate(text, dict(found.translations))
        for column, value in zip(found.names, row, strict=True):
            assert float(coefficients.get(column, 0)) == pytest.approx(float(value), rel=1e-4, abs=1e-9)
    assert any("1.00000 " in text for text in found.symbolic)


def test_without_symbols_the_groupings_are_the_same_numbers() -> None:
    quick = base_parameters(chain("arm2"), symbolic=False)
    assert quick.grouping == base("arm2").grouping
    assert quick.symbolic[0] == "mc_x1 + 0.45 m_2"
    assert quick.translations == ()


def test_names_follow_pinocchios_order_and_friction_comes_last() -> None:
    names = DynamicParameters(chain("arm2"), ("coulomb", "viscous")).names
    assert names[:3] == ("m_1", "mc_x1", "mc_y1")
    assert names[9:11] == ("I_zz1", "m_2")
    assert names[20:] == ("B_1", "B_2", "D_1", "D_2")
    assert len(DynamicParameters(chain("arm2")).values) == 20


def test_another_kind_of_friction_is_refused_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="friction viscos: unknown kind of friction; did you mean viscous"):
        base_parameters(chain("arm2"), ["viscos"])


def test_fractions_too_long_to_read_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[base_parameters.__module__], "_EXPONENTS", (127,))
    with pytest.raises(RobotError, match="base parameters of xarm7: expected coefficients of less than 63 bits"):
        base_parameters(chain("xarm7"))


def test_the_listing_shows_values_groupings_lengths_and_what_is_hidden() -> None:
    robot, found = chain("ur10 of three joints"), base("ur10 of three joints", BOTH)
    text = listing(robot, found)
    assert "21 base parameters of 36" in text
    assert "p_z3 = 0.612 m" in text
    assert "Not identifiable from any motion: m_1, mc_x1" in text
    values = [float(x) for x in DynamicParameters(robot).values]
    number = found.symbolic.index("mc_z2 + p_z3 m_3")
    expected = values[13] + 0.612 * values[20]
    [line] = [line for line in text.splitlines() if line.endswith(" mc_z2 + p_z3 m_3")]
    assert line.split()[0] == str(number + 1)
    assert float(line.split()[1]) == pytest.approx(expected, rel=1e-5)
    assert [line.split()[1] for line in text.splitlines() if line.endswith(" B_1")] == ["-"]
