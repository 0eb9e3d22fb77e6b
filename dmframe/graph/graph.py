"""`Graph`, the object with which a program or a notebook uses dmframe."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final

from dmframe import notebook
from dmframe.block import AbstractBlock, type_name
from dmframe.block.model import SYMBOLIC
from dmframe.config import Experiment
from dmframe.diagram import Diagram
from dmframe.errors import DmframeError, ValueFault, raise_all
from dmframe.graph.arguments import listed, seconds
from dmframe.graph.named import Named
from dmframe.graph.progress import Bar, progress_line, shown
from dmframe.results.run import Run
from dmframe.units import plain, to_unit

if TYPE_CHECKING:
    from dmframe.drawing import Drawing
    from dmframe.drive import Rehearsal, Replay
    from dmframe.page import Page
    from dmframe.report import Analysis, Explanation, Verification
    from dmframe.runtime import Controller
    from dmframe.simulate import Recording
    from dmframe.simulate.engine import Choice
    from dmframe.virtual import VirtualRobot

LONG = 10.0
"""From this duration [s] on a run also checks the stability near the set-point, which takes a fraction of a second."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Graph:
    """A controller, its robot, and their run settings. It is immutable: `set` returns another graph.

    A notebook displays its block diagram, title and blocks. Its ``str`` is the output of ``dmframe check``.

    Parameters
    ----------
    experiment
        The graph file that has been read and checked.
    """

    experiment: Experiment

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return self.experiment.name

    @property
    def title(self) -> str:
        """The graph's title, one line."""
        return self.experiment.file.title

    @property
    def clock(self) -> float | None:
        """Sampling period of the controller [s]; None in continuous time."""
        return self.experiment.file.clock

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return self.experiment.file.duration

    @property
    def blocks(self) -> Named[AbstractBlock]:
        """The blocks by name; their parameters are attributes, ``g.blocks["dynamics"].Gamma``."""
        held = self.experiment.blocks
        facts = {name: {"type": type_name(type(block)), "side": block.side.value} for name, block in held.items()}
        return Named("block", facts, held.__getitem__)

    @property
    def robot(self) -> Any:
        """The robot's chain of joints, a `dmframe.robot.SerialChain`; None without a robot."""
        return self.experiment.robot

    @cached_property
    def diagram(self) -> Diagram:
        """Blocks wired and flattened into one closed loop. Raises `DmframeError` with every fault of the wiring."""
        return self.experiment.diagram()

    @cached_property
    def text(self) -> str:
        """The complete graph as YAML, with all defaults: loading it gives the same run."""
        from dmframe.results.resolved import resolved_text

        return resolved_text(self.experiment)

    def set(self, values: Mapping[str, Any] | None = None, /, **keys: Any) -> Graph:
        """Another graph with some values changed, ``g.set({"dynamics.Gamma": 50, "clock": "2 ms"})``.

        Parameters
        ----------
        values
            By ``block.parameter`` or a key of the graph file; numbers in the port's own units, texts with a unit, lists
            and arrays.
        keys
            Keys of the graph file, ``g.set(clock="2 ms", duration=20)``.

        Raises
        ------
        DmframeError
            All faults of the new values at once. Faults of sizes and wires are raised when the graph is used.
        """
        if not isinstance(values, Mapping | None):
            raise ValueFault(f"set: expected values by name, {{'dynamics.Gamma': 3}}, found {values!r:.40}")
        return Graph(self.experiment.changed({**(values or {}), **keys}))

    def variants(self, values: Mapping[str, Iterable[Any]]) -> list[Graph]:
        """The graph with each combination of some values, ``g.variants({"dynamics.Gamma": [1, 10, 100]})``.

        `compare` keeps complete runs; `sweep` keeps figures of thousands of runs. Raises the errors of `set`, for all
        values at once.
        """
        made, faults = list[Graph](), list[DmframeError]()
        tried = listed(values)
        for combination in itertools.product(*tried.values()):
            try:
                made.append(self.set(dict(zip(tried, combination, strict=True))))
            except DmframeError as error:
                faults += error.faults
        raise_all(faults)
        return made

    def until(self, duration: float | str) -> Graph:
        """The same graph with another duration, ``20`` or ``"20 s"``."""
        return Graph(self.experiment.with_duration(seconds("until", duration)))

    def reality(self, like: str | Mapping[str, Any] = "ur") -> Graph:
        """The graph with channel models between controller and robot, as with its key ``reality``.

        Parameters
        ----------
        like
            A packaged set, or block types with their parameters, ``{"like": "ur", "transport_delay": {"samples": 2}}``.

        Raises
        ------
        DmframeError
            An unknown set or block type, or invalid parameters.
        """
        return self.set(reality=like)

    def baseline(self) -> Graph:
        """The graph with the blocks of its key ``baseline``. Raises `MissingError` if it has no such key."""
        return Graph(self.experiment.baseline())

    def run(
        self,
        until: float | str | None = None,
        *,
        engine: Choice = "auto",
        progress: bool | Bar | None = None,
        judge: bool = True,
    ) -> Run:
        """Simulate it on its own clock, with its own solver, start and log.

        Parameters
        ----------
        until
            Simulated time, ``20``, ``"20 s"``, ``"2 min"``; by default the graph's duration.
        engine
            ``compiled``, ``interpreted``, or ``auto``: compiled if the run is long enough to save time.
        progress
            Show a progress bar, or update an existing one; by default if a terminal or a notebook displays it.
        judge
            Report if the path leaves the tool's reach, and if the loop is unstable near its set-point on its clock.

        Raises
        ------
        DmframeError
            An unreachable start pose, an integrator that fails at once, or a run too long to store. A run that
            diverges is not a fault: `Run.divergence` gives the place.
        """
        graph = self if until is None else self.until(until)
        with shown(progress, graph.name, graph.duration) as bar:
            recording = graph.experiment.simulate(self.diagram, engine=engine, progress=bar)
        return Run(graph.experiment, self.warned(recording) if judge else recording)

    def warned(self, recording: Recording) -> Recording:
        """A run of this graph with the notices of `doubts`."""
        said = self.doubts(recording)
        return replace(recording, notices=(*recording.notices, *said)) if said else recording

    def doubts(self, recording: Recording) -> tuple[str, ...]:
        """Notices that cannot be derived from a run: an unreachable path, and an unstable sampled loop.

        They report a path that leaves the tool's reach during the run, and a sampled loop that is unstable near its
        set-point. For a UR10 this takes half a second.
        """
        from dmframe.certify.reach import out_of_reach

        with SYMBOLIC:
            left = tuple(
                f"{text}: no controller can follow it there" for text in out_of_reach(self.diagram, recording.duration)
            )
        if self.clock is None or recording.divergence is not None or recording.duration < LONG:
            return left
        from dmframe.analysis.period import TOLERANCE, sampled_radius

        radius = sampled_radius(recording.diagram, self.clock, self.experiment.start)
        if radius is None or radius <= 1 + TOLERANCE:
            return left
        said = (
            f"with its estimates at their true values this loop is unstable near its set-point on a clock of "
            f"{plain(self.clock, 's')}, spectral radius {radius:.4g}: a longer run may diverge; `analyse` gives details"
        )
        return (*left, said)

    def check_laws(self) -> tuple[str, ...]:
        """Compare the printed laws and the docstrings of its blocks with their code, as `dmframe check` does.

        Returns the equations of docstrings that cannot be read, each with file and line.

        Raises
        ------
        DmframeError
            A printed law or a docstring differs from the code.
        """
        from dmframe.certify.laws import check_laws

        with SYMBOLIC:
            return check_laws(self.diagram)

    def verify(self, *, seed: int = 0) -> Verification:
        """Prove its Lyapunov derivative exactly for all values of its gains and parameters, or give the reason why not.

        Parameters
        ----------
        seed
            Of the random points and primes.
        """
        from dmframe.report import Verification

        if isinstance(seed, bool) or not isinstance(seed, int):
            raise ValueFault(f"seed: expected a whole number, found {seed!r:.40}")
        with progress_line(self.name) as tell:
            tell("proving")
            verdict = self.experiment.verify(self.diagram, seed=seed)
        return Verification(self.experiment, self.diagram, verdict, seed)

    def analyse(self, horizon: float | str = 20.0) -> Analysis:
        """Linearise it at its set-point: margins and passivity of the servo, poles, the largest stable period.

        Parameters
        ----------
        horizon
            Length of the simulations that look for the largest sampling period [s].

        Raises
        ------
        DmframeError
            No equilibrium, or no goal to follow.
        """
        from dmframe.analysis import analyse
        from dmframe.config.places import placed
        from dmframe.report import Analysis

        experiment, diagram, until = self.experiment, self.diagram, seconds("horizon", horizon)
        try:
            with progress_line(self.name) as tell, SYMBOLIC:
                found = analyse(
                    diagram,
                    self.clock,
                    solver=experiment.solver,
                    start=experiment.start,
                    horizon=until,
                    uncertain=experiment.intervals(diagram),
                    tell=tell,
                )
        except DmframeError as error:
            raise placed(error, experiment.document) from None
        return Analysis(experiment, found)

    def controller(self, *, engine: Choice = "auto") -> Controller:
        """Its controller alone, one sample at a time, for a loop in real time.

        Parameters
        ----------
        engine
            ``auto`` compiles where there is a compiler.

        Raises
        ------
        DmframeError
            It runs in continuous time, or has no command.
        """
        from dmframe.runtime import Controller

        if self.clock is None:
            raise ValueFault(
                f"{self.name}: expected a clock such as 8 ms, found continuous; set one: set(clock='8 ms')"
            )
        return Controller(self.diagram, self.clock, start=self.experiment.start, engine=engine)

    def drive(
        self,
        robot: str = "sim",
        *,
        until: float | str | None = None,
        limits: str | Path | None = None,
        ramp: float | str | None = None,
        patience: float | str | None = None,
        payload: float | str | None = None,
        shadow: bool = False,
        rehearsed: bool = True,
        engine: Choice = "auto",
        asked: Callable[[], str] = lambda: "",
        record: Path | None = None,
    ) -> Run:
        """Drive a robot with its controller.

        Parameters
        ----------
        robot
            ``sim``, the graph's own robot; ``sim:2``, the same with a delay of two samples; ``ur:HOST``, or
            ``ur_rtde:HOST``.
        until
            Time of the reference; by default the graph's duration.
        limits
            A file; by default the limits of the robot's model.
        ramp
            Duration over which the first motion reaches its speed; none for a simulated robot.
        patience
            Longest wait for a sample of a real robot; five periods by default.
        shadow
            Compute the commands without sending them.
        payload
            Mass at the tool that the rehearsal must have covered; by default that of `rehearse`.
        rehearsed
            Require a passed rehearsal of exactly this drive before a real robot moves.
        asked
            Called at each sample; returns the reason for a stop, or an empty text.
        record
            A file to which each sample is written during the drive; the signals of a long drive are then subsampled.

        Raises
        ------
        DmframeError
            The graph drives no robot, the file has faults, or the graph may not drive a real robot.
        """
        from dmframe.drive import driven, load_limits

        recording = driven(
            self.experiment,
            self.diagram,
            robot,
            until=None if until is None else seconds("until", until),
            limits=None if limits is None else load_limits(limits, self.robot),
            ramp=None if ramp is None else to_unit(ramp, "s"),
            patience=None if patience is None else seconds("patience", patience),
            payload=None if payload is None else to_unit(payload, "kg"),
            shadow=shadow,
            rehearsed=rehearsed,
            engine=engine,
            stop_requested=asked,
            record=record,
        )
        return Run(self.experiment, recording)

    def rehearse(
        self,
        until: float | str | None = None,
        *,
        payload: float | str | None = None,
        limits: str | Path | None = None,
        ramp: float | str | None = None,
        patience: float | str | None = None,
        engine: Choice = "auto",
    ) -> Rehearsal:
        """Simulate it with the non-idealities of a real robot: delay, jitter, lost samples, a load, a speed slider.

        Parameters
        ----------
        until
            Time of each run.
        payload
            Mass at the tool that the controller does not know [kg]; by default a twentieth of the moving mass.
        limits, ramp, patience
            As of `drive`, which requires the same.
        """
        from dmframe.drive import load_limits, rehearsed

        with progress_line(self.name) as tell:
            return rehearsed(
                self.experiment,
                self.diagram,
                seconds=None if until is None else seconds("until", until),
                payload=None if payload is None else to_unit(payload, "kg"),
                limits=None if limits is None else load_limits(limits, self.robot),
                ramp=None if ramp is None else to_unit(ramp, "s"),
                patience=None if patience is None else seconds("patience", patience),
                engine=engine,
                report=tell,
            )

    def replay(self, log: str | Path, *, engine: Choice = "auto") -> Replay:
        """Compute its commands from recorded measurements and compare them with the recorded commands.

        Parameters
        ----------
        log
            The folder of the results.
        """
        from dmframe.drive import replayed
        from dmframe.files import expanded

        return replayed(self.experiment, self.diagram, expanded(log), engine=engine)

    def explain(self) -> Explanation:
        """Explain the law, signals and certificate of each block; the graph is proved for it."""
        from dmframe.report import Explanation

        return Explanation(self.experiment, self.diagram, self.verify().verdict)

    def draw(self) -> Drawing:
        """Its block diagram; a notebook displays it, and `Drawing.save` writes SVG, PNG, PDF or Mermaid."""
        from dmframe.drawing import Drawing

        return Drawing(self.diagram, self.title)

    def page(self, *, periods: bool = True) -> Page:
        """Its live page: the closed loop runs in a browser, with sliders for parameters, next to the verdict.

        A notebook displays it; `Page.save` writes one self-contained file. The graph is proved for it.

        Parameters
        ----------
        periods
            Compute the sampling periods up to which the loop is stable near its set-point, which takes two to five
            seconds for a UR10. For longer periods the page does not apply a continuous-time proof to its clock.

        Raises
        ------
        DmframeError
            The loop cannot run in a browser, for example because it draws random numbers.
        """
        from dmframe.page import Page
        from dmframe.page.periods import stable_periods

        verdict, found = self.verify().verdict, None
        if periods:
            with progress_line(self.name) as tell, SYMBOLIC:
                found = stable_periods(self.diagram, self.clock, verdict, self.experiment.start, tell)
        page = Page(self.experiment, self.diagram, verdict, found)
        _ = page.html
        return page

    def export(self, folder: str | Path, kind: Literal["c", "fmi2", "fmi3", "ros2"] = "c") -> list[Path]:
        """Export its controller for other programs to a new folder; returns the files.

        Parameters
        ----------
        kind
            ``c``: C99, with an example and a test. ``fmi2``, ``fmi3``: two units of that version of FMI for
            co-simulation, the controller and the robot with its servo. ``ros2``: a package with a controller of
            ros2_control.

        Raises
        ------
        DmframeError
            It runs in continuous time, has no command, or draws random numbers; or the folder exists already.
        """
        from dmframe.export import export_c, export_fmus, export_ros2

        if kind in ("c", "ros2"):
            return (export_c if kind == "c" else export_ros2)(self.experiment, self.diagram, folder)
        if kind not in ("fmi2", "fmi3"):
            raise ValueFault(f"kind: expected c, fmi2, fmi3 or ros2, found {kind!r}")
        return export_fmus(self.experiment, self.diagram, folder, 2 if kind == "fmi2" else 3)

    def virtual_robot(self, **behaviour: Any) -> VirtualRobot:
        """Its arm and servo behind an emulated UR controller, to which clients of a UR can connect.

        Parameters
        ----------
        behaviour
            ``series``, ``slider``, ``command_delay``, ``measurement_delay``, ``lost``, ``seed``, ``engine``; see
            `dmframe.virtual.VirtualRobot`.

        Raises
        ------
        DmframeError
            The robot is not a UR, its command is not a joint velocity, or it cannot be simulated alone.
        """
        from dmframe.virtual import VirtualRobot

        return VirtualRobot(self.experiment, self.diagram, **behaviour)

    def save(self, path: str | Path) -> Path:
        """Write `text` to a new file. Raises `OutputError` if the file exists already or cannot be written."""
        from dmframe.files import expanded, write_text

        _ = self.diagram  # faults of sizes and wires, too
        path = expanded(path)
        write_text(path, self.text, new=True)
        return path

    def __reduce__(self) -> Any:
        """Pickled without its diagram, which is built again."""
        return Graph, (self.experiment,)

    def __eq__(self, other: object) -> bool:
        """Graphs are equal if their texts are; the same text gives the same run."""
        return isinstance(other, Graph) and (self.name, self.text) == (other.name, other.text)

    def __hash__(self) -> int:
        return hash((self.name, self.text))

    def __repr__(self) -> str:
        clock = "in continuous time" if self.clock is None else f"every {plain(self.clock, 's')}"
        return f"<Graph {self.name}: {len(self.blocks)} blocks, {clock}, for {plain(self.duration, 's')}>"

    def __str__(self) -> str:
        from dmframe.graph.pages import check_page

        return check_page(self.experiment, self.diagram)

    def _repr_html_(self) -> str:
        from dmframe.drawing import svg

        clock = "continuous time" if self.clock is None else f"sampled every {plain(self.clock, 's')}"
        return (
            notebook.heading(self.name, self.title)
            + notebook.fitted(svg(self.diagram), f"dm-{self.diagram.fingerprint[:8]}")
            + notebook.paragraphs([f"{clock}, for {plain(self.duration, 's')}"])
            + self.blocks._repr_html_()
        )
