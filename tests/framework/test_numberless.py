"""Equations are stated without a block's numbers: a number on `self` would be a constant of one value in all runs."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

from dmframe.block import AbstractBlock, AdaptingBlock, Equations, Signals
from dmframe.block.certificate import Certificate, Condition, Inequality, Square, TrueValue
from dmframe.block.numberless import LARGER, SMALLER, with_other_numbers
from dmframe.block.parameter import Box, Diagonal, Interval, NonNegative, Positive, Real, Scalar, specs
from dmframe.block.port import Adapted, Element, Input, Output, State
from dmframe.catalogue import block_types
from dmframe.certify import verify
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.diagram import Diagram
from dmframe.diagram.values import with_values
from dmframe.simulate import simulate

States = ClassVar[tuple[State, ...]]
KEPT: dict[str, Any] = {}


class Falling(AbstractBlock):
    """y' = -rate y, with a test's choice of how and where it reads a number."""

    outputs = (Output("seen"),)
    states = (State("y"), State("z", "n"))
    rate: Scalar = Positive(default=2.0)
    gains: Diagonal = Real("n", default=(1.0, 2.0))
    y: Scalar = Real(default=1.0)
    y_box: Box = Interval()
    twice: bool = False
    where: str = ""
    way: ClassVar[Callable[[Any], Any]] = staticmethod(lambda self: 0)
    _rate: float = 0.0

    def model_post_init(self, context: Any, /) -> None:
        self._rate = self.rate
        KEPT["rate"], KEPT["block"] = self.rate, self
        type(self).way(self) if self.where == "cache" else None

    @property
    def steep(self) -> bool:
        return self.rate > 5

    @cached_property
    def sign(self) -> int:
        return -1 if self.rate > 5 else 1

    def helped(self) -> float:
        return float(self.rate)

    def query(self, method: str) -> None:
        if self.where in (method, "cache"):
            type(self).way(self)

    def sizes(self, robot: Any) -> Mapping[str, int]:
        self.query("sizes")
        return {}

    def elements(self, robot: Any) -> Mapping[str, Sequence[Element]]:
        self.query("elements")
        return {}

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        self.query("equations")
        rate = 2 * p.rate if self.twice else p.rate
        return Equations({"seen": x.y}, {"y": -rate * x.y, "z": -p.gains * x.z})

    def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
        self.query("start")
        return {"z": p.gains}

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        self.query("certificate")
        return Certificate(storage=(Square(x.y),), dissipation=(Square(x.y, p.rate),))

    def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
        self.query("conditions")
        return (Inequality("rate > 0", p.rate, "here"),)


WAYS: dict[str, Callable[[Any], Any]] = {
    "attribute": lambda self: self.rate,
    "number": lambda self: float(self.rate),
    "getattr": lambda self: getattr(self, "rate", 1.0),
    "hasattr": lambda self: hasattr(self, "rate"),
    "array": lambda self: np.asarray(self.gains)[0],
    "length": lambda self: len(self.gains),
    "none": lambda self: self.y_box is None,
    "start": lambda self: self.y,
    "dict": lambda self: self.__dict__["rate"],
    "vars": lambda self: vars(self)["rate"],
    "object": lambda self: object.__getattribute__(self, "rate"),
    "dump": lambda self: self.model_dump()["rate"],
    "json": lambda self: self.model_dump(mode="json")["rate"],
    "items": lambda self: dict(self)["rate"],
    "copy": lambda self: copy.copy(self).rate,
    "model_copy": lambda self: self.model_copy().rate,
    "private": lambda self: self._rate,
    "private dict": lambda self: self.__pydantic_private__["_rate"],
    "property": lambda self: self.steep,
    "cached": lambda self: self.sign,
    "helper": lambda self: self.helped(),
}
METHODS = ["equations", "start", "certificate", "conditions", "sizes", "elements"]


def made(way: Callable[[Any], Any], where: str, **options: Any) -> Diagram:
    kind = type("Falling", (Falling,), {"way": staticmethod(way), "__module__": __name__, "__annotations__": {}})
    return Diagram.build({"falling": kind(where=where, **options)})


def stated(diagram: Diagram) -> str:
    """Messages of all checks of a block's methods; none if all are correct."""
    simulate(diagram, 0.1, clock=0.1)
    return verify(diagram, trials=1).reason


@pytest.mark.parametrize("way", WAYS)
def test_no_way_to_a_number_is_left_in_equations(way: str) -> None:
    with pytest.raises(DmframeError) as caught:
        made(WAYS[way], "equations")
    assert str(caught.value).startswith("falling: ")
    with pytest.raises(DmframeError):  # nor a value stored when the block was made, with its numbers
        made(WAYS[way], "cache") if way in ("cached", "private") else made(WAYS[way], "equations", twice=True)


@pytest.mark.parametrize("where", METHODS)
def test_the_message_names_block_parameter_and_the_right_way(where: str) -> None:
    try:
        found = stated(made(WAYS["attribute"], where))
    except DmframeError as error:
        found = str(error)
    assert "falling: its methods read the number rate from self, where it would be a constant; expected p.rate" in found


