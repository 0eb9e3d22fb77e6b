r"""The claim of a diagram: V, D V, and the residual that must vanish identically.

D is d/dt along the closed loop or, for a graph whose controller runs on a clock only, the difference over a sample
(`dmframe.certify.operators`). The blocks on the servo level have the weight kappa, a cascade on top of them the weight
1:

    V = kappa (S_1 + S_2 + ...) + S_cascade,
    D V = -kappa (d_1 + d_2 + ...) - d_cascade + c |a|^2 + (terms of the projection lemma) + (bounded residuals),

where a is the vector of the cascade's cross term and kappa a free symbol; without a cascade kappa is 1. Desired
trajectories and all their derivatives are free symbols, and so are, in discrete time, all measurements and commands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import (
    SX,
    Certificate,
    Dissipated,
    LeastSquaresSteps,
    LogDet,
    Potential,
    Stored,
)
from dmframe.block.faults import fault_context
from dmframe.block.linalg import times
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.certify.certificates import Certificates, certificates_of, is_over_samples
from dmframe.certify.form import NotApplicableError, unfit
from dmframe.certify.operators import Flow, Sample
from dmframe.certify.partial_functions import domains_of
from dmframe.certify.steady import check_claims
from dmframe.common.errors import BlockError, nearest
from dmframe.common.text import Text
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.projection import Projection
from dmframe.diagram.truths import Stated
from dmframe.diagram.wiring import Wire

if TYPE_CHECKING:
    from dmframe.formula.law import PrintedLaw


@final
@dataclass(frozen=True)
class Part:
    """Contribution of one block, in the independent variables of the closed loop.

    Parameters
    ----------
    certificate
        Its terms, with measured and commanded signals substituted; those of `certificate.plant` and `certificate.acted`
        as functions of the plant's own signals, for free commands.
    cascade
        True if the block is on the task level.
    lemma
        Terms of the projection lemma in D S; none is positive.
    """

    block: str
    certificate: Certificate
    cascade: bool
    lemma: SX

    @property
    def stored(self) -> tuple[Stored, ...]:
        """Terms of S; those of update steps come last."""
        return (*self.certificate.storage, *(item.storage for item in self.certificate.steps))

    @property
    def storage(self) -> SX:
        """S."""
        return total([term.value for term in self.stored]) / 2

    @property
    def dissipation(self) -> SX:
        """d_1 + d_2 + ..."""
        own = [term.value for term in self.certificate.dissipation]
        return total([*own, *(item.decrease / 2 for item in self.certificate.steps)])

    @property
    def dominating(self) -> tuple[Dissipated, ...]:
        """The dissipated squares that dominate the cross term of a cascade."""
        return self.certificate.dissipation[: len(self.certificate.dominates)]

    @property
    def composed(self) -> SX:
        """The vector that these squares dominate, composed of their vectors."""
        shares = zip(self.certificate.dominates, self.dominating, strict=True)
        return sum((share * term.pieces[0] for share, term in shares), ca.SX(0))

    @property
    def consumption(self) -> SX:
        """C |a|^2, the cross term of a cascade."""
        return ca.SX(0) if self.certificate.consumes is None else self.certificate.consumes.value

    @property
    def residual(self) -> SX:
        """Residual: bounded terms that are not dissipated, and the part of rows that true parameters do not explain."""
        own = [term.value for term in self.certificate.residual]
        return total([*own, *(item.residual / 2 for item in self.certificate.steps)])


@final
@dataclass(frozen=True)
class Claim:
    """V and D V of a diagram.

    Parameters
    ----------
    parts
        Blocks with a certificate, in the order of the graph; in discrete time, those with a statement.
    kappa
        Weight of the servo level: a symbol, or 1 without a cascade.
    operator
        D.
    truths
        True values of estimates that certificates state, by block and name.
    silent
        In discrete time: blocks without a statement, whose behaviour may be arbitrary.
    """

    diagram: Diagram
    loop: ClosedLoop
    parts: tuple[Part, ...]
    kappa: SX
    truths: Stated
    laws: Mapping[str, PrintedLaw]
    operator: Flow | Sample
    silent: tuple[str, ...] = ()

    @cached_property
    def symbols(self) -> dict[tuple[frozenset[str], int], Any]:
        """Cache of `dmframe.certify.symbols.symbols_of`, by uncertain parameters and number of trajectories."""
        return {}

    @cached_property
    def matched(self) -> dict[Any, tuple[SX, str | None]]:
        """Cache of `dmframe.certify.definite`: results for weights, by their nodes."""
        return {}

    @property
    def over_samples(self) -> bool:
        """True if D is the difference over a sample."""
        return isinstance(self.operator, Sample)

    @property
    def flow(self) -> Flow:
        """D of a claim in continuous time."""
        assert isinstance(self.operator, Flow)
        return self.operator

    @property
    def sample(self) -> Sample:
        """D of a claim in discrete time."""
        assert isinstance(self.operator, Sample)
        return self.operator

    @cached_property
    def memories(self) -> frozenset[str]:
        """Labels of the information matrices of least squares."""
        steps = [(part.block, item) for part in self.parts for item in part.certificate.steps]
        return frozenset(f"{name}.{item.memory}" for name, item in steps if isinstance(item, LeastSquaresSteps))

    @property
    def left(self) -> str:
        """Possible increase of V in discrete time, in words; empty if V cannot increase."""
        unexplained = any(part.certificate.steps for part in self.parts)
        unbounded = any(part.certificate.residual for part in self.parts)
        kinds = ["what its data leave unexplained"] * unexplained + ["a residual that nothing bounds"] * unbounded
        return " and ".join(kinds)

    @cached_property
    def starts(self) -> Mapping[str, SX]:
        """A symbol for the initial value of each state, a column, by the state's label."""
        return {v.label: ca.SX.sym(f"start.{v.label}", v.symbol.numel()) for v in self.loop.variables}

    @property
    def cascaded(self) -> bool:
        """True if there is a cascade, whose cross term the servo level dominates."""
        return not bool(self.kappa.is_constant())

    def weight(self, part: Part) -> SX:
        """1 or kappa."""
        return ca.SX(1) if part.cascade else self.kappa

    @property
    def V(self) -> SX:
        """The Lyapunov function."""
        return total([self.weight(part) * part.storage for part in self.parts])

    @property
    def consumption(self) -> SX:
        """Sum of the cross terms of all cascades."""
        return total([part.consumption for part in self.parts])

    @cached_property
    def risks(self) -> Mapping[str, tuple[tuple[int, SX], ...]]:
        """Divisors and arguments of partial functions in each block's equations, with the instruction."""
        return {
            name: tuple(domains_of([*of.outputs.values(), *of.rates.values(), *of.next.values()]))
            for name, of in ((name, model.equations) for name, model in self.diagram.models.items())
        }

    @cached_property
    def cross_terms(self) -> tuple[tuple[Part, Part | None], ...]:
        """Each block with a cross term, and the block that dominates it; None if no block can."""
        return tuple((part, self._dominating(part)) for part in self.parts if part.certificate.consumes is not None)

    def _dominating(self, consumer: Part) -> Part | None:
        """The dominating block; of several candidates the one that composes the cross term's vector."""
        assert consumer.certificate.consumes is not None
        wanted = consumer.certificate.consumes.vector
        able = [part for part in self.parts if part.certificate.dominates and part.composed.shape == wanted.shape]
        if len(able) < 2:
            return able[0] if able else None
        differences = [ca.norm_inf(part.composed - wanted) for part in able]
        symbols = stack(ca.symvar(ca.vertcat(*differences)))
        point = np.random.default_rng(0).uniform(0.5, 1.5, symbols.numel())
        sizes = ca.Function("differences", [symbols], [ca.vertcat(*differences)])(point).full().ravel()
        return able[int(np.nanargmin(sizes))]


