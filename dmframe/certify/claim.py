r"""What a diagram claims: V, dV/dt, and the residual that must vanish identically.

The blocks on the servo level have the weight kappa, a cascade on top of them the weight 1:

    V = kappa (S_1 + S_2 + ...) + S_cascade,
    dV/dt = -kappa (d_1 + d_2 + ...) - d_cascade + c |a|^2 + (terms of the projection lemma)
            + (bounded terms that a robust adaptation leaves),

with a what the cascade consumes and kappa a free symbol; without a cascade kappa is 1. dV/dt is differentiated along
the rates of the same `ClosedLoop` that a run integrates; the desired trajectories and all their derivatives are free
symbols.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import casadi as ca
import numpy as np

from dmframe.block.faults import told_by
from dmframe.block.model import symbols_in
from dmframe.certificate import SX, Certificate, Dissipated, LogDet, Potential, Stored
from dmframe.certify.differentiated import Record
from dmframe.certify.form import NotApplicableError, check_form
from dmframe.certify.labels import labelled
from dmframe.certify.risky import risky
from dmframe.diagram import ClosedLoop, Diagram
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.projection import Projection
from dmframe.diagram.truths import Stated, conflicts
from dmframe.diagram.view import owners_of, view
from dmframe.diagram.wiring import Wire
from dmframe.errors import BlockError, DmframeError, nearest
from dmframe.formula.docstring import check_docstrings
from dmframe.formula.law import PrintedLaw
from dmframe.formula.laws import read_blocks
from dmframe.linalg import times
from dmframe.port import Side


@final
@dataclass(frozen=True)
class Part:
    """One block's part of the claim, in the leaves of the closed loop, measured and commanded signals substituted."""

    block: str
    certificate: Certificate
    cascade: bool
    rate: SX
    lemma: SX
    """Terms that the projection adds to dS/dt, none above zero."""

    @property
    def storage(self) -> SX:
        """S."""
        return total([term.value for term in self.certificate.storage]) / 2

    @property
    def dissipation(self) -> SX:
        """d_1 + d_2 + ..."""
        return total([term.value for term in self.certificate.dissipation])

    @property
    def paying(self) -> tuple[Dissipated, ...]:
        """The dissipated squares with which the block pays for a cascade."""
        return self.certificate.dissipation[: len(self.certificate.pays)]

    @property
    def composed(self) -> SX:
        """What the block pays for, composed of what it dissipates."""
        shares = zip(self.certificate.pays, self.paying, strict=True)
        return sum((share * term.pieces[0] for share, term in shares), ca.SX(0))

    @property
    def consumption(self) -> SX:
        """C |a|^2, which the servo level pays."""
        return ca.SX(0) if self.certificate.consumes is None else self.certificate.consumes.value

    @property
    def excess(self) -> SX:
        """The bounded terms that are not dissipated."""
        return total([term.value for term in self.certificate.excess])

    @property
    def residual(self) -> SX:
        """dS/dt - supply + dissipation - consumption - excess - lemma: zero, as the block claims."""
        gained = self.certificate.supply + self.consumption + self.excess + self.lemma
        return self.rate + self.dissipation - gained


