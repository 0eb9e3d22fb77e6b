"""CasADi functions in single-assignment form, and their evaluation by a table of rules."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import count
from operator import itemgetter
from typing import Any, Final, NamedTuple, TypeVar, final

from dmframe.program.operations import BY_NAME, OPERATIONS

V = TypeVar("V")

TO_READ: Final = {"live_variables": False}
"""Options of a function that is made to be read: no register is used twice, which takes a call less an instruction."""

INPUT: Final = 45
CONST: Final = 44
_OUTPUT: Final = 46
_COPIES: Final = frozenset((0, 88))  # assign, lift
_CODE: Final = itemgetter(0)
_SYMMETRIC: Final = frozenset(BY_NAME[name].code for name in ("add", "mul"))
_ARITY: Final = {code: operation.arity for code, operation in OPERATIONS.items()}


class Node(NamedTuple):
    """One value.

    Parameters
    ----------
    code
        CasADi's code of the operation; `INPUT` for an element of an argument, `CONST` for a number.
    a, b
        Indices of the first and the last operand, which are earlier values. For `INPUT`, the argument and its stored
        element. Zero for a number, and for an operation that is not in `OPERATIONS`.
    constant
        The number.
    line
        Index of CasADi's instruction: no two values of operations share a line.
    """

    code: int
    a: int
    b: int
    constant: float
    line: int

    @property
    def operands(self) -> tuple[int, ...]:
        """Indices of its operands."""
        arity = _ARITY.get(self.code, 0)
        return (self.a, self.b) if arity == 2 else (self.a,) if arity else ()


@final
@dataclass(frozen=True)
class Pattern:
    """Input or output: places of its stored elements in the dense, column-major matrix."""

    name: str
    rows: int
    size: int
    places: Sequence[int]


@final
class Program:
    """Straight-line program in single-assignment form; `codes` are the codes of all its nodes.

    Parameters
    ----------
    inputs, outputs
        The arguments and the results.
    sources
        For each output, the places of the nodes that give its stored elements.
    """

    def __init__(
        self,
        name: str,
        nodes: Sequence[Node],
        inputs: Sequence[Pattern],
        outputs: Sequence[Pattern],
        sources: Sequence[Sequence[int]],
    ) -> None:
        self.name, self.nodes, self.sources = name, nodes, sources
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        self.codes: AbstractSet[int] = set(map(_CODE, nodes))

    def elements(self, inputs: Sequence[Sequence[V]]) -> list[list[V]]:
        """Stored elements of inputs that are dense, column-major matrices."""
        pairs = zip(self.inputs, inputs, strict=True)
        return [[matrix[place] for place in argument.places] for argument, matrix in pairs]

    def stored(self, values: Sequence[V]) -> list[list[V]]:
        """Stored elements of each output, from the values of all nodes."""
        return [[values[source] for source in sources] for sources in self.sources]

    def dense(self, values: Sequence[V], zero: V) -> list[list[V]]:
        """Each output as a dense, column-major matrix, with `zero` for elements that are not stored."""
        results = []
        for output, elements in zip(self.outputs, self.stored(values), strict=True):
            matrix = [zero] * output.size
            for place, element in zip(output.places, elements, strict=True):
                matrix[place] = element
            results.append(matrix)
        return results


def read(f: Any) -> Program:
    """Program of a function; operations that are not in `OPERATIONS` become nodes without operands."""
    sources = [[0] * f.nnz_out(j) for j in range(f.n_out())]
    nodes: list[Node] = []
    append, register = nodes.append, dict[int, int]()
    new = tuple.__new__  # a proof reads 10^5 instructions, and Node(...) takes twice the time
    for line, (code, arguments, targets, constant) in enumerate(instructions(f)):
        if code in _ARITY:
            append(new(Node, (code, register[arguments[0]], register[arguments[-1]], 0.0, line)))
            register[targets[0]] = len(nodes) - 1  # after reading its operands, of which it may be one
        elif code == _OUTPUT:
            sources[targets[0]][targets[1]] = register[arguments[0]]
        elif code == INPUT:
            register[targets[0]] = len(nodes)
            append(new(Node, (code, arguments[0], arguments[1], 0.0, line)))
        elif code in _COPIES:
            register[targets[0]] = register[arguments[0]]
        else:
            for target in targets:  # a call of another function has several
                register[target] = len(nodes)
                append(new(Node, (code, 0, 0, constant, line)))
    given = zip(f.name_in(), map(f.sparsity_in, range(f.n_in())), strict=True)
    results = zip(f.name_out(), map(f.sparsity_out, range(f.n_out())), strict=True)
    inputs, outputs = (
        [Pattern(name, x.size1(), x.numel(), _places(x)) for name, x in found] for found in (given, results)
    )
    return Program(f.name(), nodes, inputs, outputs, sources)


def shared(program: Program) -> Program:
    """The same program with each value computed once: of equal operations on equal operands the first is kept.

    CasADi builds an expression again where blocks are put together, so that two of three values may be repeated.
    """
    first, place, nodes = dict[tuple[Any, ...], int](), list[int](), list[Node]()
    new = tuple.__new__  # as in `read`
    for node in program.nodes:
        code, a, b, constant, line = node
        if code in _ARITY:
            a, b = place[a], place[b]
            key: tuple[Any, ...] = (code, b, a) if a > b and code in _SYMMETRIC else (code, a, b)
            node = new(Node, (code, a, b, constant, line))
        elif code == CONST:
            key = (code, constant)
        else:
            key = (code, a, b) if code == INPUT else (len(nodes),)
        known = first.setdefault(key, len(nodes))
        if known == len(nodes):
            nodes.append(node)
        place.append(known)
    sources = [[place[source] for source in output] for output in program.sources]
    return Program(program.name, nodes, program.inputs, program.outputs, sources)


def codes(f: Any) -> set[int]:
    """Codes of a function's instructions, in a fifth of the time of `read`."""
    return {f.instruction_id(k) for k in range(f.n_instructions())}


