"""Printed law of a block: outputs, rates, and the terms of its certificate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Final, final

from dmframe.block.certificate import (
    Certificate,
    Clipped,
    InformationSquare,
    Lemma,
    LogDet,
    NormSquare,
    Potential,
    Square,
    beyond,
    clip,
)
from dmframe.block.naming import description_of
from dmframe.block.terms import divergence, potential
from dmframe.formula import tree
from dmframe.formula.formula import Formula
from dmframe.formula.robot import CONSTANTS, quantity
from dmframe.formula.tree import SCALAR, Applied, Equation, Name, Node, Norm, Number, Product, Rate


@final
@dataclass(frozen=True)
class Line:
    """left = right; `name` is the output, state or definition on the left."""

    name: str
    left: Formula
    right: Formula

    @property
    def whole(self) -> Formula:
        """The equation."""
        return Formula(Equation(self.left.node, self.right.node, self.left.node.shape))


@final
@dataclass(frozen=True)
class PrintedTerm:
    """One term of a certificate.

    Parameters
    ----------
    kind
        ``square``, ``norm square``, ``lemma``, ``gathered``, ``clipped``, ``potential`` or ``log det``.
    vector
        The squared vector; for a lemma the difference of its two columns, for a clipped term its other factor, for a
        log det the matrix of estimates.
    weight
        Its weight; for a clipped term the width.
    by
        Its further argument: for a norm square the vector of the norm, for a gathered term the matrix, for a clipped
        term the clipped vector, for a potential the width, for a log det the true matrix.
    whole
        The term itself.
    """

    kind: str
    vector: Formula
    weight: Formula
    by: Formula | None
    whole: Formula


@final
@dataclass(frozen=True)
class PrintedLaw:
    """Equations and certificate of a block.

    Parameters
    ----------
    name
        Of the block in its diagram.
    outputs, rates
        Its equations, without outputs that equal a state or a parameter. Rates come first, then the sampled states
        one sample later.
    storage, dissipation, residual, errors
        Terms of the certificate, in its order; S is half the sum of the first, and the last are in no sum.
    linear
        The bounded signals of each `StableLinear` of the certificate, in its order.
    estimates
        True values of the estimates, by the estimate's name.
    truths
        True values that the certificate states for other blocks.
    supply, consumption
        Supply rate and cross term of the certificate, if it has them.
    definitions
        Definitions of named sub-expressions.
    S, dS
        S and dS/dt as lines.
    matrices
        True if it was read as matrices; else it was read element by element.
    """

    name: str
    outputs: tuple[Line, ...]
    rates: tuple[Line, ...]
    storage: tuple[PrintedTerm, ...] = ()
    dissipation: tuple[PrintedTerm, ...] = ()
    residual: tuple[PrintedTerm, ...] = ()
    errors: tuple[PrintedTerm, ...] = ()
    linear: tuple[tuple[Formula, ...], ...] = ()
    estimates: tuple[Line, ...] = ()
    truths: tuple[Line, ...] = ()
    supply: Formula | None = None
    consumption: PrintedTerm | None = None
    definitions: tuple[Line, ...] = ()
    S: Line | None = None
    dS: Line | None = None
    matrices: bool = True

    @property
    def lines(self) -> tuple[Line, ...]:
        """All equations in the order in which they are printed."""
        energy = [line for line in (self.S, self.dS) if line is not None]
        return (*self.outputs, *self.rates, *energy, *self.truths, *self.definitions)

    @property
    def silent(self) -> PrintedLaw:
        """The same law without its storage function."""
        return replace(
            self,
            storage=(),
            dissipation=(),
            residual=(),
            errors=(),
            linear=(),
            estimates=(),
            supply=None,
            consumption=None,
            S=None,
            dS=None,
        )


ROLES: Final = ("storage", "dissipation", "residual", "errors")
"""The fields of a certificate that contain terms."""

Reader = Callable[[Any, Any], Node]
"""Returns the tree of an expression, given as it was read and as scalars."""


def line(left: Node, right: Node) -> Line:
    """Left = right."""
    name = left.of if isinstance(left, Rate) else left
    return Line(name.name if isinstance(name, Name) else "", Formula(left), Formula(right))


def lines(equations: Sequence[tuple[Node, Node]]) -> tuple[Line, ...]:
    """One line per equation, without identities such as w = w."""
    made = (line(*equation) for equation in equations)
    return tuple(item for item in made if not _is_trivial(item))


def _is_trivial(equation: Line) -> bool:
    """True for w = w, and for the rate of q where that is called dq."""
    return isinstance(equation.right.node, Name) and equation.left.latex == equation.right.latex


def rate_of(name: str, shape: tree.Shape, *, sampled: bool = False) -> Node:
    """The time derivative of a state, or its value one sample later."""
    return Rate(Name(name, shape), shape, sampled)


@final
class Energy:
    """A certificate in print.

    `scalars` is the same certificate in scalars, where it was read as matrices; `vectors` reads what is squared.
    """

    def __init__(self, certificate: Certificate, scalars: Certificate, reader: Reader, vectors: Reader) -> None:
        self._reader, self._vectors = reader, vectors
        self._pairs = {
            role: list(zip(getattr(certificate, role), getattr(scalars, role), strict=True)) for role in ROLES
        }
        self._certificate, self._scalars = certificate, scalars
        self._nodes = {role: [self._term(*pair) for pair in pairs] for role, pairs in self._pairs.items()}

    def terms(self, role: str) -> tuple[PrintedTerm, ...]:
        """The terms of a role."""
        return tuple(term for term, _ in self._nodes[role])

    def linear(self) -> tuple[tuple[Formula, ...], ...]:
        """Signals that are bounded although they are not in S."""
        pairs = zip(self._certificate.linear, self._scalars.linear, strict=True)
        return tuple(
            tuple(Formula(self._reader(*pair)) for pair in zip(mine.bounded, theirs.bounded, strict=True))
            for mine, theirs in pairs
        )

    def estimates(self) -> tuple[Line, ...]:
        """True values of the block's own estimates."""
        mine, theirs = self._certificate.estimates, self._scalars.estimates
        return lines([(Name(name), self._reader(mine[name].value, theirs[name].value)) for name in mine])

    def truths(self) -> tuple[Line, ...]:
        """True values for other blocks."""
        stated = self._certificate.truth.items()
        nodes = {name: self._reader(value, self._scalars.truth[name]) for name, value in stated}
        return lines([(Name(name, node.shape), node) for name, node in nodes.items()])

    def supply(self) -> Node:
        """The supply rate."""
        return self._reader(self._certificate.supply, self._scalars.supply)

    def consumption(self) -> PrintedTerm | None:
        """C |a|^2, the cross term of a cascade."""
        mine, theirs = self._certificate.consumes, self._scalars.consumes
        if mine is None or theirs is None:
            return None
        vector, c = self._reader(mine.vector, theirs.vector), self._reader(mine.c, theirs.c)
        return PrintedTerm("consumed", Formula(vector), Formula(c), None, Formula(self._consumed()))

    def _consumed(self) -> Node:
        mine, theirs = self._certificate.consumes, self._scalars.consumes
        if mine is None or theirs is None:
            return Number(Fraction(0))
        return squared(self._reader(mine.vector, theirs.vector), self._reader(mine.c, theirs.c))

    def S(self) -> Node:
        """Half the sum of the storage terms."""
        total: Node = Number(Fraction(0))
        for _, node in self._nodes["storage"]:
            total = tree.add(total, tree.scale(Fraction(1, 2), node), SCALAR)
        return total

    def dS(self) -> Node:
        """- dissipation + residual + consumption + supply."""
        total: Node = Number(Fraction(0))
        for _, node in self._nodes["dissipation"]:
            total = tree.subtract(total, node, SCALAR)
        for _, node in self._nodes["residual"]:
            total = tree.add(total, node, SCALAR)
        return tree.add(tree.add(total, self._consumed(), SCALAR), self.supply(), SCALAR)

    def _term(self, term: Any, scalars: Any) -> tuple[PrintedTerm, Node]:
        pairs = zip(term.pieces, scalars.pieces, strict=True)
        nodes = [(self._reader if k else self._vectors)(*pair) for k, pair in enumerate(pairs)]
        kind, vector, weight, by, whole = _TERMS[type(term)](term, nodes)
        bound = Formula(by) if by is not None else None
        return PrintedTerm(kind, Formula(vector), Formula(weight), bound, Formula(whole)), whole