@final
@dataclass(frozen=True)
class Claim:
    """V and dV/dt of a diagram.

    Parameters
    ----------
    parts
        The blocks with a certificate, in the order of the graph.
    kappa
        The weight of the servo level: a symbol, or 1 without a cascade.
    notices
        Equations of docstrings that are held to nothing.
    truths
        True values of estimates that certificates state, by block and name.
    memories
        Labels of the states that steps of least squares gather, over samples.
    differentiated
        All that has been differentiated for this claim, and has to be smooth.
    """

    diagram: Diagram
    loop: ClosedLoop
    parts: tuple[Part, ...]
    kappa: SX
    truths: Stated
    laws: Mapping[str, PrintedLaw]
    notices: tuple[str, ...] = ()
    memories: frozenset[str] = frozenset()
    differentiated: Record = field(default_factory=Record, compare=False)

    @cached_property
    def starts(self) -> Mapping[str, SX]:
        """A symbol for where each state starts, a column, by the state's label."""
        return {v.label: ca.SX.sym(f"start.{v.label}", v.symbol.numel()) for v in self.loop.variables}

    @cached_property
    def field(self) -> Field:
        """The vector field; what it differentiates is entered in the record of this claim."""
        return Field(self.diagram, self.differentiated)

    @property
    def cascaded(self) -> bool:
        """True where there is a cascade that the servo level pays for."""
        return not bool(self.kappa.is_constant())

    def weight(self, part: Part) -> SX:
        """1 or kappa."""
        return ca.SX(1) if part.cascade else self.kappa

    @property
    def V(self) -> SX:
        """The Lyapunov function."""
        return total([self.weight(part) * part.storage for part in self.parts])

    @property
    def rate(self) -> SX:
        """dV/dt along the closed loop."""
        return total([self.weight(part) * part.rate for part in self.parts])

    @property
    def consumption(self) -> SX:
        """What all cascades consume together."""
        return total([part.consumption for part in self.parts])

    @cached_property
    def risks(self) -> Mapping[str, tuple[tuple[int, SX], ...]]:
        """What each block's equations divide by, or need to be defined, with the instruction that does."""
        return {
            name: tuple(risky([*of.outputs.values(), *of.rates.values(), *of.next.values()]))
            for name, of in ((name, model.equations) for name, model in self.diagram.models.items())
        }

    @cached_property
    def payments(self) -> tuple[tuple[Part, Part | None], ...]:
        """Each block that consumes, with the one that pays for it; none where nobody could."""
        return tuple((part, self._payer(part)) for part in self.parts if part.certificate.consumes is not None)

    def _payer(self, consumer: Part) -> Part | None:
        """Of several that might pay, the one that composes what is consumed; the exact test has the last word."""
        assert consumer.certificate.consumes is not None
        wanted = consumer.certificate.consumes.vector
        able = [part for part in self.parts if part.certificate.pays and part.composed.shape == wanted.shape]
        if len(able) < 2:
            return able[0] if able else None
        differences = [ca.norm_inf(part.composed - wanted) for part in able]
        symbols = stack(ca.symvar(ca.vertcat(*differences)))
        point = np.random.default_rng(0).uniform(0.5, 1.5, symbols.numel())
        sizes = ca.Function("differences", [symbols], [ca.vertcat(*differences)])(point).full().ravel()
        return able[int(np.nanargmin(sizes))]

    @property
    def residual(self) -> SX:
        """dV/dt + dissipation - excess - consumption - lemma terms: zero, if the claim is true."""
        own = [self.weight(part) * (part.rate + part.dissipation - part.excess - part.lemma) for part in self.parts]
        return total(own) - self.consumption


def _unfollowed(diagram: Diagram, stated: Mapping[str, Certificate]) -> list[str]:
    """The blocks that give a reference which another one changes before it is followed."""
    ends = [(name, port) for name, certificate in stated.items() for port in certificate.filters]
    for name, port in ends:
        known = [item.name for item in diagram.blocks[name].inputs]
        if port not in known:
            raise NotApplicableError(f"{name}: filters names {port}, no input of it; {nearest(port, known)}")
    sources = [diagram.sources.get(end) for end in ends]
    return list(
        dict.fromkeys(source.block for source in sources if isinstance(source, Wire) and source.block in stated)
    )


def _laws(
    diagram: Diagram, certificates: Mapping[str, Certificate], truths: Stated, *, near: bool
) -> tuple[dict[str, PrintedLaw], tuple[str, ...]]:
    """The printed laws; one that is not what runs, or not what is proved, is a claim that nobody can read."""
    try:
        blocks = read_blocks(diagram, near=near)
        if near:
            return {name: block.law() for name, block in blocks.items()}, ()
        notices = check_docstrings(blocks)
        for name, certificate in certificates.items():
            blocks[name].hold(certificate, view(diagram, name, truths), diagram.loop)
        return {name: block.law() for name, block in blocks.items()}, tuple(notices)
    except DmframeError as error:
        raise NotApplicableError(error.text) from None


def total(items: Sequence[SX]) -> SX:
    """A sum of scalar expressions."""
    return ca.sum1(ca.vertcat(ca.SX(0), *items))


