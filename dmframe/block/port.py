"""Declarations of a block: inputs, outputs and states, with shape, unit and access."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import final

from dmframe.common.names import Element as Element


@final
class Access(StrEnum):
    """Which blocks may read an output.

    A closed robot outputs its measurements and accepts commands; all other signals are visible only on their side of
    the boundary between controller and plant.
    """

    INTERNAL = "internal"
    """A signal of the controller: other controller blocks may read it, the plant may not."""
    COMMANDED = "commanded"
    """A signal of the controller that the robot accepts: a joint velocity or position."""
    MEASURED = "measured"
    """A signal of the plant that the robot outputs."""
    HIDDEN = "hidden"
    """A signal of the plant that only the plant and the analysis may read."""


@final
class Side(StrEnum):
    """Which signals a block may read. Each `State` declares whether it is continuous or sampled."""

    SOURCE = "source"
    """A function of time alone: a desired trajectory."""
    CONTROLLER = "controller"
    """Reads measured signals and outputs commands."""
    PLANT = "plant"
    """Closed: the manufacturer's servo, the robot, and the channels between them and the controller."""


@dataclass(frozen=True, slots=True)
class Signal:
    """Common fields of inputs and outputs.

    Parameters
    ----------
    name
        The signal's name in the equations.
    shape
        Letters that the diagram binds, or numbers: ``""`` a scalar, ``"n"`` a column, ``"n p"`` a matrix
        (n joints, m task coordinates, p dynamic parameters, k kinematic parameters).
    unit
        Factors separated by blanks, ``"N m s/rad"``; for a prismatic joint read m for rad and N for N m.
    derivative_of
        The port of the same block whose time derivative this one is. Such an input needs no wire: the diagram derives
        it. The chain rule uses such an output as the rate of the other output, or of the signal that drives the other
        input.
    optional
        Of an input: it is zero without a wire. Of an output: the block may omit it.
    """

    name: str
    shape: str = ""
    unit: str = ""
    derivative_of: str = field(default="", kw_only=True)
    optional: bool = field(default=False, kw_only=True)


@final
@dataclass(frozen=True, slots=True)
class Input(Signal):
    """An input of a block, or a true parameter in `AbstractBlock.truth`.

    Parameters
    ----------
    drawn
        Of an input without a wire, the distribution from which each sample draws every element: ``normal`` (mean 0,
        variance 1) or ``uniform`` (from -1 to 1). The run's seed determines the numbers.
    ahead_of, ahead
        The input of the same block that this one is, `ahead` whole samples later. It needs no wire: the other one has
        to be a source's signal, whose future is known. A block with such an input is discrete-time.
    """

    drawn: str = ""
    ahead_of: str = ""
    ahead: int = 1


@final
@dataclass(frozen=True, slots=True)
class Output(Signal):
    """An output of a block.

    Parameters
    ----------
    access
        Which blocks may read it. An output of a plant is hidden by default.
    full_rank
        Of a matrix: blocks that read it assume independent rows. A run reports how close it came to losing rank.
    instead_of
        Of an output of a plant, the input of the same block that it replaces: readers of the signal that drives that
        input read this output. A measured output replaces it for controllers, any other for the plant. Several blocks
        that replace one signal form a chain in the order of the file.
    rounded_by
        Of an output with `instead_of`: the parameter with the steps to which that input is rounded,
        step floor(input / step + 1/2), as by an encoder. `analyse` uses the mean of the rounding and reports it; it
        treats any other rounding as a switch.
    notice
        Of an output that is zero in normal operation, the notice printed for a run in which it is not zero.
    steps
        Of an output of a source: it is piecewise constant. Its derivative is zero, and a proof holds between two
        steps.
    shown
        Of an output of a controller, its name in words: a run then reports its mean over the last eighth, and how well
        the estimate from which it is computed was excited.
    """

    access: Access = Access.INTERNAL
    full_rank: bool = False
    instead_of: str = ""
    rounded_by: str = ""
    notice: str = ""
    steps: bool = False
    shown: str = ""


