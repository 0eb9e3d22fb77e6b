"""The fewest values in a program that are zero at rest, and without which none of its outputs is other than zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, Final, final

import numpy as np

from dmframe.exact.fixed import MAYBE
from dmframe.exact.literal import literal
from dmframe.program import CONST, INPUT, Node, Program, by_code

SMALL: Final = 1e-6
"""What is left of a sum, relative to its parts, below which they are taken to cancel at rest."""

LEAST: Final = 1e-9
"""A state below this is zero at rest; of two numbers that are compared, a difference above it says which is larger."""

_ANY, _ALL, _ONLY, _ITSELF = "any", "all", "only", "itself"

_KINDS: Final[Mapping[int, str]] = by_code(
    {
        "mul": _ANY,
        "add": _ALL,
        "sub": _ALL,
        **dict.fromkeys(("neg", "twice", "sq", "sqrt", "sin", "tan", "tanh", "fabs", "asin", "atan", "sinh"), _ONLY),
        "div": _ONLY,
        "if_else_zero": _ANY,
    }
)
"""Which operands make an operation vanish: any one, all, or the first."""


def _vanishing(nodes: Sequence[Node], numbers: Sequence[Any]) -> tuple[list[bool], list[str]]:
    """Which values are zero at rest, up to the point's own error; and which operands make them so."""
    zero, kinds = list[bool](), list[str]()
    for node, number in zip(nodes, numbers, strict=True):
        code, a, b, constant, _ = node
        size = 0.0 if number is MAYBE else abs(float(number))
        kind = _KINDS.get(code, _ITSELF)
        if code == CONST:
            vanishes = constant == 0
        elif code == INPUT:
            vanishes = a == 0 and size <= LEAST
        elif kind == _ANY:
            vanishes = zero[a] or zero[b]
        elif kind == _ALL:
            vanishes = zero[a] and zero[b]
            if not vanishes and not zero[a] and not zero[b]:
                vanishes = size <= SMALL * max(abs(float(numbers[a])), abs(float(numbers[b])))
                kind = _ITSELF
        elif kind == _ONLY:
            vanishes = zero[a]
        else:
            vanishes = False
        zero.append(vanishes)
        kinds.append(kind)
    return zero, kinds


@final
class Cut:
    """A search for the fewest values that are zero at rest and without which nothing moves."""

    def __init__(self, program: Program, numbers: Sequence[Any]) -> None:
        self.nodes = program.nodes
        (self.outputs,) = program.stored(range(len(self.nodes)))
        self.zero, self.kinds = _vanishing(self.nodes, numbers)
        self.forms = _forms(self.nodes)
        self.chosen = dict[int, int]()

    def found(self) -> tuple[list[int], dict[int, dict[int, Fraction]]]:
        """The values; and others that are, identically, sums of these, as factors by value."""
        cut = self._least()
        while True:  # a product of two zeros has no slope; but it must vanish with the others, too
            vanishes, _ = self._vanishing_with(cut)
            open_ = [k for k in self._seen if self._both(k) and not vanishes[k] and k not in self.chosen]
            if not open_:
                break
            for place in open_:
                node = self.nodes[place]
                self.chosen[place] = node.b if self.nodes[node.a].code == INPUT else node.a
            cut = self._least()
        for place in sorted(cut, reverse=True):
            rest = [k for k in cut if k != place]
            vanishes, _ = self._vanishing_with(rest)
            if all(vanishes[k] for k in self.outputs):
                cut = rest
        return cut, self._vanishing_with(cut)[1]

    def _both(self, place: int) -> bool:
        node = self.nodes[place]
        return self.zero[place] and self.kinds[place] == _ANY and self.zero[node.a] and self.zero[node.b]

    def _needs(self, place: int) -> tuple[int, ...]:
        node, kind = self.nodes[place], self.kinds[place]
        if kind == _ALL:
            return node.a, node.b
        if kind == _ONLY:
            return (node.a,)
        if self._both(place):
            return (self.chosen[place],) if place in self.chosen else ()
        return (node.a if self.zero[node.a] else node.b,)

    def _least(self) -> list[int]:
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import breadth_first_order, maximum_flow

        nodes, zero = self.nodes, self.zero
        source, sink, most = 2 * len(nodes), 2 * len(nodes) + 1, len(nodes)
        waiting, seen = list(dict.fromkeys(self.outputs)), set[int]()
        edges = {(2 * place + 1, sink): most for place in waiting}
        while waiting:
            place = waiting.pop()
            if place in seen or (nodes[place].code == CONST and zero[place]):
                continue
            seen.add(place)
            edges[2 * place, 2 * place + 1] = 1
            if not zero[place] or self.kinds[place] == _ITSELF:
                edges[source, 2 * place] = most
                continue
            for operand in self._needs(place):
                edges[2 * operand + 1, 2 * place] = most
                waiting.append(operand)
        self._seen = sorted(seen)
        if not seen:
            return []
        rows, columns = zip(*edges, strict=True)
        numbers = np.array(list(edges.values()), dtype=np.int32)
        graph = csr_array((numbers, (rows, columns)), shape=(sink + 1, sink + 1))
        left = (graph - maximum_flow(graph, source, sink).flow).tocsr()
        left.eliminate_zeros()
        reached = set(breadth_first_order(left, source, return_predecessors=False).tolist())
        return [place for place in self._seen if 2 * place in reached and 2 * place + 1 not in reached]

    def _vanishing_with(self, cut: Sequence[int]) -> tuple[list[bool], dict[int, dict[int, Fraction]]]:
        """What is zero where the cut is, by the operations alone; and what is so as a sum of the cut's values."""
        inside, sums = set(cut), dict[int, dict[int, Fraction]]()
        basis = _Span({place: form for place in cut if (form := self.forms[place]) is not None})
        vanishes = list[bool]()
        for place, node in enumerate(self.nodes):
            code, a, b, constant, _ = node
            kind = _KINDS.get(code, _ITSELF)
            if place in inside:
                here = True
            elif code == CONST:
                here = constant == 0
            elif code == INPUT or kind == _ITSELF:
                here = False
            elif kind == _ANY:
                here = vanishes[a] or vanishes[b]
            else:
                here = vanishes[a] and (kind == _ONLY or vanishes[b])
            form = self.forms[place]
            if not here and form and (factors := basis.factors(form)) is not None:
                here, sums[place] = True, factors
            vanishes.append(here)
        return vanishes, sums


