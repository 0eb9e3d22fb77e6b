"""Files in which a list, a name or an assumption hides what is false: a further round of attacks.

Entries are those of `attacks` and `false_theorems`.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

from tests.framework.checker.attacks import Attack
from tests.framework.checker.false_theorems import _turning
from tests.framework.checker.written import File, concluded, sampled, stable


def hidden() -> Iterator[Attack]:
    """All of them."""
    return chain(_weights(), _conditions(), _boxes(), _names(), _signals(), _residuals(), _bodies())


def _square(*weight: str) -> File:
    """dx/dt = -x, with a stored square of (x, y) or a matrix as its weight; the element "?" is tanh(x)^2.

    It is true if the weight is.
    """
    file = File()
    places = file.states(x="+0 x", y="+0 y")
    wave = file.instruction("tanh", places["x"])
    unknown = file.instruction("mul", wave, wave)
    elements = [unknown if text == "?" else file.number(text) for text in weight]
    file.term("stored", file.vector(*places.values()), file.vector(*elements), assumed="it is a square")
    concluded(file.data, file.vector(*places.values()), "is bounded")
    return file


def _weights() -> Iterator[Attack]:
    """A weight that is assumed to be positive must be so where it is decided."""
    yield "a weight of which one element is assumed", _square("?", "1").data, "assumes uniformly positive"
    for weight in (("?", "-1"), ("-1", "?"), ("0", "?")):
        yield f"a weight {weight} that is assumed", _square(*weight).data, "refuted"
    yield "a matrix of which one element is assumed", _square("2", "?", "?", "1").data, "assumes uniformly positive"
    for weight in (("-1", "?", "?", "1"), ("1", "?", "?", "0"), ("1", "?", "0", "-1/9")):
        yield f"a matrix {weight} that is assumed", _square(*weight).data, "refuted"
    for sign in ("1", "-1"):
        file = stable()
        weight = file.number("2")
        for _ in range(15):
            weight = file.instruction("mul", weight, weight)
        weight = file.instruction("mul", weight, file.number(sign))
        file.term("dissipated", file.vector(-1), file.vector(weight), assumed="it is")
        yield f"a weight of {sign} times 2^(2^15), which is assumed", file.data, "refuted"


def _conditions() -> Iterator[Attack]:
    """A condition on numbers is decided, and not assumed; of several, those that are."""
    for margin, strict, allowed in (
        (("-1", "?"), False, "refuted"),
        (("?", "-1"), True, "refuted"),
        (("?", "0"), True, "refuted"),
        (("?", "0"), False, "open"),
        (("?", "1"), True, "open"),
        (("1/0",), True, "refuted"),
        (("-1/0", "?"), True, "refuted"),
    ):
        file = stable()
        free = file.symbol("free", "constant")
        K = file.symbol("K", "constant", numbers=[["0", "2"]])
        pole = file.instruction("sub", K, file.number("1"))
        elements = {"?": free, "1/0": file.instruction("div", file.number("1"), file.instruction("mul", pole, pole))}
        elements["-1/0"] = file.instruction("mul", file.number("-1"), elements["1/0"])
        places = [elements[text] if text in elements else file.number(text) for text in margin]
        file.condition(file.vector(*places), strict=strict)
        yield f"a condition of the elements {margin}, strict: {strict}", file.data, allowed


def _boxes() -> Iterator[Attack]:
    """A true value of which one element is unknown must be inside in the others; and boxes have names of their own."""
    for true, allowed in (("1/2", "assumes true value is inside"), ("2", "refuted"), ("-1/9", "refuted")):
        file = _estimates("e")
        value = file.vector(file.symbol("theta", "constant"), file.number(true))
        file.data["terms"][-1]["parts"]["true"] = value
        file.data["terms"][0]["parts"]["vector"] = file.vector(*_errors(file, value))
        yield f"a true value (unknown, {true}) in a box [0, 1]", file.data, allowed
    file = _estimates("e", "e")
    yield "two projections of one name", file.data, "refused"
    file = _estimates("e", "f")
    yield "two projections of two names", file.data, "assumes f: it starts in its box"


def _estimates(*names: str) -> File:
    """Projected estimates of two elements each, at rest: V = |estimate - true|^2 / 2, whose rates are corrections."""
    file, two = File(), []
    for k, name in enumerate(names):
        item = {"kind": "state", "size": 2, "numbers": None, "exact": False}
        for label, kind in ((f"a{k}", "state"), (f"a{k}, correction", "correction")):
            file.data["symbols"].append({**item, "label": label, "kind": kind})
        place = len(file.data["symbols"]) - 2
        a, c = ([file.instruction("input", place + j, i) for i in (0, 1)] for j in (0, 1))
        zero, one = (file.vector(*[file.number(text)] * 2) for text in "01")
        correction = file.vector(*c)
        file.data["rates"][f"a{k}"] = correction
        file.term("stored", file.vector(*a), one)
        parts = {"vector": file.vector(*a), "correction": correction, "true": zero, "lower": zero, "upper": one}
        two.append((name, parts | {"weight": one}))
    for name, parts in two:
        file.rule("projected", "dissipated", parts)
        file.data["terms"][-1]["name"] = name
    return file


def _errors(file: File, true: int) -> list[int]:
    """Estimate minus true value."""
    vectors = file.data["vectors"]
    estimate = vectors[file.data["terms"][-1]["parts"]["vector"]]
    return [file.instruction("sub", x, y) for x, y in zip(estimate, vectors[true], strict=True)]


def _names() -> Iterator[Attack]:
    """A name must not read as a statement, and is not empty."""
    for name in ("", " ", " w", "w ", "w goes to zero and x", "y is bounded, w", "y and z are bounded; x"):
        for key, own in (("conclusions", "signal"), ("symbols", "label"), ("terms", "name"), ("ranks", "name")):
            yield f"{own} of {key}: {name!r}", _named(name, key, own), "refused"
    for name in ("island", "bias", "z - z_d", "egoes", "area"):
        yield f"a signal {name!r}", _named(name, "conclusions", "signal"), "re-proved"


def _named(name: str, key: str, own: str) -> dict[str, Any]:
    file = stable()
    file.symbol("y", "given")
    one = file.vector(file.number("1"))
    file.data["ranks"] = [{"name": "R", "matrix": one, "vector": one}]
    file.data[key][-1][own] = name
    return file.data


def _signals() -> Iterator[Attack]:
    """One signal has one vector, and that of a symbol's name is the symbol."""
    file = stable()
    y = file.vector(file.symbol("y", "state"))
    file.data["rates"]["y"] = file.vector(file.number("1"))
    named = {**file.data, "conclusions": [{"signal": "y", "says": "goes to zero", "vector": 0}]}
    yield "a conclusion about x by the name of another state, y", named, "refused"
    concluded(file.data, y, "is bounded", "y")
    yield "a conclusion about a state y that grows, by its name", file.data, "unshown y is bounded"
    file = stable()
    tame = file.vector(file.instruction("tanh", file.data["vectors"][0][0]))
    concluded(file.data, tame, "is bounded", "w")
    concluded(file.data, 0, "goes to zero", "w")
    yield "two signals of one name", file.data, "refused"


