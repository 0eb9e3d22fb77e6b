"""The verdict on a seeded fault in a closed loop, compared with numbers that are independent of the certifier."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple
from unittest import mock

import casadi as ca
from closed_loops import ADAPTATION, FULL, Built, known_blocks, loops, negative_in_numbers, same_field, true_in_numbers
from seeded_faults import LIBRARY, Mutant, mutated_block

from dmframe.block import AbstractBlock, Signals
from dmframe.block.adapting import AdaptingBlock
from dmframe.block.certificate import Certificate
from dmframe.block.model import BlockModel, Recalled, model_block, signals_of, symbols_in
from dmframe.block.port import Side
from dmframe.block.steady import collected, stated_equations
from dmframe.certify import Verdict, claim_of, verify
from dmframe.certify.assemble import assembled
from dmframe.certify.steady import check_claims
from dmframe.common.errors import DmframeError
from dmframe.common.text import Text
from dmframe.diagram import Diagram
from dmframe.prove.export import digest
from dmframe.prove.identity import identity
from dmframe.prove.reals import why_not_refuted
from dmframe.robot import recursion
from dmframe.robot.bodies import Body
from dmframe.robot.symbolic import SymbolicRobot

OUTCOMES = {
    "refuted": "the certifier refutes it",
    "no diagram": "the diagram or the claim cannot be built, or is defined nowhere",
    "condition": "the identity is true, and a condition fails",
    "units": "the identity is true, every condition holds, and units do not agree",
    "equivalent": "the identity is true, and numbers agree",
    "unchanged": "the block's expressions are unchanged in every closed loop that holds it",
    "survived": "proved, though numbers show another dV/dt or a term below zero, or with conclusions that are new",
}


@dataclass(frozen=True)
class Result:
    """Result of a fault in one closed loop."""

    mutant: Mutant
    loop: str
    outcome: str
    reason: str


@contextlib.contextmanager
def patched(mutant: Mutant) -> Iterator[None]:
    """The library with one function replaced in every module and class that refers to it."""
    name = mutant.original.__name__

    def holders(of: Any) -> list[Any]:
        modules = [module for module_name, module in sys.modules.items() if module_name.startswith("dmframe")]
        return [each for each in (*modules, SymbolicRobot, Body, AdaptingBlock) if vars(each).get(name) is of]

    found = holders(mutant.original)
    assert found
    try:
        for holder in found:
            setattr(holder, name, mutant.function)
        recursion.forget()
        yield
    finally:
        recursion.forget()
        for holder in holders(mutant.function):  # a module imported in the meantime refers to it too
            setattr(holder, name, mutant.original)


def unlabelled(stated: Mapping[str, Certificate], laws: Any) -> dict[str, Certificate]:
    """Certificates with a number for each name."""
    del laws

    def counted(certificate: Certificate) -> Certificate:
        driven = tuple(
            replace(item, of=tuple(Text(str(k)) for k in range(len(item.bounded)))) for item in certificate.linear
        )
        return replace(certificate, linear=driven)

    return {name: counted(certificate) for name, certificate in stated.items()}


@contextlib.contextmanager
def nothing_printed() -> Iterator[None]:
    """Without printed laws, which would refuse some faults before the exact test, and without conclusions."""
    with (
        mock.patch("dmframe.certify.laws.printed_laws", return_value={}),
        mock.patch("dmframe.certify.labels.labelled", unlabelled),
        mock.patch("dmframe.certify.assumed._named", return_value=Text()),
        mock.patch("dmframe.certify.verifier.statements_of", return_value=[]),
        mock.patch("dmframe.certify.verifier.hypotheses", return_value=[]),
    ):
        yield


class _Only(dict[str, AbstractBlock]):
    """Blocks by name; iteration yields those of some types."""

    def __init__(self, blocks: Mapping[str, AbstractBlock], unchanged: Sequence[type[AbstractBlock]]) -> None:
        super().__init__(blocks)
        self._unchanged = unchanged

    def items(self) -> Any:
        """The blocks of types other than the unchanged ones."""
        return [(name, block) for name, block in super().items() if type(block) not in self._unchanged]


@contextlib.contextmanager
def reusing(honest: Diagram) -> Iterator[None]:
    """Models of the blocks; for unchanged classes those of a diagram without faults.

    The check that unchanged certificates do not depend on numbers (`check_claims`) is not repeated.
    """
    kinds = [type(block) for block in honest.blocks.values()]
    robots = {id(model.robot): model.robot for model in honest.models.values() if model.robot is not None}

    def model(name: str, block: AbstractBlock, *rest: Any) -> BlockModel:
        known = honest.models[name]
        return known if type(known.block) is type(block) else model_block(name, block, *rest)

    def hold(diagram: Diagram, truths: Any) -> None:
        check_claims(replace(diagram, blocks=_Only(diagram.blocks, kinds)), truths)

    with (
        mock.patch("dmframe.diagram.diagram.model_block", model),
        mock.patch("dmframe.certify.claim.check_claims", hold),
    ):
        if len(robots) != 1:
            yield
            return
        with mock.patch("dmframe.diagram.diagram._symbolic", return_value=next(iter(robots.values()))):
            yield


class Statement(NamedTuple):
    """The statements of a loop's blocks of one type, as CasADi prints them.

    `claimed` contains the certificate, conditions and initial values; `concluded` the stable linear subsystems, which
    only conclusions use.
    """

    law: str
    claimed: str
    concluded: str


def statement(loop: Built, kind: str, block: type[AbstractBlock]) -> Statement | None:
    """None if it cannot be evaluated, or has other symbols than the block without faults."""
    texts = list[Statement]()
    for name, (of, values) in loop.specs.items():
        if of == kind:
            try:
                texts.append(Statement(*(_written(loop, name, each) for each in _stated(loop, name, block(**values)))))
            except Exception:
                return None
    return Statement(*("\n".join(each) for each in zip(*texts, strict=True)))


def _written(loop: Built, name: str, stated: Any) -> str:
    expressions, rest = collected(stated)
    return "\n".join([*rest, ca.Function("stated", _symbols(loop, name), list(expressions)).serialize()])


def _stated(loop: Built, name: str, block: AbstractBlock) -> tuple[Any, Any, Any]:
    u, x, p, truth = _signals(loop, name)
    certificate = block.composed_certificate(u, x, p, truth)
    fields = {} if certificate is None else dict(vars(certificate))
    driven = fields.pop("linear", ())
    equations, conditions = block.composed_equations(u, x, p), list(block.composed_conditions(p, truth))
    return stated_equations(equations), (fields, conditions, block.composed_start(u, p, truth)), driven


@cache
def _signals(loop: Built, name: str) -> tuple[Signals, Signals, Signals, Signals]:
    """Symbols of a block without faults, with a robot that caches its functions."""
    diagram = loop.diagram
    model = diagram.models[name]
    robot = None if model.robot is None else Recalled(model.robot)
    u, x, p = signals_of(name, model.inputs, model.states, {**model.parameters, **model.starts}, robot)
    sizes = {
        port.name: (*diagram.sizes.of(port.shape), 1)[:2]
        for port in model.block.truth
        if diagram.sizes.has_sizes_of(port)
    }
    truth = {port: ca.SX.sym(f"truth.{port}", *size) for port, size in sizes.items()}
    return u, x, p, Signals(name, "truths", truth)


@cache
def _symbols(loop: Built, name: str) -> list[Any]:
    expressions, _ = collected(_stated(loop, name, loop.diagram.models[name].block))
    return list(ca.symvar(ca.veccat(*expressions)))


@cache
def unchanged_statement(loop: Built, kind: str) -> Statement | None:
    """The statements of the block without faults."""
    return statement(loop, kind, known_blocks()[kind])


_JUDGED = dict[tuple[str, Statement], Result]()
"""Results by loop and statement: two faults with the same expressions have one verdict."""


UNCHANGED = "the block's expressions are unchanged"
SAME_RATES = "the rates are unchanged"
UNCALLED = "no closed loop calls the function"
SAME_LAW = "the certificate differs, dV/dt is true all the same"


def tried(mutant: Mutant, everywhere: bool = False) -> list[Result]:
    """The first closed loop in which a fault changes a certificate or a rate, else the last one; `everywhere`: all."""
    found = list[Result]()
    for loop in homes(mutant, loops(), everywhere):
        found.append(_judged_once(mutant, loop))
        if not everywhere and found[-1].reason not in (UNCHANGED, SAME_RATES):
            return found[-1:]
    return (found if everywhere else found[-1:]) or [Result(mutant, "", "unchanged", UNCALLED)]


def _judged_once(mutant: Mutant, loop: Built) -> Result:
    if mutant.owner in LIBRARY:
        return judged(mutant, loop)
    own = unchanged_statement(loop, mutant.owner)
    stated = statement(loop, mutant.owner, mutated_block(known_blocks()[mutant.owner], mutant))
    if stated is None or own is None:
        return judged(mutant, loop)
    if stated == own:
        return Result(mutant, loop.name, "unchanged", UNCHANGED)
    key = loop.name, stated
    if key not in _JUDGED:
        _JUDGED[key] = concluded(mutant, loop) if stated[:2] == own[:2] else judged(mutant, loop)
    reason = _JUDGED[key].reason
    reason = SAME_LAW if stated.law == own.law and reason == SAME_RATES else reason
    return replace(_JUDGED[key], mutant=mutant, reason=reason)


def concluded(mutant: Mutant, loop: Built) -> Result:
    """Result of a fault that affects conclusions only: no new conclusion is allowed.

    That a signal named by the fault is bounded does not count: it is decided from the loop, not from the name.
    """
    with reusing(loop.diagram):
        try:
            verdict = verify(loop.build({mutant.owner: mutant}, mutated_block), trials=1, start=loop.start)
        except DmframeError as error:
            return Result(mutant, loop.name, "no diagram", error.text)
    if verdict.outcome != "proved":
        units = str(verdict.reason).startswith("the units")
        return Result(mutant, loop.name, "units" if units else "condition", str(verdict.reason))
    if new := new_conclusions(verdict, verdict_without_faults(loop)):
        return Result(mutant, loop.name, "survived", f"new conclusions: {', '.join(new)}")
    return Result(mutant, loop.name, "equivalent", "only conclusions depend on it, and none is new")


@cache
def verdict_without_faults(loop: Built) -> Verdict:
    """The verdict of the loop without faults."""
    return verify(loop.diagram, trials=1, start=loop.start)


def new_conclusions(verdict: Verdict, before: Verdict) -> list[str]:
    """Conclusions on a signal or a state that another verdict names, and that it does not contain."""
    named = {str(item.signal) for item in before.statements}
    known = [(str(item.signal), item.says, set(map(str, item.assumes))) for item in before.statements]
    known += [  # by Barbalat's lemma
        (str(item.signal), "goes to zero", {f"the derivative of {item.signal} is bounded"})
        for item in before.statements
        if item.says == "is square-integrable"
    ]
    found = [
        f"{item.signal} {item.says}"
        for item in verdict.statements
        if item.signal in named
        and not any(
            (item.signal, item.says) == (signal, reports) and assumes <= set(map(str, item.assumes))
            for signal, reports, assumes in known
        )
    ]
    if verdict.states and before.states:
        found += [f"{label} is bounded" for label in verdict.states.bounded if label not in before.states.bounded]
    return found


def judged(mutant: Mutant, loop: Built) -> Result:
    """Result of a fault in one closed loop."""
    block = mutant.owner in known_blocks()
    with reusing(loop.diagram) if block else patched(mutant), nothing_printed():
        try:
            diagram = loop.build({mutant.owner: mutant} if block else {}, mutated_block)
            if block and known_blocks()[mutant.owner].side is Side.SOURCE and _free_of_sources(diagram):
                return Result(mutant, loop.name, "equivalent", "trajectories and their derivatives are free")
            claim = assembled(claim_of(diagram))
            if not identity(claim, trials=1, seed=0).zero and not why_not_refuted(
                claim, 0
            ):  # `verify` searches for the block too
                return Result(mutant, loop.name, "refuted", "the residual is not zero")
            if not block and digest(claim) == _digest_without_faults(loop) and same_field(diagram, loop.diagram):
                return Result(mutant, loop.name, "equivalent", SAME_RATES)
            verdict = verify(diagram, trials=1, start=loop.start)
        except DmframeError as error:
            return Result(mutant, loop.name, "no diagram", error.text)
        except Exception as error:  # a fault in the library may raise any error; that of a block is a `DmframeError`
            if block:
                raise
            return Result(mutant, loop.name, "no diagram", repr(error))
        return Result(mutant, loop.name, *_outcome(diagram, verdict, loop))


def _free_of_sources(diagram: Diagram) -> bool:
    """True if no part of the claim depends on a source's equations, so that no fault in them has an effect."""
    claim = claim_of(diagram)
    sources = {name for name, block in diagram.blocks.items() if block.side is Side.SOURCE}
    own = {s for p in claim.loop.parameters if p.label.split(".")[0] in sources for s in symbols_in([p.symbol])}
    moves = claim.flow.rates_of(symbols_in([claim.V])) if not claim.over_samples else claim.sample.next
    held = [claim.V, *moves.values(), *(x for part in claim.parts for x in part.certificate.pieces)]
    return not (own | symbols_in([claim.loop.time])) & symbols_in(held)


