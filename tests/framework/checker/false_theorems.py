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
    return chain(_words(), _functions(), _constants(), _bodies(), _chains(), _linear(), _numbers())


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
        file.symbol(name, "constant")
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
    x = file.vector(file.data["vectors"][0][0])
    file.term("residual", x, file.vector(-1))
    concluded(file.data, x)
    yield "a conclusion next to a residual", file.data, "w"


def _functions() -> Iterator[Attack]:
    file = stable()
    file.names.append("log")
    x = file.data["vectors"][0][0]
    concluded(file.data, file.vector(file.instruction("log", x)), "is bounded")
    yield "the logarithm of what goes to zero is bounded", file.data, "assumes arguments of logarithms stay away"

    file = stable()
    y = file.symbol("y", "state")
    file.data["rates"]["y"] = file.vector(file.instruction("mul", y, y))
    yield "x goes to zero, but another state is infinite before", file.data, "assumes solutions exist for all time"

    yield "a box that moves", _moving_box().data, "refused"

    for name in ("fmin", "floor", "if_else_zero"):
        file = stable()
        file.names += [name] * (name not in file.names)
        y = file.symbol("y", "state")
        file.data["rates"]["y"] = file.vector(file.number("1"))
        concluded(file.data, file.vector(file.instruction(name, y, y)), "is bounded")
        yield f"{name} of a state that grows", file.data, "w"

    file = stable()
    t = file.symbol("t", "time")
    wave = file.instruction("sin", file.instruction("mul", t, t))
    x = file.data["vectors"][file.data["rates"]["x"]][0]
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
    x, y = file.states(x="-1 x")["x"], file.symbol("y", "constant", numbers=[["1", "1"]])
    one = file.vector(file.number("1"))
    file.term("stored", file.vector(x), one)
    file.term("dissipated", file.vector(x), one)
    concluded(file.data, file.vector(y), "is bounded", signal="y")
    yield "a state that is called a parameter", file.data, "assumes constant: y"

    file = stable()
    r = file.symbol("r", "given")
    file.data["rates"]["r"] = file.vector(file.data["vectors"][0][0])
    concluded(file.data, file.vector(r), "is bounded")
    yield "a trajectory that a state moves", file.data, "refused"

    file = stable()
    file.data["rates"]["n"] = 0
    file.symbol("n", "constant")
    yield "a constant with a rate", file.data, "refused"

    file = File()
    places = file.states(x="-1 x")
    K, one = file.symbol("K", "constant", numbers=[["0", "2"]]), file.vector(file.number("1"))
    scaled = file.vector(file.instruction("mul", K, places["x"]))
    file.term("stored", scaled, one)
    file.term("dissipated", scaled, one)
    concluded(file.data, file.vector(places["x"]))
    yield "V = (K x)^2 / 2 with K in [0, 2]", file.data, "assumes almost all values of: K"

    for ends, allowed in ((["0", "2"], "w"), (["-1/9", "2"], "refuted"), ([f"-1/{'9' * 3900}", "2"], "refuted")):
        file = File()
        x, W = file.states(x="-1 x")["x"], file.symbol("W", "constant", numbers=[ends])
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
    robot = data["robots"][0]
    joints = [{**joint, "body": replaced(data, joint["body"])} for joint in robot["joints"]]
    own = {key: replaced(data, robot[key]) for key in ("rotors", "torque")}
    data["robots"].append({**robot, "joints": joints, **own})
    yield "a chain of negative bodies that no term uses", data, "refuted"

    for kind in ("state", "given", "constant"):
        file = File()
        x, m = file.states(x="-1 x")["x"], file.symbol("m", kind)
        if kind != "constant":
            file.data["rates"]["m"] = file.vector(-1)
        weight = file.vector(m)
        for role in ("stored", "dissipated"):
            file.term(role, file.vector(x), weight)
        concluded(file.data, file.vector(x))
        yield f"the energy of a body whose mass is a {kind}", file.data, "refuted"

    for kind in ("revolute", "prismatic"):
        yield f"a {kind} joint whose arm grows with the time", _growing(kind).data, "w"

    file = stable()
    file.symbol("q", "state", size=0)
    file.data["rates"]["q"] = none = file.vector()
    file.data["robots"] = [{"position": "q", "joints": [], "rotors": none, "gravity": none, "torque": none}]
    yield "a chain without bodies", file.data, "refused"

    file = stable()
    x, v, m = file.symbol("q", "state"), file.symbol("v", "state"), file.symbol("m", "constant", numbers=[["1", "1"]])
    a = file.instruction("add", x, v)
    file.data["rates"] |= {"q": file.vector(v), "v": file.vector(a)}
    one = file.number("1")
    body = file.vector(one, -1, one, -1, -1, one, -1, -1, -1, m)
    place = file.vector(one, -1, -1, -1, one, -1, -1, -1, one, -1, -1, x)
    joint = {"kind": "prismatic", "axis": file.vector(-1, -1, one), "place": place, "body": body}
    own = {"rotors": file.vector(-1), "gravity": file.vector(-1, -1, -1)}
    torque = file.vector(file.instruction("mul", m, a))
    file.data["robots"] = [{"position": "q", "joints": [joint], **own, "torque": torque}]
    yield "a torque that is what the acceleration needs", file.data, "robot a torque of m, q, v"


