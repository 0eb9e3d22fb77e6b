"""What a block shows of itself: ports and states, with shape, unit and access."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, final


@final
class Access(StrEnum):
    """Who may read an output.

    A closed robot hands out what it measures and takes what may be commanded; all else stays on its own side of the
    line between controller and plant.
    """

    INTERNAL = "internal"
    """A signal of the controller: other controller blocks may read it, the plant may not."""
    COMMANDED = "commanded"
    """A signal of the controller that the robot accepts: a joint velocity or position."""
    MEASURED = "measured"
    """A signal of the plant that its maker hands out."""
    HIDDEN = "hidden"
    """A signal of the plant that only the plant and the analysis may read."""


@final
class Side(StrEnum):
    """Which signals a block may read. In which time its states move, each `State` says."""

    SOURCE = "source"
    """A function of time alone: a desired trajectory."""
    CONTROLLER = "controller"
    """Reads what is measured, writes what is commanded."""
    PLANT = "plant"
    """Closed: the maker's servo and the robot, and what stands between them and the controller."""


@final
@dataclass(frozen=True, slots=True)
class Port:
    """An input or an output of a block.

    Parameters
    ----------
    name
        The signal's name in the equations.
    shape
        Letters that the diagram binds, or numbers: ``""`` a scalar, ``"n"`` a column, ``"n p"`` a matrix
        (n joints, m task coordinates, p dynamic parameters, k kinematic parameters).
    unit
        Factors separated by blanks, ``"N m s/rad"``; for a prismatic joint read m for rad and N for N m.
    access
        Of an output: who may read it. An output of a plant is hidden unless it says otherwise.
    derivative_of
        The port of the same block whose time derivative this one is. Nobody needs to drive such an input: the diagram
        derives it. Such an output is what the chain rule takes for the rate of the other output, or of the signal that
        drives the other input.
    optional
        An input that is zero when nobody drives it; an output that a block may leave out.
    full_rank
        Of a matrix that is an output: whoever reads it counts on its rows being independent. A run tells how close it
        came to losing that.
    drawn
        Of an input that nobody drives, the distribution from which each sample draws it anew: ``normal`` (mean 0,
        variance 1) or ``uniform`` (from -1 to 1), every element by itself. The run's seed decides the numbers.
    ahead_of, ahead
        The input of the same block that this one is, `ahead` whole samples later. Nobody needs to drive such an input:
        the other one has to be a source's signal, whose future is known. A block that reads it runs on a clock alone.
    instead_of
        Of an output of a plant, the input of the same block in whose place it stands: whoever would read what drives
        that input reads this output. A measured one stands there for controllers, any other for the plant. Of several
        blocks that stand in for one signal each reads the one before it, in the order of the file.
    rounded_by
        Of an output that replaces an input (`instead_of`): the parameter that holds the steps to which that input is
        rounded, step floor(input / step + 1/2), as by an encoder. `analyse` takes it as it is in the mean, the steps as
        fine, and says so; any other rounding is a switch.
    told
        Of an output that is zero as long as all is well, what a run says of it where it is not.
    steps
        Of an output of a source: it is constant but for the instants at which it steps. Its derivative is zero, and a
        proof is one of the time between two steps.
    shown
        Of an output of a controller, what it is, in words: a run then tells its mean over the last eighth, and how much
        of the estimate behind it the motion has felt.
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


@final
@dataclass(frozen=True, slots=True)
class State:
    """A quantity that a block integrates, or moves from sample to sample.

    A parameter of the same name, if the block has one, is the state's start; else it starts at zero or where the
    block's `start` says. On a clock, a continuous state of a controller is emulated: one explicit Euler step a sample,
    with the second term that `Equations.second` may say.

    Parameters
    ----------
    recorded
        It stands in a run's results unless the log names other signals. A long memory that nobody looks at need not.
    sampled
        It keeps its value between samples, and `Equations.next` says what it is at the next one. Without it the state
        moves in continuous time, as `Equations.rates` says.
    box
        Name of the parameter that holds the interval onto which the state is projected, where there is one.
    ball
        Name of the parameter that holds the ball onto which the state is projected, where there is one.
    gain
        Of a state with a ball, the name of the parameter that is its adaptation gain, in whose metric it is projected.
    bodies
        Of the estimates of a robot's links, ten inertial parameters each, in front of all others: name of the parameter
        that holds the share of its nominal pseudo-inertia below which no link's is let, where there is one.
    nominal
        The input that holds the nominal estimates, which may not move, of a state with bodies.
    optional
        The block may leave it out, by not stating its rate.
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
"""What the numbers of an input can be drawn from."""


class Element(NamedTuple):
    """One of what a letter of a shape counts, such as a dynamic parameter: its name in results, and its unit."""

    name: str
    unit: str = ""


@final
@dataclass(frozen=True, slots=True)
class Adapted:
    """An estimate: a state that an `dmframe.block.AdaptingBlock` adapts.

    It starts at the parameter of its name, if the block has one, else where `AdaptingBlock.nominal` says, or at zero.

    Parameters
    ----------
    name, shape, unit, optional
        As of a `State`.
    gain
        The parameter that is its adaptation gain. V weighs its error with the inverse.
    nominal
        The input at which it starts where no parameter says.
    box, ball
        Whether it may be projected onto an interval, and onto a ball: the parameters ``w_box`` and ``w_ball`` of w.
    memory
        The state that gathers what a fit with forgetting has seen.
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
        """The state, and its memory."""
        box, ball = f"{self.name}_box" * self.box, f"{self.name}_ball" * self.ball
        own = State(self.name, self.shape, self.unit, box, ball, self.gain, optional=self.optional)
        return (own, State(self.memory, f"{self.shape} {self.shape}", optional=True)) if self.memory else (own,)


ANY = "*"
"""The unit of an input that takes any unit: an error that drives an adaptation, say."""

TIME = Port("t", "", "s")
"""The input that every block may declare without anyone driving it: the time."""

PERIOD = Port("T", "", "s")
"""The same for the sampling period; a block that reads it runs on a clock alone."""