@final
@dataclass(frozen=True, slots=True)
class Port:
    """The former class of inputs and outputs, with the fields of both; a block's class converts it.

    Write `Input` or `Output` instead: they have only the fields that apply.
    """

    name: str
    shape: str = ""
    unit: str = ""
    access: Access = Access.INTERNAL
    derivative_of: str = ""
    optional: bool = False
    full_rank: bool = False
    drawn: str = ""
    ahead_of: str = ""
    ahead: int = 1
    instead_of: str = ""
    rounded_by: str = ""
    told: str = ""
    steps: bool = False
    shown: str = ""

    def as_kind(self, kind: type[Input] | type[Output]) -> Input | Output:
        """The same input or output.

        Raises
        ------
        TypeError
            A field is set that this kind does not have.
        """
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        given["notice"] = given.pop("told")
        plain = {item.name: item.default for item in fields(self)} | {"notice": ""}
        known = {item.name for item in fields(kind)}
        if wrong := [name for name, value in given.items() if name not in known and value != plain[name]]:
            article = "an input" if kind is Input else "an output"
            raise TypeError(f"{self.name}: {article} has no field {', '.join(wrong)}")
        return kind(**{name: value for name, value in given.items() if name in known})


@final
@dataclass(frozen=True, slots=True)
class State:
    """A continuous or sampled state of a block.

    Its initial value is the parameter of the same name, if the block has one; otherwise the value from the block's
    `start`, or zero. On a clock, a continuous state of a controller is emulated: one explicit Euler step per sample,
    with the second-order term of `Equations.second`, if there is one.

    Parameters
    ----------
    recorded
        A run records it unless the log names other signals; false for large states such as delay lines.
    sampled
        It is constant between samples, and `Equations.next` gives its value at the next sample. Otherwise the state is
        continuous, and `Equations.rates` gives its derivative.
    box
        Name of the parameter with the interval onto which the state is projected, if there is one.
    ball
        Name of the parameter with the ball onto which the state is projected, if there is one.
    gain
        Of a state with a ball, the name of the parameter that is its adaptation gain; the projection uses the metric
        of its inverse.
    bodies
        Of a state that starts with the inertial parameters of the robot's links, ten per link: name of the parameter
        with the fraction of the nominal pseudo-inertia that is the lower bound of each link's pseudo-inertia, if there
        is one.
    nominal
        Of a state with `bodies`, the input with the nominal estimates, which must be constant.
    optional
        The block may omit it, by not stating its rate.
    """

    name: str
    shape: str = ""
    unit: str = ""
    box: str = ""
    ball: str = ""
    gain: str = ""
    bodies: str = ""
    nominal: str = ""
    optional: bool = False
    sampled: bool = False
    recorded: bool = True


DISTRIBUTIONS = ("normal", "uniform")
"""Distributions of a random input."""


@final
@dataclass(frozen=True, slots=True)
class Adapted:
    """An estimate: a state that an `dmframe.block.AdaptingBlock` adapts.

    Its initial value is the parameter of its name, if the block has one; otherwise that of `AdaptingBlock.nominal`,
    or zero.

    Parameters
    ----------
    name, shape, unit, optional
        As of a `State`.
    gain
        The parameter that is its adaptation gain. Its inverse is the weight of the estimation error in V.
    nominal
        The input with its initial value, if no parameter sets it.
    box, ball
        Whether it may be projected onto an interval, and onto a ball: the parameters ``w_box`` and ``w_ball`` of w.
    memory
        The state that is the information matrix of a fit with forgetting.
    """

    name: str
    shape: str = ""
    unit: str = ""
    gain: str = ""
    nominal: str = ""
    box: bool = True
    ball: bool = False
    memory: str = ""
    optional: bool = False

    @property
    def states(self) -> tuple[State, ...]:
        """The state, and its information matrix if it has one."""
        box, ball = f"{self.name}_box" * self.box, f"{self.name}_ball" * self.ball
        own = State(self.name, self.shape, self.unit, box, ball, self.gain, optional=self.optional)
        return (own, State(self.memory, f"{self.shape} {self.shape}", optional=True)) if self.memory else (own,)


ANY = "*"
"""The unit of an input that accepts any unit, such as an error that drives an adaptation."""

TIME = Input("t", "", "s")
"""The time, an input that every block may declare; it needs no wire."""

PERIOD = Input("T", "", "s")
"""The sampling period, an input without a wire; a block that reads it runs only on a clock."""
