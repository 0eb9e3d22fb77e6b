r"""The canonical form of a certificate file, in which a checker has less to decide.

- V is divided by kappa, which is a number: 1/kappa is part of the weights of all terms without it.
- A vector has one element for each element of what it belongs to.
- Squares :math:`|v_j|^2_{W_j}` of the dissipation and the cross terms :math:`c\,|\sum_j a_j v_j|^2` that they dominate
  become one square of :math:`v = (v_1, v_2, \dots)`, with the matrix of the blocks
  :math:`\delta_{jk} W_j - c\,a_j a_k`, so that the small gain is the sign of its pivots.
- Every key is present, and symbols that kappa replaces are not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, final

Data = dict[str, Any]

KINDS = {
    "parameter": "constant",
    "stepping": "constant",
    "trajectory": "given",
    "period": "given",
    "noise": "given",
    "command": "given",
    "projection": "correction",
}
"""Kind of a symbol in the file, by its kind in the claim; others are the same."""


def canonical(file: Mapping[str, Any], kappa: Fraction) -> Data:
    """The file, whose terms may have a ``level`` and the role ``cross``, in canonical form."""
    return _Form(file, kappa).found


@final
class _Form:
    """A file that is being changed: new instructions follow those of its program."""

    def __init__(self, file: Mapping[str, Any], kappa: Fraction) -> None:
        self.found: Data = {key: file[key] for key in file if key != "cross"}
        self._program, self._vectors = file["program"], file["vectors"]
        self._known = dict[tuple[Any, ...], int]()
        cascaded = any(term["level"] for term in file["terms"])
        self._share = self._number(1 / kappa) if cascaded else None
        terms = [self._term(term) for term in file["terms"]]
        combined, gone = self._dominated(terms, file.get("cross", []))
        kept = [k for k in range(len(terms)) if k not in gone]
        self.found["terms"] = [terms[k] for k in kept] + combined
        for key in ("robots", "stable", "ranks"):
            self.found[key] = list(file.get(key, []))
        self.found["symbols"] = [self._symbol(item) for item in file["symbols"]]
        optional = {"margin": None, "strict": True}
        self.found["conditions"] = [{**optional, **item} for item in file["conditions"]]
        self.found["conclusions"] = [
            {"signal": item["signal"], "says": item["says"], "vector": item.get("vector")}
            for item in file["conclusions"]
        ]
        self.found["vectors"] = [elements for _, elements in self._vectors]

    # ---- Instructions and vectors

    def _instruction(self, name: str, a: int, b: int) -> int:
        program, key = self._program, (name, a, b)
        if key not in self._known:
            if name not in program["operations"]:
                program["operations"].append(name)
            for column, value in (("code", program["operations"].index(name)), ("a", a), ("b", b)):
                program[column].append(value)
            self._known[key] = len(program["code"]) - 1
        return self._known[key]

    def _number(self, value: Fraction) -> int:
        constants = self._program["constants"]
        if str(value) not in constants:
            constants.append(str(value))
        return self._instruction("const", constants.index(str(value)), 0)

    def _product(self, *places: int) -> int:
        """Place of a product; -1 is that of a zero."""
        first, *rest = places
        for place in rest:
            first = -1 if -1 in (first, place) else self._instruction("mul", first, place)
        return first

    def _sum(self, a: int, b: int) -> int:
        return b if a == -1 else a if b == -1 else self._instruction("add", a, b)

    def _difference(self, a: int, b: int) -> int:
        return a if b == -1 else self._instruction("sub", a if a >= 0 else self._number(Fraction(0)), b)

    def _elements(self, vector: int) -> list[int]:
        elements: list[int] = self._vectors[vector][1]
        return elements

    def _vector(self, elements: Sequence[int], rows: int = 0) -> int:
        entry = [rows or len(elements), list(elements)]
        if entry not in self._vectors:
            self._vectors.append(entry)
        return int(self._vectors.index(entry))

    def _spread(self, vector: int, size: int) -> int:
        elements = self._elements(vector)
        return self._vector(elements * size) if len(elements) == 1 != size else vector

    def _as_wide_as(self, vector: int, other: int) -> int:
        return self._spread(vector, len(self._elements(other)))

    # ---- Symbols and terms

    def _symbol(self, item: Mapping[str, Any]) -> Data:
        exact = "values" in item
        numbers = [[x, x] for x in item["values"]] if exact else item.get("numbers")
        own = {"label": item["label"], "kind": KINDS.get(item["kind"], item["kind"]), "size": item["size"]}
        return {**own, "numbers": numbers, "exact": exact}

    def _term(self, item: Mapping[str, Any]) -> Data:
        term: Data = {**item, "parts": dict(item["parts"])}
        parts = term["parts"]
        if term["role"] != "cross" and "vector" in parts:
            parts |= {name: self._as_wide_as(k, parts["vector"]) for name, k in parts.items()}
        if not term.pop("level") and self._share is not None and "weight" in parts:
            rows, weight = self._vectors[parts["weight"]]
            parts["weight"] = self._vector([self._product(x, self._share) for x in weight], rows)
        return term

    def _dominated(self, terms: Sequence[Data], cross: Sequence[Data]) -> tuple[list[Data], set[int]]:
        """Squares with matrices as weights, and the positions of the terms that they replace."""
        groups = dict[frozenset[int], list[Data]]()
        for item in cross:
            groups.setdefault(frozenset(k for _, k in item["by"]), []).append(item)
        found, gone = list[Data](), {item["term"] for item in cross}
        for squares, items in groups.items():
            used = sorted(squares)
            gone |= squares
            found.append(self._combined([terms[k] for k in used], used, [(terms[x["term"]], x["by"]) for x in items]))
        return found, gone

    def _combined(self, squares: Sequence[Data], used: Sequence[int], cross: Sequence[tuple[Data, Any]]) -> Data:
        vectors = [self._elements(term["parts"]["vector"]) for term in squares]
        weights = [self._elements(term["parts"]["weight"]) for term in squares]
        n, m = len(vectors[0]), len(vectors)
        shares = [
            {used.index(k): self._elements(self._spread(share, n)) for share, k in by} for _, by in cross
        ]  # a_j of each cross term
        factors = [self._elements(term["parts"]["weight"])[0] for term, _ in cross]

        def element(j: int, k: int, r: int) -> int:
            left, taken = weights[j][r] if j == k else -1, -1
            for c, share in zip(factors, shares, strict=True):
                taken = self._sum(taken, self._product(c, share[min(j, k)][r], share[max(j, k)][r]))
            return self._difference(left, taken)

        matrix = [
            element(j, k, r) if r == s else -1 for k in range(m) for s in range(n) for j in range(m) for r in range(n)
        ]
        parts = {"vector": self._vector([x for own in vectors for x in own]), "weight": self._vector(matrix, m * n)}
        name = ", ".join(term["name"] for term in squares)
        return {**squares[0], "name": f"{name}, less what they dominate", "parts": parts}
