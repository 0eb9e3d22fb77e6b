"""Degrees and sizes of coefficients, compared with SymPy's for the same fractions, expanded and not reduced."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from fractions import Fraction
from math import log2
from typing import Any, Final, final

import casadi as ca
import pytest

from dmframe.common.errors import ValueFault
from dmframe.exact.ring import evaluated
from dmframe.exact.sizes import Size, Sizes, free
from dmframe.exact.tangent import Tangents
from dmframe.exact.tape import Tape
from dmframe.prove.claim import Steps
from dmframe.prove.rules import step_result


@final
class Quotient:
    """A numerator and a denominator, polynomials that are expanded and never reduced."""

    def __init__(self, numerator: Any, denominator: Any = 1) -> None:
        import sympy  # imported here: it takes a second, and each worker collects every test

        self.numerator, self.denominator = sympy.expand(numerator), sympy.expand(denominator)

    def __add__(self, other: Any) -> Quotient:
        a, b, c, d = self.numerator, self.denominator, *_parts(other)
        return Quotient(a * d + c * b, b * d)

    def __mul__(self, other: Any) -> Quotient:
        c, d = _parts(other)
        return Quotient(self.numerator * c, self.denominator * d)

    def __neg__(self) -> Quotient:
        return Quotient(-self.numerator, self.denominator)

    def __sub__(self, other: Any) -> Quotient:
        return self + (-other)

    def __rsub__(self, other: Any) -> Quotient:
        return other + (-self)

    __radd__, __rmul__ = __add__, __mul__


def _parts(value: Any) -> tuple[Any, Any]:
    import sympy

    return (value.numerator, value.denominator) if isinstance(value, Quotient) else (sympy.Integer(value), 1)


@final
class Quotients:
    """The ring of these fractions; a function's value is a new symbol, and equal arguments give the same."""

    def __init__(self) -> None:
        self._known = dict[Any, Any]()

    def number(self, value: Fraction | int) -> Quotient:
        return Quotient(Fraction(value).numerator, Fraction(value).denominator)

    def reduced(self, value: Any) -> Any:
        return value

    def inverse(self, value: Any) -> Quotient:
        numerator, denominator = _parts(value)
        if numerator == 0:
            raise ZeroDivisionError
        return Quotient(denominator, numerator)

    def power(self, value: Any, exponent: int) -> Quotient:
        numerator, denominator = _parts(value if exponent >= 0 else self.inverse(value))
        return Quotient(numerator ** abs(exponent), denominator ** abs(exponent))

    def call(self, name: str, *arguments: Any) -> Quotient:
        import sympy

        function = {"cos": "sin", "fabs": "sign"}.get(name, name)
        key = (function, *(sympy.cancel(a / b) for a, b in map(_parts, arguments)))
        t = self._known.setdefault(key, sympy.Symbol(f"z{len(self._known)}"))
        if name in ("sin", "cos"):
            return Quotient(2 * t if name == "sin" else 1 - t * t, 1 + t * t)
        return arguments[0] * Quotient(t) if name == "fabs" else Quotient(t)


def exceeds(polynomial: Any, degree: int, height: int) -> bool:
    """True if a polynomial has a higher degree, or larger coefficients, than its bound."""
    import sympy

    if polynomial == 0:
        return False
    terms = sympy.Poly(polynomial, *(sorted(polynomial.free_symbols, key=str) or [sympy.Symbol("x")]))
    return bool(terms.total_degree() > degree or log2(sum(abs(int(c)) for c in terms.coeffs())) > height + 1e-9)


def held(true: Sequence[Any], reported: Sequence[Any]) -> int:
    """Number of comparisons; each bound has to hold."""
    import sympy

    pairs = [(one, other) for one, other in zip(true, reported, strict=True) if isinstance(other, Size)]
    for one, size in pairs:
        numerator, denominator = _parts(one)
        assert not exceeds(sympy.sympify(numerator), size.degree, size.height)
        assert not exceeds(sympy.sympify(denominator), size.denominator, size.height_denominator)
    return len(pairs)


def test_a_size_that_is_too_small_is_seen() -> None:
    import sympy

    x, y = sympy.symbols("x y")
    assert not exceeds(6 * x**2 * y + 2, 3, 3)
    assert exceeds(6 * x**2 * y + 2, 2, 3)
    assert exceeds(6 * x**2 * y + 3, 3, 3)
    with pytest.raises(AssertionError):
        held([Quotient(x, 1 + x**2)], [Size(1, 1, 0, 1)])


ONE: Final[Sequence[Callable[[Any], Any]]] = (
    *(ca.sin, ca.cos, ca.fabs, ca.sign, ca.tanh, ca.exp, ca.atan, ca.sqrt),
    *(lambda x: x * x, lambda x: 1 / x, lambda x: x**-3, lambda x: 2 * x, lambda x: -x, lambda x: x**1.5),
)
TWO: Final[Sequence[Callable[[Any, Any], Any]]] = (
    *(ca.fmin, ca.fmax, ca.atan2, ca.hypot),
    *(lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / b, lambda a, b: a**b),
)


