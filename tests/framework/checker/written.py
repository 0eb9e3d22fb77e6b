"""Small certificates that are written by hand."""

from __future__ import annotations

from typing import Any, Final

LISTS: Final = ("symbols", "vectors", "terms", "robots", "stable", "ranks", "conditions")


class File:
    """A certificate that is written by hand: symbols of one element, and a program."""

    def __init__(self, over: str = "flow") -> None:
        self.names = ["const", "input", "add", "sub", "mul", "div", "sin", "tanh", "fmin", "fmax"]
        program: dict[str, list[Any]] = {"operations": self.names, "code": [], "a": [], "b": [], "constants": []}
        self.data: dict[str, Any] = {"format": "dmframe-certificate", "version": 4, "about": {}, "over": over}
        self.data |= {key: [] for key in (*LISTS, "conclusions", "assumed")}
        self.data |= {"program": program, "rates": {}}

    def instruction(self, name: str, a: int, b: int = 0) -> int:
        for key, value in (("code", self.names.index(name)), ("a", a), ("b", b)):
            self.data["program"][key].append(value)
        return len(self.data["program"]["code"]) - 1

    def symbol(self, label: str, kind: str, numbers: Any = None, *, size: int = 1, exact: bool = False) -> int:
        item = {"label": label, "kind": kind, "size": size, "numbers": numbers, "exact": exact}
        self.data["symbols"].append(item)
        return self.instruction("input", len(self.data["symbols"]) - 1)

    def number(self, value: str) -> int:
        self.data["program"]["constants"].append(value)
        return self.instruction("const", len(self.data["program"]["constants"]) - 1)

    def vector(self, *places: int) -> int:
        self.data["vectors"].append(list(places))
        return len(self.data["vectors"]) - 1

    def term(self, role: str, vector: int, weight: int, assumed: str | None = None) -> None:
        self.rule("square", role, {"vector": vector, "weight": weight}, assumed)

    def rule(self, rule: str, role: str, parts: dict[str, int], assumed: str | None = None) -> None:
        name = f"{role} {len(self.data['terms'])}"
        self.data["terms"].append({"name": name, "role": role, "rule": rule, "parts": parts, "assumed": assumed})

    def projected(self, state: int, correction: int, low: str, high: str, true: str = "0") -> None:
        """A projected estimate of one element, whose error has the weight 1 in V."""
        ends = {"true": true, "lower": low, "upper": high, "weight": "1"}
        parts = {"vector": self.vector(state), "correction": self.vector(correction)}
        self.rule("projected", "dissipated", parts | {key: self.vector(self.number(x)) for key, x in ends.items()})

    def condition(self, margin: int | None, name: str = "open", *, strict: bool = True) -> None:
        self.data["conditions"].append({"name": name, "margin": margin, "strict": strict})

    def states(self, **rates: str) -> dict[str, int]:
        """States with a rate that is a sum of multiples of states: ``x="-1 x +2 y"``."""
        places = {label: self.symbol(label, "state") for label in rates}
        for label, text in rates.items():
            words, total = text.split(), self.number("0")
            for factor, other in zip(words[::2], words[1::2], strict=True):
                own = self.instruction("mul", self.number(factor.lstrip("+")), places[other])
                total = self.instruction("add", total, own)
            self.data["rates"][label] = self.vector(total)
        return places


def concluded(data: dict[str, Any], vector: int, says: str = "goes to zero", signal: str = "w") -> None:
    """Add a conclusion about a signal."""
    data["conclusions"].append({"signal": signal, "says": says, "vector": vector})


def constant(data: dict[str, Any], *values: str) -> int:
    """A new vector of numbers."""
    program, places = data["program"], []
    for value in values:
        program["constants"].append(value)
        program["code"].append(program["operations"].index("const"))
        program["a"].append(len(program["constants"]) - 1)
        program["b"].append(0)
        places.append(len(program["code"]) - 1)
    data["vectors"].append(places)
    return len(data["vectors"]) - 1