Form = dict[int, Fraction]


def _forms(nodes: Sequence[Node]) -> list[Form | None]:
    """Of each value that is a sum of arguments with rational factors: these, by the argument's place."""
    forms, named = list[Form | None](), by_code({name: name for name in ("add", "sub", "neg", "twice", "mul")})
    first = dict[tuple[int, int], int]()
    for place, (code, a, b, constant, _) in enumerate(nodes):
        form: Form | None = None
        name = named.get(code)
        if code == INPUT:
            form = {first.setdefault((a, b), place): Fraction(1)}
        elif code == CONST and constant == 0:
            form = {}
        elif name in ("neg", "twice") and (one := forms[a]) is not None:
            form = {key: value * (-1 if name == "neg" else 2) for key, value in one.items()}
        elif name in ("add", "sub") and (one := forms[a]) is not None and (other := forms[b]) is not None:
            form = _sum(one, other, Fraction(1 if name == "add" else -1))
        elif name == "mul":
            for factor, other_place in ((a, b), (b, a)):
                if nodes[factor].code == CONST and (one := forms[other_place]) is not None:
                    form = {key: value * literal(nodes[factor].constant) for key, value in one.items()}
        forms.append(form)
    return forms


def _sum(one: Mapping[int, Fraction], other: Mapping[int, Fraction], factor: Fraction) -> Form:
    found = dict(one)
    for key, value in other.items():
        found[key] = found.get(key, Fraction(0)) + factor * value
    return {key: value for key, value in found.items() if value}


@final
class _Span:
    """All sums of some forms, with rational factors."""

    def __init__(self, forms: Mapping[int, Form]) -> None:
        self._rows = list[tuple[int, Form, Form]]()  # the leading argument, the form, and of which forms it is made
        for place, form in forms.items():
            left, made = self._reduced(form, {place: Fraction(1)})
            if left:
                key = min(left)
                self._rows.append((key, left, made))

    def _reduced(self, form: Form, made: Form) -> tuple[Form, Form]:
        for key, row, of in self._rows:
            if key in form:
                factor = -form[key] / row[key]
                form, made = _sum(form, row, factor), _sum(made, of, factor)
        return form, made

    def factors(self, form: Form) -> Form | None:
        """The forms of which one is the sum, with their factors; None where it is none."""
        left, made = self._reduced(form, {})
        return None if left else {key: -value for key, value in made.items()}
