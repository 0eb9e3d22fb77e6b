"""What each estimate estimates, as numbers: what the blocks declare, and what their certificates say."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dmframe.certificate import SX
from dmframe.certify.claim import certificates_of
from dmframe.certify.form import NotApplicableError
from dmframe.diagram import ClosedLoop, Diagram


def estimates_of(diagram: Diagram) -> dict[str, np.ndarray | None]:
    """The estimates, by state label, each with what it estimates at the diagram's own parameters.

    None stands for a true value that is no function of parameters alone, and for all of a diagram that claims nothing.
    """
    found = dict[str, np.ndarray | None]()
    for name, model in diagram.models.items():
        found |= dict.fromkeys(f"{name}.{item.name}" for item in model.estimates)
    try:
        certificates = certificates_of(diagram)[0]
    except NotApplicableError:
        return found
    for name, certificate in certificates.items():
        for state, true in certificate.estimates.items():
            value = ca.SX(true.value) + ca.SX.zeros(*diagram.models[name].states[state].shape)
            found[f"{name}.{state}"] = _number(diagram.loop, value)
    return found


def true_values(diagram: Diagram) -> dict[str, np.ndarray]:
    """What each estimate estimates, of those of which it is known."""
    return {label: value for label, value in estimates_of(diagram).items() if value is not None}


def _number(loop: ClosedLoop, value: SX) -> np.ndarray | None:
    function = ca.Function("truth", [loop.p], [ca.densify(*loop.joined([value]))], {"allow_free": True})
    return None if function.has_free() else np.asarray(function(loop.p_values).full().ravel())
