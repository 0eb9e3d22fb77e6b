"""A CasADi function's program with exact numbers, evaluated in a prime field."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, NamedTuple, final

import casadi as ca

from dmframe.errors import ValueFault
from dmframe.exact.literal import literal
from dmframe.exact.trial import Trial
from dmframe.program import CONST, INPUT, OPERATIONS, POWERS, Node, Program, read

_ADD, _SUB, _MUL, _DIV, _NEG, _SQ, _TWICE, _INV = (
    ca.OP_ADD,
    ca.OP_SUB,
    ca.OP_MUL,
    ca.OP_DIV,
    ca.OP_NEG,
    ca.OP_SQ,
    ca.OP_TWICE,
    ca.OP_INV,
)
_SIN, _COS, _SIGN, _FABS = ca.OP_SIN, ca.OP_COS, ca.OP_SIGN, ca.OP_FABS
_INPUT, _CONST = INPUT, CONST
_SUMS_AND_PRODUCTS: Final = frozenset((_ADD, _SUB, _MUL, _NEG, _SQ, _TWICE))
_KNOWN: Final = frozenset((INPUT, CONST, *OPERATIONS))
_LARGEST_POWER: Final = 2**16


class _Size(NamedTuple):
    """Degrees of a numerator and a denominator, and log2 of the sum of their integer coefficients' absolute values."""

    numerator: int
    denominator: int
    height: int
    height_denominator: int


_ONE: Final = _Size(0, 0, 0, 0)
_FREE: Final = _Size(1, 0, 0, 0)
_ON_CIRCLE: Final = _Size(2, 2, 1, 1)


@final
@dataclass(frozen=True)
class Bound:
    """What the probability of a wrong answer depends on.

    `degree` is that of the outputs' numerators (the largest of them), `height` log2 of the size of their integer
    coefficients. `degree_total` and `height_total` add what else can go wrong at a random point: a vanishing
    denominator, and two different arguments of one function that happen to be equal.
    """

    degree: int
    height: int
    degree_total: int
    height_total: int


