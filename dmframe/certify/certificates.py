"""The certificates of a diagram's blocks, each evaluated with the true values that the others state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca

from dmframe.block.certificate import SX, Certificate
from dmframe.block.faults import fault_context
from dmframe.block.model import symbols_in
from dmframe.block.port import Side
from dmframe.certify.form import NotApplicableError, check_form
from dmframe.common.errors import BlockError
from dmframe.diagram import Diagram
from dmframe.diagram.truths import Stated, conflicts
from dmframe.diagram.view import owners_of, view


@final
@dataclass(frozen=True)
class Certificates:
    """Statements of the blocks of a diagram.

    Parameters
    ----------
    stated
        Certificates, by block.
    truths
        True values of estimates, by block and name.
    silent
        In discrete time: blocks without a certificate, and controllers whose certificate is in continuous time.
    """

    stated: Mapping[str, Certificate]
    truths: Stated
    silent: tuple[str, ...] = ()


def certificates_of(diagram: Diagram) -> Certificates:
    """Evaluate every block's certificate.

    In continuous time each block must have one. In discrete time a block without one is `silent`, and so is a
    controller whose certificate stores no sampled state: the proof is then valid for any behaviour of these blocks.

    Raises `NotApplicableError` for a missing or ill-formed certificate, and for a true value that is not available.
    """
    sides, sampled = (
        (Side.PLANT, Side.CONTROLLER),
        bool(diagram.loop.discrete_time),
    )  # they read the plant's true values
    everyone = [name for side in sides for name, block in diagram.blocks.items() if block.side is side]
    waiting, rounds, silent = everyone, 0, list[str]()
    found, truths, read = dict[str, Certificate](), dict[str, Mapping[str, SX]](), dict[str, Mapping[str, str]]()
    while waiting:
        faults = dict[str, str]()
        for name in waiting:
            try:
                certificate, read[name] = _certificate(diagram, name, truths, lenient=sampled)
            except BlockError as error:
                faults[name] = error.text
                continue
            if certificate is None and not sampled:
                raise NotApplicableError(_unproved(diagram, name))
            if certificate is None:
                silent.append(name)
                continue
            found[name] = certificate
            truths[name] = {key: ca.SX(value) for key, value in certificate.truth.items()}
        # an early certificate may have used a value that another block states only later
        early = [name for name in found if _owners(diagram, name, truths) != read[name]]
        rounds += 1
        if list(faults) == waiting or rounds > 2 * len(everyone):
            needed = [text for name, text in faults.items() if not sampled or _is_sampled(diagram, name)]
            if needed or early:
                causes = [_unproved(diagram, name) for name in silent if needed and diagram.blocks[name].unproved]
                raise NotApplicableError(
                    "; ".join([*causes, *needed]) or f"the truth of {', '.join(early)} does not settle"
                )
            silent += faults  # continuous-time laws
            break
        waiting = [*faults, *early]
    for text in conflicts(diagram, truths):
        raise NotApplicableError(text)
    if sampled:
        silent += [name for name in found if _is_silent(diagram, name, found[name])]
    order = list(diagram.blocks)
    stated = {name: found[name] for name in order if name in found}
    return Certificates(stated, truths, tuple(name for name in order if name in silent))


def is_over_samples(diagram: Diagram, name: str, certificate: Certificate) -> bool:
    """True for a certificate that describes the step from sample to sample."""
    if any((certificate.steps, certificate.delay_lines, certificate.plant, certificate.solved, certificate.acted)):
        return True
    states = diagram.models[name].states
    sampled = symbols_in(states[state.name] for state in diagram.blocks[name].states if state.sampled)
    pieces = [piece for term in certificate.storage for piece in term.pieces]
    return bool(sampled & symbols_in(ca.SX(piece) for piece in pieces if not isinstance(piece, ca.MX)))


def _is_silent(diagram: Diagram, name: str, certificate: Certificate) -> bool:
    controller = diagram.blocks[name].side is Side.CONTROLLER
    return controller and not is_over_samples(diagram, name, certificate) and not _is_sampled(diagram, name)


def _is_sampled(diagram: Diagram, name: str) -> bool:
    return any(state.sampled for state in diagram.blocks[name].states)


def _unproved(diagram: Diagram, name: str) -> str:
    kind, why = diagram.type_of(name), diagram.blocks[name].unproved
    article = "an" if kind[0] in "aeiou" else "a"
    return f"{name}: {article} {kind} has no certificate{f': {why}' if why else ''}"


def _owners(diagram: Diagram, name: str, truths: Stated) -> Mapping[str, str]:
    try:
        return owners_of(diagram, name, truths)
    except BlockError as error:
        raise NotApplicableError(error.text) from None


def _certificate(
    diagram: Diagram, name: str, truths: Stated, *, lenient: bool
) -> tuple[Certificate | None, Mapping[str, str]]:
    known = len(diagram.resolver.faults)
    seen = view(diagram, name, truths)
    if faults := diagram.resolver.faults[known:]:  # a true value that depends on an unavailable signal
        del diagram.resolver.faults[known:]
        if not lenient:
            raise NotApplicableError(f"{name}: {faults[0].text}")
    with fault_context(name, "certificate()"):
        certificate = diagram.blocks[name].composed_certificate(seen.u, seen.x, seen.p, seen.truth)
    if certificate is not None and type(certificate) is not Certificate:
        raise NotApplicableError(f"{name}: expected a Certificate, found {type(certificate).__name__}")
    if certificate is not None and not (lenient and not is_over_samples(diagram, name, certificate)):
        check_form(name, certificate)
    return certificate, seen.owners


__all__ = ["Certificates", "certificates_of", "is_over_samples"]
