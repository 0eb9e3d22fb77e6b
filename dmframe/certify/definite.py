"""Matrix weights of squares: positive definiteness by rational factors, or by the physical consistency of the links."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, LogDet
from dmframe.block.linalg import ldl, nodes
from dmframe.block.model import symbols_in
from dmframe.block.parameter import specs
from dmframe.certify.claim import Claim
from dmframe.certify.symbols import symbols_of
from dmframe.diagram import Diagram
from dmframe.diagram.projection import Bodies
from dmframe.prove.definite import pivots
from dmframe.robot.parameters import INERTIAL
from dmframe.robot.pseudo_inertia import parameters_of, pseudo_inertia


def unphysical_links(robot: Any) -> list[str]:
    """Names of the joints whose links together are no body of a positive mass distribution."""
    return [
        joint.name
        for joint, row in zip(robot.joints, robot.inertia, strict=True)
        if not min(pivots(pseudo_inertia(row))) > 0
    ]


def least_body_pivot(robot: Any) -> Fraction:
    """Positive iff each link's inertia is that of some mass distribution; M(q) is then positive definite at every q."""
    return min(min(pivots(pseudo_inertia(row))) for row in robot.inertia)


def body_pivots(diagram: Diagram) -> SX:
    """The same pivots, of all links, as expressions in the diagram's parameters."""
    symbols = [parameter.symbol for parameter in diagram.loop.parameters if parameter.label == "robot.inertia"]
    links = [ca.vertsplit(row) for row in ca.vertsplit(symbols[0], len(INERTIAL))] if symbols else []
    matrices = (ca.blockcat(pseudo_inertia(link)) for link in links)
    return ca.vertcat(ca.SX(0, 1), *(pivot for matrix in matrices for pivot in ldl(matrix)[1]))


def is_mass_matrix(claim: Claim, weight: SX) -> bool:
    """True for a weight that is identically the mass matrix of the diagram's robot at a state of its plant.

    The last link may contain a load, ten parameters from a source; the weight is then a mass matrix if the load is a
    rigid body, see `load_in`. A diagonal of nonnegative parameters, such as rotor inertias, may be added.
    """
    return _matched(claim, weight) is not None


def load_in(claim: Claim, weight: SX) -> str:
    """Label of the load contained in the last link of a mass matrix; empty without a load."""
    return _matched(claim, weight) or ""


def is_matrix(claim: Claim, weight: SX) -> bool:
    """True for a weight that is not diagonal; for one joint, a mass matrix with an unknown load."""
    return not weight.is_column() or (weight.is_scalar() and bool(load_in(claim, weight)))


def _matched(claim: Claim, weight: SX) -> str | None:
    """Label of the load in a mass matrix, empty without a load; None for any other weight."""
    key = nodes(weight)
    if key not in claim.matched:
        claim.matched[key] = weight, _match(claim, weight)  # the stored weight keeps the identities of its nodes unique
    return claim.matched[key][1]


def _match(claim: Claim, weight: SX) -> str | None:
    found = _found(claim, weight)
    return None if found is None else found[0]


def body_matrix(claim: Claim, weight: SX) -> tuple[SX, Any, SX, SX] | None:
    """Joint positions, robot, inertia of the bodies and rotors of a weight that is a mass matrix; None otherwise."""
    found = _found(claim, weight)
    return None if found is None else found[1:]


def _found(claim: Claim, weight: SX) -> tuple[str, SX, Any, SX, SX] | None:
    symbols = symbols_of(claim)
    for q, robot in _poses(claim, weight):
        used, size = symbols_in([weight]), len(INERTIAL)
        bodies = {"": robot.inertia}
        for leaf in claim.diagram.resolver.trajectories.values():
            if leaf.symbol.shape == (size, 1) and used & leaf.identities:
                own = robot.inertia
                bodies[leaf.name] = ca.vertcat(own[:-size], own[-size:] + leaf.symbol)
        for label, inertia in bodies.items():
            held = symbols_in([inertia])
            if held and not held & used:  # a mass matrix is linear in the inertia of its bodies, and not zero
                continue
            rest = weight - robot.mass_matrix(q, inertia)
            for rotors in _rotors(claim, weight):
                if symbols.vanishes("difference", rest - ca.diag(rotors)):
                    return label, q, robot, inertia, rotors
    return None


def _rotors(claim: Claim, weight: SX) -> Iterator[SX]:
    """No rotors, then each column of parameters in the weight that are declared nonnegative."""
    size, used, blocks = weight.shape[0], symbols_in([weight]), claim.diagram.blocks
    yield ca.SX(size, 1)
    for parameter in claim.diagram.loop.parameters:
        block, _, name = parameter.label.partition(".")
        spec = specs(type(blocks[block])).get(name) if block in blocks else None
        if spec and spec.sign and parameter.symbol.shape == (size, 1) and used & symbols_in([parameter.symbol]):
            yield parameter.symbol


def is_mass_matrix_of_bodies(claim: Claim, matrix: SX) -> bool:
    """True for the mass matrix of estimates that V or a projection keeps physically consistent.

    A V that does not increase keeps them in a compact set of consistent parameters; a projection keeps them above a
    fraction of the nominal ones, for any V. Such a mass matrix is uniformly positive definite.
    """
    symbols = symbols_of(claim)
    return any(
        symbols.vanishes("difference", matrix - robot.mass_matrix(q, bodies))
        for bodies in _kept_bodies(claim)
        for q, robot in _poses(claim, matrix)
        if bodies.numel() == len(INERTIAL) * robot.n
    )


def _kept_bodies(claim: Claim) -> Iterator[SX]:
    """Estimated inertial parameters of links that stay physically consistent, all links in one column."""
    for projection in claim.loop.projections:
        if isinstance(projection.set, Bodies):
            yield projection.state[: projection.set.nominal.numel()]
    if any(part.certificate.residual for part in claim.parts):
        return
    for part in claim.parts:
        found = [term.matrix for term in part.certificate.storage if isinstance(term, LogDet)]
        rows = [[[P[i, j] for j in range(4)] for i in range(4)] for P in found if P.shape == (4, 4)]
        if rows:
            yield ca.vertcat(*(value for P in rows for value in parameters_of(P)))


def _poses(claim: Claim, matrix: SX) -> Iterator[tuple[SX, Any]]:
    """Positions of robots whose mass matrix has that shape."""
    for variable in claim.loop.plant:
        robot = claim.diagram.models[variable.block].robot
        if robot is not None and variable.symbol.numel() == robot.n and matrix.shape == (robot.n, robot.n):
            yield variable.symbol, robot


def least_sampled(claim: Claim, weight: SX) -> float:
    """Least eigenvalue of a weight at 200 sampled states."""
    loop = claim.loop
    function = ca.Function("W", [loop.state, loop.p], [weight])
    rng = np.random.default_rng(0)
    states = rng.uniform(-np.pi, np.pi, (200, loop.state.numel()))
    return min(float(np.linalg.eigvalsh(function(state, loop.p_values).full())[0]) for state in states)