def _chains() -> Iterator[Attack]:
    """A joint turns about a constant axis, bodies and gravity do not move by themselves, and positions are states."""
    yield "a chain that turns about a constant axis", _turning().data, "robot q: a chain of 1 rigid bodies"
    file = _turning()
    robot, half = file.data["robots"][0], file.number("1/2")
    slow, body = file.data["vectors"][file.data["rates"]["v"]][0], file.data["vectors"][robot["joints"][0]["body"]]
    robot["joints"][0]["body"] = file.vector(*body[:6], half, *body[7:])  # it is heavier on one side
    arm = file.instruction("mul", half, file.instruction("cos", 0))
    pull = file.instruction("div", file.instruction("mul", file.number("2"), slow), arm)
    robot |= {"gravity": file.vector(-1, pull, -1), "torque": file.vector(-1)}
    yield "gravity that moves a body without a torque as the states decide", file.data, "refused"
    yield "a joint whose axis moves with it", _turning(moving=True).data, "refused"
    file = _turning()
    for item in file.data["symbols"]:
        item["kind"] = "given"
    yield "a chain whose positions are given", file.data, "refuted"
    file = _turning()
    file.data["rates"]["q"] = file.vector(file.instruction("mul", file.number("-1"), 0))
    for term in file.data["terms"]:
        term["parts"] = {"vector": file.vector(0), "weight": file.vector(file.number("1"))}
    file.data["robots"][0]["torque"] = file.vector(file.instruction("mul", file.number("2"), 0))
    concluded(file.data, file.vector(0))
    yield "a chain whose speed is -q, with a torque 2 q that repels it", file.data, "refuted"
    file = _turning()
    q, s = 0, file.symbol("s", "state")
    file.data["rates"]["s"] = file.vector(-1)
    product = file.instruction("mul", q, s)
    twice = file.instruction("add", product, product)
    nothing = file.instruction("sub", twice, file.instruction("mul", product, file.number("2")))
    joint = file.data["robots"][0]["joints"][0]
    joint["place"] = file.vector(*file.data["vectors"][joint["place"]][:9], nothing, -1, -1)
    yield "a transform that names another state", file.data, "refused"


def _turning(*, moving: bool = False) -> File:
    """A sphere with the inertia 2 about each axis, which turns about z, with the acceleration -q - v.

    With `moving` it turns by the rotation Rz(3 q/5) Rx(4 q/5): the axis (4, 3 sin(4 q/5), 3 cos(4 q/5))/5 has unit
    length and obeys dA/dq = A K, but is not constant.
    """
    file = File()
    file.names.append("cos")
    q, v = (file.symbol(label, "state") for label in "qv")
    make, zero, one = file.instruction, -1, file.number("1")

    def scaled(factor: str, place: int) -> int:
        return make("mul", file.number(factor), place)

    turns = [scaled("3/5", q), scaled("4/5", q)] if moving else [q]
    (ca, sa), (cb, sb) = ([(make("cos", x), make("sin", x)) for x in turns] + [(one, zero)])[:2]
    columns, axis = [ca, sa, zero, scaled("-1", sa), ca, zero, zero, zero, one], [zero, zero, one]
    if moving:
        columns[3:] = [scaled("-1", make("mul", sa, cb)), make("mul", ca, cb), sb]
        columns += [make("mul", sa, sb), scaled("-1", make("mul", ca, sb)), cb]
        axis = [file.number("4/5"), scaled("3/5", sb), scaled("3/5", cb)]
    slow = make("sub", scaled("-1", q), v)
    file.data["rates"] = {"q": file.vector(v), "v": file.vector(slow)}
    file.term("stored", file.vector(q, v), file.vector(one, one))
    file.term("dissipated", file.vector(v), file.vector(one))
    body = file.vector(one, zero, one, zero, zero, one, zero, zero, zero, one)
    place = file.vector(*columns, zero, zero, zero)
    joint = {"kind": "revolute", "axis": file.vector(*axis), "place": place, "body": body}
    own = {"rotors": file.vector(zero), "gravity": file.vector(zero, zero, zero)}
    torque = file.vector(scaled("2", slow))
    file.data["robots"] = [{"position": "q", "joints": [joint], **own, "torque": torque}]
    return file


