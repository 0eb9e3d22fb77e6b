"""Minimum cut of a program: the fewest values that vanish at an equilibrium and determine all outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, Final, final

import numpy as np

from dmframe.analysis.sums import Span, Sum, scaled, sums_of
from dmframe.program import CONST, INPUT, Node, Program, by_code

SMALL: Final = 1e-6
"""Sum, relative to its terms, below which the terms count as cancelling at the equilibrium."""

LEAST: Final = 1e-9
"""A smaller state counts as zero at the equilibrium, and a smaller difference of compared numbers as equality."""

_FEW: Final = 250
"""Largest cut whose values are tested one by one for redundancy; a larger one would take minutes."""

_MANY: Final = 4096
"""Up to this number of values, the cut with more arguments is preferred among cuts of equal size."""

_ANY, _ALL, _ONLY, ITSELF = "any", "all", "only", "itself"

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


def vanishing(nodes: Sequence[Node], numbers: Sequence[Any]) -> tuple[list[bool], list[str]]:
    """Values that vanish at the equilibrium within the point's error, and the operands that cause it."""
    zero, kinds = list[bool](), list[str]()
    for node, number in zip(nodes, numbers, strict=True):
        code, a, b, constant, _ = node
        size = abs(float(number))
        kind = _KINDS.get(code, ITSELF)
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
                kind = ITSELF
        elif kind == _ONLY:
            vanishes = zero[a]
        else:
            vanishes = False
        zero.append(vanishes)
        kinds.append(kind)
    return zero, kinds


@final
class Cut:
    """Search for the fewest values that vanish at the equilibrium and make all outputs vanish."""

    def __init__(self, program: Program, numbers: Sequence[Any]) -> None:
        self.nodes = program.nodes
        (self.outputs,) = program.stored(range(len(self.nodes)))
        self.zero, self.kinds = vanishing(self.nodes, numbers)
        self.forms = sums_of(self.nodes, inputs_alone=True)
        self.chosen = dict[int, int]()

    def found(self) -> tuple[list[int], dict[int, Sum]]:
        """Values of the cut; and identities: other values as sums of these, factors by value and power of T."""
        cut = self._least()
        while True:  # a product of two zeros has zero slope, but must vanish with the cut too
            vanishes, _ = self._vanishing_with(cut)
            reached = self._reached(cut)
            open_ = [
                k for k in self._seen if k in reached and self._both(k) and not vanishes[k] and k not in self.chosen
            ]
            if not open_:
                break
            for place in open_:
                node = self.nodes[place]
                self.chosen[place] = node.b if self.nodes[node.a].code == INPUT else node.a
            cut = self._least()
        for place in self._doubtful(cut):
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
        source, sink, most = 2 * len(nodes), 2 * len(nodes) + 1, 1 << 30
        waiting, seen = list(dict.fromkeys(self.outputs)), set[int]()
        edges = {(2 * place + 1, sink): most for place in waiting}
        while waiting:
            place = waiting.pop()
            if place in seen or (nodes[place].code == CONST and zero[place]):
                continue
            seen.add(place)
            edges[2 * place, 2 * place + 1] = _MANY - (nodes[place].code == INPUT)
            if not zero[place] or self.kinds[place] == ITSELF:
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

    def _doubtful(self, cut: Sequence[int]) -> list[int]:
        """Values that may be redundant: all of a small cut, else chosen operands and dependent values."""
        if len(cut) <= _FEW:
            return sorted(cut, reverse=True)
        _, relations = self._span(cut)
        found = {place for relation in relations for place, _ in relation} | set(self.chosen.values())
        return [place for place in sorted(cut, reverse=True) if place in found or self.forms[place] is None]

    def _span(self, cut: Sequence[int]) -> tuple[Span, list[Sum]]:
        """Span of the cut's values as sums with powers of T, and the linear relations between them."""
        span, relations = Span(), list[Sum]()
        for power in (0, 1, -1):
            for place in cut:
                if (form := scaled(self.forms[place], Fraction(1), power)) is not None:
                    relation = span.add(form, (place, power))
                    relations += [] if relation is None else [relation]
        return span, relations

    def _reached(self, cut: Sequence[int]) -> set[int]:
        """Values that must vanish for the outputs to vanish and that are not determined by the cut."""
        waiting, reached, inside = list(self.outputs), set[int](), set(cut)
        while waiting:
            place = waiting.pop()
            if place not in reached and place not in inside:
                reached.add(place)
                waiting += self._needs(place) if self.zero[place] and self.kinds[place] != ITSELF else ()
        return reached

    def _vanishing_with(self, cut: Sequence[int]) -> tuple[list[bool], dict[int, Sum]]:
        """Values that vanish with the cut by the operations alone; and those that are sums of its values."""
        inside, sums, (basis, _) = set(cut), dict[int, Sum](), self._span(cut)
        vanishes = list[bool]()
        for place, node in enumerate(self.nodes):
            code, a, b, constant, _ = node
            kind = _KINDS.get(code, ITSELF)
            if place in inside:
                here = True
            elif code == CONST:
                here = constant == 0
            elif code == INPUT or kind == ITSELF:
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
