"""Files that would prove a false theorem: a third round of attacks, written with the checkers' source at hand.

An entry is a name, the file, and what is allowed: outcomes; ``w``: the statement about w is not shown; ``assumes
TEXT``: the result lists an assumption that contains the text; ``robot TEXT``: so does what it says of the robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from tests.framework.checker.attacks import Attack
from tests.framework.checker.certificates import certificate, replaced
from tests.framework.checker.written import File, concluded, stable


def false_theorems() -> Iterator[Attack]:
    """All of them."""
    return chain(_words(), _functions(), _constants(), _bodies(), _linear(), _numbers())


def _words() -> Iterator[Attack]:
    """What the result says must be what was shown, word by word."""
    for name in ("w\nconclusions:\n  y", "w\x1b[2K", "\u202ew", "\ud800", "w\u2028y", "w\u00a0y", "\x00"):
        file = stable()
        file.data["conclusions"][0]["signal"] = name
        yield f"the name of a signal {name!a}", file.data, "refused"
        file = stable()
        file.condition(None, name)
        yield f"the name of a condition {name!a}", file.data, "refused"
        file = stable()
        file.data["assumed"] = [name]
        yield f"an assumption {name!a}", file.data, "refused"
        file = stable()
        file.symbol(name, "parameter")
        yield f"a label {name!a}", file.data, "refused"
        file = File()
        x = file.vector(file.states(x="-1 x")["x"])
        file.term("stored", x, file.vector(file.instruction("tanh", 0)), assumed=name)
        yield f"the reason of a weight {name!a}", file.data, "refused"

    file = stable()
    y = file.vector(file.symbol("y", "state"))
    file.data["rates"]["y"] = file.vector(file.number("1"))
    concluded(file.data, y, signal="x")
    yield "two conclusions of the same words, of which one holds", file.data, "refused"

    data = certificate("ur10_slow_repetitive")
    concluded(data, 0)
    yield "a conclusion about a signal over samples", data, "w"
    data = stable().data
    data["conclusions"].append({"signal": "w", "says": "never leaves the workspace", "vector": None})
    yield "a conclusion of an unknown kind", data, "w"
    file = stable()
    x = file.vector(file.data["vectors"][0][1][0])
    file.term("residual", x, file.vector(-1))
    concluded(file.data, x)
    yield "a conclusion next to a residual", file.data, "w"


def _functions() -> Iterator[Attack]:
    file = stable()
    file.names.append("log")
    x = file.data["vectors"][0][1][0]
    concluded(file.data, file.vector(file.instruction("log", x)), "is bounded")
    yield "the logarithm of what goes to zero is bounded", file.data, "assumes arguments of logarithms stay away"

    file = stable()
    y = file.symbol("y", "state")
    file.data["rates"]["y"] = file.vector(file.instruction("mul", y, y))
    yield "x goes to zero, but another state is infinite before", file.data, "assumes solutions exist for all time"

    for name in ("fmin", "floor", "if_else_zero"):
        file = stable()
        file.names.append(name)
        y = file.symbol("y", "state")
        file.data["rates"]["y"] = file.vector(file.number("1"))
        concluded(file.data, file.vector(file.instruction(name, y, y)), "is bounded")
        yield f"{name} of a state that grows", file.data, "w"

    file = stable()
    t = file.symbol("t", "time")
    wave = file.instruction("sin", file.instruction("mul", t, t))
    x = file.data["vectors"][file.data["rates"]["x"]][1][0]
    file.data["rates"]["x"] = file.vector(file.instruction("mul", x, wave))
    yield "a rate that changes its sign", file.data, "refuted"

    file = File()
    x, t = file.states(x="-1 x")["x"], file.symbol("t", "time")
    one = file.vector(file.number("1"))
    file.term("stored", file.vector(x), file.vector(t))
    file.term("dissipated", file.vector(x), one)
    yield "a weight that is the time", file.data, "refuted refused"


def _constants() -> Iterator[Attack]:
    """What the file calls constant, or given, is listed."""
    file = File()
    x, y = file.states(x="-1 x")["x"], file.symbol("y", "parameter", numbers=[["1", "1"]])
    one = file.vector(file.number("1"))
    file.term("stored", file.vector(x), one)
    file.term("dissipated", file.vector(x), one)
    concluded(file.data, file.vector(y), "is bounded", signal="y")
    yield "a state that is called a parameter", file.data, "assumes constant: y"

    file = stable()
    r = file.symbol("r", "trajectory")
    file.data["rates"]["r"] = file.vector(file.data["vectors"][0][1][0])
    concluded(file.data, file.vector(r), "is bounded")
    yield "a trajectory that a state moves", file.data, "refused"

    file = stable()
    file.data["rates"]["n"] = 0
    file.symbol("n", "noise")
    yield "a noise with a rate", file.data, "refused"

    file = File()
    places = file.states(x="-1 x")
    K, one = file.symbol("K", "parameter", numbers=[["0", "2"]]), file.vector(file.number("1"))
    scaled = file.vector(file.instruction("mul", K, places["x"]))
    file.term("stored", scaled, one)
    file.term("dissipated", scaled, one)
    concluded(file.data, file.vector(places["x"]))
    yield "V = (K x)^2 / 2 with K in [0, 2]", file.data, "assumes almost all values of: K"

    for ends, allowed in ((["0", "2"], "w"), (["-1/9", "2"], "refuted"), ([f"-1/{'9' * 3900}", "2"], "refuted")):
        file = File()
        x, W = file.states(x="-1 x")["x"], file.symbol("W", "parameter", numbers=[ends])
        rest = file.instruction("sub", file.number("1"), W)
        file.data["rates"]["x"] = file.vector(
            file.instruction("mul", file.instruction("sub", rest, file.number("1")), x)
        )
        file.term("stored", file.vector(x), file.vector(file.number("1")))
        file.term("dissipated", file.vector(x), file.vector(W))
        concluded(file.data, file.vector(x), "is square-integrable")
        yield f"a dissipation with a weight in [{ends[0]:.9}, {ends[1]}]", file.data, allowed


def _bodies() -> Iterator[Attack]:
    """A chain must consist of bodies, and a weight that is not decided must be its mass matrix."""
    data = certificate("arm2_joint")
    mass = data["masses"][0]
    motion = {**mass["motion"], "torque": replaced(data, mass["motion"]["torque"])}
    own = {key: replaced(data, mass[key]) for key in ("weight", "inertia")}
    rotors = mass["rotors"] if mass["rotors"] is None else replaced(data, mass["rotors"])
    data["masses"].append({**mass, **own, "rotors": rotors, "motion": motion})
    yield "a chain of negative bodies that no term uses", data, "refuted"

    for kind in ("state", "trajectory", "noise", "parameter"):
        file = File()
        x, m = file.states(x="-1 x")["x"], file.symbol("m", kind)
        if kind in ("state", "trajectory"):
            file.data["rates"]["m"] = file.vector(-1)
        weight, zero = file.vector(m), file.vector(-1)
        for role in ("stored", "dissipated"):
            file.term(role, file.vector(x), weight)
        joint = {"kind": "prismatic", "axis": ["0", "0", "1"], "rotation": list("100010001")}
        bodies = file.vector(m, *[-1] * 9)
        own = {"translations": file.vector(-1, -1, -1), "inertia": bodies, "rotors": None, "motion": None}
        file.data["masses"] = [{"weight": weight, "position": zero, **own, "joints": [joint]}]
        concluded(file.data, file.vector(x))
        yield f"a body whose mass is a {kind}", file.data, "refuted refused"

    yield "a chain whose length grows with the time", _growing().data, "refuted"

    file = stable()
    none = dict.fromkeys(("weight", "position", "translations", "inertia"), file.vector())
    file.data["masses"] = [{**none, "rotors": None, "motion": None, "joints": []}]
    yield "a chain without bodies", file.data, "refused"

    file = stable()
    x, v, m = file.symbol("q", "state"), file.symbol("v", "state"), file.symbol("m", "parameter", numbers=[["1", "1"]])
    inertia = file.symbol("I", "parameter", numbers=[["1", "1"]])
    a = file.instruction("add", x, v)
    file.data["rates"] |= {"q": file.vector(v), "v": file.vector(a)}
    bodies = file.vector(m, -1, -1, -1, inertia, -1, inertia, -1, -1, inertia)
    motion = {"velocity": file.vector(v), "acceleration": file.vector(a), "gravity": file.vector(-1, -1, -1)}
    motion["torque"] = file.vector(file.instruction("mul", m, a))
    own = {"translations": file.vector(-1, -1, -1), "inertia": bodies, "rotors": None, "motion": motion}
    joint = {"kind": "prismatic", "axis": ["0", "0", "1"], "rotation": list("100010001")}
    file.data["masses"] = [{"weight": file.vector(m), "position": file.vector(x), **own, "joints": [joint]}]
    yield "a torque that is what the acceleration needs", file.data, "robot a torque of m, q, v"


def _growing() -> File:
    """V = |(a, b)|^2 in the mass matrix of a slide at the end of an arm of the length L, with L and b unbounded.

    2 V = 2 a^2 + (L a + b)^2 is constant with da/dt = 0, db/dt = -a, dL/dt = 1.
    """
    file = File()
    a, b, L = (file.symbol(label, "state") for label in "abL")
    one, zero = file.number("1"), file.number("0")
    rates = {"a": -1, "b": file.instruction("sub", zero, a), "L": one}
    file.data["rates"] = {label: file.vector(place) for label, place in rates.items()}
    first = file.instruction("add", file.number("2"), file.instruction("mul", L, L))
    weight = file.vector(first, L, L, one)
    file.term("stored", file.vector(a, b), weight)
    body = [one, -1, -1, -1, one, -1, one, -1, -1, one]  # of mass 1, with the inertia 1 about each axis
    own = {"inertia": file.vector(*body, *body), "rotors": None, "motion": None}
    arm = {"kind": "revolute", "axis": ["0", "0", "1"], "rotation": list("100010001")}
    slide = {"kind": "prismatic", "axis": ["0", "1", "0"], "rotation": list("100010001")}
    own |= {"translations": file.vector(-1, -1, -1, L, -1, -1), "joints": [arm, slide]}
    file.data["masses"] = [{"weight": weight, "position": file.vector(-1, -1), **own}]
    concluded(file.data, file.vector(b), "is bounded")
    return file


def _linear() -> Iterator[Attack]:
    file = stable()
    places = file.states(y="-1 y +2 z", z="+2 y -1 z")
    y, z, rate = file.vector(places["y"]), file.vector(places["z"]), file.vector(file.number("-1"))
    file.data["linear"] = [{"vectors": [own], "rates": [[rate]]} for own in (y, z)]
    concluded(file.data, y, "is bounded")
    yield "two linear equations that drive each other", file.data, "w"

    for vectors, rates in (([], []), ([y], []), ([y], [[]]), ([y], [[rate, rate]]), ([y, z], [[rate], [rate]])):
        file = stable()
        places = file.states(y="-1 y +2 z", z="+2 y -1 z")
        file.vector(places["y"]), file.vector(places["z"]), file.vector(file.number("-1"))
        file.data["linear"] = [{"vectors": vectors, "rates": rates}]
        concluded(file.data, y, "is bounded")
        yield f"a linear equation with {len(vectors)} vectors and the rates {rates}", file.data, "w refused"

    file = stable()
    x, y = file.data["vectors"][0][1][0], file.symbol("y", "state")
    file.data["rates"]["y"] = file.vector(y)
    wide, long = file.vector(x, y), file.vector(x, y, x)
    file.data["linear"] = [{"vectors": [wide, wide], "rates": [[wide, long], [wide, wide]]}]
    yield "a linear equation with vectors of two sizes", file.data, "refused"

    file = stable()
    y = file.vector(file.symbol("y", "state"))
    file.data["rates"]["y"] = file.vector(file.number("1"))
    empty = file.data["vectors"].append([1, []]) or len(file.data["vectors"]) - 1
    file.data["ranks"] = [{"name": "R", "matrix": empty, "vector": y}]
    concluded(file.data, y)
    yield "a matrix of full rank without columns", file.data, "w refused"


def _numbers() -> Iterator[Attack]:
    for exponent in (140, 300, 600):
        file = stable()
        x = power = file.data["vectors"][0][1][0]
        for _ in range(exponent):
            power = file.instruction("mul", power, power)
        rate = file.data["vectors"][file.data["rates"]["x"]][1][0]
        wrong = file.instruction("sub", power, x)
        file.data["rates"]["x"] = file.vector(file.instruction("add", rate, wrong))
        yield f"a rate that is wrong by x^(2^{exponent}) - x", file.data, "refuted refused"

    for size in (-1, 0.5, "1", True, None, 10**30):
        data = stable().data
        data["symbols"][0]["size"] = size
        yield f"a symbol of the size {size!r}", data, "refused"

    file = File()
    file.symbol("x", "state", size=0)
    file.data["rates"]["x"] = file.vector()
    file.term("stored", file.vector(), file.vector())
    concluded(file.data, file.vector())
    yield "a state without elements", file.data, "refused refuted"

    for numbers in ([], [["1"]], [["1", "1", "1"]], [["1", "1"], ["1", "1"]], "11", [[1, 1]], {"0": "1"}):
        file = stable()
        file.symbol("K", "parameter", numbers=numbers)
        yield f"the numbers {numbers}", file.data, "refused"
    file = stable()
    file.symbol("K", "parameter", numbers=[["1", "2"]], exact=True)
    yield "an interval that is exact", file.data, "refused"
    file = stable()
    file.symbol("y", "state", numbers=[["1", "1"]])
    yield "numbers of a state", file.data, "refused"
