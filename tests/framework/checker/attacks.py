"""Files that state more than is true, written with the checkers' source at hand.

`holes` repeats each hole that was found in a first version of the checkers; `more` are further attempts. An entry is a
name, the file, and the outcomes that are allowed. ``w`` stands for: re-proved, but the statement about w is not shown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from tests.framework.checker.certificates import certificate, replaced
from tests.framework.checker.written import File, circular, concluded, constant, dominated, sampled, stable

Attack = tuple[str, dict[str, Any], str]


def _of(name: str, change: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    data = certificate(name)
    change(data)
    return data


def holes() -> Iterator[Attack]:
    """Holes 1 to 18 that were found and closed; 12 and 19 are no files, and have tests of their own."""
    file = File()
    places = file.states(x="-1 x +9 y", y="+0 x -1 y")
    both, weight = file.vector(*places.values()), file.vector(*map(file.number, ("1", "0", "4", "1")))
    file.term("stored", both, weight)
    yield "1 a matrix with positive pivots that is not symmetric", file.data, "refuted"

    yield "2 a dissipation whose matrix is not symmetric", dominated(off="0").data, "refuted"
    yield "3 a dissipation that does not dominate a cross term", dominated().data, "refuted"
    file = stable()
    x = file.data["vectors"][0][0]
    file.term("dissipated", file.vector(x, x, x, x), file.vector(*map(file.number, ("1", "-1", "-1", "1"))))
    yield "4 a positive matrix as a diagonal", file.data, "refuted"

    def axis(data: dict[str, Any]) -> None:
        data["robots"][0]["joints"][0]["axis"] = constant(data, "0", "0", "0")

    def reflected(data: dict[str, Any]) -> None:
        joint = data["robots"][0]["joints"][1]
        place = data["vectors"][joint["place"]]
        joint["place"] = replaced(data, joint["place"])
        data["vectors"][-1][3:] = place[3:]

    yield "5 a joint without an axis", _of("arm2_joint", axis), "refuted"
    yield "5 a reflection", _of("arm2_joint", reflected), "refuted"

    file = File()
    correction = file.symbol("correction", "correction")
    for label in "ab":
        state = file.symbol(label, "state")
        file.data["rates"][label] = file.vector(correction)
        file.term("stored", file.vector(state), file.vector(file.number("1")))
        file.projected(state, correction, "-1", "1")
    yield "6 a correction of two estimates", file.data, "refused"

    file = stable()
    file.projected(file.instruction("add", 0, 0), file.symbol("x, correction", "correction"), "-1", "1")
    yield "6 a projection of values in continuous time", file.data, "refused"

    file = stable()
    noise = file.symbol("noise", "given")
    data = file.data
    file.term("stored", file.vector(noise), data["terms"][0]["parts"]["weight"])
    yield "7 V of a noise without a rate", data, "refused"

    def ball(data: dict[str, Any]) -> None:
        next(term for term in data["terms"] if term["rule"] == "projected")["rule"] = "ball"

    yield "8 a projection onto an unknown set", _of("arm2_joint", ball), "refused"

    file = File()
    x = file.vector(file.states(x="+1 x")["x"])
    file.term("stored", x, file.vector(file.number("-1")))
    file.term("dissipated", x, file.vector(file.number("1")))
    for term in file.data["terms"]:
        term["assumed"] = "it is"
    yield "9 a negative weight that is assumed to be positive", file.data, "refuted"

    file = stable()
    y = file.vector(file.symbol("y", "state"))
    file.data["rates"]["y"] = file.vector(file.number("1"))
    file.data["ranks"] = [{"name": "R", "matrix": file.vector(file.number("0")), "vector": y}]
    concluded(file.data, y)
    yield "10 a matrix of full rank that is zero", file.data, "w"

    def resting(data: dict[str, Any]) -> None:
        data["robots"][0]["torque"] = constant(data, "0", "0")

    yield "11 a robot at rest", _of("arm2_joint", resting), "refuted"

    file = stable()
    K = file.symbol("K", "constant", numbers=[["60", "60"]])
    pole = file.instruction("div", file.number("1"), file.instruction("sub", K, file.number("60")))
    concluded(file.data, file.vector(pole))
    yield "13 a divisor that vanishes at the file's numbers", file.data, "refused"

    file = stable()
    place = file.number("3")
    for _ in range(60):
        place = file.instruction("mul", place, place)
    file.condition(file.vector(place))
    yield "14 a number of 2^60 digits", file.data, "refuted"

    data = circular(nominal="a")
    for term in data["terms"]:
        parts = term["parts"]
        if "lower" in parts:
            parts["lower"], parts["upper"] = parts["upper"], parts["lower"]
    yield "15 a box whose ends are exchanged", data, "refuted"

    yield from _over_samples()
    yield "17 corrections that depend on one another", circular(nominal="b, correction"), "w"
    data = dominated().data
    data["terms"][1]["role"] = "cross"
    yield "18 a cross term", data, "refused"


def _over_samples() -> Iterator[Attack]:
    """Faults of a file that proves the step of an estimate and its projection."""
    for part, value, allowed in (
        ("correction", "0", "refuted"),
        ("true", "1", "refuted"),
        ("upper", "2", "refuted"),
        ("lower", "-2", "refuted"),
        ("weight", "2", "refuted"),
        ("weight", "-1", "refuted"),
    ):
        file = sampled()
        term = next(term for term in file.data["terms"] if term["rule"] == "projected")
        term["parts"][part] = file.vector(file.number(value))
        yield f"16 a projection over samples with another {part}", file.data, allowed
    file = sampled(true="2")
    yield "16 a projection onto a box without the true value", file.data, "refuted"
    file = sampled()
    theta = file.data["vectors"][0][0]
    file.data["rates"]["theta"] = file.vector(file.instruction("mul", theta, file.number("2")))
    yield "16 another next value", file.data, "refuted"
    file = sampled()
    file.term("stored", file.vector(file.symbol("t", "time")), file.vector(file.number("1")))
    yield "16 V of the time over samples", file.data, "refused"
    for key in ("stable", "ranks"):
        data = sampled().data
        data[key] = [{"vector": 0, **({"weight": 1, "loss": 1} if key == "stable" else {"name": "R", "matrix": 1})}]
        yield f"16 {key} over samples", data, "refused"
    data = sampled().data
    data["over"] = "flow"
    yield "16 steps in continuous time", data, "refused"
    data = sampled().data
    data["terms"][0]["rule"] = "potential"
    data["terms"][0]["parts"]["scale"] = data["terms"][0]["parts"]["weight"]
    yield "16 a potential over samples", data, "refused"
    data = sampled().data
    data["rates"]["y"] = data["rates"]["theta"]
    yield "16 the next value of a given signal", data, "refused"
    file = sampled()
    w = file.symbol("w", "state")
    file.data["rates"]["w"] = file.vector(file.instruction("fmin", file.instruction("fmax", w, w), w))
    concluded(file.data, file.vector(w), "is bounded")
    yield "16 a state that is clipped to itself", file.data, "w"


def more() -> Iterator[Attack]:
    """Further attempts."""
    data = stable().data
    data["terms"] = []
    yield "V without a term", data, "refused"

    for weight, allowed in (("0", "refuted"), ("-1", "refuted")):
        file = stable()
        own = file.vector(file.number(weight))
        for term in file.data["terms"]:
            term["parts"]["weight"] = own
        yield f"a weight of {weight}", file.data, allowed

    file = stable()
    for term in file.data["terms"]:
        term["parts"]["vector"] = file.vector(-1)
    yield "V of a vector that is zero", file.data, "refuted"

    file = File()
    x = file.vector(file.states(x="+1 x")["x"])
    file.term("stored", x, file.vector(file.number("1")))
    file.term("residual", x, file.vector(file.number("1")))
    concluded(file.data, x, "is bounded")
    yield "an unstable state with a residual", file.data, "w"

    file = stable()
    x = file.data["vectors"][file.data["terms"][0]["parts"]["vector"]][0]
    zero = file.instruction("sub", x, x)
    file.condition(file.vector(file.instruction("div", x, zero)))
    yield "a divisor that is identically zero", file.data, "refused"

    for name in ("mul", "sub"):
        file = stable()
        x = file.data["vectors"][file.data["rates"]["x"]][0]
        pole = file.instruction("div", x, file.instruction("sub", x, x))
        nothing = file.instruction(name, file.number("0") if name == "mul" else pole, pole)
        file.data["rates"]["x"] = file.vector(file.instruction("add", x, nothing))
        yield f"a pole that {name} removes", file.data, "refused"

    file = stable()
    K = file.symbol("K", "constant", numbers=[["60", "60"]])
    x = file.data["vectors"][file.data["rates"]["x"]][0]
    pole = file.instruction("div", x, file.instruction("sub", K, file.number("60")))
    file.data["rates"]["y"] = file.vector(pole)
    file.symbol("y", "state")
    yield "a rate with a pole at the file's numbers", file.data, "refused"

    for value in (None, True, 1, ["is bounded"]):
        data = stable().data
        data["conclusions"][0]["says"] = value
        yield f"a conclusion that says {value!r}", data, "refused"

    file = File()
    a, correction = file.symbol("a", "state"), file.symbol("a, correction", "correction")
    file.data["rates"]["a"] = file.vector(correction)
    for low in ("-3", "-9"):
        file.term("stored", file.vector(a), file.vector(file.number("1")))
        file.projected(a, correction, low, "9")
    yield "two boxes of one estimate", file.data, "refused"

    file = stable()
    concluded(file.data, file.vector())
    yield "a conclusion about an empty vector", file.data, "refused"

    file = stable()
    free = file.symbol("free", "constant")
    file.condition(file.vector(free))
    yield "a condition on a parameter without numbers", file.data, "open"

    file = stable()
    file.symbol("K", "constant", numbers=[["2", "1"]])
    yield "an interval with its ends exchanged", file.data, "refused"

    file = stable()
    y = file.vector(file.symbol("y", "state"))
    one = file.data["rates"]["y"] = file.vector(file.number("1"))
    file.data["stable"] = [{"vector": y, "weight": one, "loss": file.vector(file.number("-1"))}]
    concluded(file.data, y, "is bounded")
    yield "an unstable linear equation", file.data, "w"

    file = stable()
    y = file.vector(file.symbol("y", "state"))
    file.data["rates"]["y"] = file.vector(file.number("1"))
    concluded(file.data, y, "is bounded")
    yield "a state that grows", file.data, "w"

    file = stable()
    file.symbol("y", "state")
    correction = file.symbol("y, correction", "correction")
    file.data["rates"]["y"] = file.vector(correction)
    concluded(file.data, file.data["rates"]["y"], "is bounded")
    yield "a correction without a projection", file.data, "w"

    def shorter(data: dict[str, Any]) -> None:
        data["robots"][0]["joints"].pop()

    def crossed(data: dict[str, Any]) -> None:
        term = next(term for term in data["terms"] if term["rule"] == "tanh")
        term["parts"]["weight"] = constant(data, "1", "0", "4", "1")

    def wider(data: dict[str, Any]) -> None:
        term = next(term for term in data["terms"] if term["rule"] == "tanh")
        term["parts"]["scale"] = constant(data, "1/200", "1/200", "1")

    yield "a scale with more elements than its vector", _of("arm2_joint", wider), "refused"
    yield "a chain with fewer joints than positions", _of("arm2_joint", shorter), "refused"
    yield "a matrix as the weight of a monotone term", _of("arm2_joint", crossed), "refused"

    file = stable()
    place = file.number("2")
    for _ in range(2000):
        place = file.instruction("mul", place, place)
    file.vector(place)
    yield "a number of 2^2000 digits", file.data, "refused"

    for key, value in {
        "text": "1",
        "a truth value": True,
        "a list": [1],
        "nothing": None,
        "a number beyond the vectors": 10**30,
        "a negative number": -1,
        "a fraction": 0.5,
    }.items():
        data = stable().data
        data["terms"][0]["parts"]["vector"] = value
        yield f"{key} as a vector", data, "refused"

    for value in ("1e3", "1/0", "-", "", " 1", "0x1", "1_0", "nan", "inf", "²", "9" * 5000, "1/-2", 1, None):
        file = stable()
        file.number("1")
        file.data["program"]["constants"][-1] = value
        yield f"the constant {value!r:.12}", file.data, "refused"

    file = stable()
    file.instruction("add", len(file.data["program"]["code"]), 0)
    yield "an instruction that reads itself", file.data, "refused"

    file = stable()
    file.names.append("system")
    yield "an operation that is not used", file.data, "refused"
    file = stable()
    file.names.append("system")
    file.instruction("system", 0, 0)
    yield "an unknown operation", file.data, "refused"

    file = stable()
    file.symbol("x", "state")
    yield "two symbols of one label", file.data, "refused"

    for key in ("version", "terms", "rates", "stable", "assumed"):
        data = stable().data
        del data[key]
        yield f"no {key}", data, "refused"
    for version in (1, 2, 3, "4", 4.5, True, None):
        data = stable().data
        data["version"] = version
        yield f"version {version!r}", data, "refused"
    data = stable().data
    data["theorem"] = "anything"
    yield "a further key", data, "refused"

    def twice(data: dict[str, Any]) -> None:
        data["terms"].append(next(term for term in data["terms"] if term["rule"] == "projected"))

    def other(data: dict[str, Any]) -> None:
        one, two, *_ = (term["parts"] for term in data["terms"] if term["rule"] == "projected")
        one["correction"] = two["correction"]

    def following(data: dict[str, Any]) -> None:
        data["rates"]["path.q_d"] = data["rates"]["arm.q"]

    def negative(data: dict[str, Any]) -> None:
        item = next(x for x in data["conditions"] if x["margin"] is not None and x["strict"])
        item["margin"] = replaced(data, item["margin"])

    yield "a projection that is counted twice", _of("arm2_joint", twice), "refused refuted"
    yield "the correction of another estimate", _of("arm2_joint", other), "refused refuted"
    yield "a trajectory that follows the robot", _of("pendulum", following), "refused"
    yield "a condition of the other sign", _of("arm2_joint", negative), "refuted"
