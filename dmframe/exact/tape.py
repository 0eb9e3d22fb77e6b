"""A CasADi function's program with exact numbers, evaluated in a prime field."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final, final

from dmframe.common.errors import ValueFault
from dmframe.exact.literal import exact
from dmframe.exact.trial import Trial
from dmframe.program import BY_NAME, CONST, INPUT, OPERATIONS, POWERS, Node, Program, read

if TYPE_CHECKING:
    import casadi as ca

_ADD, _SUB, _MUL, _DIV, _NEG, _SQ, _TWICE, _INV, _SIN, _COS, _SIGN, _FABS = (
    BY_NAME[name].code
    for name in ("add", "sub", "mul", "div", "neg", "sq", "twice", "inv", "sin", "cos", "sign", "fabs")
)
_INPUT, _CONST = INPUT, CONST
_KNOWN: Final = frozenset((INPUT, CONST, *OPERATIONS))
_OPAQUE: Final = (
    frozenset(OPERATIONS) - POWERS - {_ADD, _SUB, _MUL, _DIV, _NEG, _SQ, _TWICE, _INV, _SIN, _COS, _SIGN, _FABS}
)
"""Functions that a field does not have."""
_LARGEST_POWER: Final = 2**16


@final
class Tape:
    """The program of an SX function; `numbers` contains the rational numbers that its floats were written as.

    The field operations are written in one loop instead of a table of rules, since they take most of the time
    of a proof. Raises `ValueFault` for an operation on non-scalars and for a number that is not finite.
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
            self.numbers = {node.constant: exact(node.constant) for node in program.nodes if node.code == _CONST}
        except ValueFault as error:
            raise ValueFault(f"exact test of {self.name}: {error.text}") from None
        self._whole = dict(self._whole_exponents()) if program.codes & POWERS else {}

    @classmethod
    def from_function(cls, f: ca.Function) -> Tape:
        """Read `f`; also raises `ValueFault` for a function that is not an SX function."""
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
        """Instructions, for evaluations other than in a field."""
        return self.program.nodes

    def exponent(self, k: int) -> int | None:
        """The exponent of an integer power, which is a product; None for every other operation."""
        code, _, b, _, _ = self.nodes[k]
        return self._whole.get(b) if code in POWERS else None

    def _whole_exponents(self) -> Iterator[tuple[int, int]]:
        """(position, number) of exponents that are integers of moderate size."""
        for place in {node.b for node in self.nodes if node.code in POWERS}:
            if self.nodes[place].code == _CONST:
                number = self.numbers[self.nodes[place].constant]
                if number.denominator == 1 and abs(number) <= _LARGEST_POWER:
                    yield place, number.numerator

    def values(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[int]:
        """Residues of all instructions; arguments as in `evaluate`."""
        return [value % trial.prime for value in self._run(inputs, trial)]

    def evaluate(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[list[int]]:
        """Residues of the outputs at the residues of the inputs, both dense and column-major.

        Raises `ZeroDivision` if a denominator vanishes, and `ValueFault` for inputs of another size.
        """
        found = [len(values) for values in inputs]
        expected = [size for _, size in self.inputs]
        if found != expected:
            raise ValueFault(f"exact test of {self.name}: expected inputs of {expected} numbers, found {found}")
        return self.outputs_of(self._run(inputs, trial), trial)

    def outputs_of(self, values: Sequence[int], trial: Trial) -> list[list[int]]:
        """Residues of the outputs from the values of all instructions."""
        return [[value % trial.prime for value in matrix] for matrix in self.program.dense(values, 0)]

    def _run(self, inputs: Sequence[Sequence[int]], trial: Trial) -> list[int]:
        values = [0] * len(self.nodes)
        self.compute(enumerate(self.nodes), values, inputs, trial)
        return values

    def compute(
        self, places: Iterable[tuple[int, Node]], values: list[int], inputs: Sequence[Sequence[int]], trial: Trial
    ) -> None:
        """Enter the values of some instructions, with their positions and in order; they are not reduced.

        Raises `ZeroDivision` if a denominator vanishes.
        """
        # Sums are reduced only in products, which halves the time of a trial.
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
            elif code in _OPAQUE:
                operation = OPERATIONS[code]
                at = (values[a] % p, values[b] % p) if operation.arity == 2 else (values[a] % p,)
                values[k] = trial.opaque(operation.name, at)
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
            elif b in self._whole:
                exponent = self._whole[b]
                values[k] = (
                    pow(values[a], exponent, p) if exponent >= 0 else pow(trial.inverse(values[a]), -exponent, p)
                )
            else:  # a power
                values[k] = trial.opaque(OPERATIONS[code].name, (values[a] % p, values[b] % p))