def claim_of(diagram: Diagram, *, near: bool = False) -> Claim:
    """Assemble what the blocks claim; with `near`, what prints is held to what runs at a few points alone.

    Raises `NotApplicableError` where a block has no certificate or an ill-formed one, or needs a truth that the diagram
    does not have.
    """
    loop = diagram.loop
    if loop.clocked:
        raise NotApplicableError(f"{loop.clocked}; a proof in continuous time does not reach it")
    stated, truths = certificates_of(diagram)
    laws, notices = _laws(diagram, stated, truths, near=near)
    unfollowed = _unfollowed(diagram, stated)
    stated |= {name: Certificate(truth=stated[name].truth) for name in unfollowed}
    laws = {name: law.silent if name in unfollowed else law for name, law in laws.items()}
    differentiated = Record()
    along, named = Field(diagram, differentiated), labelled(stated, laws)
    parts = tuple(along.part(name, certificate) for name, certificate in named.items())
    if not any(part.certificate.storage for part in parts):
        raise NotApplicableError("no block of this graph stores anything; there is no V")
    cascades = [part for part in parts if part.certificate.consumes is not None]
    kappa = ca.SX.sym("kappa") if cascades else ca.SX(1)
    return Claim(diagram, loop, parts, kappa, truths, laws, notices, differentiated=differentiated)


@final
class Field:
    """The closed loop's vector field, measured and commanded signals substituted, and time derivatives along it.

    Every derivative is entered in the record; that of a faulty field, by which a check is tried, in one of its own.
    """

    def __init__(self, diagram: Diagram, record: Record | None = None) -> None:
        self.diagram, self.loop, self.record = diagram, diagram.loop, Record() if record is None else record
        loop = self.loop
        variables = loop.variables
        self._leaves = [loop.time, *(variable.symbol for variable in variables)]
        self._rates = [ca.SX(1), *loop.joined(loop.rates_of(variables))]
        self._labels = ["", *(variable.label for variable in variables)]

    def with_parameters(self, symbols: SX, others: SX) -> Field:
        """The same field with other parameters in its equations."""
        field = Field(self.diagram)
        field._rates = list(ca.substitute(self._rates, [symbols], [others]))
        return field

    def with_factors(self, factors: Mapping[str, SX]) -> Field:
        """The same field with the rates of these states, by label, multiplied."""
        field = Field(self.diagram)
        named = zip(self._labels, self._rates, strict=True)
        field._rates = [rate * factors[label] if label in factors else rate for label, rate in named]
        return field

    def part(self, name: str, certificate: Certificate) -> Part:
        """A block's part, with the time derivative of its storage."""
        joined = certificate.mapped(self.loop.joined)
        storage = total([term.value for term in joined.storage]) / 2
        lemma = total([self._lemma(name, joined, item) for item in self._projections(name, storage)])
        task = certificate.task or certificate.consumes is not None
        for term in joined.storage:
            self.record.add(f"{name}: the storage of {term.of}", _inside(term))
        return Part(name, joined, task, self._along(storage), lemma)

    def derivative(self, expression: SX, of: str) -> SX:
        """d/dt along the closed loop, trajectories moving as they like; `of` names it in the record."""
        self.record.add(of, expression)
        return self._along(expression)

    def unrecorded(self, expression: SX) -> SX:
        """The same of what the caller itself examines: `dmframe.certify.smoothness.slope` is the only such caller."""
        return self._along(expression)

    def _along(self, expression: SX) -> SX:
        used = symbols_in([expression])
        pairs = [
            (leaf, rate) for leaf, rate in zip(self._leaves, self._rates, strict=True) if used & symbols_in([leaf])
        ]
        for (block, port, order), leaf in list(self.diagram.resolver.trajectories.items()):
            if used & symbols_in([leaf.symbol]):
                pairs.append((leaf.symbol, self.diagram.resolver.trajectory_rate(block, port, order)))
        if not pairs:
            return ca.SX(0)
        return ca.jtimes(expression, stack(leaf for leaf, _ in pairs), stack(rate for _, rate in pairs))

    def _projections(self, name: str, storage: SX) -> list[Projection]:
        """Of the block's own states. What another block stores may move with them too, as sigma does through dq_ref:
        it has no lemma, so the correction must cancel there, as it does where ddq_ref is derived with it.
        """
        used = symbols_in([storage])
        return [item for item in self.loop.projections if item.block == name and used & symbols_in([item.state])]

    def _lemma(self, name: str, certificate: Certificate, projection: Projection) -> SX:
        r"""(theta - theta_true)' W c: the projection lemma, for an estimate whose error is stored as one square."""
        own, estimate = symbols_in([projection.state]), certificate.estimates.get(projection.of)
        held = [term for term in certificate.storage if symbols_in(term.pieces) & own]
        if estimate is not None and len(held) == 1 and not symbols_in([estimate.weight]) & own:
            (square,) = held  # that of the estimate, which is always among them
            return ca.dot(times(square.weight, square.vector), projection.correction)
        hint = f"; say what it estimates by estimates={{'{projection.of}': TrueValue(...)}}" if estimate is None else ""
        raise NotApplicableError(
            f"{name}: {projection.name} is projected, but is not stored as one square of its error, which the "
            f"projection lemma needs{hint}"
        )