def test_what_reads_options_and_symbols_alone_is_as_before() -> None:
    for twice, rate in ((False, 2.0), (True, 4.0)):
        diagram = made(lambda self: self.twice, "equations", twice=twice)
        assert verify(diagram, trials=1).outcome == ("proved" if not twice else "refuted")
        run = simulate(diagram, 1.0, clock=0.1)
        np.testing.assert_allclose(run["falling.y"].ravel(), (1 - 0.1 * rate) ** np.arange(11), rtol=1e-12)


@pytest.mark.parametrize(
    "way", [lambda self: KEPT["rate"], lambda self: KEPT["block"].rate], ids=["a global number", "a global block"]
)
def test_a_number_found_elsewhere_is_found_by_other_numbers(way: Callable[[Any], float]) -> None:
    class Global(Falling):
        """With a sign that depends on a number outside p."""

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            sign = 1 if way(self) < 5 else -1
            return Equations({"seen": x.y}, {"y": -sign * p.rate * x.y, "z": -x.z})

    text = "falling: equations\\(\\) state another rate of y where rate has another value, read as a Python"
    for rate in (2.0, 0.01, 4.9, 7.0, 4000.0):
        with pytest.raises(DmframeError, match=text):
            Diagram.build({"falling": Global(rate=rate)})


def through_a_global(self: Any) -> float:
    return 1.0 if KEPT["rate"] < 5 else -1.0


def through_a_block(self: Any) -> float:
    return float(KEPT["block"].gains[0])


def leaking(found: Callable[[Any], float], where: str, **options: Any) -> Diagram:
    """A decrease, with a factor that depends on a number outside p, in the named method."""

    class Leaking(Falling):
        """With a factor."""

        def factor(self, method: str) -> float:
            return found(self) if method == where else 1.0

        def start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, Any]:
            return {"z": self.factor("start") * p.gains}

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            factor = self.factor("certificate")
            return Certificate(storage=(Square(x.y, factor),), dissipation=(Square(x.y, factor * p.rate),))

        def conditions(self, p: Signals, truth: Signals) -> Sequence[Condition]:
            return (Inequality("rate > 0", self.factor("conditions") * p.rate, "here"),)

    return Diagram.build({"falling": Leaking(**options)})


@pytest.mark.parametrize("found", [through_a_global, through_a_block])
@pytest.mark.parametrize(
    ("where", "reports"),
    [
        ("certificate", "certificate() states another storage"),
        ("conditions", "conditions() state another list of conditions"),
        ("start", "start() states another start of z"),
    ],
)
def test_a_number_found_elsewhere_is_found_in_what_is_proved_and_in_starts(
    found: Callable[[Any], float], where: str, reports: str
) -> None:
    number = "rate" if found is through_a_global else "gains"
    text = f"falling: {reports} where {number} has another value, read as a Python number; expected p.{number}"
    for rate in (2.0, 7.0):
        verdict = verify(leaking(found, where, rate=rate, gains=(1.0, rate)), trials=1)
        assert (verdict.outcome, verdict.reason) == ("not_applicable", text)
    if where == "start":
        with pytest.raises(DmframeError) as caught:
            simulate(leaking(found, where), 0.1, clock=0.1)
        assert str(caught.value) == text
    assert verify(leaking(found, ""), trials=1).outcome == "proved"


def test_a_sweep_evaluates_a_start_with_what_the_old_number_left_behind() -> None:
    diagram = leaking(through_a_global, "start", rate=2.0)
    with pytest.raises(DmframeError, match="its equations or its start read rate as a number"):
        with_values(diagram, {"falling.rate": 7.0})


def test_a_number_is_varied_alone_where_a_block_takes_no_other_number_for_all() -> None:
    class Paired(Falling):
        """Its two rates add up to three: neither all of its numbers nor these two can be multiplied."""

        other: Scalar = Positive(default=1.0)
        third: Scalar = Positive(default=1.0)

        def model_post_init(self, context: Any, /) -> None:
            super().model_post_init(context)
            KEPT["third"] = self.third
            if self.rate + self.other != 3:
                raise ValueFault("paired: rate + other = 3")

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            return Equations({"seen": x.y}, {"y": -KEPT["third"] * p.rate * x.y, "z": -x.z})

    with pytest.raises(DmframeError, match="another rate of y where third has another value"):
        Diagram.build({"falling": Paired()})


class Learning(AdaptingBlock):
    """a_hat' = direction, with a number read in the method that a test names."""

    inputs = (Input("s"),)
    outputs = (Output("v"),)
    estimates = (Adapted("a_hat", "", "", "Gamma"),)
    driven_by: ClassVar[str] = "s"
    Gamma: Diagonal = Positive(default=2.0)
    floor: Scalar = NonNegative(default=0.0)
    where: str = ""

    def query(self, method: str) -> float:
        return self.floor if self.where == method else 0.0

    def direction(self, u: Signals, x: Signals, p: Signals, error: Any, /) -> Mapping[str, Any]:
        return {"a_hat": error + self.query("direction")}

    def nominal(self, u: Signals, p: Signals) -> Mapping[str, Any]:
        return {"a_hat": ca.SX(1 + self.query("nominal"))}

    def error(self, u: Signals, x: Signals, p: Signals) -> Any:
        return u.s + self.query("error")

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"v": x.a_hat + self.query("equations")})

    def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
        return Certificate(estimates={"a_hat": TrueValue(ca.SX(0), 1 / p.Gamma)})