def _moving_box() -> File:
    """An estimate whose box begins at another one, b, which moves as fast as the time: so does its correction.

    V = (e^2 + (b - 1/2)^2 + (a - 2)^2) / 2 has the rates da/dt = c_a, db/dt = t e + c_b, de/dt = -e - t (b - 1/2).
    """
    file = File()
    a, b, e = (file.symbol(label, "state") for label in "abe")
    ca, cb = (file.symbol(f"{label}, correction", "correction") for label in "ab")
    t, one, make = file.symbol("t", "time"), file.vector(file.number("1")), file.instruction
    errors = [e, make("sub", b, file.number("1/2")), make("sub", a, file.number("2"))]
    pushed = make("add", e, make("mul", t, errors[1]))
    rates = {"a": ca, "b": make("add", make("mul", t, e), cb), "e": make("sub", file.number("0"), pushed)}
    file.data["rates"] = {label: file.vector(place) for label, place in rates.items()}
    for error in errors:
        file.term("stored", file.vector(error), one)
    file.term("dissipated", file.vector(e), one)
    file.projected(b, cb, "0", "1", true="1/2")
    file.projected(a, ca, "0", "5", true="2")
    file.data["terms"][-1]["parts"]["lower"] = file.vector(b)
    concluded(file.data, file.vector(ca), "is bounded")
    return file


def _growing(kind: str) -> File:
    """V = (a^2 + s^2 + (L a + b)^2) / 2, an energy with an arm of the length L, which grows: V is constant, b is not.

    a is the speed of a revolute joint, and b that of a slide across its arm. For a prismatic joint, L has the speed s.
    """
    file = File()
    a, b, L, s = (file.symbol(label, "state") for label in ("a", "b", "L", "s"))
    one, zero = file.number("1"), file.number("0")
    speed = s if kind == "prismatic" else one
    lost = file.instruction("sub", zero, file.instruction("mul", speed, a))
    rates = {"a": -1, "b": lost, "L": speed, "s": -1}
    file.data["rates"] = {label: file.vector(place) for label, place in rates.items()}
    across = file.instruction("add", file.instruction("mul", L, a), b)
    file.term("stored", file.vector(a, s, across), file.vector(one, one, one))
    concluded(file.data, file.vector(b), "is bounded")
    return file


def _linear() -> Iterator[Attack]:
    file = stable()
    places = file.states(y="-1 y +2 z", z="+2 y -1 z")
    y, z, one = file.vector(places["y"]), file.vector(places["z"]), file.vector(file.number("1"))
    file.data["stable"] = [{"vector": own, "weight": one, "loss": one} for own in (y, z)]
    concluded(file.data, y, "is bounded")
    yield "two linear equations that drive each other", file.data, "w"

    for weight, loss, y_rate, z_rate, allowed in (
        ("", "1 1", "-1 y", "-1 z", "refused"),
        ("1 1", "1", "-1 y", "-1 z", "refused"),
        ("1 1 1", "1 1", "-1 y", "-1 z", "refused"),
        ("1 1", "1 1 1 1 1", "-1 y", "-1 z", "refused"),
        ("1 1", "-1 1", "+1 y", "-1 z", "w"),
        ("-1 -1", "1 1", "+1 y", "+1 z", "w"),
        ("1 2 2 1", "1 1", "+1/3 y -2/3 z", "-2/3 y +1/3 z", "w"),  # it is not positive
        ("1 -2 2 1", "1 2 -2 1", "+3/5 y +4/5 z", "-4/5 y +3/5 z", "w"),  # it is not symmetric
    ):
        file = File()
        places = file.states(x="-1 x", y=y_rate, z=z_rate)
        x, unit = file.vector(places["x"]), file.vector(file.number("1"))
        file.term("stored", x, unit)
        file.term("dissipated", x, unit)
        both = file.vector(places["y"], places["z"])
        own = {key: file.vector(*map(file.number, text.split())) for key, text in (("weight", weight), ("loss", loss))}
        file.data["stable"] = [{"vector": both, **own}]
        concluded(file.data, both, "is bounded")
        yield f"a linear equation with the weight ({weight}) and the loss ({loss})", file.data, allowed

    file = stable()
    y, K = file.symbol("y", "state"), file.symbol("K", "state")
    grown = file.instruction("mul", K, K)
    file.data["rates"] |= {"y": file.vector(y), "K": file.vector(K)}
    one = file.vector(file.number("1"))
    file.data["stable"] = [{"vector": file.vector(y), "weight": file.vector(grown), "loss": one}]
    concluded(file.data, file.vector(y), "is bounded")
    yield "a linear equation whose weight is a state", file.data, "w"

    file = stable()
    y = file.vector(file.symbol("y", "state"))
    file.data["rates"]["y"] = file.vector(file.number("1"))
    empty = file.vector()
    file.data["ranks"] = [{"name": "R", "matrix": empty, "vector": y}]
    concluded(file.data, y)
    yield "a matrix of full rank without columns", file.data, "w refused"


def _numbers() -> Iterator[Attack]:
    for exponent in (140, 300, 600):
        file = stable()
        x = power = file.data["vectors"][0][0]
        for _ in range(exponent):
            power = file.instruction("mul", power, power)
        rate = file.data["vectors"][file.data["rates"]["x"]][0]
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
        file.symbol("K", "constant", numbers=numbers)
        yield f"the numbers {numbers}", file.data, "refused"
    file = stable()
    file.symbol("K", "constant", numbers=[["1", "2"]], exact=True)
    yield "an interval that is exact", file.data, "refused"
    file = stable()
    file.symbol("y", "state", numbers=[["1", "1"]])
    yield "numbers of a state", file.data, "refused"