Description = tuple[str, Node, Node, Node | None, Node]


def _square(term: Any, nodes: Sequence[Node]) -> Description:
    vector, weight = nodes
    return "square", vector, weight, None, squared(vector, weight)


def squared(vector: Node, weight: Node) -> Node:
    """|a|^2_W; a scalar weight is a factor in front."""
    if isinstance(vector, Product) and vector.coefficient == -1:
        vector = tree.scale(tree.MINUS, vector)
    if isinstance(weight, Number):
        return tree.scale(weight.value, Norm(vector, squared=True))
    if tree.is_scalar(weight) and not tree.is_scalar(vector):
        return tree.multiply(weight, Norm(vector, squared=True), SCALAR)
    return Norm(vector, squared=True, weight=weight)


def _norm_square(term: Any, nodes: Sequence[Node]) -> Description:
    vector, weight, by = nodes
    return "norm square", vector, weight, by, tree.multiply(Norm(by), squared(vector, weight), SCALAR)


def _lemma(term: Any, nodes: Sequence[Node]) -> Description:
    weight, first, second, scale = nodes
    shape = max((node.shape for node in nodes), key=lambda shape: shape[0])
    difference = tree.subtract(first, second, shape)

    def phi(x: Node) -> Node:
        if x == Number(Fraction(0), x.shape) != first:
            return Number(Fraction(0), shape)
        if term.phi == "beyond" and weight == scale:
            return Applied("beyond", (x, scale), shape, description=description_of(beyond))
        if term.phi == "tanh" and scale == Name(CONSTANTS["friction_velocity"]):
            return quantity("coulomb", (x,), shape)
        width = (Number(Fraction(1)),) if term.phi == "beyond" else ()
        return Applied(term.phi, (tree.divide(x, scale, shape), *width), shape)

    slip = tree.subtract(phi(first), phi(second), shape)
    inside = term.phi == "beyond" and weight == scale  # width * beyond(x / width, 1) is beyond(x, width)
    whole = tree.dot(difference, slip if inside else tree.multiply(weight, slip, shape))
    return "lemma", difference, weight, None, whole