def claim_of(diagram: Diagram, *, held: bool = True, named: bool = True) -> Claim:
    """Assemble the blocks' certificates. Printed laws are compared with the code at a few points only.

    `dmframe.certify.laws.check_laws` compares them fully, including docstrings. If not `held`, `unsteady` has to
    check whether certificates contain numbers. If not `named`, for a claim that was assembled before from the same
    blocks, no printed law is read, and terms have no names.

    Raises `NotApplicableError` if a block has no certificate or an invalid one, or requires a true value that the
    diagram does not have.
    """
    found = certificates_of(diagram)
    if held:
        check_claims(diagram, found.truths)
    return _over_samples(diagram, found) if diagram.loop.discrete_time else _in_continuous_time(diagram, found, named)


def unsteady(diagram: Diagram) -> str:
    """Reason why a certificate, condition or initial value contains a number not read from `p`; empty if none does."""
    try:
        check_claims(diagram, certificates_of(diagram).truths)
    except NotApplicableError as error:
        return error.text
    return ""


def _in_continuous_time(diagram: Diagram, found: Certificates, named: bool) -> Claim:
    stated, truths = dict(found.stated), found.truths
    laws: Mapping[str, PrintedLaw] = {}
    if named:
        from dmframe.certify.laws import printed_laws  # not imported by a run that has the names cached

        laws = printed_laws(diagram, stated, truths)
    unfollowed = _unfollowed(diagram, stated)
    stated |= {name: Certificate(truth=stated[name].truth) for name in unfollowed}
    laws = {name: law.silent if name in unfollowed else law for name, law in laws.items()}
    along = Flow(diagram)
    if named:
        from dmframe.certify.labels import labelled

        stated = labelled(stated, laws)
    parts = tuple(flow_part(along, name, item) for name, item in stated.items())
    if not any(part.certificate.storage for part in parts):
        raise NotApplicableError("no block of this graph has a storage function, so there is no V")
    cascades = [part for part in parts if part.certificate.consumes is not None]
    kappa = ca.SX.sym("kappa") if cascades else ca.SX(1)
    return Claim(diagram, diagram.loop, parts, kappa, truths, laws, along)


