r"""Effect of a disturbance torque on the storage of the servo level.

A torque d on the joints adds :math:`G d` to the joint acceleration, :math:`G = \partial \ddot q / \partial d`, and so

.. math:: \frac{\partial S}{\partial \dot q} G\, d

to dS/dt. The block that dominates a cross term states coefficients :math:`c_i` (`Certificate.disturbed`) with

.. math:: \Big(\frac{\partial S}{\partial \dot q} G\Big)^\top = \sum_i c_i v_i,

where the :math:`|v_i|^2_{W_i}` are its dissipated squares. The equation is tested exactly, as an identity in all
symbols. With :math:`|d_j| \le D_j`, Cauchy's inequality bounds the additional power:

.. math:: \Big|\sum_i (c_i v_i)^\top d\Big| \le \delta \Big(\sum_i |v_i|^2_{W_i}\Big)^{1/2}, \qquad
          \delta^2 = \sum_j D_j^2 \sum_i c_{ij}^2 / W_{ij}
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from dmframe.block.certificate import SX
from dmframe.certify.claim import Claim, Part
from dmframe.certify.symbols import Symbols
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram
from dmframe.diagram.view import view
from dmframe.diagram.wiring import Wire

TORQUE = "tau_ext"
"""The input of a robot at which a torque of the environment acts."""


class NoBoundError(DmframeError):
    """A loop has no bound of this kind; the text gives the reason."""


def require_disturbed(claim: Claim, symbols: Symbols, servo: Part, storage: SX) -> None:
    """Test the equation of the module docstring for a dominating block.

    Parameters
    ----------
    servo
        The block on the servo level that states `Certificate.disturbed`.
    storage
        S, the sum of all storage functions on the servo level.

    Raises
    ------
    NoBoundError
        The equation does not hold, or a torque acts on more than the acceleration of one robot.
    """
    robot, velocity, gain = _response(claim.diagram)
    shares = servo.certificate.disturbed
    squares = servo.certificate.dissipation[: len(shares)]
    stated = sum((share * term.pieces[0] for share, term in zip(shares, squares, strict=True)), ca.SX(0))
    found = gain.T @ ca.gradient(storage, velocity)
    if not symbols.vanishes("disturbed", ca.densify(found - stated)):
        raise NoBoundError(f"{servo.block}: a joint torque does not act on V as its certificate states (disturbed)")
    above = ca.vertcat(ca.SX(0), *(part.storage for part in claim.parts if part.cascade))
    if not symbols.vanishes("undisturbed", ca.densify(ca.jacobian(above, velocity) @ gain)):
        raise NoBoundError(f"a torque on the joints of {robot} acts on the storage of the task directly")


def _response(diagram: Diagram) -> tuple[str, SX, SX]:
    """The robot, its joint velocity, and the derivative of its acceleration by a joint torque, in the loop's leaves."""
    robots = [
        name for name, model in diagram.models.items() if TORQUE in model.inputs and "dq" in model.equations.rates
    ]
    if len(robots) != 1:
        raise NoBoundError(f"expected one robot with an input {TORQUE}, found {len(robots)}")
    (name,) = robots
    model = diagram.models[name]
    torque = model.inputs[TORQUE]
    for what in _read_of(diagram, name):
        raise NoBoundError(f"a torque acts on {what} directly")
    gain = ca.jacobian(model.equations.rates["dq"], torque)
    known = [(symbol, getattr(view(diagram, name).u, port)) for port, symbol in model.inputs.items() if port != TORQUE]
    used = [(symbol, value) for symbol, value in known if ca.depends_on(gain, symbol)]
    (gain,) = ca.substitute([gain], [a for a, _ in used], [b for _, b in used])
    return name, model.states["dq"], diagram.loop.joined([gain])[0]


def _read_of(diagram: Diagram, name: str) -> Iterator[str]:
    """Signals through which a torque acts on other blocks, or on more than the acceleration."""
    model = diagram.models[name]
    direct = {port for port, value in model.equations.outputs.items() if TORQUE in model.needs(value)}
    for (block, port), source in diagram.sources.items():
        if isinstance(source, Wire) and source.block == name and source.port in direct:
            yield f"{block}.{port}"
    for state, rate in model.equations.rates.items():
        if state != "dq" and TORQUE in model.needs(rate):
            yield f"{name}.{state}"