def _gathered(term: Any, nodes: Sequence[Node]) -> Description:
    vector, weight, memory, *_ = nodes
    whole = tree.multiply(weight, Norm(vector, squared=True, weight=memory), SCALAR)
    return "gathered", vector, weight, memory, whole


def _clipped(term: Any, nodes: Sequence[Node]) -> Description:
    first, width, other = nodes
    clipped = Applied("clip", (first, width), first.shape, description=description_of(clip))
    return "clipped", other, width, first, tree.dot(clipped, other)


def _potential(term: Any, nodes: Sequence[Node]) -> Description:
    vector, width, weight = nodes
    return (
        "potential",
        vector,
        weight,
        width,
        Applied("potential", (vector, width, weight), SCALAR, description=description_of(potential)),
    )


def _log_det(term: Any, nodes: Sequence[Node]) -> Description:
    matrix, true, weight = nodes
    distance = Applied("divergence", (matrix, true), SCALAR, description=description_of(divergence))
    return "log det", matrix, weight, true, tree.multiply(weight, distance, SCALAR)


_TERMS: Mapping[type, Callable[[Any, Sequence[Node]], Description]] = {
    Square: _square,
    NormSquare: _norm_square,
    Lemma: _lemma,
    InformationSquare: _gathered,
    Clipped: _clipped,
    Potential: _potential,
    LogDet: _log_det,
}


def pieces_of(certificate: Certificate) -> list[tuple[str, Any]]:
    """All expressions of a certificate, with a description of each."""
    found = list[tuple[str, Any]]()
    for role in ROLES:
        for place, term in enumerate(getattr(certificate, role), start=1):
            kind = type(term).__name__
            found += [(f"{kind} {place} of its {role}", piece) for piece in term.pieces]
    found.append(("its supply", certificate.supply))
    if certificate.consumes is not None:
        found += [("its cross term", certificate.consumes.vector), ("its cross term", certificate.consumes.c)]
    found += [("its dominates", item) for item in certificate.dominates]
    found += [("its stable linear subsystem", piece) for item in certificate.linear for piece in item.pieces]
    found += [("its reference limits", piece) for item in certificate.barriers for piece in item.pieces]
    found += [(f"the true value of {name}", true.value) for name, true in certificate.estimates.items()]
    return found + [(f"the true value {name}", value) for name, value in certificate.truth.items()]
