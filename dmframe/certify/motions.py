"""Motions of the plant for random smooth commands, and the part of a block's rows that they leave unexplained.

Equations, initial values and wires are those of the graph: the plant is integrated with each command held constant, and
the sampled states that the rows depend on are updated as their blocks state. Only the commands are replaced
(`DrivenLoop`); rounding is removed, and random inputs are zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple, final

import casadi as ca
import numpy as np

from dmframe.block.certificate import SX, Steps
from dmframe.block.faults import fault_context
from dmframe.block.model import symbols_in
from dmframe.block.sampled import DelayLine
from dmframe.block.steps import summed
from dmframe.certify.claim import Claim, Part
from dmframe.certify.driven import DrivenLoop
from dmframe.common.errors import DmframeError
from dmframe.diagram import Diagram, Parameter, Variable
from dmframe.diagram.closed_loop import stack
from dmframe.diagram.pieces import rows_of
from dmframe.diagram.view import view
from dmframe.simulate.block_starts import has_start
from dmframe.simulate.instants import Instants
from dmframe.simulate.start import start_state
from dmframe.simulate.stiffness import fastest

ROUNDED: Final = 1e-12
"""Step of a quantiser whose rounding is removed."""

AMPLITUDE: Final = 1.0
"""Largest command of a motion, in its own unit: kinetic terms then exceed the error of the means."""

SINUSOIDS: Final = 3
RATES: Final = (1.0, 6.0)
"""Number of sinusoids in a command, and the range of their rates [rad/s]."""

POSE: Final = 1.2
"""Largest initial angle or length of a motion, within the joint's limits."""

SPREAD: Final = 1.25
"""Largest factor between varied parameters and the graph's; those of the controller are not increased."""

SPAN: Final = 1.5
"""Longest step of the integrator times the plant's fastest rate at the start."""


DEEP: Final = 20
"""Depth to which two expressions are compared."""


class UnmovedError(DmframeError):
    """No motion of the plant can be computed by this method."""


class EstimatorRow(NamedTuple):
    """A row of an estimator's steps, h and y of all outputs; `stored` if it is the one that a delay line stores."""

    h: SX
    y: SX
    stored: bool


class Left(NamedTuple):
    """Unexplained part of rows at the samples of one motion, eta = left + slope @ unknown constants, and its terms.

    `left`, `y` and `predicted`, y and h' theta_true: (samples, outputs); `slope`: (samples, outputs, constants).
    """

    left: np.ndarray
    slope: np.ndarray
    y: np.ndarray
    predicted: np.ndarray


@final
@dataclass(frozen=True)
class Motion:
    """Parameters, initial values of states without a stated one, and amplitudes and rates of the commands."""

    p: Mapping[str, np.ndarray]
    pose: Mapping[str, np.ndarray]
    amplitudes: np.ndarray
    rates: np.ndarray

    def commands(self, t: np.ndarray) -> np.ndarray:
        """(commands, instants): sums of sinusoids, zero at t = 0."""
        return np.asarray(np.sum(self.amplitudes[:, :, None] * np.sin(self.rates[:, :, None] * t), axis=1))


def estimator_rows(claim: Claim, part: Part, item: Steps) -> tuple[EstimatorRow, ...]:
    """The distinct rows of steps; of a row that a delay line stores, the one that it stores."""
    stored = dict[int, tuple[int, SX, DelayLine]]()
    for line in part.certificate.delay_lines:
        symbol = claim.sample.symbols[f"{part.block}.{line.state}"]
        stored |= {x.element_hash(): (k, new, line) for x, k, new in _entries(line, symbol)}
    found = dict[tuple[int, ...], EstimatorRow]()
    for h, y in item.rows:
        h, y = (ca.vec(ca.densify(ca.SX(side))) for side in (h, y))
        row = ca.vertsplit(ca.vertcat(h, y))
        known = [stored.get(x.element_hash()) for x in row]
        lines = [one[2] for one in known if one is not None]
        together = all(_same_time(lines[0], line) for line in lines) and len({one and one[0] for one in known}) == 1
        of_line = len(lines) == len(row) and together
        if of_line:
            row = [one[1] for one in known if one is not None]
        column = ca.vertcat(*row)
        key = tuple(x.element_hash() for x in row)
        found.setdefault(key, EstimatorRow(column[: h.numel()], column[h.numel() :], of_line))
    return tuple(found.values())


