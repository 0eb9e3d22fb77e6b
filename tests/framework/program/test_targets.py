"""Each target's table of rules, compared with CasADi's evaluation of every operation that SX can contain."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import casadi as ca
import numpy as np
import pytest
from flint import arb, fmpq, fmpq_poly
from flint.utils.flint_exceptions import DomainError

from dmframe.build import load
from dmframe.build.library import address
from dmframe.codegen import function as c
from dmframe.codegen.source import shipped
from dmframe.common.errors import DmframeError, EngineError, ValueFault
from dmframe.exact import MERSENNE_127, Tape, Trial, balls, enclosure, pieces, rational, rational_reconstruction
from dmframe.exact.arithmetic import ARITHMETIC
from dmframe.exact.sizes import degrees
from dmframe.formula import points
from dmframe.program import OPERATIONS, read, run
from dmframe.regressor import polynomial
from dmframe.regressor.python_source import RULES as NUMPY_RULES
from dmframe.regressor.python_source import _statements
from tests.page_code import page_module

POINTS: Final = ((0.375, 0.75), (-0.375, 0.75), (1.75, -2.25), (2.5, 2.5), (0.0, 0.625), (0.625, 0.0), (-3.0, -0.5))
CODES: Final = sorted(OPERATIONS)


def function(code: int) -> Any:
    """One operation of two inputs; the second is read in any case."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    if code == ca.OP_CONSTPOW:
        return ca.Function("f", [x, y], [x**2.5])
    value = ca.SX.unary(code, x) if OPERATIONS[code].arity == 1 else ca.SX.binary(code, x, y)
    return ca.Function("f", [x, y], [value])


FUNCTIONS: Final = {code: function(code) for code in CODES}


def truth(code: int, x: float, y: float) -> float:
    return float(FUNCTIONS[code](x, y))


def in_fractions(f: Any, x: float, y: float) -> float:
    return float(rational.evaluate(f, [[Fraction(x)], [Fraction(y)]])[0][0])


def in_intervals(f: Any, x: float, y: float) -> float:
    """Of no width: they stay so."""
    found = rational.evaluate(f, [[rational.Interval.of(Fraction(x))], [Fraction(y)]])[0][0]
    interval = rational.Interval.of(found)
    assert interval.lower == interval.upper
    return float(interval.lower)


def in_enclosures(f: Any, x: float, y: float) -> float:
    ((found,),) = enclosure.Enclosing(f)([[x], [y]])
    assert found.lower <= found.upper
    return float((found.lower + found.upper) / 2)


def in_balls(f: Any, x: float, y: float) -> float:
    program = read(f)
    return float(program.stored(balls.enclosed(program, [[arb(x)], [arb(y)]]))[0][0])


def in_pieces(f: Any, x: float, y: float) -> float:
    piece = pieces._Piece(Tape.from_function(f), [Fraction(y)], Fraction(x), range(100))
    return float(piece.at(Fraction(x))[0])


def in_polynomials(f: Any, x: float, y: float) -> float:
    """At symbols that replace the numbers; at angles for sine and cosine."""
    code = max(read(f).codes - {ca.OP_INPUT, ca.OP_CONST})
    angles = [(0, (1, 0)), (0, (0, 1))]
    symbols = [polynomial.Polynomial.symbol(name) for name in "xy"]
    ((found,),) = polynomial.expand(f, [[value] for value in (angles if code in (ca.OP_SIN, ca.OP_COS) else symbols)])
    known, angle = {"x": x, "y": y}, (x, y)
    total = 0.0
    for key, factor in found.terms.items():
        term = float(factor) * math.prod(known[name] for name in key.symbols)
        for wave in key.waves:
            turned = sum(k * q for k, q in zip(wave.k, angle, strict=True))
            term *= math.sin(turned) if wave.sine else math.cos(turned)
        total += term
    return total


def in_numpy(f: Any, x: float, y: float) -> float:
    """The statements that a written module has between its head and its return."""
    statements, results = _statements(f)
    scope: dict[str, Any] = {"np": np, "i0": np.array([x]), "i1": np.array([y]), "o0": np.zeros((1, 1))}
    with np.errstate(all="ignore"):
        exec("\n".join(line.strip() for line in (*statements, *results)), scope)
    return float(scope["o0"][0, 0])


with TemporaryDirectory() as _folder:
    PAGE: Final = page_module("docs/how_to/extend.md", "plain_python.py", Path(_folder))


