"""True values of the estimates, as numbers: declared by blocks, and stated by their certificates."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Certificate
from dmframe.block.model import symbols_in
from dmframe.certify.certificates import certificates_of
from dmframe.certify.form import NotApplicableError
from dmframe.diagram import Diagram


def estimated(diagram: Diagram, *, resting: bool = False) -> dict[str, SX | None]:
    """The estimates, by state label, each with its true value as an expression in the diagram's parameters.

    None for a true value that depends on more than parameters, and for all estimates of a diagram without a claim. With
    `resting`, unknown constants, such as the initial value of an integrator, are zero.
    """
    loop, found = diagram.loop, dict[str, SX | None]()
    known = loop.constants
    for name, model in diagram.models.items():
        found |= dict.fromkeys(f"{name}.{item.name}" for item in model.estimates)
    try:
        certificates = certificates_of(diagram).stated
    except NotApplicableError:
        return found
    for name, certificate in certificates.items():
        for state, true in _stated(certificate).items():
            value = ca.SX(true) + ca.SX.zeros(*diagram.models[name].states[state].shape)
            if resting and certificate.unknown:
                unknown = ca.veccat(ca.SX(0, 1), *certificate.unknown.values())
                value = ca.substitute(value, unknown, ca.SX.zeros(unknown.shape))
            value = ca.vec(ca.densify(*loop.joined([value])))
            found[f"{name}.{state}"] = value if symbols_in([value]) <= known else None
    return found


def _stated(certificate: Certificate) -> dict[str, SX]:
    moved = {item.estimate: item.true for item in certificate.steps}
    return moved | {state: true.value for state, true in certificate.estimates.items()}


def estimates_of(diagram: Diagram, *, resting: bool = False) -> dict[str, np.ndarray | None]:
    """`estimated` at the diagram's own numbers."""
    loop = diagram.loop

    def number(value: SX | None) -> np.ndarray | None:
        if value is None:
            return None
        return np.asarray(ca.Function("truth", [loop.p], [value])(loop.p_values).full().ravel())

    return {label: number(value) for label, value in estimated(diagram, resting=resting).items()}


def true_values(diagram: Diagram, *, resting: bool = False) -> dict[str, np.ndarray]:
    """Known true values of the estimates."""
    return {label: value for label, value in estimates_of(diagram, resting=resting).items() if value is not None}