def _unfollowed(diagram: Diagram, stated: Mapping[str, Certificate]) -> list[str]:
    """Blocks whose output reference another block modifies before it is tracked."""
    ends = [(name, port) for name, certificate in stated.items() for port in certificate.filters]
    for name, port in ends:
        known = [item.name for item in diagram.blocks[name].inputs]
        if port not in known:
            raise NotApplicableError(f"{name}: filters names {port}, no input of it; {nearest(port, known)}")
    sources = [diagram.sources.get(end) for end in ends]
    return list(
        dict.fromkeys(source.block for source in sources if isinstance(source, Wire) and source.block in stated)
    )


def total(items: Sequence[SX]) -> SX:
    """A sum of scalar expressions."""
    return ca.sum1(ca.vertcat(ca.SX(0), *items))


def flow_part(along: Flow, name: str, certificate: Certificate) -> Part:
    """Part of a block; the expressions of its storage are entered in the record."""
    joined = certificate.mapped(along.loop.joined)
    storage = total([term.value for term in joined.storage]) / 2
    used = symbols_in([storage])
    # the block's own states only; in another block's storage the correction must cancel
    own = [item for item in along.loop.projections if item.block == name and used & symbols_in([item.state])]
    lemma = total([_lemma(name, joined, item) for item in own])
    task = certificate.task or certificate.consumes is not None
    for term in joined.storage:
        along.record.add(Text(f"{name}: the storage of ", term.of), _inside(term))
    return Part(name, joined, task, lemma)


def _lemma(name: str, certificate: Certificate, projection: Projection) -> SX:
    r"""(theta - theta_true)' W c: the projection lemma, for an estimate whose error is stored as one square."""
    own, estimate = symbols_in([projection.state]), certificate.estimates.get(projection.of)
    held = [term for term in certificate.storage if symbols_in(term.pieces) & own]
    if estimate is not None and len(held) == 1 and not symbols_in([estimate.weight]) & own:
        (square,) = held  # the square of the estimate, which is always among them
        return ca.dot(times(square.weight, square.vector), projection.correction)
    hint = f"; say what it estimates by estimates={{'{projection.of}': TrueValue(...)}}" if estimate is None else ""
    raise NotApplicableError(
        f"{name}: {projection.name} is projected, but is not stored as one square of its error, which the "
        f"projection lemma needs{hint}"
    )


def _inside(term: Stored) -> SX:
    """The expression that must be smooth for a term to be smooth.

    A potential is a smooth function of its vector, and so is a divergence where it is finite.
    """
    return stack(map(ca.SX, term.pieces)) if isinstance(term, Potential | LogDet) else ca.SX(term.value)


def _over_samples(diagram: Diagram, found: Certificates) -> Claim:
    claiming = {
        name: item
        for name, item in found.stated.items()
        if name not in found.silent
        and (diagram.blocks[name].side is Side.CONTROLLER or is_over_samples(diagram, name, item))
    }
    if not any(item.storage or item.steps for item in claiming.values()):
        reason = f"{diagram.loop.discrete_time}; a proof in continuous time does not reach it"
        raise NotApplicableError(f"{reason}, and no block of this graph claims anything over samples")
    step = Sample(diagram)
    parts = tuple(_sample_part(step, name, item) for name, item in claiming.items())
    claim = Claim(diagram, diagram.loop, parts, ca.SX(1), found.truths, {}, step, silent=found.silent)
    for part in parts:
        for text in unfit(claim, part):
            raise NotApplicableError(f"{part.block}: {text}")
    return claim


def _sample_part(step: Sample, name: str, certificate: Certificate) -> Part:
    """Part of a block; raises `NotApplicableError` for an invalid expression, such as an MX."""
    loop = step.loop
    measured = [(leaf.symbol, leaf.expression) for leaf in loop.measured]

    def of_the_plant(expressions: list[SX]) -> list[SX]:
        if not measured or not expressions:
            return expressions
        return list(ca.substitute(expressions, [stack(a for a, _ in measured)], [stack(b for _, b in measured)]))

    try:
        with fault_context(name, "certificate()"):
            column = tuple(ca.vec(ca.densify(ca.SX(item))) for item in certificate.solved)
            own = replace(certificate, solved=column, plant=(), acted=()).mapped(loop.crossed)
            outside = Certificate(plant=certificate.plant, acted=certificate.acted).mapped(of_the_plant)
    except BlockError as error:
        raise NotApplicableError(error.text) from None
    held = [ca.SX(item.held) for item in certificate.acted]
    acted = tuple(replace(item, held=given) for item, given in zip(outside.acted, held, strict=True))
    return Part(name, replace(own, plant=outside.plant, acted=acted), False, ca.SX(0))


__all__ = ["Claim", "NotApplicableError", "Part", "claim_of", "flow_part", "total", "unsteady"]
