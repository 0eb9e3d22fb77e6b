"""`Graph`, the object with which a program or a notebook uses dmframe."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from dmframe.block.model import SYMBOLIC
from dmframe.common.errors import DmframeError, ValueFault, raise_all
from dmframe.common.units import plain, seconds, to_unit
from dmframe.config import BaseGraph
from dmframe.config.given import listed
from dmframe.graph.doubts import doubts
from dmframe.graph.progress import progress_line, shown

if TYPE_CHECKING:
    from dmframe.bounds.given import Torque
    from dmframe.drawing import Drawing
    from dmframe.drive import Rehearsal, Replay
    from dmframe.export import TargetFunction
    from dmframe.graph.progress import Bar
    from dmframe.page import Page
    from dmframe.report.analysis import Analysis
    from dmframe.report.explanation import Explanation
    from dmframe.report.verification import Verification
    from dmframe.results.run import Run
    from dmframe.runtime import Controller
    from dmframe.simulate.engine import Choice
    from dmframe.virtual import VirtualRobot


@final
class Graph(BaseGraph):
    """A controller, its robot, and their run settings. It is immutable: `set` returns another graph.

    A notebook displays its block diagram, title and blocks. Its ``str`` is the output of ``dmframe check``. Its file,
    blocks, settings and diagram are those of `dmframe.config.BaseGraph`.
    """

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
        from dmframe.results.run import Run

        graph = self if until is None else self.until(until)
        with shown(progress, graph.name, graph.duration) as bar:
            recording = graph.simulate(self.diagram, engine=engine, progress=bar)
        run = Run(graph, recording)
        return run.noticed(*doubts(self, recording)) if judge else run

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

    def verify(
        self, *, seed: int = 0, over: float | str = "60 s", disturbance: Torque = 0.0, clock: bool = False
    ) -> Verification:
        """Prove its Lyapunov derivative exactly for all values of its gains and parameters, or give the reason why not.

        Parameters
        ----------
        seed
            Of the random points and primes.
        over
            Length of the run for bounds on the tracking error [s].
        disturbance
            Bound on a disturbance torque, one for all joints or one for each [N m].
        clock
            Whether to look for sampling intervals up to which the loop is proved on a clock.

        Raises
        ------
        DmframeError
            A time that is not above zero, a negative torque, or another number of torques than joints.
        """
        from dmframe.bounds.given import torques_of
        from dmframe.report.verification import Verification

        if isinstance(seed, bool) or not isinstance(seed, int):
            raise ValueFault(f"seed: expected a whole number, found {seed!r:.40}")
        until, robot = seconds("over", over), self.diagram.robot
        torques = torques_of(disturbance, 1 if robot is None else robot.n)
        with progress_line(self.name) as tell:
            tell("proving")
            verdict = self.verdict(seed=seed, copies=True, over=until, disturbance=torques)
            if not clock:
                return Verification(self, verdict, seed)
            from dmframe.analysis.held_proof import clock_proof_of

            return Verification(self, verdict, seed, sampling=clock_proof_of(self, verdict, seed, tell))

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
        from dmframe.report.analysis import Analysis

        until = seconds("horizon", horizon)
        with progress_line(self.name) as tell, SYMBOLIC, self.placing():
            found = analyse(
                self.diagram,
                self.clock,
                solver=self.solver.automatic,
                start=self.start,
                horizon=until,
                uncertain=self.intervals(),
                tell=tell,
            )
        return Analysis(self, found)

    def controller(self, *, engine: Choice = "auto") -> Controller:
        """The controller without the plant, one sample at a time, for a real-time loop.

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
        return Controller(self.diagram, self.clock, start=self.start, engine=engine)

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
            Limits of the drive: a file; by default the limits of the robot's model.
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
        from dmframe.drive import load_limits, run_on_robot
        from dmframe.results.run import Run

        recording = run_on_robot(
            self,
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
        return Run(self, recording)

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
            Mass at the tool that is unknown to the controller [kg]; by default a twentieth of the moving mass.
        limits, ramp, patience
            As of `drive`, which requires the same.
        """
        from dmframe.drive import load_limits, rehearsed

        with progress_line(self.name) as tell:
            return rehearsed(
                self,
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
        from dmframe.common.files import expanded
        from dmframe.drive import replayed

        return replayed(self, expanded(log), engine=engine)

    def explain(self) -> Explanation:
        """Explain the law, signals and certificate of each block; the graph is proved for it."""
        from dmframe.report.explanation import Explanation

        return Explanation(self, self.verify().verdict)

    def draw(self) -> Drawing:
        """Its block diagram; a notebook displays it, and `Drawing.save` writes SVG, PNG, PDF or Mermaid."""
        from dmframe.drawing import Drawing

        return Drawing(self.diagram, self.title)

    def page(self, *, periods: bool = True, ghost: Graph | None = None) -> Page:
        """Its live page: the closed loop runs in a browser, with sliders for parameters, next to the verdict.

        A notebook displays it; `Page.save` writes one self-contained file. The graph is proved for it.

        Parameters
        ----------
        periods
            Compute the sampling periods up to which the loop is stable near its set-point: seconds for a UR10.
        ghost
            Another graph of the robot, simulated next to it; by default the rivals of its key ``page``.

        Raises
        ------
        DmframeError
            A loop cannot run in a browser, for example because it draws random numbers.
        """
        from dmframe.page import ghosts_of, page_of

        rivals, verdict = ghosts_of(self, ghost), self.verify().verdict
        with progress_line(self.name) as tell:
            return page_of(self, verdict, rivals, periods=periods, tell=tell)

    def export(self, folder: str | Path, kind: str | TargetFunction = "c") -> list[Path]:
        """Export its controller for other programs to a new folder; returns the files.

        Parameters
        ----------
        kind
            ``c``: C99, with an example and a test. ``fmi2``, ``fmi3``: two units of that version of FMI for
            co-simulation, the controller and the robot with its servo. ``ros2``: a package with a controller of
            ros2_control. Or a function of the graph that returns the files by their names.

        Raises
        ------
        DmframeError
            It runs in continuous time, has no command, or draws random numbers; or the folder exists already.
        """
        from dmframe.export.folder import export

        return export(self, folder, kind)

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

        return VirtualRobot(self, **behaviour)

    def __repr__(self) -> str:
        clock = "in continuous time" if self.clock is None else f"every {plain(self.clock, 's')}"
        return f"<Graph {self.name}: {len(self.blocks)} blocks, {clock}, for {plain(self.duration, 's')}>"

    def __str__(self) -> str:
        from dmframe.graph.pages import check_page

        return check_page(self)

    def _repr_html_(self) -> str:
        from dmframe.graph.in_notebook import graph_html

        return graph_html(self)