@final
class Tape:
    """The program of an SX function, and in `numbers` the rational ones that its floats were written as.

    Its operations in the field are written out in one loop, for a proof spends its time there: no table of rules.
    Raises `ValueFault` for an operation of something else than scalars, and for a number that is not finite.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.name = program.name
        self.inputs = tuple((argument.name, argument.size) for argument in program.inputs)
        self.outputs = program.outputs
        if not program.codes <= _KNOWN:
            code = next(node.code for node in program.nodes if node.code not in _KNOWN)
            raise ValueFault(
                f"exact test of {self.name}: expected scalar operations, found CasADi's instruction {code}; "
                "expand() the function"
            )
        try:
            self.numbers = {constant: literal(constant) for code, _, _, constant, _ in program.nodes if code == _CONST}
        except ValueFault as error:
            raise ValueFault(f"exact test of {self.name}: {error.text}") from None
        self._whole = dict(self._whole_exponents()) if program.codes & POWERS else {}

    @classmethod
    def from_function(cls, f: ca.Function) -> Tape:
        """Read `f`; raises `ValueFault` for a function that is not plain SX too."""
        if not f.is_a("SXFunction"):
            raise ValueFault(f"exact test of {f.name()}: expected an SX function, found {f.class_name()}; expand() it")
        if f.has_free():
            free = ", ".join(str(symbol) for symbol in f.get_free())
            raise ValueFault(
                f"exact test of {f.name()}: expected every symbol among the inputs, found the free {free}; add an input"
            )
        return cls(read(f))

    def __len__(self) -> int:
        return len(self.program.nodes)

    @property
    def nodes(self) -> Sequence[Node]:
        """What is computed, for another evaluation than in a field."""
        return self.program.nodes

    def exponent(self, k: int) -> int | None:
        """The exponent of a whole power, which is a product; None for every other operation."""
        code, _, b, _, _ = self.nodes[k]
        return self._whole.get(b) if code in POWERS else None

    def _whole_exponents(self) -> Iterator[tuple[int, int]]:
        """(place, number) of exponents that are whole, and not too large."""
        for place in {node.b for node in self.nodes if node.code in POWERS}:
            if self.nodes[place].code == _CONST:
                number = self.numbers[self.nodes[place].constant]
                if number.denominator == 1 and abs(number) <= _LARGEST_POWER:
                    yield place, number.numerator

    def values(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[int]:
        """The residues of all instructions, as `evaluate` takes its arguments."""
        return [value % trial.prime for value in self._run(inputs, trial)]

    def evaluate(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[list[int]]:
        """The outputs' residues at the inputs' residues, both dense and column-major.

        Raises `ZeroDivision` where a denominator vanishes, and `ValueFault` for inputs of another size.
        """
        found = [len(values) for values in inputs]
        expected = [size for _, size in self.inputs]
        if found != expected:
            raise ValueFault(f"exact test of {self.name}: expected inputs of {expected} numbers, found {found}")
        return self.outputs_of(self._run(inputs, trial), trial)

    def outputs_of(self, values: Sequence[int], trial: Trial) -> list[list[int]]:
        """The outputs' residues of the numbers of all instructions."""
        return [[value % trial.prime for value in matrix] for matrix in self.program.dense(values, 0)]

    def _run(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[int]:
        values = [0] * len(self.nodes)
        self.compute(enumerate(self.nodes), values, inputs, trial)
        return values

    def compute(
        self, places: Iterable[tuple[int, Node]], values: list[int], inputs: Sequence[Sequence[int]], trial: Trial
    ) -> None:
        """Enter the numbers of some instructions, each with its place and in order; they are not reduced.

        Raises `ZeroDivision` where a denominator vanishes.
        """
        # Sums stay unreduced until a product reduces them: that halves the time of a trial.
        p = trial.prime
        given, numbers = self.program.elements(inputs), self.numbers
        for k, (code, a, b, constant, _) in places:
            if code == _MUL:
                values[k] = values[a] * values[b] % p
            elif code == _ADD:
                values[k] = values[a] + values[b]
            elif code == _SUB:
                values[k] = values[a] - values[b]
            elif code == _SQ:
                values[k] = values[a] * values[a] % p
            elif code == _INPUT:
                values[k] = given[a][b]
            elif code == _NEG:
                values[k] = -values[a]
            elif code == _TWICE:
                values[k] = 2 * values[a]
            elif code == _CONST:
                values[k] = trial.residue(numbers[constant])
            elif code == _DIV:
                values[k] = values[a] * trial.inverse(values[b]) % p
            elif code == _INV:
                values[k] = trial.inverse(values[a])
            elif code == _COS:
                values[k] = trial.cos_sin(values[a] % p)[0]
            elif code == _SIN:
                values[k] = trial.cos_sin(values[a] % p)[1]
            elif code == _SIGN:
                values[k] = trial.sign(values[a] % p)
            elif code == _FABS:
                values[k] = trial.size(values[a] % p)
            elif code in POWERS and b in self._whole:
                exponent = self._whole[b]
                values[k] = (
                    pow(values[a], exponent, p) if exponent >= 0 else pow(trial.inverse(values[a]), -exponent, p)
                )
            else:
                operation = OPERATIONS[code]
                at = (values[a] % p, values[b] % p) if operation.arity == 2 else (values[a] % p,)
                values[k] = trial.opaque(operation.name, at)

    def degrees(self, fixed: Mapping[int, Sequence[Fraction | None]] | None = None) -> Bound:
        """Bounds on the outputs' degrees in their free symbols; `fixed` gives inputs, or elements, known values.

        The free symbols are the inputs, one t for each point of the circle, and one symbol for each opaque value.
        """
        known = self.program.elements([(fixed or {}).get(i, [None] * size) for i, (_, size) in enumerate(self.inputs)])
        sizes: list[_Size] = []
        doubts = list(self._spread(known, sizes))
        outputs = [size for output in self.program.stored(sizes) for size in output]
        degree = max((size.numerator for size in outputs), default=0)
        height = max((size.height for size in outputs), default=0)
        return Bound(
            degree, height, degree + sum(doubt[0] for doubt in doubts), height + sum(doubt[1] for doubt in doubts)
        )

    def _spread(self, known: Sequence[Sequence[Fraction | None]], sizes: list[_Size]) -> Iterator[tuple[int, int]]:
        """Fill `sizes`; yield (degree, height) of each polynomial that must not vanish at the random point."""
        calls: dict[int, dict[int, _Size]] = defaultdict(dict)
        for place, node in enumerate(self.nodes):
            code, a, b, constant, _ = node
            if code in _SUMS_AND_PRODUCTS:
                sizes.append(_combined(code, sizes[a], sizes[b]))
            elif code == _INPUT:
                value = known[a][b]
                sizes.append(_FREE if value is None else _constant(value))
            elif code == _CONST:
                sizes.append(_constant(self.numbers[constant]))
            elif code in (_DIV, _INV):
                yield sizes[b].numerator, sizes[b].height
                sizes.append(_times(sizes[a] if code == _DIV else _ONE, _power(sizes[b], -1)))
            elif (exponent := self.exponent(place)) is not None:
                if exponent < 0:
                    yield sizes[a].numerator, sizes[a].height
                sizes.append(_power(sizes[a], exponent))
            else:
                function = {_COS: _SIN, _FABS: _SIGN}.get(code, code)
                calls[function].update((operand, sizes[operand]) for operand in node.operands)
                sizes.append(_result(code, sizes[a]))
        for function, found in calls.items():
            yield _coincidences(list(found.values()))
            if function == _SIN:
                yield 2 * len(found), len(found)


def _constant(value: Fraction) -> _Size:
    return _Size(0, 0, abs(value.numerator).bit_length(), value.denominator.bit_length())


def _power(size: _Size, exponent: int) -> _Size:
    scaled = _Size(*(abs(exponent) * part for part in size))
    if exponent >= 0:
        return scaled
    return _Size(scaled.denominator, scaled.numerator, scaled.height_denominator, scaled.height)


def _times(x: _Size, y: _Size) -> _Size:
    return _Size(*(left + right for left, right in zip(x, y, strict=True)))


def _combined(code: int, x: _Size, y: _Size) -> _Size:
    """The size of a sum or a product; of the left one where the operation has one argument."""
    if code in (_ADD, _SUB):
        return _Size(
            max(x.numerator + y.denominator, y.numerator + x.denominator),
            x.denominator + y.denominator,
            max(x.height + y.height_denominator, y.height + x.height_denominator) + 1,
            x.height_denominator + y.height_denominator,
        )
    if code == _MUL:
        return _times(x, y)
    if code == _SQ:
        return _power(x, 2)
    return x._replace(height=x.height + 1) if code == _TWICE else x


def _result(code: int, argument: _Size) -> _Size:
    """The size of a function's value: a point of the circle, a free symbol, or an argument times a sign."""
    if code in (_SIN, _COS):
        return _ON_CIRCLE
    return _times(argument, _FREE) if code == _FABS else _FREE


def _coincidences(arguments: Sequence[_Size]) -> tuple[int, int]:
    """Of k arguments, x = y or x = -y in k (k-1)/2 pairs each, and x = 0 in k cases: k^2 polynomials."""
    degree = max(size.numerator for size in arguments) + max(size.denominator for size in arguments)
    height = max(size.height for size in arguments) + max(size.height_denominator for size in arguments) + 1
    return len(arguments) ** 2 * degree, len(arguments) ** 2 * height