@cache
def _digest_without_faults(loop: Built) -> str:
    with nothing_printed():
        return digest(assembled(claim_of(loop.diagram)))


def _outcome(diagram: Diagram, verdict: Verdict, loop: Built) -> tuple[str, str]:
    reason = str(verdict.reason)
    if verdict.outcome == "refuted":
        return "refuted", reason
    if verdict.claim is None or verdict.test is None:
        return "no diagram", reason
    try:
        if not true_in_numbers(diagram, verdict.claim):
            return "survived", f"dV/dt is another one in numbers; {reason}"
    except FloatingPointError as error:
        return "survived" if verdict.outcome == "proved" else "condition", f"{error}; {reason}"
    if verdict.outcome == "proved":
        negative = set(negative_in_numbers(diagram, verdict.claim)) - set(negative_without_faults(loop))
        if negative:
            return "survived", f"below zero in numbers: {', '.join(sorted(negative))}"
        unchanged = same_field(diagram, loop.diagram)
        return "equivalent", SAME_RATES if unchanged else "the rates differ, dV/dt is true all the same"
    if diagram.unit_faults and verdict.test.zero and all(item.holds for item in verdict.conditions):
        return "units", reason
    return ("condition" if verdict.test.zero else "equivalent"), reason


@cache
def negative_without_faults(loop: Built) -> tuple[str, ...]:
    """Negative terms at sampled states of a loop without faults, such as one that is positive by assumption."""
    with nothing_printed():
        return tuple(negative_in_numbers(loop.diagram, claim_of(loop.diagram)))


