"""Small certificates that are written by hand."""

from __future__ import annotations

from typing import Any, Final

LISTS: Final = ("symbols", "vectors", "terms", "projections", "masses", "linear", "ranks", "steps", "conditions")


class File:
    """A certificate that is written by hand: symbols of one element, and a program."""

    def __init__(self, over: str = "flow") -> None:
        self.names = ["const", "input", "add", "sub", "mul", "div", "sin", "tanh"]
        program: dict[str, list[Any]] = {"operations": self.names, "code": [], "a": [], "b": [], "constants": []}
        self.data: dict[str, Any] = {"format": "dmframe-certificate", "version": 3, "about": {}, "over": over}
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
        self.data["vectors"].append([len(places), list(places)])
        return len(self.data["vectors"]) - 1

    def term(self, role: str, vector: int, weight: int, assumed: str | None = None) -> None:
        parts, name = {"vector": vector, "weight": weight}, f"{role} {len(self.data['terms'])}"
        item = {"name": name, "role": role, "rule": "square", "parts": parts, "assumed": assumed, "phi": None}
        self.data["terms"].append(item)

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


def constant(data: dict[str, Any], *values: str, rows: int = 0) -> int:
    """A new vector of numbers."""
    program, places = data["program"], []
    for value in values:
        program["constants"].append(value)
        program["code"].append(program["operations"].index("const"))
        program["a"].append(len(program["constants"]) - 1)
        program["b"].append(0)
        places.append(len(program["code"]) - 1)
    data["vectors"].append([rows or len(places), places])
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
    ca, cb = (file.symbol(f"{label}, correction", "projection") for label in "ab")
    one = {"a": a, "b, correction": cb}[nominal]
    zero, low, high = (file.vector(file.number(text)) for text in ("0", "-9", "9"))
    unit = file.vector(file.number("1"))
    product = file.instruction
    moved = product("add", product("mul", a, one), product("mul", b, ca))
    slow = product("sub", product("sub", file.number("0"), x), product("div", moved, x))
    rates = {"a": product("add", one, ca), "b": product("add", ca, cb), "x": slow}
    file.data["rates"] = {label: file.vector(place) for label, place in rates.items()}
    for place in (a, b, x):
        file.term("stored", file.vector(place), unit)
    file.term("dissipated", file.data["terms"][2]["parts"]["vector"], unit)
    own = {"set": "box", "true": zero, "lower": low, "upper": high}
    for k, label in enumerate("ab"):
        item = {"term": k, "state": label, **own}
        file.data["projections"].append(item)
    concluded(file.data, file.data["rates"]["a"], "is bounded")
    return file.data