def in_plain_python(f: Any, x: float, y: float) -> float:
    """The function that the target of docs/how_to/extend.md writes."""
    scope: dict[str, Any] = {"math": math}
    exec(PAGE.function(f), scope)
    return float(scope["f"]([x], [y])[0])


def again(f: Any, x: float, y: float) -> float:
    """Rebuilt as an expression, operation by operation."""
    program, symbols = read(f), [ca.SX.sym("x"), ca.SX.sym("y")]
    values = run(program, points.REBUILT, given=lambda i, _: symbols[i], constant=ca.SX, refuse=KeyError)
    return float(ca.Function("g", symbols, [program.stored(values)[0][0]])(x, y))


def in_a_field(f: Any, x: float, y: float) -> float:
    """Rational values, recovered from their residues; other values are unknown there."""
    tape, trial = Tape.from_function(f), Trial(MERSENNE_127, random.Random(0))
    [[residue]] = tape.evaluate([[trial.residue(Fraction(value))] for value in (x, y)], trial)
    return float(rational_reconstruction(residue, MERSENNE_127))


Target = Callable[[Any, float, float], float]
TARGETS: Final[dict[str, tuple[Target, dict[int, Any]]]] = {
    "fractions": (in_fractions, rational.RULES),
    "intervals": (in_intervals, rational.RULES),
    "enclosures": (in_enclosures, enclosure.RULES),
    "balls": (in_balls, balls.RULES),
    "polynomials": (in_polynomials, polynomial.RULES),
    "numpy": (in_numpy, NUMPY_RULES),
    "plain python": (in_plain_python, PAGE.RULES),
    "again": (again, points.REBUILT),
}
REFUSED: Final = {
    "fractions": r"f: expected \+ - \* / only, found CasADi's instruction {}; its sign cannot be decided",
    "intervals": r"f: expected \+ - \* / only, found CasADi's instruction {}; its sign cannot be decided",
    "enclosures": r"f: expected \+ - \* /, sin and cos only, found CasADi's instruction {}",
    "balls": "CasADi's instruction {} has no enclosure rule",
    "polynomials": "f: expected sums and products of symbols, sines and cosines, found CasADi's instruction {}",
    "numpy": "Python source of f: expected plain operations, found CasADi's {}",
    "plain python": "f: no rule for CasADi's instruction {}",
}
ARITHMETIC_NAMES: Final = "add sub mul div neg sq twice inv"
HELD: Final = {
    "fractions": ARITHMETIC_NAMES,
    "intervals": ARITHMETIC_NAMES,
    "enclosures": f"{ARITHMETIC_NAMES} sin cos",
    "balls": " ".join(operation.name for operation in OPERATIONS.values() if operation.name != "erfinv"),
    "polynomials": "add sub mul neg sq twice sin cos",
    "numpy": f"{ARITHMETIC_NAMES} sin cos tanh",
    "plain python": f"{ARITHMETIC_NAMES} sin cos tanh exp sqrt fabs fmin fmax lt le eq ne not and or if_else_zero",
    "again": " ".join(operation.name for operation in OPERATIONS.values()),
}


def differences(name: str, code: int) -> Iterator[bool]:
    """True where CasADi has a number and the target has another one, or none."""
    compute, _ = TARGETS[name]
    for x, y in POINTS:
        expected = truth(code, x, y)
        if math.isfinite(expected):
            try:
                found = compute(FUNCTIONS[code], x, y)
            except Exception:  # for any result of a wrong rule
                found = math.nan
            yield not math.isclose(found, expected, rel_tol=1e-13, abs_tol=1e-13)


def held(name: str) -> list[int]:
    return [code for code in CODES if OPERATIONS[code].name in HELD[name].split()]


@pytest.mark.parametrize("name", TARGETS)
def test_each_rule_gives_what_casadi_gives(name: str) -> None:
    assert sorted(TARGETS[name][1]) == held(name)
    found = {OPERATIONS[code].name: list(differences(name, code)) for code in held(name)}
    assert not {operation: wrong for operation, wrong in found.items() if any(wrong) or len(wrong) < 2}


@pytest.mark.parametrize("name", REFUSED)
def test_an_operation_without_a_rule_is_refused_in_the_targets_own_words(name: str) -> None:
    others = [code for code in CODES if code not in held(name)]
    assert others
    for code in others:
        with pytest.raises(DmframeError, match=REFUSED[name].format(code)):
            TARGETS[name][0](FUNCTIONS[code], 0.375, 0.75)


def another(rules: dict[int, Any], code: int) -> int:
    """The next operation with as many operands; not a power, of which there are two equal ones."""
    alike = [k for k in sorted(rules) if OPERATIONS[k].arity == OPERATIONS[code].arity and k != ca.OP_CONSTPOW]
    return next((k for k in alike if k > code), alike[0])