def homes(mutant: Mutant, available: Sequence[Built], everywhere: bool = False) -> Iterator[Built]:
    """The closed loops that contain a block of this type, or call a function of the library, the fastest first.

    Of those that call a function, one for each number of joints, unless `everywhere`: a planar arm does not show most
    rotations. Of those with adaptation, one for each set of options.
    """
    kind, seen = mutant.owner, set[Hashable]()
    fitting = [loop for loop in available if kind in LIBRARY or kind in loop.types]
    fitting = [loop for loop in fitting if (FULL in loop.name) == (kind == "gain")] or fitting
    for loop in sorted(fitting, key=cost):
        if kind in LIBRARY and not everywhere:
            case = options_of(loop) if kind == "adapting" else loop.robot.n
            if case in seen or not called(loop, mutant.original):
                continue
            seen.add(case)
        yield loop


def options_of(loop: Built) -> frozenset[str]:
    """The parameters by which its blocks' adaptation differs from the gradient law."""
    return frozenset(name for _, values in loop.specs.values() for name in values if name in ADAPTATION)


@cache
def cost(loop: Built) -> int:
    """Number of instructions of a loop's rates."""
    moving = loop.diagram.loop
    rates = ca.veccat(*(variable.own_rate for variable in moving.variables if variable.own_rate is not None))
    return int(ca.Function("rates", ca.symvar(rates), [rates]).n_nodes())


def called(loop: Built, function: Any) -> bool:
    """True where the loop's diagram or claim calls a function of the library."""
    return function.__code__ in _calls(loop)


@cache
def _calls(loop: Built) -> frozenset[Any]:
    found = set[Any]()
    before = sys.getprofile()
    sys.setprofile(lambda frame, event, _: found.add(frame.f_code) if event == "call" else None)
    try:
        with nothing_printed():
            assembled(claim_of(loop.build()))
    finally:
        sys.setprofile(before)
    return frozenset(found)