def _inside(term: Stored) -> SX:
    """What has to be smooth for a term to be.

    A potential is smooth in what it is made of, and so is a divergence where V, which holds it, is finite.
    """
    return stack(map(ca.SX, term.pieces)) if isinstance(term, Potential | LogDet) else ca.SX(term.value)


def certificates_of(diagram: Diagram) -> tuple[dict[str, Certificate], Stated]:
    """Every block's certificate, each made of the true values that all the others state."""
    sides = (Side.PLANT, Side.CONTROLLER)  # the plant first, so that the others can read what its certificates say
    everyone = [name for side in sides for name, block in diagram.blocks.items() if block.side is side]
    waiting, rounds = everyone, 0
    found, stated, read = dict[str, Certificate](), dict[str, Mapping[str, SX]](), dict[str, Mapping[str, str]]()
    while waiting:
        faults = dict[str, str]()
        for name in waiting:
            try:
                certificate, read[name] = _certificate(diagram, name, stated)
            except BlockError as error:
                faults[name] = error.text
                continue
            if certificate is None:
                raise NotApplicableError(_unproved(diagram, name))
            found[name] = certificate
            stated[name] = {key: ca.SX(value) for key, value in certificate.truth.items()}
        # who came early may have taken another block's value for its own, which had not stated it yet
        early = [name for name in everyone if name not in faults and _owners(diagram, name, stated) != read[name]]
        rounds += 1
        if list(faults) == waiting or rounds > 2 * len(everyone):
            raise NotApplicableError("; ".join(faults.values()) or f"the truth of {', '.join(early)} does not settle")
        waiting = [*faults, *early]
    for text in conflicts(diagram, stated):
        raise NotApplicableError(text)
    return {name: found[name] for name in diagram.blocks if name in found}, stated


def _unproved(diagram: Diagram, name: str) -> str:
    kind, why = diagram.type_of(name), diagram.blocks[name].unproved
    article = "an" if kind[0] in "aeiou" else "a"
    return f"{name}: {article} {kind} has no certificate{f': {why}' if why else ''}"


def _owners(diagram: Diagram, name: str, stated: Stated) -> Mapping[str, str]:
    try:
        return owners_of(diagram, name, stated)
    except BlockError as error:
        raise NotApplicableError(error.text) from None


def _certificate(diagram: Diagram, name: str, stated: Stated) -> tuple[Certificate | None, Mapping[str, str]]:
    known = len(diagram.resolver.faults)
    seen = view(diagram, name, stated)
    if faults := diagram.resolver.faults[known:]:  # a truth that would need what cannot be had
        del diagram.resolver.faults[known:]
        raise NotApplicableError(f"{name}: {faults[0].text}")
    with told_by(name, "certificate()"):
        certificate = diagram.blocks[name].composed_certificate(seen.u, seen.x, seen.p, seen.truth)
    if certificate is not None and type(certificate) is not Certificate:
        raise NotApplicableError(f"{name}: expected a Certificate, found {type(certificate).__name__}")
    if certificate is not None:
        check_form(name, certificate)
    return certificate, seen.owners


__all__ = ["Claim", "Field", "NotApplicableError", "Part", "certificates_of", "claim_of", "total"]
