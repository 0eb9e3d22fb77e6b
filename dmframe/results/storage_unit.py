"""Unit of V, derived from the units of the blocks' storage functions."""

from __future__ import annotations

from dmframe.certify.claim import Claim
from dmframe.dimensions.check import checks_of
from dmframe.dimensions.dimension import RAD, Dimension, declared, product, spelled
from dmframe.results.decided import StorageUnit


def storage_unit(claim: Claim) -> StorageUnit:
    """Derive the unit of V.

    Without a cascade all blocks have weight 1. With one, kappa converts the unit of the servo level to that of the
    cascade, which is the unit of V.
    """
    diagram = claim.diagram
    stored = [part for part in claim.parts if part.certificate.storage or part.certificate.steps]
    weights = {part.block: claim.cascaded and not part.cascade for part in stored}
    parts, rates = dict[str, str](), dict[str, str]()
    for check in checks_of(diagram.models, diagram.sizes, diagram.robot):
        found = check.storage if check.model.name in weights else None
        if found is not None:
            parts[check.model.name], rates[_text(found)] = _text(found), _text(product(found, declared("s"), -1))
    levels = [
        list(dict.fromkeys(unit for name, unit in parts.items() if weights[name] == weight)) for weight in (False, True)
    ]
    several = tuple(next((level for level in levels if len(level) > 1), ()))
    unit = "" if several or not levels[0] else levels[0][0]
    return StorageUnit(unit, rates.get(unit, ""), parts, several)


def _text(dimension: Dimension) -> str:
    powers = tuple(0 if k == RAD else power for k, power in enumerate(dimension.powers))
    text = spelled(Dimension(powers, angular=False))
    return "1" if text == "a plain number" else text