@pytest.mark.parametrize("name", TARGETS)
def test_a_wrong_rule_is_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rules = TARGETS[name][1]
    for code in held(name):
        with monkeypatch.context() as patched:
            patched.setitem(rules, code, rules[another(rules, code)])
            assert any(differences(name, code)), OPERATIONS[code].name


def followed(code: int) -> Any:
    """The operation with non-trivial conditions, for targets that use conditions."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    conditions = {ca.OP_NOT: (x < 1, y), ca.OP_IF_ELSE_ZERO: (x < 1, y)}
    conditions |= dict.fromkeys((ca.OP_AND, ca.OP_OR), (x < 1, y < 0.7))
    return ca.Function("f", [x, y], [FUNCTIONS[code](*conditions.get(code, (x, y)))])


def differences_near(code: int) -> Iterator[bool]:
    """On the piece that begins at each point, from CasADi's value shortly after."""
    f = followed(code)
    for x, y in POINTS:
        expected = float(f(x + 1e-12, y))
        if math.isfinite(expected) and math.isfinite(float(f(x, y))):
            try:
                found = in_pieces(f, x, y)
            except Exception:
                found = math.nan
            yield not math.isclose(found, expected, rel_tol=1e-5, abs_tol=1e-5)


@pytest.mark.parametrize("code", [code for code in CODES if code != ca.OP_ERFINV])
def test_what_is_followed_in_time_has_casadis_value_near_every_switch(code: int) -> None:
    wrong = list(differences_near(code))
    assert len(wrong) >= 2
    assert not any(wrong)


@pytest.mark.parametrize("code", sorted(pieces.SWITCHES))
def test_a_switch_held_wrongly_is_caught(code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rules = dict(pieces.SWITCHES)
    farther = another(rules, another(rules, code))  # near a switch < and <= are equal
    monkeypatch.setattr(pieces, "SWITCHES", rules | {code: rules[farther]})
    assert any(differences_near(code))


def on_polynomials(code: int) -> bool:
    """True if the rule for polynomials in time agrees with arithmetic at one time."""
    operands = [fmpq_poly([3, fmpq(1, 2)]), fmpq_poly([5])][: OPERATIONS[code].arity]
    if code == ca.OP_INV:
        operands = [fmpq_poly([5])]
    try:
        found = pieces.ARITHMETIC[code](*operands)
    except DomainError:  # a quotient that is no polynomial
        return False
    return bool(found(fmpq(7)) == ARITHMETIC[code](*(operand(fmpq(7)) for operand in operands)))


@pytest.mark.parametrize("code", sorted(ARITHMETIC))
def test_polynomials_in_time_have_the_rules_of_numbers(code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert on_polynomials(code)
    rules = dict(ARITHMETIC)
    monkeypatch.setattr(pieces, "ARITHMETIC", rules | {code: rules[another(rules, code)]})
    assert not on_polynomials(code)


def test_the_field_reconstructs_rational_values_only() -> None:
    rational_ones = {*ARITHMETIC, ca.OP_FABS}
    for code in CODES:
        for x, y in POINTS:
            expected = truth(code, x, y)
            if code in ARITHMETIC and math.isfinite(expected):
                assert in_a_field(FUNCTIONS[code], x, y) == pytest.approx(expected, rel=1e-15)
        if code not in rational_ones | {ca.OP_SIN, ca.OP_COS, ca.OP_SIGN}:
            trial = Trial(MERSENNE_127, random.Random(0))
            tape = Tape.from_function(FUNCTIONS[code])
            [[one]], [[same]], [[other]] = (tape.evaluate([[x], [y]], trial) for x, y in ((4, 9), (4, 9), (5, 9)))
            assert one == same != other
            assert [key.split(",")[0] for key in trial.functions] == [f"{OPERATIONS[code].name} of {k}" for k in (4, 5)]


def whole(codes: Sequence[int]) -> Any:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    return ca.Function("f", [x, y], [ca.vertcat(*(FUNCTIONS[code](x, y) for code in codes))])


def in_c(codes: Sequence[int], dialect: c.Dialect = c.ONE) -> np.ndarray:
    """A column for each point."""
    entry = (
        '__attribute__((visibility("default"))) void dm_rows(const double *x, const double *y, double *r) '
        "{ dm_f(x, y, r); }\n"
    )
    library = load("".join(map(shipped, dialect.arithmetic)) + c.written(whole(codes), dialect) + "\n" + entry).library
    assert library is not None
    columns = []
    for x, y in POINTS:
        given, result = [np.array([value]) for value in (x, y)], np.zeros(len(codes))
        library.dm_rows(*map(address, given), address(result))
        columns.append(result)
    return np.array(columns).T


IN_C: Final = [code for code in CODES if code != ca.OP_ERFINV]


def test_each_rule_gives_in_c_what_casadi_gives() -> None:
    assert sorted(c.ONE.rules) == sorted(c.SIMD.rules) == IN_C
    expected = np.array([whole(IN_C)(x, y).full()[:, 0] for x, y in POINTS]).T
    np.testing.assert_allclose(in_c(IN_C), expected, rtol=4e-16, atol=0)
    with pytest.raises(EngineError, match=f"f has CasADi's instruction {ca.OP_ERFINV}, which cannot be translated"):
        c.written(FUNCTIONS[ca.OP_ERFINV])


def test_wrong_rules_in_c_are_caught() -> None:
    expected = np.array([whole(IN_C)(x, y).full()[:, 0] for x, y in POINTS]).T
    named = {code: OPERATIONS[code].name for code in IN_C}
    wrong = {name: c.ONE.forms[named[another(dict(c.ONE.rules), code)]] for code, name in named.items()}
    found = in_c(IN_C, replace(c.ONE, forms=wrong))
    same = np.isclose(found, expected, rtol=1e-13, atol=0, equal_nan=True).all(axis=1)
    assert [OPERATIONS[code].name for code, alike in zip(IN_C, same, strict=True) if alike] == []


def test_numbers_that_are_not_finite_are_written_in_c_and_refused_elsewhere() -> None:
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.vertcat(x + math.nan, x + math.inf, x * -math.inf, x * -2.5)])
    text = c.written(f)
    assert [word in text for word in ("NAN", "INFINITY", "(-INFINITY)", "(-2.5)")] == [True] * 4
    for compute, words in (
        (Tape.from_function, "exact test of f: expected finite constants, found"),
        (lambda f: rational.evaluate(f, [[Fraction(1)]]), "f: expected finite constants, found"),
        (enclosure.Enclosing, "f: expected finite constants, found"),
    ):
        with pytest.raises(ValueFault, match=words):
            compute(f)


