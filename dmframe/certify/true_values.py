"""What each estimate estimates, as numbers: read off the certificates."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dmframe.block.model import symbols_in
from dmframe.certificate import Certificate
from dmframe.certify.claim import certificates_of
from dmframe.certify.form import NotApplicableError
from dmframe.diagram import ClosedLoop, Diagram, Variable


def true_values(diagram: Diagram) -> dict[str, np.ndarray]:
    """What each estimate estimates, by state label, at the diagram's own parameters.

    A state is an estimate if its block stores the square of its difference from an expression in parameters alone.
    Empty for a diagram that claims nothing.
    """
    loop = diagram.loop
    try:
        certificates = [certificate.mapped(loop.joined) for certificate in certificates_of(diagram)[0].values()]
    except NotApplicableError:
        return {}
    found = dict[str, np.ndarray]()
    for variable in loop.controller:
        for certificate in certificates:
            truth = _truth(variable, certificate, loop)
            if truth is not None:
                found[variable.label] = truth
    return found


def _truth(variable: Variable, certificate: Certificate, loop: ClosedLoop) -> np.ndarray | None:
    own = symbols_in([variable.symbol])
    for square in certificate.storage:
        if not own & symbols_in([square.vector]):
            continue
        slope = ca.jacobian(square.vector, variable.symbol)
        rest = -ca.substitute(ca.SX(square.vector), variable.symbol, ca.SX.zeros(*variable.symbol.shape))
        unit = slope.is_square() and slope.is_constant() and ca.DM(slope - ca.SX.eye(slope.shape[0])).is_zero()
        function = ca.Function("truth", [loop.p], [ca.densify(rest)], {"allow_free": True})
        if unit and not function.has_free():
            return np.asarray(function(loop.p_values).full().ravel())
    return None
