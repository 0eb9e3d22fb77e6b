"""A CasADi function's instructions, read once and evaluated in a prime field."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, NamedTuple, final

import casadi as ca

from dmframe.errors import ValueFault
from dmframe.exact.literal import literal
from dmframe.exact.trial import Trial

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
_SIN, _COS, _SIGN, _FABS, _CONST, _INPUT, _POWER = (
    ca.OP_SIN,
    ca.OP_COS,
    ca.OP_SIGN,
    ca.OP_FABS,
    ca.OP_CONST,
    ca.OP_INPUT,
    ca.OP_POW,
)
_OPAQUE_NAMES: Final = (
    "EXP LOG POW CONSTPOW SQRT TAN ASIN ACOS ATAN LT LE EQ NE NOT AND OR FLOOR CEIL FMOD COPYSIGN IF_ELSE_ZERO "
    "ERF FMIN FMAX SINH COSH TANH ASINH ACOSH ATANH ATAN2 ERFINV LOG1P EXPM1 HYPOT REMAINDER"
)
_OPAQUE: Final = {getattr(ca, "OP_" + name): name.lower() for name in _OPAQUE_NAMES.split()}
_TRANSPARENT: Final = frozenset((ca.OP_ASSIGN, ca.OP_LIFT))
_FIELD: Final = frozenset((_ADD, _SUB, _MUL, _DIV, _NEG, _SQ, _TWICE, _INV, _SIN, _COS, _SIGN, _FABS))
_OPAQUE_CALL: Final = -1
_LARGEST_POWER: Final = 2**16


class _Node(NamedTuple):
    """One value of the tape. `a` and `b` are earlier values, or the position of an input, or a power's exponent."""

    code: int
    a: int = 0
    b: int = 0
    arguments: tuple[int, ...] = ()
    constant: Fraction = Fraction(0)

    @property
    def operation(self) -> int:
        """CasADi's code of it."""
        return self.a if self.code == _OPAQUE_CALL else self.code

    @property
    def operands(self) -> tuple[int, ...]:
        """The earlier values that it takes."""
        if self.code in (_INPUT, _CONST):
            return ()
        return self.arguments or ((self.a,) if self.code == _POWER else (self.a, self.b))


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
    """The straight-line program of an SX function.

    Register reuse is undone, so that every instruction has a place of its own; constants are the rational numbers that
    the floats found were written as (`literal`).
    """

    def __init__(
        self, name: str, nodes: Sequence[_Node], inputs: Sequence[tuple[str, int]], outputs: Sequence[_Output]
    ) -> None:
        self.name = name
        self.inputs = tuple(inputs)
        self.outputs = tuple(outputs)
        self._nodes = tuple(nodes)

    @classmethod
    def from_function(cls, f: ca.Function) -> Tape:
        """Read `f`; raises `ValueFault` for a function that is not plain SX, or has non-finite constants."""
        if not f.is_a("SXFunction"):
            raise ValueFault(f"exact test of {f.name()}: expected an SX function, found {f.class_name()}; expand() it")
        if f.has_free():
            free = ", ".join(str(symbol) for symbol in f.get_free())
            raise ValueFault(
                f"exact test of {f.name()}: expected every symbol among the inputs, found the free {free}; add an input"
            )
        nodes, results = _read(f)
        inputs = [(f.name_in(i), f.numel_in(i)) for i in range(f.n_in())]
        outputs = [
            _Output(f.name_out(j), f.size1_out(j), f.numel_out(j), tuple(_dense(f.sparsity_out(j))), tuple(results[j]))
            for j in range(f.n_out())
        ]
        return cls(f.name(), nodes, inputs, outputs)

    def __len__(self) -> int:
        return len(self._nodes)

    @property
    def nodes(self) -> tuple[_Node, ...]:
        """The instructions, for another evaluation than in a field."""
        return self._nodes

    def values(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[int]:
        """The residues of all instructions, as `evaluate` takes its arguments."""
        return [value % trial.prime for value in self._run([value for vector in inputs for value in vector], trial)]

    def evaluate(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[list[int]]:
        """The outputs' residues at the inputs' residues, both dense and column-major.

        Raises `ZeroDivision` where a denominator vanishes, and `ValueFault` for inputs of another size.
        """
        found = [len(values) for values in inputs]
        expected = [size for _, size in self.inputs]
        if found != expected:
            raise ValueFault(f"exact test of {self.name}: expected inputs of {expected} numbers, found {found}")
        values = self._run([value for vector in inputs for value in vector], trial)
        results = []
        for output in self.outputs:
            dense = [0] * output.size
            for place, source in zip(output.places, output.sources, strict=True):
                dense[place] = values[source] % trial.prime
            results.append(dense)
        return results

    def _run(self, flat: Sequence[int], trial: Trial) -> list[int]:
        # Sums stay unreduced until a product reduces them: that halves the time of a trial.
        p = trial.prime
        values: list[int] = []
        append = values.append
        for code, a, b, arguments, constant in self._nodes:
            if code == _MUL:
                append(values[a] * values[b] % p)
            elif code == _ADD:
                append(values[a] + values[b])
            elif code == _SUB:
                append(values[a] - values[b])
            elif code == _SQ:
                append(values[a] * values[a] % p)
            elif code == _INPUT:
                append(flat[a])
            elif code == _NEG:
                append(-values[a])
            elif code == _TWICE:
                append(2 * values[a])
            elif code == _CONST:
                append(trial.residue(constant))
            elif code == _DIV:
                append(values[a] * trial.inverse(values[b]) % p)
            elif code == _INV:
                append(trial.inverse(values[a]))
            elif code == _COS:
                append(trial.cos_sin(values[a] % p)[0])
            elif code == _SIN:
                append(trial.cos_sin(values[a] % p)[1])
            elif code == _SIGN:
                append(trial.sign(values[a] % p))
            elif code == _FABS:
                append(trial.size(values[a] % p))
            elif code == _POWER:
                append(pow(values[a], b, p) if b >= 0 else pow(trial.inverse(values[a]), -b, p))
            else:
                at = ", ".join(str(values[argument] % p) for argument in arguments)
                append(trial.opaque(f"{_OPAQUE[a]} of {at}"))
        return values

    def degrees(self, fixed: Mapping[int, Sequence[Fraction | None]] | None = None) -> Bound:
        """Bounds on the outputs' degrees in their free symbols; `fixed` gives inputs, or elements, known values.

        The free symbols are the inputs, one t for each point of the circle, and one symbol for each opaque value.
        """
        known = [value for i, (_, size) in enumerate(self.inputs) for value in (fixed or {}).get(i, [None] * size)]
        sizes: list[_Size] = []
        doubts = list(self._spread(known, sizes))
        outputs = [sizes[source] for output in self.outputs for source in output.sources]
        degree = max((size.numerator for size in outputs), default=0)
        height = max((size.height for size in outputs), default=0)
        return Bound(
            degree, height, degree + sum(doubt[0] for doubt in doubts), height + sum(doubt[1] for doubt in doubts)
        )

    def _spread(self, known: Sequence[Fraction | None], sizes: list[_Size]) -> Iterator[tuple[int, int]]:
        """Fill `sizes`; yield (degree, height) of each polynomial that must not vanish at the random point."""
        calls: dict[int, dict[int, _Size]] = defaultdict(dict)
        for code, a, b, arguments, constant in self._nodes:
            if code == _INPUT:
                value = known[a]
                sizes.append(_FREE if value is None else _constant(value))
            elif code == _CONST:
                sizes.append(_constant(constant))
            elif code in (_DIV, _INV) or (code == _POWER and b < 0):
                divisor = sizes[b] if code == _DIV else sizes[a]
                yield divisor.numerator, divisor.height
                sizes.append(_times(sizes[a] if code == _DIV else _ONE, _power(divisor, b if code == _POWER else -1)))
            elif code in (_SIN, _COS, _SIGN, _FABS, _OPAQUE_CALL):
                function = {_OPAQUE_CALL: a, _COS: _SIN, _FABS: _SIGN}.get(code, code)
                calls[function].update((argument, sizes[argument]) for argument in arguments or (a,))
                sizes.append(_result(code, _FREE if arguments else sizes[a]))
            elif code == _POWER:
                sizes.append(_power(sizes[a], b))
            else:
                sizes.append(_combined(code, sizes[a], sizes[b]))
        for function, found in calls.items():
            yield _coincidences(list(found.values()))
            if function == _SIN:
                yield 2 * len(found), len(found)


@final
@dataclass(frozen=True)
class _Output:
    name: str
    rows: int
    size: int
    places: tuple[int, ...]
    sources: tuple[int, ...]


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


def _dense(sparsity: Any) -> list[int]:
    """Where each stored element of a sparse matrix stands in the dense, column-major one."""
    rows, columns = sparsity.row(), sparsity.get_col()
    return [row + column * sparsity.size1() for row, column in zip(rows, columns, strict=True)]


def _read(f: ca.Function) -> tuple[list[_Node], list[list[int]]]:
    """The nodes, and for each output the nodes that its stored elements come from."""
    starts, start = [], 0
    for i in range(f.n_in()):
        starts.append(start)
        start += f.numel_in(i)
    places = [_dense(f.sparsity_in(i)) for i in range(f.n_in())]
    results = [[0] * f.nnz_out(j) for j in range(f.n_out())]
    nodes: list[_Node] = []
    register: dict[int, int] = {}
    name, output, given, constant = f.name(), ca.OP_OUTPUT, ca.OP_INPUT, ca.OP_CONST  # looked up once, read 10^5 times
    code_of, arguments_of, targets_of = f.instruction_id, f.instruction_input, f.instruction_output
    for k in range(f.n_instructions()):
        code, arguments, targets = code_of(k), arguments_of(k), targets_of(k)
        if code == output:
            results[targets[0]][targets[1]] = register[arguments[0]]
            continue
        if code in _TRANSPARENT:
            register[targets[0]] = register[arguments[0]]
            continue
        if code in _FIELD:
            node = _Node(code, register[arguments[0]], register[arguments[-1]])
        elif code == given:
            node = _Node(_INPUT, starts[arguments[0]] + places[arguments[0]][arguments[1]])
        elif code == constant:
            node = _Node(_CONST, constant=_exact(f.instruction_constant(k), name))
        else:
            node = _operation(code, [register[argument] for argument in arguments], nodes, name)
        register[targets[0]] = len(nodes)
        nodes.append(node)
    return nodes, results


def _exact(value: float, name: str) -> Fraction:
    try:
        return literal(value)
    except ValueFault as error:
        raise ValueFault(f"exact test of {name}: {error.text}") from None


def _operation(code: int, arguments: Sequence[int], nodes: Sequence[_Node], name: str) -> _Node:
    """What is no operation of the field: a whole power, or a function of which nothing is known."""
    if code in (ca.OP_POW, ca.OP_CONSTPOW):
        exponent = nodes[arguments[1]]
        whole = exponent.code == _CONST and exponent.constant.denominator == 1
        if whole and abs(exponent.constant) <= _LARGEST_POWER:
            return _Node(_POWER, arguments[0], exponent.constant.numerator)
    if code in _OPAQUE:
        return _Node(_OPAQUE_CALL, code, arguments=tuple(arguments))
    raise ValueFault(
        f"exact test of {name}: expected scalar operations, found CasADi's instruction {code}; expand() the function"
    )