def stable() -> File:
    """dx/dt = -x with V = x^2 / 2: a true file."""
    file = File()
    x, one = file.vector(file.states(x="-1 x")["x"]), file.vector(file.number("1"))
    file.term("stored", x, one)
    file.term("dissipated", x, one)
    concluded(file.data, x, signal="x")
    return file


def dominated(c: str = "3/5", *, off: str = "") -> File:
    """dx/dt = -x + c (x + y), dy/dt = -y + c (x + y) is unstable for c = 3/5.

    The dissipation is that of the matrix 1 - c [1 1; 1 1], with `off` in place of its element (2, 1).
    """
    file = File()
    total = {"3/5": "2/5", "1/5": "4/5"}[c]
    places = file.states(x=f"-{total} x +{c} y", y=f"-{total} y +{c} x")
    x, both = file.vector(places["x"]), file.vector(places["x"], places["y"])
    file.term("stored", both, file.vector(file.number("1"), file.number("1")))
    matrix = (total, off or f"-{c}", f"-{c}", total)
    file.term("dissipated", both, file.vector(*map(file.number, matrix)))
    concluded(file.data, x)
    return file


def circular(*, nominal: str) -> dict[str, Any]:
    """A true identity with two estimates a and b; the rate of a is that of the symbol `nominal`, plus its correction.

    V = (a^2 + b^2 + x^2) / 2, da/dt = nominal + c_a, db/dt = c_a + c_b, dx/dt = -x - (a nominal + b c_a) / x.
    """
    file = File()
    a, b, x = (file.symbol(label, "state") for label in "abx")
    ca, cb = (file.symbol(f"{label}, correction", "correction") for label in "ab")
    one = {"a": a, "b, correction": cb}[nominal]
    unit = file.vector(file.number("1"))
    product = file.instruction
    moved = product("add", product("mul", a, one), product("mul", b, ca))
    slow = product("sub", product("sub", file.number("0"), x), product("div", moved, x))
    rates = {"a": product("add", one, ca), "b": product("add", ca, cb), "x": slow}
    file.data["rates"] = {label: file.vector(place) for label, place in rates.items()}
    for place in (a, b, x):
        file.term("stored", file.vector(place), unit)
    file.term("dissipated", file.data["terms"][2]["parts"]["vector"], unit)
    for state, correction in ((a, ca), (b, cb)):
        file.projected(state, correction, "-9", "9")
    concluded(file.data, file.data["rates"]["a"], "is bounded")
    return file.data


def sampled(true: str = "0") -> File:
    """theta+ = theta + (y - theta) / 2 in the box [-1, 1], from sample to sample: a true file where it contains `true`.

    It is the normalised step of the row h = 1 with a gain and a floor of 1, so that n = 2.
    """
    file = File("sample")
    theta, y, make = file.symbol("theta", "state"), file.symbol("y", "given"), file.instruction
    half, value, one = file.number("1/2"), file.number(true), file.vector(file.number("1"))
    ends, halves = [file.number(text) for text in ("-1", "1")], file.vector(half, half)
    error, unexplained = make("sub", theta, value), make("sub", y, value)
    step = make("mul", make("sub", y, theta), half)
    z = make("add", theta, step)
    x = make("fmin", make("fmax", z, ends[0]), ends[1])
    correction = file.vector(make("sub", x, z))
    file.term("stored", file.vector(error), one)
    for role, own in (("dissipated", error), ("residual", unexplained)):
        scaled = make("mul", own, half)
        file.term(role, file.vector(scaled, scaled), halves)
    file.term("dissipated", file.vector(step), file.vector(half))
    file.term("dissipated", correction, file.vector(half))
    parts = {"vector": file.vector(z), "correction": correction, "true": file.vector(value), "weight": one}
    file.rule("projected", "dissipated", parts | {"lower": file.vector(ends[0]), "upper": file.vector(ends[1])})
    file.data["rates"]["theta"] = file.vector(x)
    return file
