"""Region of kinematic parameters in which a Jacobian keeps full row rank along a path."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray

from dmframe.analysis.joint_path import REACHED, JointPath, joint_path
from dmframe.analysis.path_tube import path_tube
from dmframe.analysis.rank_bound import Shape
from dmframe.analysis.rank_problem import Centre, RankProblem, rank_problem
from dmframe.analysis.rank_search import LARGEST, Cover, RankSearch
from dmframe.common.errors import ValueFault
from dmframe.diagram import Diagram

Array = NDArray[np.float64]
Progress = Callable[[str], None]

MOST_BOXES: Final = 40_000
LEAST_FRACTION: Final = 0.1
"""Default required singular value, as a fraction of the least one along the path."""

LOST: Final = 1e-9
"""A singular value below this is rank loss [m/rad]."""

_LEAST_WEIGHT: Final = 0.1
"""Least relative half-width of a parameter with a short translation, with ``length`` scaling."""

_MOST_STRIDE: Final = 0.05
_LEAST_STRIDE: Final = 0.005
"""Range of the largest joint step between two poses of the path [rad]."""


@final
@dataclass(frozen=True)
class RankLoss:
    """Reason for the absence of a region, even with the parameters at the centre.

    Parameters
    ----------
    kind
        unreachable: the tool cannot follow its path; singular: the tube contains a pose at which the matrix violates
        the required bound; undecided: neither proved nor refuted.
    time
        Of the path [s].
    q
        (n,) the pose.
    singular
        The least singular value at that pose.
    text
        The reason as a sentence.
    """

    kind: Literal["unreachable", "singular", "undecided"]
    time: float
    q: Array
    singular: float
    text: str


@final
@dataclass(frozen=True)
class RankRegion:
    r"""Set of kinematic parameters for which :math:`J J^\top \ge c^2 I` is proved along a joint path.

    For every q within `tube` of the joint path, in each joint, and every :math:`a_k` in the set, every singular value
    of J is at least `certified` > 0. The proof uses interval arithmetic with outward rounding and covers all real q and
    :math:`a_k` there. It assumes that the robot stays in the tube and the estimate in its set (ensured by a
    projection). The joint path is exact: inverse kinematics gives poses in floating point, and for every time up to
    `until` a pose with the tool on its path is proved to lie within `line_distance` of the lines between them, in each
    joint. For a path that was given, the lines are the path.

    Parameters
    ----------
    matrix
        ``block.port`` of J.
    parameters
        ``block.state`` of the estimate, or ``robot.a_k`` for known kinematics: the region then bounds the model error.
    names, centre, half
        (h,) each: names of the parameters, centre of the set, and its half-widths or half-axes [m].
    shape
        box, or ball (with unequal `half`, an ellipsoid).
    radius
        The largest of `half` [m].
    option
        ``block.parameter`` of the graph for the set; None for known kinematics.
    start_inside
        False if the initial estimate is outside the set; None for known kinematics.
    tube
        Largest deviation of each joint from the path [rad].
    asked, certified
        Required c, and certified least singular value. [unit]
    nominal
        Least singular value at the path's poses and the set's centre, in floating point. [unit]
    unit
        Unit of the singular values.
    time, q
        Time of the least certified value [s], and the centre pose of that box.
    fails_at
        Radius of a set with known parameters that violate `asked`, in floating point; None if none was found. The
        largest region has a radius between `radius` and this [m].
    path
        The joint path.
    boxes
        Number of boxes of poses in the proof.
    model
        Fingerprint of the diagram.
    redundant
        True for a redundant robot: this joint path, with minimum-norm steps, is one of many.
    loss
        Reason for the absence of a region; `radius` and `certified` are then 0.
    """

    matrix: str
    parameters: str
    names: tuple[str, ...]
    centre: Array
    half: Array
    shape: Shape
    option: str | None
    start_inside: bool | None
    tube: float
    asked: float
    certified: float
    nominal: float
    unit: str
    time: float
    q: Array
    fails_at: float | None
    path: JointPath
    boxes: int
    model: str = ""
    redundant: bool = False
    loss: RankLoss | None = None

    @property
    def holds(self) -> bool:
        """True if there is a region."""
        return self.loss is None

    @property
    def until(self) -> float:
        """Time up to which the exact joint path is enclosed [s]."""
        return self.path.until

    @property
    def line_distance(self) -> float | None:
        """Bound on the distance of the exact joint path from the lines [rad]; None for a given path."""
        return (
            None
            if self.path.line_distance is None or not self.holds
            else float(np.max(self.path.line_distance, initial=0.0))
        )

    @property
    def radius(self) -> float:
        """The largest half-width [m]."""
        return float(np.max(self.half, initial=0.0))


def rank_region(
    diagram: Diagram,
    start: Mapping[str, Any] | None = None,
    *,
    duration: float,
    tube: float = 0.05,
    least: float | None = None,
    centre: Centre = "truth",
    shape: Shape = "box",
    scale: Literal["uniform", "length"] | Sequence[float] = "uniform",
    boxes: int = MOST_BOXES,
    path: JointPath | None = None,
    progress: Progress | None = None,
) -> RankRegion:
    r"""Largest set of :math:`a_k` found for which J keeps full row rank along the desired path.

    The joint path follows from inverse kinematics and the start of a run, with an approach if the start is off the
    path. Boxes of q cover the tube around it; boxes are bisected until the lower bound of J's singular values over each
    (`dmframe.analysis.rank_bound`) suffices or cannot. The size of the set is found by bisection.

    Parameters
    ----------
    diagram
        A diagram with a matrix that must keep full row rank, such as ``J_hat``.
    start
        As in `dmframe.simulate.start_state`.
    duration
        Covered part of the path [s]; one period of a periodic path.
    tube
        Largest deviation of each joint from the path [rad].
    least
        c, the required least singular value; default: a tenth of the least one along the path.
    centre
        truth or start: centre of the set.
    shape
        box or ball.
    scale
        uniform; length, in proportion to the parameter's translation (at least a tenth of the longest); or a number for
        each parameter. The largest half-width is the radius.
    boxes
        Maximum number of boxes for one size of the set; a higher number may give a larger set.
    path
        Joint path to be used instead, such as a run's: that of a redundant robot depends on its controller.

    Raises
    ------
    NotApplicableError
        The diagram has no such matrix or no path, or the matrix depends on other unknowns.
    ValueFault
        An argument is out of its range.
    """
    _check(tube=tube, duration=duration, boxes=boxes, least=least, shape=shape, centre=centre)
    tell = progress or (lambda text: None)
    problem = rank_problem(diagram, start or {}, centre, given=path is not None)
    weights = _weights(scale, problem.centre)
    path = path or _followed(problem, duration, tube, tell)
    search = RankSearch(problem, path, tube, shape, weights, boxes, tell)
    singular = search.singular(path.poses)
    nominal = float(np.min(singular))
    required = LEAST_FRACTION * nominal if least is None else least
    cover, radius, fails_at = None, 0.0, None
    loss = _unreachable(problem, path, float(singular[-1])) or _lost(search, path, nominal, int(np.argmin(singular)))
    loss = loss or _undecided(search, path)
    if loss is None:
        loss, cover = _middle(search, path, required)
    if cover is not None:
        fails_at = search.fails_at(required)
        radius, cover = search.largest(required, cover, fails_at or LARGEST)
    half = radius * weights
    place = 0 if cover is None else int(np.argmin(cover.least))
    option = problem.options.get(shape)
    return RankRegion(
        matrix=problem.matrix,
        parameters=problem.parameters,
        names=problem.names,
        centre=problem.centre,
        half=half,
        shape=shape,
        option=option,
        start_inside=_inside(problem, half, shape),
        tube=tube,
        asked=required,
        certified=0.0 if cover is None else float(cover.least[place]),
        nominal=nominal,
        unit=problem.unit,
        time=float(path.times[cover.segment[place]]) if cover is not None else loss.time if loss is not None else 0.0,
        q=path.poses[-1] if cover is None else (cover.low[place] + cover.high[place]) / 2,
        fails_at=fails_at,
        path=path,
        boxes=0 if cover is None else len(cover.least),
        model=diagram.fingerprint,
        redundant=search.bound.n > search.bound.rows and path.line_distance is not None,
        loss=loss,
    )


def _followed(problem: RankProblem, duration: float, tube: float, tell: Progress) -> JointPath:
    if problem.reach is None:  # only with a user's path
        raise TypeError(problem.matrix)
    stride, proof = min(max(tube / 2, _LEAST_STRIDE), _MOST_STRIDE), path_tube(problem.path, tube)

    def follows(fraction: float) -> None:
        tell(f"following the path: {100 * fraction:.0f} %")

    return joint_path(problem.reach, problem.start, duration, problem.period, stride, proof, follows)


def _unreachable(problem: RankProblem, path: JointPath, singular: float) -> RankLoss | None:
    path_exit = path.path_exit
    if path_exit is None:
        return None
    goal = ", ".join(f"{number:.4g}" for number in path_exit.goal)
    away = (
        f"at t = {path_exit.later:.6g} s it is at [{goal}], {path_exit.distance:.3g} m from the nearest reachable point"
    )
    text = (
        f"the path jumps by {path_exit.jump:.3g} m at t = {path_exit.time:.6g} s, where no joint path can follow it"
        if path_exit.jump
        else f"the path leaves the workspace at t = {path_exit.time:.6g} s: {away}"
        if path_exit.distance > REACHED
        else f"the path passes a singularity at t = {path_exit.time:.6g} s, after which no nearby pose reaches it"
    )
    text += f"; the least singular value of {problem.matrix} at the last pose is {singular:.3g} {problem.unit}"
    return RankLoss("unreachable", path_exit.time, path_exit.q, singular, text)


def _undecided(search: RankSearch, path: JointPath) -> RankLoss | None:
    """Undecided result for a path whose joint path is not proved between two poses."""
    unproved = path.unproved
    if unproved is None:
        return None
    why = f"the joint path is not proved to follow the desired one from t = {unproved.time:.6g} s on: {unproved.reason}"
    singular = float(search.singular(unproved.q[None])[0])
    return RankLoss("undecided", unproved.time, unproved.q, singular, f"{why}; no bound on {search.problem.matrix}")


def _lost(search: RankSearch, path: JointPath, nominal: float, place: int) -> RankLoss | None:
    if nominal > LOST:
        return None
    problem, time = search.problem, float(path.times[place])
    text = f"{problem.matrix} is rank-deficient on the path, at t = {time:.6g} s"
    return RankLoss("singular", time, path.poses[place], nominal, text)


def _middle(search: RankSearch, path: JointPath, least: float) -> tuple[RankLoss | None, Cover | None]:
    """Cover with the parameters at their centre, or the reason for its absence."""
    problem, tube = search.problem, search.tube
    found = search.witness(0.0, least)
    if found is None:
        holds, cover = search.cover(0.0, least, search.segments())
        if holds:
            return None, cover
        worst = int(np.argmin(np.nan_to_num(cover.least, nan=-np.inf)))
        place, q = int(cover.segment[worst]), (cover.low[worst] + cover.high[worst]) / 2
        singular = float(search.singular(q[None])[0])
        kind: Literal["singular", "undecided"] = "singular" if singular < least else "undecided"
    else:
        place, q, singular, kind = found.place, found.q, found.singular, "singular"
    time = float(path.times[place])
    at = f"at t = {time:.6g} s, within {tube:.4g} rad of the path, the least singular value of {problem.matrix}"
    text = (
        f"{at} is {singular:.3g} {problem.unit}, but {least:.3g} is required; use a narrower tube or another path"
        if kind == "singular"
        else f"{at} could not be decided with this number of boxes; use a narrower tube or more boxes"
    )
    return RankLoss(kind, time, q, singular, text), None


def _inside(problem: RankProblem, half: Array, shape: Shape) -> bool | None:
    """True if the estimate starts in the set; None without one."""
    if problem.estimate is None:
        return None
    away = np.abs(problem.estimate - problem.centre)
    if shape == "box":
        return bool(np.all(away <= half))
    return bool(np.sum(np.divide(away, half, out=np.where(away > 0, np.inf, 0.0), where=half > 0) ** 2) <= 1)


def _weights(scale: str | Sequence[float], centre: Array) -> Array:
    """Half-widths of the set of radius 1."""
    if isinstance(scale, str):
        if scale == "uniform":
            return np.ones(len(centre))
        if scale != "length" or len(centre) % 3:
            raise ValueFault(f"scale: expected uniform, length or a number for each parameter, found {scale}")
        lengths = np.repeat(np.linalg.norm(centre.reshape(-1, 3), axis=1), 3)
        return np.asarray(np.maximum(lengths / np.max(lengths), _LEAST_WEIGHT))
    weights = np.asarray(scale, dtype=float)
    if weights.shape != centre.shape or not np.all(np.isfinite(weights) & (weights >= 0)) or not np.any(weights):
        raise ValueFault(f"scale: expected {len(centre)} numbers, none below 0 and not all 0, found {weights.tolist()}")
    return np.asarray(weights / np.max(weights))


def _check(*, tube: float, duration: float, boxes: int, least: float | None, shape: str, centre: str) -> None:
    for name, found, choices in (("shape", shape, ("box", "ball")), ("centre", centre, ("truth", "start"))):
        if found not in choices:
            raise ValueFault(f"{name}: expected {' or '.join(choices)}, found {found}")
    if not (np.isfinite(tube) and tube >= 0):
        raise ValueFault(f"tube: expected an angle of at least 0 rad, found {tube:g}")
    if not (np.isfinite(duration) and duration >= 0):
        raise ValueFault(f"duration: expected at least 0 s, found {duration:g}")
    if boxes < 1:
        raise ValueFault(f"boxes: expected at least 1, found {boxes}")
    if least is not None and not (np.isfinite(least) and least > 0):
        raise ValueFault(f"least: expected a singular value above 0, found {least:g}")