def _entries(line: DelayLine, symbol: SX) -> Iterator[tuple[SX, int, SX]]:
    """Each element of a delay line's state, with the index of its entry and the element of the newest one."""
    rows, columns = line.newest.shape
    newest, down = ca.densify(ca.SX(line.newest)), columns == symbol.shape[1]
    for i in range(symbol.shape[0]):
        for j in range(symbol.shape[1]):
            k = i // rows if down else j // columns
            yield symbol[i, j], k, newest[i % rows, j % columns]


def _same_time(one: DelayLine, other: DelayLine) -> bool:
    """True if two delay lines store entries at the same samples."""
    return one is other or bool(ca.is_equal(ca.SX(one.when), ca.SX(other.when), DEEP))


@final
class Moved:
    """A block's rows along motions of the plant; raises `UnmovedError` if no motion can be computed.

    Attributes
    ----------
    estimator_rows
        The distinct rows.
    reads
        Positions in `ClosedLoop.p` of the parameters of rows and plant that no motion varies since they are zero.
    """

    def __init__(self, claim: Claim, part: Part, item: Steps) -> None:
        self._diagram, self._loop = claim.diagram, claim.loop
        loop, driven = self._loop, DrivenLoop(claim.diagram)
        if driven.feeds_through:
            raise UnmovedError("what is measured holds a command of the same instant")
        if not driven.commands.numel():
            raise UnmovedError("the plant takes no command")
        self.estimator_rows = estimator_rows(claim, part, item)
        rows = _rows(part, item, self.estimator_rows)
        flow, (held, _) = loop.flow, loop.held_over_a_sample
        after = driven.becomes([*rows, flow, held])
        self._needed = [variable for variable in loop.stepped if variable.label in after]
        self._x, self._z = (stack(v.symbol for v in states) for states in (self._needed, loop.flowing))
        self._commands = driven.commands.numel()
        seen = [self._x, self._z, driven.commands, loop.time, loop.period, loop.p]
        becomes = stack(after[variable.label] for variable in self._needed)
        self._sample = self._function("sample", seen, [becomes, held, *rows])
        self._flow = self._function("flow", [self._z, held, loop.time, loop.p], driven.measured([flow]))
        self._made = dict(_stated_starts(claim.diagram))
        self._posed = list(_posed(self._diagram, part, self._made))
        self._plant = {p.label for p in loop.parameters if ca.depends_on(flow, p.symbol)}
        read = symbols_in([becomes, *rows, flow])
        self._read = {p.label for p in loop.parameters if read & symbols_in([p.symbol]) and not self._rounds(p)}
        still = {x.element_hash() for p in loop.parameters if p.label in self._read for x in _zeros(p)} & read
        self.reads = tuple(k for k, x in enumerate(ca.vertsplit(loop.p)) if x.element_hash() in still)

    def _function(self, name: str, seen: Sequence[SX], made: Sequence[SX]) -> Any:
        # a piecewise constant source steps between two motions only
        still, drawn = self._loop.standing(0.0), self._loop.drawn
        made = [still.on_path(item) for item in made]
        if drawn.numel():
            made = ca.substitute(made, [drawn], [ca.SX.zeros(drawn.numel())])
        function = ca.Function(name, list(seen), list(made), {"allow_free": True})
        if function.has_free():
            raise UnmovedError(f"its rows, or what moves the plant, hold {function.get_free()[0]}")
        return function

    def motion(self, rng: np.random.Generator) -> Motion:
        """A random motion."""
        numbers = {p.label: self._number(p, rng) for p in self._loop.parameters}
        size = (self._commands, SINUSOIDS)
        amplitudes = AMPLITUDE / SINUSOIDS * rng.uniform(0.5, 1, size) * rng.choice([-1, 1], size)
        pose = {v.label: self._pose(v, rng) for v in self._posed}
        return Motion(numbers, pose, amplitudes, rng.uniform(*RATES, size))

    def _number(self, parameter: Parameter, rng: np.random.Generator) -> np.ndarray:
        """The graph's number times a random factor; the step of a quantiser is almost zero."""
        if self._rounds(parameter):
            return np.full_like(parameter.value, ROUNDED)
        most = 1.0 if parameter.label in self._plant else 0.0  # keeps poles of the controller inside the unit circle
        factor = float(SPREAD ** rng.uniform(-1.0, most))
        return factor * parameter.value if parameter.label in self._read else parameter.value

    def _rounds(self, parameter: Parameter) -> bool:
        """True for the step of a quantiser."""
        block, _, name = parameter.label.partition(".")
        model = self._diagram.models.get(block)
        return model is not None and any(port.rounded_by == name for port in model.block.outputs)

    def _pose(self, variable: Variable, rng: np.random.Generator) -> np.ndarray:
        lower, upper = np.full((2, variable.symbol.numel()), [[-POSE], [POSE]])
        if self._diagram.robot is not None and variable.symbol.numel() == self._diagram.robot.n:
            joints = self._diagram.robot.joints
            lower = np.maximum(lower, [joint.lower for joint in joints])
            upper = np.minimum(upper, [joint.upper for joint in joints])
        return np.asarray(rng.uniform(np.minimum(lower, upper), upper))

    def left(self, motion: Motion, T: float, duration: float) -> Left:
        """Unexplained part at the samples of one motion, from its start."""
        x, z, p = self._start(motion, T)
        count, substeps = round(duration / T), math.ceil(T / self._step(motion, x, z, p, T))
        t = T * np.arange(count)
        found = self._ticks(T, substeps)(np.concatenate([x, z]), motion.commands(t), t, p)
        if not all(np.all(np.isfinite(item)) for item in found):
            raise UnmovedError("a motion leaves all bounds")
        found[1] = found[1].reshape(count, -1 if found[1].size else 0, found[0].shape[1]).swapaxes(1, 2)
        return Left(*found)

    def _start(self, motion: Motion, T: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        loop = self._loop
        parameters = tuple(replace(p, value=motion.p[p.label]) for p in loop.parameters)
        diagram = replace(self._diagram, loop=replace(loop, parameters=parameters))
        wanted = {variable.label for variable in (*self._needed, *loop.flowing)}
        idle = {variable.label: 0.0 for variable in loop.variables if variable.label not in wanted}
        state = start_state(diagram, {**idle, **motion.pose}, self._made, Instants(T))
        at = {variable.label: state[rows] for variable, rows in rows_of(loop.variables)}
        x, z = (np.concatenate([np.zeros(0), *(at[v.label] for v in of)]) for of in (self._needed, loop.flowing))
        return x, z, diagram.loop.p_values

    def _step(self, motion: Motion, x: np.ndarray, z: np.ndarray, p: np.ndarray, T: float) -> float:
        """Step of the integrator, from the plant's Jacobian at the start by finite differences."""
        held = self._sample(x, z, motion.commands(np.zeros(1)), 0, T, p)[1]
        moved = z[:, None] + 1e-6 * np.eye(z.size)
        rates = self._flow(np.column_stack([moved, z]), held, 0, p).full() if z.size else np.zeros((0, 1))
        speed = float(fastest(((rates[:, :-1] - rates[:, -1:]) / 1e-6)[None])[0]) if z.size else 0.0
        if not math.isfinite(speed):
            raise UnmovedError("the plant's rates are too steep")
        return min(T, SPAN / max(speed, 1e-9))

    def _ticks(self, T: float, substeps: int) -> Callable[..., list[np.ndarray]]:
        """(x and z, commands, instants, p) -> unexplained part, its slope, y, h' theta_true: a row for each sample."""
        sizes = self._x.numel(), self._z.numel(), self._commands, 1, self._loop.p.numel()
        x, z, c, t, p = (ca.MX.sym(name, size) for name, size in zip("xzctp", sizes, strict=True))
        becomes, held, *rows = self._sample(x, z, c, t, T, p)
        h, end = T / substeps, z
        flow = self._runge_kutta(h)
        for k in range(substeps):
            end = flow(end, held, t + k * h, p)
        tick = ca.Function("tick", [x, z, c, t, p], [becomes, end, *(ca.vec(row) for row in rows)])
        both = ca.MX.sym("state", x.numel() + z.numel())
        parts = tick(both[: x.numel()], both[x.numel() :], c, t, p)
        one = ca.Function("one", [both, c, t, p], [ca.densify(part) for part in (ca.vertcat(*parts[:2]), *parts[2:])])
        return partial(_repeated, one)

    def _runge_kutta(self, h: float) -> Any:
        z, held, t, p = (ca.MX.sym(name, self._flow.numel_in(k)) for k, name in enumerate(("z", "held", "t", "p")))
        a = self._flow(z, held, t, p)
        b = self._flow(z + h / 2 * a, held, t + h / 2, p)
        c = self._flow(z + h / 2 * b, held, t + h / 2, p)
        d = self._flow(z + h * c, held, t + h, p)
        return ca.Function("step", [z, held, t, p], [z + h / 6 * (a + 2 * b + 2 * c + d)])


def _repeated(one: Any, state: np.ndarray, commands: np.ndarray, times: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Outputs of repeated steps without the next state, a row for each step; a `mapaccum` takes longer to build."""
    buffer, evaluate = one.buffer()
    now, command, time, given = state.copy(), np.zeros(len(commands)), np.zeros(1), np.array(p, dtype=float)
    then = [np.zeros(one.nnz_out(place)) for place in range(one.n_out())]
    for place, array in enumerate((now, command, time, given)):
        buffer.set_arg(place, array.data)
    for place, array in enumerate(then):
        buffer.set_res(place, array.data)
    found = [np.zeros((len(times), array.size)) for array in then[1:]]
    for k, t in enumerate(times):
        command[:], time[:] = commands[:, k], t
        evaluate()
        now[:] = then[0]
        for rows, array in zip(found, then[1:], strict=True):
            rows[k] = array
    return found


def _zeros(parameter: Parameter) -> Iterator[SX]:
    """Elements of a parameter that are zero, which no factor varies."""
    elements = ca.vertsplit(ca.vec(ca.densify(ca.SX(parameter.symbol))))
    for element, number in zip(elements, parameter.value.ravel(order="F"), strict=True):
        if not number:
            yield element


def _rows(part: Part, item: Steps, rows: Sequence[EstimatorRow]) -> list[SX]:
    """Unexplained part of all rows for zero unknown constants, its slope in them, y and h' theta_true."""
    true, unknown = ca.vec(ca.densify(ca.SX(item.true))), stack(part.certificate.unknown.values())
    predicted = ca.vertcat(*(summed(item.parts, row.h * true) for row in rows))
    y = ca.vertcat(*(row.y for row in rows))
    if unknown.numel() > len(item.parts):
        raise UnmovedError("there are more unknown constants than outputs, and they could explain any rows")
    slope = ca.jacobian(y - predicted, unknown)
    if ca.depends_on(ca.vec(slope), unknown):
        raise UnmovedError("what its rows leave is not affine in its unknown constants")
    (predicted,) = (
        ca.substitute([predicted], [unknown], [ca.SX.zeros(unknown.numel())]) if unknown.numel() else [predicted]
    )
    return [ca.densify(part) for part in (y - predicted, slope, y, predicted)]


def _stated_starts(diagram: Diagram) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Initial values stated by blocks, evaluated once: a run requires equal results."""
    for name in diagram.blocks:
        seen = view(diagram, name)
        with fault_context(name, "start()"):
            yield ("stated", name), dict(diagram.blocks[name].composed_start(seen.u, seen.p, seen.truth))


def _posed(diagram: Diagram, part: Part, made: dict[tuple[str, ...], Any]) -> Iterator[Variable]:
    """Positions of the plant without a stated initial value; they may start anywhere."""
    positions = symbols_in(ca.SX(item.position) for item in part.certificate.acted)
    for variable in diagram.loop.flowing:
        if not has_start(diagram, variable, made) and (
            variable.identities & positions or (diagram.robot is not None and variable.name == "q")
        ):
            yield variable
