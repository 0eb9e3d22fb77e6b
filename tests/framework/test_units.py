"""Units against SI's definitions worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dmframe.common.errors import UnitError, ValueFault
from dmframe.common.units import _DEFINITIONS, _PREFIXES_OF, _size, compatible, is_rate, plain, rate_over, to_unit

HOW = "write it like N m s/rad or m/s^2: spaces multiply, everything after the one slash divides"
CHOICES = "choose from %, A, Hz, J, N, V, W, deg, h, kg, m, min, mm, ms, rad, rpm, s, turn"


@pytest.mark.parametrize(
    ("text", "unit", "number"),
    [
        ("90 ms", "s", 0.09),
        ("35 ms", "s", 0.035),
        ("8ms", "s", 0.008),
        ("1e3 us", "s", 0.001),
        ("250 µs", "s", 0.00025),
        ("2 min", "s", 120.0),
        ("-90 deg", "rad", -math.pi / 2),
        ("+.5 turn", "rad", math.pi),
        ("60 rpm", "rad/s", 2 * math.pi),
        ("1 rad/s", "rad/s", 1.0),
        ("3 N m", "N m", 3.0),
        ("3 J", "N m", 3.0),
        ("0.8 kN m s/rad", "N m s/rad", 800.0),
        ("180 N m s/deg", "N m s/rad", 180 * 180 / math.pi),
        ("2 kg m^2", "kg m^2", 2.0),
        ("2 kg cm**2", "kg m^2", 0.0002),
        ("9.81 m s^-2", "m/s^2", 9.81),
        ("5 %", "", 0.05),
        ("7", "m", 7.0),
        (" 7 ", "", 7.0),
    ],
)
def test_a_text_with_a_unit_becomes_the_nearest_float_in_the_unit_expected(text: str, unit: str, number: float) -> None:
    assert to_unit(text, unit) == number


def test_a_bare_number_is_in_the_unit_expected_already() -> None:
    assert to_unit(3, "rad/s") == 3.0
    assert isinstance(to_unit(3, "rad/s"), float)


def test_a_bandwidth_may_be_given_as_an_angular_frequency_and_not_the_other_way_round() -> None:
    assert to_unit("15 rad/s", "1/s") == 15.0
    with pytest.raises(UnitError, match="differ by an angle"):
        to_unit("15 1/s", "rad/s")
    with pytest.raises(UnitError, match="differ by an angle"):
        to_unit("15 rad/s^2", "1/s^2")


def test_everything_after_the_slash_divides() -> None:
    assert to_unit("1 J/kg K", "m^2/s^2 K") == 1.0
    assert compatible("J/kg K", "J/(kg K)")
    assert not compatible("J/kg K", "J K/kg")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        ("3 m", "rad/s", "expected a quantity in rad/s, found '3 m': m cannot be converted to rad/s"),
        ("0 m", "s", "expected a quantity in s, found '0 m': m cannot be converted to s"),
        ("3 m", "", "expected a plain number, found '3 m': m cannot be converted to a plain number"),
        (
            "9 deg",
            "rad/s",
            "expected a quantity in rad/s, found '9 deg': deg cannot be converted to rad/s; did you mean deg/s?",
        ),
        ("1 kN", "N/m", "expected a quantity in N/m, found '1 kN': kN cannot be converted to N/m; did you mean kN/m?"),
        (
            "2 m/s",
            "m/s^2",
            "expected a quantity in m/s^2, found '2 m/s': m/s cannot be converted to m/s^2; did you mean m/s^2?",
        ),
        ("3 N m", "N", "expected a quantity in N, found '3 N m': N m cannot be converted to N"),
        ("125 Hz", "s", "expected a quantity in s, found '125 Hz': Hz cannot be converted to s; one over it can: 8 ms"),
        ("0 Hz", "s", "expected a quantity in s, found '0 Hz': Hz cannot be converted to s"),
        ("1e999 Hz", "s", "expected a quantity in s, found '1e999 Hz': Hz cannot be converted to s"),
        ("5 cmm", "m", "expected a quantity in m, found '5 cmm': unknown unit cmm; did you mean mm?"),
        ("3 deg", "m", "expected a quantity in m, found '3 deg': deg cannot be converted to m"),
        (
            "2 Hz",
            "rad/s",
            "expected a quantity in rad/s, found '2 Hz': Hz and rad/s differ by an angle; write rad, deg or turn",
        ),
        (
            "2 rad",
            "",
            "expected a plain number, found '2 rad': rad and a plain number differ by an angle; write rad, deg or turn",
        ),
        ("3 rad/sec", "rad/s", "expected a quantity in rad/s, found '3 rad/sec': unknown unit sec; did you mean s?"),
        ("3 Newton", "N", "expected a quantity in N, found '3 Newton': unknown unit Newton; did you mean N?"),
        ("3 Nm", "N m", "expected a quantity in N m, found '3 Nm': unknown unit Nm; did you mean N m?"),
        ("3 Ns", "N s", "expected a quantity in N s, found '3 Ns': unknown unit Ns; did you mean N s?"),
        ("3 hz", "Hz", "expected a quantity in Hz, found '3 hz': unknown unit hz; did you mean Hz?"),
        ("3 sec", "s", "expected a quantity in s, found '3 sec': unknown unit sec; did you mean s?"),
        ("3 furlong", "s", f"expected a quantity in s, found '3 furlong': unknown unit furlong; {CHOICES}"),
        ("3 m", "furlong", f"expected a quantity in furlong, found '3 m': unknown unit furlong; {CHOICES}"),
        ("1,5 m", "m", "expected a quantity in m, found '1,5 m': a number has a decimal point, not a comma"),
        ("3 m/s/s", "m", f"expected a quantity in m, found '3 m/s/s': cannot read 'm/s/s' as a unit; {HOW}"),
        ("3 m2", "m^2", f"expected a quantity in m^2, found '3 m2': cannot read 'm2' as a unit; {HOW}"),
        ("1 000 m", "m", f"expected a quantity in m, found '1 000 m': cannot read '000 m' as a unit; {HOW}"),
    ],
)
def test_a_unit_that_does_not_fit_is_refused(value: str, unit: str, text: str) -> None:
    with pytest.raises(UnitError) as fault:
        to_unit(value, unit)
    assert str(fault.value) == text


@pytest.mark.parametrize("unit", ["(m", "m)", "()", "^2", "m^", "m/", "/s", "m^99", "m-s", "m\\s", "(m)^2", "(" * 2000])
def test_what_is_not_a_unit_is_called_unreadable(unit: str) -> None:
    with pytest.raises(UnitError, match=r"cannot read .* as a unit; write it like N m s/rad"):
        to_unit("3 " + unit, "m")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("x", "expected a quantity in s, found 'x': begin with a number"),
        ("", "expected a quantity in s, found '': begin with a number"),
        ("nan s", "expected a quantity in s, found 'nan s': the number must be finite"),
        ("-.inf", "expected a quantity in s, found '-.inf': the number must be finite"),
        ("1e999 s", "expected a quantity in s, found '1e999 s': the number must be finite"),
        ("1e308 h", "expected a quantity in s, found '1e308 h': the number must be finite"),
        ("1e999999999999 s", "expected a quantity in s, found '1e999999999999 s': the number must be finite"),
        (math.nan, "expected a quantity in s, found nan: the number must be finite"),
        (-math.inf, "expected a quantity in s, found -inf: the number must be finite"),
        (10**400, f"expected a quantity in s, found 1{'0' * 59}...: the number must be finite"),
        (True, "expected a quantity in s, found True: give a number or a text such as '1 s'"),
        (None, "expected a quantity in s, found None: give a number or a text such as '1 s'"),
    ],
)
def test_what_is_not_a_finite_number_is_refused(value: Any, text: str) -> None:
    with pytest.raises(ValueFault) as fault:
        to_unit(value, "s")
    assert str(fault.value) == text


def test_a_wrong_type_for_a_plain_number_is_refused() -> None:
    with pytest.raises(ValueFault, match=r"^expected a plain number, found \[\]: give a number$"):
        to_unit([], "")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("unit_a", "unit_b", "same"),
    [
        ("N m s/rad", "N m/(rad/s)", True),
        ("J", "N m", True),
        ("1/s^2", "s^-2", True),
        ("rad/s", "rad/s", True),
        ("", "rad/rad", True),
        ("m", "mm", False),
        ("Hz", "rad/s", False),
        ("rad", "", False),
        ("rad", "deg", False),
        ("N m", "N m/rad", False),
    ],
)
def test_two_units_are_compatible_where_only_their_spelling_differs(unit_a: str, unit_b: str, same: bool) -> None:
    assert compatible(unit_a, unit_b) is same
    assert compatible(unit_b, unit_a) is same


def test_an_unknown_unit_is_compatible_with_nothing() -> None:
    with pytest.raises(UnitError, match=r"^unknown unit Nm; did you mean N m\?$"):
        compatible("Nm", "N m")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.09, "s", "90 ms"),
        (2.9e-4, "m", "290 µm"),
        (9.376e-3, "m", "9.38 mm"),
        (0.9999996, "s", "1 s"),
        (7200.0, "s", "7200 s"),
        (-0.5, "rad/s", "-500 mrad/s"),
        (800.0, "N m s/rad", "800 N m s/rad"),
        (1234567.0, "N", "1.23 MN"),
        (0.02, "m^2", "0.02 m^2"),
        (0.01, "mm", "0.01 mm"),
        (0.001, "1/s", "0.001 1/s"),
        (12345.0, "kg", "12300 kg"),
        (0.0, "m", "0 m"),
        (2.0, "", "2"),
        (math.nan, "m", "nan m"),
    ],
)
def test_a_quantity_is_shown_with_three_digits_and_a_prefix_that_reads_well(value: float, unit: str, text: str) -> None:
    assert plain(value, unit) == text


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.floats(1e-6, 1e6), st.sampled_from(["s", "m", "rad/s", "N m s/rad", "m/s^2", "V"]))
def test_what_is_shown_can_be_read_again(value: float, unit: str) -> None:
    assert to_unit(plain(value, unit, digits=6), unit) == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize(
    ("unit", "rate"),
    [
        ("m", "1/(m s)"),
        ("rad/s", "1/rad"),
        ("N m", "1/(N m s)"),
        ("rad^2/(N m s^3)", "N m s^2/rad^2"),
        ("s", "1/s^2"),
        ("1/s", ""),
    ],
)
def test_a_rate_over_a_quantity_has_the_unit_that_divides_it_by_the_second(unit: str, rate: str) -> None:
    assert rate_over(unit) == rate
    assert compatible(f"{rate or '1'}", f"1/(({unit}) s)")


def test_the_table_is_that_of_pint() -> None:
    import pint

    registry: Any = pint.UnitRegistry()
    bases = {"rad": "radian", "K": "kelvin", "A": "ampere"}
    names = [name for line in _DEFINITIONS.strip().splitlines() for name in line.partition(" = ")[0].split()]
    prefixed = [f"{prefix}metre" for few in _PREFIXES_OF for prefix in few.split()]
    for name in (*names, *prefixed):
        scale, dimension = _size(name)
        ours = float(scale) * registry("1")
        for base, power in dimension.items():
            ours = ours * registry(bases.get(base, base)) ** power
        theirs = registry({"%": "percent", "rev": "turn"}.get(name, name))
        assert math.isclose((theirs / ours).to_reduced_units().magnitude, 1.0, rel_tol=1e-12), name


@pytest.mark.parametrize(
    ("text", "seconds"), [("2 minutes", 120.0), ("2 mins", 120.0), ("10 seconds", 10.0), ("2 ms", 0.002)]
)
def test_a_name_of_three_letters_has_a_plural(text: str, seconds: float) -> None:
    assert to_unit(text, "s") == seconds


@pytest.mark.parametrize(("text", "hint"), [("2 Pas", "Pa s"), ("2 Ns", "N s"), ("2 Hzs", "Hz s"), ("2 ss", "")])
def test_a_product_without_a_space_is_no_plural(text: str, hint: str) -> None:
    with pytest.raises(UnitError, match=f"unknown unit .*{hint}"):
        to_unit(text, "N s")


@pytest.mark.parametrize(
    ("unit", "of", "rate"),
    [("rad/s", "rad", True), ("m/s^2", "m/s", True), ("1/s", "", True), ("deg/s", "rad", False), ("m/s", "rad", False)],
)
def test_a_rate_has_the_unit_of_its_quantity_over_seconds(unit: str, of: str, rate: bool) -> None:
    assert is_rate(unit, of) is rate