@pytest.mark.parametrize("where", ["direction", "nominal", "error", "equations"])
def test_a_block_that_adapts_states_its_directions_without_numbers_too(where: str) -> None:
    blocks = {"falling": made(WAYS["attribute"], "").blocks["falling"]}
    wires = {"learning.s": "falling.seen"}
    assert Diagram.build({**blocks, "learning": Learning()}, wires).loop.controller
    with pytest.raises(DmframeError, match=r"learning: its methods read the number floor from self"):
        stated(Diagram.build({**blocks, "learning": Learning(where=where)}, wires))


@pytest.mark.parametrize("where", ["direction", "nominal", "error", "equations", "certificate"])
def test_a_number_found_elsewhere_is_found_in_what_an_adapting_block_states(where: str) -> None:
    class Remembering(Learning):
        """With a number that its validator stores."""

        def model_post_init(self, context: Any, /) -> None:
            KEPT["floor"] = self.floor

        def query(self, method: str) -> float:
            return float(KEPT["floor"]) if method == where else 0.0

        def certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate:
            return Certificate(estimates={"a_hat": TrueValue(ca.SX(self.query("certificate")), 1 / p.Gamma)})

    blocks = {"falling": made(WAYS["attribute"], "").blocks["falling"], "learning": Remembering()}
    try:
        found = verify(Diagram.build(blocks, {"learning.s": "falling.seen"}), trials=1).reason
    except DmframeError as error:
        found = str(error)
    assert "learning: " in found
    assert "where floor has another value, read as a Python number; expected p.floor" in found


def test_whether_a_number_is_given_is_a_property_of_p() -> None:
    class Boxed(Falling):
        """Faster without a box."""

        def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
            factor = 1 if "y_box" in p else 2
            return Equations({"seen": x.y}, {"y": -factor * p.rate * x.y, "z": 0 * x.z})

    for box, end in ((None, 0.6), ((-1.0, 1.0), 0.8)):
        run = simulate(Diagram.build({"falling": Boxed(y_box=box)}), 0.1, clock=0.1)
        assert float(run["falling.y"][-1, 0]) == pytest.approx(end)


def test_most_packaged_blocks_take_other_numbers() -> None:
    kinds = {name: kind for name, kind in block_types().items() if specs(kind)}
    taken = 0
    for kind in kinds.values():
        try:
            block = kind()
        except DmframeError:  # without defaults for all
            continue
        numbers = [key for key in specs(kind) if getattr(block, key) is not None]
        for factors in (LARGER, SMALLER) if numbers else ():
            others = list(with_other_numbers(block, factors))
            assert others, kind
            assert all(any(getattr(other, key) != getattr(block, key) for key in numbers) for other in others)
            taken += 1
    assert taken > 10


EVALUATED: list[str] = []


def noted() -> float:
    EVALUATED.append("once")
    return 1.0


class Steady(AbstractBlock):
    outputs = (Output("seen"),)
    states = (State("y"),)
    rate: Scalar = Positive(default=2.0)

    def equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"seen": x.y}, {"y": -p.rate * x.y * noted()})


class Storing(Steady):
    def model_post_init(self, context: Any, /) -> None:
        KEPT["rate"] = self.rate


def evaluations(block: AbstractBlock) -> int:
    EVALUATED.clear()
    Diagram.build({"steady": block})
    return len(EVALUATED)


def test_a_block_without_a_place_to_leave_a_number_is_evaluated_at_other_numbers_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def other(self: Steady, u: Signals, x: Signals, p: Signals) -> Equations:
        return Equations({"seen": x.y}, {"y": -p.rate * x.y * noted() * 1.0})

    assert [evaluations(Steady()) for _ in range(3)] == [3, 1, 1]
    assert evaluations(Steady(rate=3)) == 3
    assert [evaluations(Storing()) for _ in range(2)] == [3, 3]  # its result may have changed
    with monkeypatch.context() as patched:
        patched.setattr(f"{__name__}.noted", lambda: EVALUATED.append("otherwise") or 2.0)
        assert evaluations(Steady()) == 3  # a helper with another law
    with monkeypatch.context() as patched:
        patched.setattr(Steady, "equations", other)
        assert evaluations(Steady()) == 3  # another method, though it states the same
    with monkeypatch.context() as patched:
        patched.setattr(Steady, "model_post_init", Storing.model_post_init)
        assert evaluations(Steady()) == 3
    assert evaluations(Steady()) == 1


def test_what_differs_each_time_is_found_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    assert evaluations(Steady()) in (1, 3)
    count = itertools.count(7)
    monkeypatch.setattr(f"{__name__}.noted", lambda: float(next(count)))
    for _ in range(2):
        with pytest.raises(DmframeError, match="steady: equations"):
            evaluations(Steady())