@pytest.mark.parametrize("seed", range(4))
def test_programs_and_their_derivatives_are_no_larger_than_it_states(seed: int) -> None:
    import sympy

    rng, x, compared = random.Random(seed), ca.SX.sym("x", 3), 0
    symbols, directions = ([Quotient(s) for s in sympy.symbols(f"{name}0:3")] for name in "xv")
    for _ in range(40):
        pool = [*ca.vertsplit(x), ca.SX(0.3), ca.SX(-7), ca.SX(1) / 3]
        for _ in range(rng.randint(3, 6)):
            a, b = rng.choice(pool), rng.choice(pool)
            pool.append(rng.choice(ONE)(a) if rng.random() < 0.4 else rng.choice(TWO)(a, b))
        sizes, quotients = Sizes(), Quotients()
        try:
            tape = Tape.from_function(ca.Function("f", [x], pool[-2:]))
            reported, true = evaluated(tape, sizes, sizes.inputs(tape, {})), evaluated(tape, quotients, [symbols])
            slopes = Tangents(tape, [0, 1], [0])
            moved = slopes.along(sizes, reported, {0: [free() for _ in range(3)]})
            moving = slopes.along(quotients, true, {0: directions})
        except (ZeroDivisionError, ValueFault):
            continue
        compared += held(true, reported) + sum(map(held, moving, moved))
    assert compared > 100


@pytest.mark.parametrize("box", [False, True])
@pytest.mark.parametrize(
    ("rule", "sizes", "rows"), [("normalised", (2, 1), 1), ("normalised", (1,), 2), ("least_squares", (1,), 1)]
)
def test_steps_are_no_larger_than_it_states(rule: Any, sizes: tuple[int, ...], rows: int, box: bool) -> None:
    import sympy

    n, triangles = sum(sizes), sum(size * (size + 1) // 2 for size in sizes)
    counts = {"theta": n, "true": n, "gain": n, "floor": 1} | dict.fromkeys(("lower", "upper") if box else (), n)
    for k in range(rows):
        counts |= {f"h{k}": n, f"y{k}": len(sizes)}
    memory = {"gathered": triangles, "retention": 1} if rule == "least_squares" else {}
    counts |= memory
    steps = Steps(rule, "w", "G" if memory else "", sizes, rows, box, {})
    symbols = {name: [Quotient(s) for s in sympy.symbols(f"{name}_0:{count}")] for name, count in counts.items()}
    true = step_result(Quotients(), steps, symbols)
    reported = step_result(Sizes(), steps, {name: [free() for _ in range(count)] for name, count in counts.items()})
    for name in reported.moves:
        assert held(true.moves[name], reported.moves[name])
    assert held([true.moved, true.lost, true.gained], [reported.moved, reported.lost, reported.gained]) == 3


@pytest.mark.parametrize("n", [1, 2, 3])
def test_an_inverse_matrix_is_no_larger_than_it_states(n: int) -> None:
    """Compared with the adjugate of the polynomial matrix diag(B) W, B_i the product of the denominators of row i."""
    import sympy

    x, y, z = sympy.symbols("x y z")
    tops, bottoms = [x + 2 * y, 3 * x * z, y - 5, x * x + 1, 7], [z + 3, 1 + x * x, 2, y]
    W = [[(tops[(2 * i + j) % 5], bottoms[(i + 3 * j) % 4]) for j in range(n)] for i in range(n)]
    given = [[_size_of(sympy.sympify(a), sympy.sympify(b)) for a, b in row] for row in W]
    ring = Sizes()
    reported = ring.inverse_matrix(given)
    B = [sympy.prod([b for _, b in row]) for row in W]
    N = sympy.Matrix(n, n, lambda i, j: sympy.cancel(B[i] * W[i][j][0] / W[i][j][1]))
    adjugate, determinant = N.adjugate(), sympy.expand(N.det())
    true = [[Quotient(adjugate[i, j] * B[j], determinant) for j in range(n)] for i in range(n)]
    assert sum(map(held, true, reported)) == n * n
    whole = ring.bound([])
    assert not exceeds(determinant, whole.degree_total, whole.height_total)  # it must not vanish
    assert len({id(entry) for row in reported for entry in row}) == n * n


def _size_of(numerator: Any, denominator: Any) -> Size:
    import sympy

    counts = []
    for polynomial in (numerator, denominator):
        terms = sympy.Poly(polynomial, *sympy.symbols("x y z"))
        counts.append((int(terms.total_degree()), sum(abs(int(c)) for c in terms.coeffs())))
    (degree, size), (lower, other) = counts
    return Size(degree, lower, (size - 1).bit_length(), (other - 1).bit_length())