def _residuals() -> Iterator[Attack]:
    """Where one of two terms of a name has no positive weight, the name's term is not integrable."""
    for data, word in ((stable().data, "integrable"), (sampled().data, "summable")):
        file = File()
        file.data, file.names = data, data["program"]["operations"]
        name = "the error"
        zero, x = file.vector(-1), data["vectors"][data["terms"][0]["parts"]["vector"]][0]
        file.term("dissipated", file.vector(file.instruction("mul", x, x)), zero)
        file.term("residual", file.vector(x), zero)
        last = next(term for term in data["terms"] if term["role"] == "dissipated")
        for term in (last, data["terms"][-2]):
            term["name"] = name
        yield f"two dissipated terms of one name, of which one is {word}", data, f"unshown {name} is {word}"


def _bodies() -> Iterator[Attack]:
    """Joints and bodies at the limits of what a chain is."""
    for what, change, allowed in (
        ("a body without mass", lambda joint, file: _body(joint, file, *"0000000000"), "refuted"),
        ("a body that is a point", lambda joint, file: _body(joint, file, *"0000000001"), "refuted"),
        ("a body without a moment", lambda joint, file: _body(joint, file, "-1", *"010010001"), "refuted"),
        ("a body of nine elements", lambda joint, file: _body(joint, file, *"101001000"), "refused"),
        ("an axis of two elements", lambda joint, file: _part(joint, file, "axis", *"01"), "refused"),
        ("an axis of the length 2", lambda joint, file: _part(joint, file, "axis", *"002"), "refuted"),
        ("an axis that is zero", lambda joint, file: _part(joint, file, "axis", *"000"), "refuted"),
        ("another kind of joint", lambda joint, file: joint.update(kind="prismatic"), "refuted"),
        ("an unknown kind of joint", lambda joint, file: joint.update(kind="screw"), "refused"),
        ("a place of nine elements", lambda joint, file: _part(joint, file, "place", *"100010001"), "refused refuted"),
        ("a place that does not turn", lambda joint, file: _part(joint, file, "place", *"100010001000"), "refuted"),
    ):
        file = _turning()
        robot = file.data["robots"][0]
        change(robot["joints"][0], file)
        if "without" in what or "point" in what:
            robot["torque"] = file.vector(-1)  # it needs none
        yield what, file.data, allowed
    file = _turning()
    robot = file.data["robots"][0]
    robot["joints"] = robot["joints"] * 2
    yield "one joint twice, of one position", file.data, "refused"
    file = _turning()
    file.data["robots"][0] |= {"rotors": file.vector(file.number("-2")), "torque": file.vector(-1)}
    yield "a rotor with a negative inertia", file.data, "refuted"
    file = _turning()
    file.data["rates"]["q"] = file.vector(file.symbol("u", "given"))
    yield "speeds that are given and have no rate", file.data, "refuted"
    file = _turning()
    file.data["robots"][0]["gravity"] = file.vector(-1, -1)
    yield "gravity of two elements", file.data, "refused"


def _body(joint: dict[str, Any], file: File, *elements: str) -> None:
    _part(joint, file, "body", *elements)


def _part(joint: dict[str, Any], file: File, key: str, *elements: str) -> None:
    joint[key] = file.vector(*map(file.number, elements))
