"""Check that certificates, conditions and initial values do not contain numbers of the block."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from dmframe.block import AbstractBlock
from dmframe.block.certificate import SX, Certificate
from dmframe.block.faults import fault_context
from dmframe.block.parameter import specs
from dmframe.block.steady import Stating, check_steady, collected
from dmframe.certify.form import NotApplicableError
from dmframe.common.errors import BlockError, DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.truths import Stated
from dmframe.diagram.view import View, stated_start, view


def check_claims(diagram: Diagram, truths: Stated) -> None:
    """Reject a block whose certificate, conditions or initial values contain a number that was not read from `p`.

    Raises `NotApplicableError`: such a claim would be valid for one number only, but printed for all.
    """
    for name, block in diagram.blocks.items():
        if not specs(type(block)):
            continue
        seen = view(diagram, name, truths)
        for statement, stating in _methods(name, seen, {}):
            try:
                check_steady(name, block, statement, stating(block), stating)
            except BlockError as error:
                raise NotApplicableError(error.text) from None


def stated_claims(block: AbstractBlock, seen: View, constants: dict[str, SX]) -> dict[str, Any]:
    """A block's certificate and conditions, by descriptions of their parts; an exception as a text.

    `constants` are the unknown constants of certificates, by name; missing ones are created.
    """
    found = dict[str, Any]()
    for _, stating in _methods("", seen, constants)[:2]:
        found |= stating(block)
    return found


def _with_own_constants(stated: Certificate, known: dict[str, SX]) -> dict[str, Any]:
    """A certificate whose unknown constants, created again by each evaluation, are replaced by the `known` ones."""
    made = {name: value for name, value in stated.unknown.items() if isinstance(value, ca.SX)}
    ours = [known.setdefault(name, ca.SX.sym(name, *value.shape)) for name, value in made.items()]
    found = dict[str, Any]()
    for key, value in vars(stated).items():
        expressions, rest = collected(value)
        if all(one.shape == other.shape for one, other in zip(ours, made.values(), strict=True)):
            expressions = ca.substitute(list(expressions), list(made.values()), ours)
        found[key] = (expressions, rest)
    return found


def _methods(name: str, seen: View, constants: dict[str, SX]) -> list[tuple[str, Stating]]:
    def certificate(block: AbstractBlock) -> Mapping[str, Any]:
        stated = block.composed_certificate(seen.u, seen.x, seen.p, seen.truth)
        if not isinstance(stated, Certificate):
            return {"certificate": stated}
        return _with_own_constants(stated, constants) if stated.unknown else vars(stated)

    def conditions(block: AbstractBlock) -> Mapping[str, Any]:
        return {"list of conditions": list(block.composed_conditions(seen.p, seen.truth))}

    def start(block: AbstractBlock) -> Mapping[str, Any]:
        return stated_start(block, seen)

    def stating(method: str, stated: Stating) -> Stating:
        def evaluated(block: AbstractBlock) -> Mapping[str, Any]:
            try:
                with fault_context(name, method):
                    return stated(block)
            except DmframeError as error:  # an error that depends on a number also differs
                return {"error": error.text}

        return evaluated

    return [
        ("certificate() states", stating("certificate()", certificate)),
        ("conditions() state", stating("conditions()", conditions)),
        ("start() states", stating("start()", start)),
    ]