def instructions(f: Any) -> Iterator[tuple[int, list[int], list[int], float]]:
    """CasADi's instructions, (code, read, written, constant), with reused registers but for a function `TO_READ`."""
    code_of, arguments_of, targets_of = f.instruction_id, f.instruction_input, f.instruction_output
    outputs = sum(map(f.nnz_out, range(f.n_out())))
    values = count() if f.is_a("SXFunction") and f.sz_w() == f.n_instructions() - outputs else None
    for k in range(f.n_instructions()):
        code = code_of(k)
        targets = targets_of(k) if values is None or code == _OUTPUT else [next(values)]
        if code == CONST:
            yield code, [], targets, f.instruction_constant(k)
        else:
            yield code, arguments_of(k), targets, 0.0


def run(
    program: Program,
    rules: Mapping[int, Callable[..., V]],
    *,
    given: Callable[[int, int], V],
    constant: Callable[[float], V],
    refuse: Callable[[int], Exception],
    keep: Callable[[Node, V], V] | None = None,
) -> list[V]:
    """Values of all nodes, of the type that the rules compute with.

    Parameters
    ----------
    rules
        Operation's code -> function of its operands, which returns NotImplemented to refuse them.
    given
        (argument, stored element) -> value.
    constant
        Number -> value.
    refuse
        Code -> exception for an operation without a rule, or whose rule refuses its operands.
    keep
        (node, value) -> replacement of the value, such as the name of a variable that a line of text sets; the value
        itself by default.
    """
    values = list[V]()
    for node in program.nodes:
        code, a, b, number, _ = node
        rule = rules.get(code)
        if code == INPUT:
            value = given(a, b)
        elif code == CONST:
            value = constant(number)
        elif rule is None:
            raise refuse(code)
        else:
            arity = _ARITY.get(code)
            value = rule(values[a], values[b]) if arity == 2 else rule(values[a]) if arity else rule()
        if value is NotImplemented:
            raise refuse(code)
        values.append(value if keep is None else keep(node, value))
    return values


def _places(sparsity: Any) -> Sequence[int]:
    """Places of the stored elements of a sparse matrix in the dense, column-major one."""
    if sparsity.is_dense():
        return range(sparsity.numel())
    rows, columns = sparsity.row(), sparsity.get_col()
    return [row + column * sparsity.size1() for row, column in zip(rows, columns, strict=True)]
