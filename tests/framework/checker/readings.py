"""Files that the two checkers could read in two ways: types, empty and long lists, names, limits, and texts of JSON.

Entries are those of `attacks`. `equals` are true files, of which both must have the same result.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import chain
from typing import Any

from tests.framework.checker.attacks import Attack
from tests.framework.checker.written import File, concluded, sampled, stable


def readings() -> Iterator[Attack]:
    """All of them."""
    return chain(_types(), _lists(), _names(), _limits())


def growing(role: Any) -> dict[str, Any]:
    """dx/dt = x with V = x^2 / 2, and a term x^2 of this role."""
    file = File()
    x, one = file.vector(file.states(x="+1 x")["x"]), file.vector(file.number("1"))
    file.term("stored", x, one)
    file.term(role, x, one)
    file.data["terms"][1]["name"] = "x^2"
    concluded(file.data, x, "is bounded")
    return file.data


def _types() -> Iterator[Attack]:
    """A value of another type must not be read as one that it resembles."""
    for role in ("stored", "dissipated", "residual"):
        yield f"a growing state with the role [{role}]", growing([role]), "refused"
    for key, value in (
        *(("about", x) for x in (None, 5, [], "text", {"graph": 1}, {"graph": None}, {"graph": ["x"]})),
        *(("rates", x) for x in ([0], [], None, "")),
        *(("over", x) for x in (["flow"], None)),
        *(("assumed", x) for x in ("text", [5], {"0": "text"})),
        ("version", [4]),
        ("robots", {}),
    ):
        data = stable().data
        data[key] = value
        yield f"{key}: {value!r}", data, "refused"
    for own in (None, True, False, "0", "", 0.5, [], [0], {}):
        file = stable()
        file.data["vectors"].append([own])
        yield f"a vector of {own!r}", file.data, "refused"
    for name in (5, None, "\n", "x" * 9, ["add"]):
        file = stable()
        file.names.append(name)
        yield f"the operation {name!r}, which nothing uses", file.data, "refused"
    for key, own in (("kind", ["state"]), ("size", [1]), ("exact", 0), ("numbers", {}), ("label", ["x"])):
        data = stable().data
        data["symbols"][0][key] = own
        yield f"a symbol whose {key} is {own!r}", data, "refused"
    for key, own in (("rule", ["square"]), ("assumed", 0), ("assumed", False), ("parts", [0, 1]), ("name", None)):
        data = stable().data
        data["terms"][0][key] = own
        yield f"a term whose {key} is {own!r}", data, "refused"


def _lists() -> Iterator[Attack]:
    """A part of the file that is not used is read all the same, and no vector is empty."""
    file = stable()
    x = file.vector(file.data["vectors"][0][0])
    file.term("residual", x, file.vector(-1))
    with_residual = file.data
    for data in (with_residual, sampled().data):
        for vector in (10**5, "0", [0], True):
            wrong = {**data, "conclusions": [{"signal": "w", "says": "is bounded", "vector": vector}]}
            yield f"an unused conclusion about the vector {vector!r}, over a {data['over']}", wrong, "refused"
    for key, item in (
        ("stable", {"vector": 10**5, "weight": 0, "loss": 0}),
        ("ranks", {"name": "R", "matrix": 0, "vector": "0"}),
        ("robots", {"position": "x", "joints": [], "rotors": 0, "gravity": 10**5, "torque": 0}),
    ):
        yield f"{key} that reads no vector", {**with_residual, key: [item]}, "refused"
    for key in ("terms", "stable", "ranks", "conditions", "conclusions"):
        file = stable()
        none = file.vector()
        items: dict[str, dict[str, Any]] = {
            "terms": {**file.data["terms"][1], "parts": {"vector": none, "weight": none}},
            "stable": {"vector": none, "weight": none, "loss": none},
            "ranks": {"name": "R", "matrix": none, "vector": none},
            "conditions": {"name": "open", "margin": none, "strict": True},
            "conclusions": {"signal": "w", "says": "goes to zero", "vector": none},
        }
        file.data[key].append(items[key])
        yield f"an empty vector of {key}", file.data, "refused"
    for kind, numbers, exact in (("time", None, False), ("state", None, False), ("constant", [], True)):
        data = stable().data
        item = {"label": "y", "kind": kind, "size": 0, "numbers": numbers, "exact": exact}
        yield f"a {kind} without elements", {**data, "symbols": [*data["symbols"], item]}, "refused"
    file = stable()
    file.symbol("K", "constant", exact=True)
    yield "an exact constant without numbers", file.data, "refused"


def _names() -> Iterator[Attack]:
    """A name is one line of ASCII, and a name of the result has one meaning."""
    for name in ("\u0445", "x\u3164", "\u03b1", "\u1c89", "\U0002ebf0", "x\u0301", "\uff58"):
        file = stable()
        file.symbol(name, "state")
        yield f"the label {name!a}", file.data, "refused"
    for one, other in ((0, 0), (0, None), (None, None)):
        file = stable()
        file.condition(one, "gain > 0", strict=False)
        file.condition(other, "gain > 0", strict=False)
        yield f"two conditions of one name, with the margins {one} and {other}", file.data, "refused"
    file = File()
    places = file.states(x="-1 x", y="+1 y")
    square = [file.instruction("mul", place, place) for place in places.values()]
    for place, weight in zip(places.values(), square, strict=True):
        file.term("stored", file.vector(place), file.vector(weight), assumed="a square")
        file.data["terms"][-1]["name"] = "e"
    yield "two assumed weights of one name", file.data, "refused"
    file = stable()
    x = file.data["vectors"][0][0]
    file.data["ranks"] = [{"name": "R", "matrix": file.vector(own), "vector": 0} for own in (x, file.number("1"))]
    yield "two matrices of one name", file.data, "refused"


def _limits() -> Iterator[Attack]:
    """What would exhaust time or memory is refused before."""
    for kind, count, size in (("given", 1, 2 * 10**6), ("given", 2000, 999_999), ("state", 1, 20_000)):
        file = stable()
        file.data["symbols"] += [
            {"label": f"y{k}", "kind": kind, "size": size, "numbers": None, "exact": False} for k in range(count)
        ]
        yield f"{count} symbols of the kind {kind} with {size} elements", file.data, "refused"
    file = stable()
    file.term("dissipated", file.vector(*[-1] * 301), file.vector(*[-1] * 301**2))
    yield "a matrix with 301 rows", file.data, "refused"
    for sign, allowed in (("1", "refuted"), ("-1", "refuted")):
        file = stable()
        weight = file.number("2")
        for _ in range(15):
            weight = file.instruction("mul", weight, weight)
        weight = file.instruction("mul", weight, file.number(sign))
        file.term("dissipated", file.vector(-1), file.vector(weight))
        yield f"a weight of {sign} times 2^(2^15), which is not decided", file.data, allowed


def texts() -> Iterator[tuple[str, bytes]]:
    """Texts that are no certificate, though a reader of JSON may read one from them."""
    text = json.dumps(stable().data)
    assert '"a": [0' in text
    for old, new in (
        ('"version": 4', '"version": 4.0'),
        ('"version": 4', '"version": 4e0'),
        ('"a": [0', '"a": [0.0'),
        ('"a": [0', '"a": [0E5'),
        ('"size": 1', '"size": 1.00000000000000000000001'),
        ('"size": 1', '"size": 01'),
        ('"about": {}', '"about": {"graph": 1e999}'),
        ('"about": {}', '"about": {"graph": NaN}'),
        ('"about": {}', f'"about": {{"graph": {"9" * 5000}}}'),
        ('"about": {}', '"about": {"a": "x", "\\u0061": "y"}'),
        ('"over": "flow"', '"over": "sample", "over": "flow"'),
        ('"over": "flow"', '"__proto__": {}, "over": "flow"'),
    ):
        assert old in text
        yield f"{new:.40} in place of {old}", text.replace(old, new, 1).encode()
    for what, content in {
        "nothing": "",
        "spaces": " \n ",
        "a list": "[]",
        "no JSON": "not json",
        "half a file": text[:-9],
    }.items():
        yield what, content.encode()
    yield "a number of 10000 digits", b"9" * 10_000
    yield "a byte that is no UTF-8", text.replace('"about": {}', '"about": {"g": "?"}').encode().replace(b"?", b"\xff")
    yield "a byte order mark", b"\xef\xbb\xbf" + text.encode()
    yield "UTF-16", text.encode("utf-16")
    yield "a file of 20 MB", text.encode() + b" " * 2 * 10**7


def equals() -> Iterator[tuple[str, dict[str, Any], list[str]]]:
    """True files with expressions that are written twice, and what is concluded."""
    file = stable()
    c = file.symbol("c", "constant", numbers=[["0", "1"]])
    file.term("dissipated", file.vector(-1), file.vector(file.instruction("sub", c, c)))
    yield "a weight c - c", file.data, ["x goes to zero"]

    file = File()
    x, c = file.symbol("x", "state"), file.symbol("c", "constant", numbers=[["1", "3"]])
    two = file.number("2")
    first, second = (file.instruction("sub", c, two) for _ in range(2))
    weight = file.instruction("mul", first, second)
    loss = file.instruction("mul", weight, x)
    file.data["rates"]["x"] = file.vector(file.instruction("sub", file.number("0"), loss))
    file.term("stored", file.vector(x), file.vector(file.number("1")))
    file.term("dissipated", file.vector(x), file.vector(weight))
    concluded(file.data, file.vector(x), "is bounded")
    yield "a weight (c - 2) (c - 2)", file.data, ["w is bounded"]

    file = File()
    places = file.states(x="-1 x", y="+1 y")
    waves = [file.instruction("mul", file.instruction("tanh", places["y"]), places["y"]) for _ in range(2)]
    total = file.instruction("sub", file.instruction("add", places["x"], waves[0]), waves[1])
    file.term("stored", file.vector(total), file.vector(file.number("1")))
    file.term("dissipated", file.vector(places["x"]), file.vector(file.number("1")))
    concluded(file.data, file.vector(places["x"]), "is bounded")
    yield "V of x + tanh(y) y - tanh(y) y", file.data, ["w is bounded"]

    file = File()
    z, c, one = file.vector(file.states(z="-1 z")["z"]), file.vector(file.symbol("c", "constant")), file.number("1")
    file.term("stored", c, file.vector(one))
    file.data["stable"] = [{"vector": z, "weight": file.vector(one), "loss": file.vector(one)}]
    concluded(file.data, z)
    yield "a linear equation whose force is zero", file.data, ["w goes to zero"]