def test_a_number_is_a_double_or_what_was_written_as_the_target_likes() -> None:
    x = ca.SX.sym("x")
    f = ca.Function("f", [x, ca.SX.sym("y")], [x * 0.1])
    assert rational.evaluate(f, [[Fraction(1)], [Fraction(1)]]) == [[Fraction(1, 10)]]
    assert list(Tape.from_function(f).numbers.values()) == [Fraction(1, 10)]
    ((found,),) = polynomial.expand(f, [[polynomial.Polynomial.number(1)]] * 2)
    assert list(found.terms.values()) == [Fraction(0.1)]
    ((near,),) = enclosure.Enclosing(f)([[1.0], [1.0]])
    assert near.lower <= Fraction(0.1) <= near.upper


def test_a_whole_power_is_a_product_wherever_it_is_exact() -> None:
    """CasADi writes products up to an exponent of 100, and a power above."""
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.vertcat(x**150, x**-101, x**2.5)])
    tape, trial = Tape.from_function(f), Trial(MERSENNE_127, random.Random(0))
    powers = [k for k, node in enumerate(tape.nodes) if node.code == ca.OP_CONSTPOW]
    assert [tape.exponent(k) for k in powers] == [150, -101, None]
    [[first, second, _]] = tape.evaluate([[3]], trial)
    assert [first, second] == [trial.residue(Fraction(3) ** exponent) for exponent in (150, -101)]
    assert list(trial.functions) == [f"constpow of 3, {trial.residue(Fraction(5, 2))}"]
    [[high, low, _]] = (program := tape.program).stored(balls.enclosed(program, [[arb(3)]]))
    assert math.isclose(float(high), 3.0**150, rel_tol=1e-14)
    assert math.isclose(float(low), 3.0**-101, rel_tol=1e-14)
    moving = [code for k, code in pieces.moving_operations(tape, [[True]]) if k in powers]
    assert moving == [ca.OP_POW, ca.OP_POW, ca.OP_CONSTPOW]
    whole_ones = Tape.from_function(ca.Function("f", [x], [ca.vertcat(x**150, x**-101)]))
    bound = degrees(whole_ones)
    assert bound.degree == 150
    assert bound.degree_total == 150 + 1  # the divisor x must not vanish
