"""Checks the certificate of a control loop: ``python check.py FILE [--json]``.

``dmframe verify GRAPH --certificate FILE`` writes the file. This program needs Python's standard library alone, and
shares no code with dmframe or ``check.js``. The page ``docs/explanation/checker.md`` proves each rule.

Exit status: 0 re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).

A certificate contains symbols x (states, trajectories, parameters), a program of their functions, the rates dx/dt (or
the next values x+), and terms. It states that

    V = 1/2 sum_k w_k T_k,   dV/dt = - sum w_k d_k + sum cross terms + sum residual + projection terms

holds identically, or the same for V(x+) - V(x). T_k and d_k are formed from vectors and weights by a rule. The file
contains no value of V and no derivative. In the order of this program:

1. Expressions, their derivatives, and their values: modulo a prime, and in intervals.
2. The certificate, its terms, its robot, and its steps from sample to sample.
3. The identity. A fraction of polynomials that is not identically zero vanishes at a random point with a probability of
   at most 8 (D + H) / 2^bits, where D and H bound its degree and its coefficients.
4. Signs of weights, boxes and conditions, and the small gain, in intervals.
5. Conclusions: signals that are bounded, and those that go to zero.
"""

import json
import operator
import secrets
import sys
from fractions import Fraction
from math import log2

SIZES, WANTED, LARGEST, LONGEST = (149, 269, 521), -300, 10**6, 2 * 10**7
CONSTANT = {"parameter", "weight", "constant", "stepping"}
GIVEN = {"trajectory", "period", "noise", "command"}
KINDS = CONSTANT | GIVEN | {"time", "state", "projection"}
ARITHMETIC = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}
BOUNDED = set("sin cos tanh atan atan2 sign lt le eq not and".split())
UNARY = set("sin cos tanh atan sqrt exp log fabs sign floor not".split())
BINARY = set("fmin fmax lt le eq and if_else_zero atan2".split())
ASSUMED = (
    "names, rates and next values are those of the loop that runs",
    "divisors stay away from 0, and arguments of roots and logarithms are positive",
)


class Refused(Exception):
    """The file is no valid certificate, or contains a rule that this program does not know."""


class Refuted(Exception):
    """A statement of the file is wrong, or its data do not show it."""


class Undecided(Exception):
    """A divisor vanishes at this point, or these intervals do not decide."""


def need(condition, text):
    if not condition:
        raise Refused(text)


def show(condition, text):
    if not condition:
        raise Refuted(text)


# ---- Expressions -----------------------------------------------------------------------------------------------------


class Node:
    """A number, a symbol (value: its label and element), or an operation or function of other nodes."""

    __slots__ = ("name", "of", "value")

    def __init__(self, name, *of, value=None):
        self.name, self.of, self.value = name, of, value

    def __add__(self, other):
        return other if self is ZERO else self if other is ZERO else Node("add", self, other)

    def __sub__(self, other):
        return self if other is ZERO else Node("sub", self, other)

    def __mul__(self, other):
        if ZERO in (self, other):
            return ZERO
        return other if self is ONE else self if other is ONE else Node("mul", self, other)

    def __truediv__(self, other):
        return self * Node("inv", other)


ZERO, ONE = Node("number", value=Fraction(0)), Node("number", value=Fraction(1))
SLOPES = {
    "inv": lambda f, x: ZERO - f * f,
    "sin": lambda f, x: Node("cos", x),
    "cos": lambda f, x: ZERO - Node("sin", x),
    "tanh": lambda f, x: ONE - f * f,
    "atan": lambda f, x: ONE / (ONE + x * x),
    "sqrt": lambda f, x: ONE / (f + f),
    "exp": lambda f, x: f,
    "log": lambda f, x: ONE / x,
}


def number(value):
    return ZERO if value == 0 else ONE if value == 1 else Node("number", value=Fraction(value))


def below(nodes, known=()):
    """These nodes and those that they depend on, operands first, without known ones."""
    found, waiting = {}, list(nodes)
    while waiting:
        more = [x for x in waiting[-1].of if x not in found and x not in known]
        if more:
            waiting += more
        elif (node := waiting.pop()) not in known:
            found[node] = None
    return list(found)


def symbols(nodes):
    return {node for node in below(nodes) if node.name == "symbol"}


def rates(nodes, moves, found):
    """Derivatives, with those of symbols from the function `moves`; None where there is none. `found` keeps all."""
    for node in below(nodes, found):
        slopes = [found[x] for x in node.of]
        if node.name == "symbol":
            found[node] = moves(node)
        elif None in slopes or all(slope is ZERO for slope in slopes):
            found[node] = None if None in slopes else ZERO
        elif node.name in ("add", "sub"):
            found[node] = ARITHMETIC[node.name](*slopes)
        elif node.name == "mul":
            found[node] = slopes[0] * node.of[1] + node.of[0] * slopes[1]
        else:
            found[node] = SLOPES[node.name](node, *node.of) * slopes[0] if node.name in SLOPES else None
    return [found[node] for node in nodes]


def replaced(nodes, given):
    """The nodes with others in place of symbols."""
    found = dict(given)
    for node in below(nodes, found):
        of = [found[x] for x in node.of]
        same = all(a is b for a, b in zip(of, node.of))
        found[node] = node if same else ARITHMETIC.get(node.name, lambda *of, name=node.name: Node(name, *of))(*of)
    return [found[node] for node in nodes]


def evaluate(nodes, ring, values):
    """Values in a ring, whose elements have + - *. `values` contains given ones, and keeps all."""
    for node in below(nodes, values):
        of = [values[x] for x in node.of]
        values[node] = ring.kept(ARITHMETIC[node.name](*of)) if node.name in ARITHMETIC else ring.call(node, *of)
    return [values[node] for node in nodes]


def dot(left, right):
    first, *rest = (a * b for a, b in zip(left, right, strict=True))
    return sum(rest, first)


def plus(left, right):
    return [a + b for a, b in zip(left, right, strict=True)]


def minus(left, right):
    return [a - b for a, b in zip(left, right, strict=True)]


def product(rows, others):
    return [[dot(row, column) for column in zip(*others, strict=True)] for row in rows]


def flat(rows):
    return [x for row in rows for x in row]


def spread(item, size):
    need(len(item) in (1, size), "a diagonal: expected one number, or one for each element")
    return item * size if len(item) == 1 else item


def weighted(weight, vector):
    """W a, with W one number, a diagonal, or a matrix column by column."""
    n = len(vector)
    if len(weight) == n * n:
        return [dot(weight[i::n], vector) for i in range(n)]
    return [w * x for w, x in zip(spread(weight, n), vector, strict=True)]


class Field:
    """Residues modulo a prime. A function has a random value for each argument: what holds for all values holds for
    those of the function. sin and cos of one argument are a random point of the unit circle. If `frozen`, a bounded
    function keeps its value whatever its argument is.
    """

    def __init__(self, p, frozen=False):
        self.p, self.frozen, self.known = p, frozen, {}

    def random(self, *key):
        return self.known.setdefault(key, secrets.randbelow(self.p))

    def kept(self, value):
        return value % self.p

    def inverse(self, a):
        if a % self.p == 0:
            raise Undecided("a divisor vanishes")
        return pow(a, -1, self.p)

    def call(self, node, *given):
        name = node.name
        if name == "number":
            return node.value.numerator * self.inverse(node.value.denominator) % self.p
        if name == "symbol" or (self.frozen and name in BOUNDED - {"sin", "cos"}):
            return self.random(node)
        if name == "inv":
            return self.inverse(*given)
        if name in ("sin", "cos"):
            return self.turned(name, 1, node.of[0]) if self.frozen else self.turned(name, *given, self.size(*given))
        return self.random(name, self.size(*given)) if name == "fabs" else self.random(name, *given)

    def size(self, a):
        return min(a, -a % self.p)

    def turned(self, name, angle, key):
        if angle == 0:
            return int(name == "cos")
        t = self.random("circle", key)
        value = (1 - t * t if name == "cos" else 2 * t) * self.inverse(1 + t * t) % self.p
        return value if name == "cos" or 2 * angle < self.p else self.p - value


class Interval:
    """A rational interval, which contains all values over the intervals of the parameters. The class is the ring."""

    def __init__(self, lower, upper):
        self.lower, self.upper = lower, upper
        if max(x.numerator.bit_length() + x.denominator.bit_length() for x in (lower, upper)) > LARGEST:
            raise Undecided("a number is too long")

    def __add__(self, other):
        return Interval(self.lower + other.lower, self.upper + other.upper)

    def __sub__(self, other):
        return Interval(self.lower - other.upper, self.upper - other.lower)

    def __mul__(self, other):
        ends = [x * y for x in (self.lower, self.upper) for y in (other.lower, other.upper)]
        return Interval(max(min(ends), Fraction(0)) if self is other else min(ends), max(ends))

    def inverse(self):
        if self.lower <= 0 <= self.upper:
            raise Undecided("a divisor may vanish")
        return Interval(1 / self.upper, 1 / self.lower)

    @staticmethod
    def kept(value):
        return value

    @staticmethod
    def call(node, *given):
        if node.name == "fabs":
            (a,) = given
            return Interval(max(a.lower, -a.upper, Fraction(0)), max(-a.lower, a.upper))
        if node.name not in ("number", "inv"):
            raise Undecided(f"{node.name}: no interval")
        return given[0].inverse() if given else Interval(node.value, node.value)


# ---- The file --------------------------------------------------------------------------------------------------------

TOP = "format version about over program vectors rates assumed"
LISTS = {
    "symbols": "label kind size values? numbers?",
    "terms": "name level role rule parts assumed? phi?",
    "conditions": "name margin? strict?",
    "conclusions": "signal says assumes vector? estimate?",
}
FLOW = {
    "cross": "term by",
    "projections": "term state correction set true lower upper",
    "masses": "weight position translations inertia rotors? joints motion?",
    "linear": "vectors rates",
    "ranks": "name matrix vector",
}
SAMPLE = {"steps": "rule estimate rows sizes box parts"}
RULES = {
    "stored": {"square": "vector weight", "potential": "vector width weight"},
    "dissipated": {"square": "vector weight", "monotone": "weight first second scale"},
    "residual": {"square": "vector weight"},
    "cross": {"square": "vector weight"},
}


def keys(data, names, where):
    """The object, with None for keys that may be missing; refuses other keys."""
    need(type(data) is dict, f"{where}: expected an object")
    must, may = ({x.rstrip("?") for x in names.split() if x.endswith("?") == free} for free in (False, True))
    wrong = must - data.keys() | data.keys() - must - may
    need(not wrong, f"{where}: missing or unknown: {', '.join(sorted(wrong))}")
    return dict.fromkeys(may) | data


def at(items, k, where):
    need(type(k) is int and 0 <= k < len(items), f"{where}: there is no number {k!r:.20}")
    return items[k]


def rational(text):
    numerator, slash, denominator = text.partition("/")
    digits = numerator.removeprefix("-") + denominator
    need(len(text) < 4000 and digits.isascii() and digits.isdigit(), f"expected a fraction, found {text:.40}")
    need(numerator not in ("", "-") and (not slash or int(denominator)), f"expected a fraction, found {text:.40}")
    return Fraction(int(numerator), int(denominator or 1))


class Certificate:
    """A file that has been read: vectors of nodes, terms, and statements about them."""

    def __init__(self, data):
        need(type(data) is dict and data.get("format") == "dmframe-certificate", "no certificate of dmframe")
        need(type(data.get("version")) is int and data["version"] == 2, "version: expected 2; write the file again")
        need(data.get("over") in ("flow", "sample"), "over: expected flow or sample")
        self.samples = data["over"] == "sample"
        lists = LISTS | (SAMPLE if self.samples else FLOW)
        keys(data, " ".join((TOP, *lists)), "the file")
        need(all(type(data[name]) is list for name in (*lists, "vectors", "assumed")), "the file: expected lists")
        lists = {name: [keys(x, own, name) for x in data[name]] for name, own in lists.items()}
        self.lists = dict.fromkeys((*FLOW, *SAMPLE), ()) | lists
        self.symbols, self.kinds, self.fixed, self.numbers, self.derivatives, self.divided = {}, {}, {}, {}, {}, []
        self.assumed = list(map(str, data["assumed"]))
        texts = [x for item in lists["conclusions"] for x in (item["signal"], item["says"])]
        texts += [item["name"] for item in (*lists["conditions"], *lists["terms"], *lists.get("ranks", ()))]
        need(all(type(x) is str for x in texts), "a name: expected a text")
        need(sum(abs(item["size"]) for item in lists["symbols"]) < LARGEST, "symbols: too many elements")
        for item in lists["symbols"]:
            self.read_symbol(**item)
        program = self.read_program(**keys(data["program"], "operations code a b constants", "program"))
        places = [ZERO, *program]  # -1 is the place of a zero
        self.vectors = [(rows, [at(places, k + 1, "a vector") for k in own]) for rows, own in data["vectors"]]
        self.rates = {}
        for label, k in data["rates"].items():
            need(self.kinds.get(label) in ("state", "state" if self.samples else "trajectory"), f"{label}: a rate")
            self.rates |= dict(zip(self.symbols[label], self.vector(k), strict=True))
        self.terms = [Term(self, **item) for item in lists["terms"]]
        stored = [node for term in self.terms if term.role == "stored" for part in term.parts.values() for node in part]
        need(stored or self.lists["steps"], "V has no term")
        for node in symbols(stored):
            moves = node in self.rates or (self.kinds[node.value[0]] == "time" and not self.samples)
            need(moves or self.constant([node]), f"V depends on {node.value[0]}, which has no rate")

    def read_symbol(self, label, kind, size, values, numbers):
        need(type(label) is str and label not in self.symbols and kind in KINDS, f"{label}: twice, or an unknown kind")
        need(type(size) is int and 0 <= size < LARGEST, f"{label}: its size")
        need(size == 1 or kind not in ("time", "weight", "period"), f"{label}: expected one number")
        nodes = self.symbols[label] = [Node("symbol", value=(label, k)) for k in range(size)]
        self.kinds[label] = kind
        need(kind == "parameter" or (values is None and numbers is None), f"{label}: numbers of a {kind}")
        if values is not None:
            self.fixed |= dict(zip(nodes, map(rational, values), strict=True))
            numbers = [[x, x] for x in values]
        for node, pair in zip(nodes, numbers or (), strict=numbers is not None):
            self.numbers[node] = Interval(*map(rational, pair))
            need(self.numbers[node].lower <= self.numbers[node].upper, f"{label}: an interval with its ends exchanged")

    def read_program(self, operations, code, a, b, constants):
        labels, nodes = list(self.symbols), []
        numbers = [number(rational(x)) for x in constants]
        for k, first, second in zip(code, a, b, strict=True):
            name = at(operations, k, "an operation")
            if name == "const":
                nodes.append(at(numbers, first, "a constant"))
            elif name == "input":
                nodes.append(at(self.symbols[at(labels, first, "an input")], second, "an input"))
            else:
                x, y = at(nodes, first, "an operand"), at(nodes, second, "an operand")
                need(name in ARITHMETIC or name in UNARY or name in BINARY, f"unknown operation {name!r:.30}")
                own = Node(name, x) if name in UNARY else Node(name, x, y)
                nodes.append(ARITHMETIC[name](x, y) if name in ARITHMETIC else own)
                self.divided += [Node("inv", y)] * (name == "div")  # a divisor must not vanish, even in a part times 0
        return nodes

    def inputs(self, label, kind):
        need(self.kinds.get(label) == kind, f"{label}: expected a {kind}")
        return self.symbols[label]

    def vector(self, k):
        return at(self.vectors, k, "a vector")[1]

    def rows(self, k):
        """Rows of a matrix, which a vector contains column by column."""
        rows, elements = at(self.vectors, k, "a matrix")
        need(type(rows) is int and rows > 0 and len(elements) % rows == 0, "a matrix: its number of rows")
        return [elements[i::rows] for i in range(rows)]

    def term(self, k, role):
        found = at(self.terms, k, "a term")
        need((found.role, found.rule) == (role, "square"), f"{found.name}: expected a {role} square")
        return found

    def constant(self, nodes):
        return all(self.kinds[node.value[0]] in CONSTANT for node in symbols(nodes))

    def rate(self, nodes):
        """Derivatives along the file's rates; None where there is none, or of a symbol without a rate."""
        slopes = {"time": ONE} | dict.fromkeys(CONSTANT, ZERO)
        return rates(nodes, lambda x: self.rates.get(x, slopes.get(self.kinds[x.value[0]])), self.derivatives)

    def sure_rate(self, nodes):
        found = self.rate(nodes)
        need(None not in found, "a derivative that does not exist, or of a function without a rule")
        return found


# ---- Terms, the robot, and steps -------------------------------------------------------------------------------------


class Term:
    """A term T of V, of the dissipation, of the residual, or a cross term, with its parts by name."""

    def __init__(self, of, name, level, role, rule, parts, assumed, phi):
        self.name, self.level, self.role, self.rule, self.assumed, self.phi = name, level, role, rule, assumed, phi
        need(role in RULES and rule in RULES[role], f"{name}: unknown rule {rule} of a {role} term")
        self.parts = {part: of.vector(k) for part, k in keys(parts, RULES[role][rule], name).items()}
        self.factor = ONE if level == "" else of.inputs(level, "weight")[0]
        self.weight, self.vector = self.parts["weight"], self.parts.get("vector", ())
        need(rule != "monotone" or phi in ("tanh", "atan"), f"{name}: unknown function {phi}")
        need(not of.samples or (rule == "square" and not level and role != "cross"), f"{name}: over samples")

    def value(self):
        if self.rule == "square":
            return dot(self.vector, weighted(self.weight, self.vector))
        if self.rule == "monotone":  # sum w (a - b) (phi(a / v) - phi(b / v))
            a, b = self.parts["first"], self.parts["second"]
            v = spread(self.parts["scale"], len(a))
            phi = [[Node(self.phi, x / y) for x, y in zip(z, v, strict=True)] for z in (a, b)]
            return dot(weighted(spread(self.weight, len(a)), minus(a, b)), minus(*phi))
        # potential: sum 2 w v^2 (sqrt(1 + (a / v)^2) - 1)
        v = spread(self.parts["width"], len(self.vector))
        gains = [x * x * (root - ONE) for x, root in zip(v, self.roots(), strict=True)]
        return (ONE + ONE) * dot(spread(self.weight, len(v)), gains)

    def roots(self):
        """sqrt(1 + (a / v)^2) of a potential."""
        ratios = [a / v for a, v in zip(self.vector, spread(self.parts["width"], len(self.vector)), strict=True)]
        return [Node("sqrt", ONE + x * x) for x in ratios]


def robot(of, item):
    """Names, and nodes that must vanish: a weight is the mass matrix of a chain of rigid bodies, and the acceleration
    follows from the torque. `translations` are those of the joints in their parents' frames.

    T_i places body i in the world, and S_i is the integral of r r' dm over its points r = (x, y, z, 1). By d'Alembert's
    principle, the force of joint j is sum_i tr(dT_i/dq_j S_i (d2T_i/dt2 - gravity)').
    """
    weight, position, translations, inertia = (of.vector(item[x]) for x in FLOW["masses"].split()[:4])
    n, T, frames = len(position), [[ONE if i == k else ZERO for k in range(4)] for i in range(3)], []
    q, dq, ddq = ([Node("symbol", value=(None, name)) for _ in position] for name in ("q", "dq", "ddq"))
    rotors = [ZERO] * n if item["rotors"] is None else spread(of.vector(item["rotors"]), n)
    sizes = (len(item["joints"]), len(translations) // 3, len(inertia) / 10)
    need(sizes[0] == n == sizes[2] and sizes[1] >= n, "a chain: sizes of its parts")
    for i, joint in enumerate(item["joints"]):
        T = product(T, placed(keys(joint, "kind axis rotation", "a joint"), q[i], translations[3 * i : 3 * i + 3]))
        frames.append(flat(T))
    bodies = [pseudo_inertia(inertia[10 * i : 10 * i + 10]) for i in range(n)]

    def force(slopes, accelerations):
        """Sum over the bodies of the trace of a slope of T times S times an acceleration."""
        parts = [(x[r : r + 4], S, y[r : r + 4]) for x, S, y in zip(slopes, bodies, accelerations) for r in (0, 4, 8)]
        return sum((dot(x, [dot(row, y) for row in S]) for x, S, y in parts), ZERO)

    slopes = [[rates(T, lambda x, own=own: ONE if x is own else ZERO, {}) for T in frames] for own in q]
    mass = [force(slopes[j], slopes[k]) + (rotors[j] if j == k else ZERO) for k in range(n) for j in range(n)]
    yield "the mass matrix", minus(weight, replaced(mass, dict(zip(q, position, strict=True))))
    if item["motion"] is not None:
        names = "velocity acceleration gravity torque"
        velocity, acceleration, gravity, torque = (
            of.vector(keys(item["motion"], names, "motion")[x]) for x in names.split()
        )
        need(of.constant([*translations, *inertia, *rotors]), "a chain: expected constant bodies")
        moves = dict(zip([*q, *dq], [*dq, *ddq], strict=True))
        falls = [ZERO if k % 4 < 3 else gravity[k // 4] for k in range(12)]
        speeds = [rates(T, lambda x: moves.get(x, ZERO), {}) for T in frames]
        seconds = [minus(rates(x, lambda x: moves.get(x, ZERO), {}), falls) for x in speeds]
        forces = [force(slopes[j], seconds) + rotors[j] * ddq[j] for j in range(n)]
        actual = dict(zip([*q, *dq, *ddq], [*position, *velocity, *acceleration], strict=True))
        yield "the robot's velocity", minus(of.sure_rate(position), velocity)
        yield "the robot's acceleration", minus(of.sure_rate(velocity), acceleration)
        yield "the robot's equation of motion", minus(replaced(forces, actual), torque)


def placed(joint, q, origin):
    """Transform from the parent's frame to that of a joint, of 4 rows."""
    axis, R = (list(map(rational, joint[name])) for name in ("axis", "rotation"))
    need(len(R) == 9 and len(axis) == 3, "a joint: sizes of its axis and rotation")
    R = [R[0:3], R[3:6], R[6:9]]
    x, y = R[0], R[1]
    third = [x[i - 2] * y[i - 1] - x[i - 1] * y[i - 2] for i in range(3)]
    proper = (dot(axis, axis), dot(x, x), dot(y, y), dot(x, y)) == (1, 1, 1, 0) and R[2] == third
    need(proper, "a joint: expected a unit axis and a rotation")
    R, a = [list(map(number, row)) for row in R], list(map(number, axis))
    turn = [[ONE if i == k else ZERO for k in range(3)] for i in range(3)]
    if joint["kind"] == "revolute":  # cos 1 + sin [a]x + (1 - cos) a a'
        c, s = Node("cos", q), Node("sin", q)
        skew = [[ZERO, ZERO - a[2], a[1]], [a[2], ZERO, ZERO - a[0]], [ZERO - a[1], a[0], ZERO]]
        turn = [[c * turn[i][k] + s * skew[i][k] + (ONE - c) * a[i] * a[k] for k in range(3)] for i in range(3)]
    else:
        need(joint["kind"] == "prismatic", "a joint: expected revolute or prismatic")
        origin = plus(origin, [x * q for (x,) in product(R, [[x] for x in a])])
    return [*([*row, x] for row, x in zip(product(R, turn), origin, strict=True)), [ZERO, ZERO, ZERO, ONE]]


def pseudo_inertia(values):
    """S of a body, from m, m c (3), and I_xx, I_xy, I_yy, I_xz, I_yz, I_zz about the origin of its frame."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = values
    xy, xz, yz, half = ZERO - xy, ZERO - xz, ZERO - yz, number(Fraction(1, 2)) * (xx + yy + zz)
    return [[half - xx, xy, xz, x], [xy, half - yy, yz, y], [xz, yz, half - zz, z], [x, y, z, m]]


def updated(of, item):
    """Names, and nodes that must vanish: the next value of an estimate is that of its steps.

    For each output and each of its rows (h, y) in turn: theta <- theta + D h e / n, with e = y - h'theta, n = floor +
    h' D h, and D the gain. Then |theta - true|^2_(1/D) changes by exactly -(h'(theta - true))^2 / n - floor e^2 / n^2 +
    eta^2 / n, where eta = y - h'true. A box with the true value inside moves theta towards it.
    """
    name, rows, sizes = item["estimate"], item["rows"], item["sizes"]
    fixed = "gain floor true" + " lower upper" * item["box"]
    need(item["rule"] == "normalised", f"{name}: unknown rule {item['rule']} of steps")
    need(type(item["box"]) is bool and type(rows) is int and 0 < rows < LARGEST, f"{name}: its steps")
    names = " ".join((fixed, *(f"h{k} y{k}" for k in range(rows))))
    part = {x: of.vector(k) for x, k in keys(item["parts"], names, name).items()}
    state, (floor,), moved, end = of.inputs(name, "state"), part["floor"], [], 0
    need(of.constant([node for x in fixed.split() for node in part[x]]), f"{name}: parts that are not constant")
    need(all(type(n) is int and n > 0 for n in sizes) and sum(sizes) == len(state), f"{name}: its sizes")
    for j, n in enumerate(sizes):
        own, end = slice(end, end + n), end + n
        theta, gain = state[own], part["gain"][own]
        for k in range(rows):
            h, y = part[f"h{k}"][own], part[f"y{k}"][j]
            direction = [d * x for d, x in zip(gain, h, strict=True)]
            step = (y - dot(h, theta)) / (floor + dot(h, direction))
            theta = plus(theta, [x * step for x in direction])
            if item["box"]:
                bounds = zip(theta, part["lower"][own], part["upper"][own], strict=True)
                theta = [Node("fmin", Node("fmax", x, low), high) for x, low, high in bounds]
        moved += theta
    yield f"the next value of {name}", minus([of.rates[x] for x in state], moved)


# ---- The identity ----------------------------------------------------------------------------------------------------


def equalities(of):
    """Names, and nodes that must vanish; the first one is V, which must not."""
    V, total, found = ZERO, ZERO, []
    for term in of.terms:
        value = term.value()
        if term.role == "stored":
            V = V + term.factor * value
            change = replaced([value], of.rates)[0] - value if of.samples else of.sure_rate([value])[0]
            total = total + term.factor * number(Fraction(1, 2)) * change
        else:
            total = total + term.factor * value if term.role == "dissipated" else total - term.factor * value
    for item in of.lists["projections"]:  # (estimate - true value)' W correction
        name, term = item["state"], of.term(item["term"], "stored")
        need(item["correction"] == f"{name}, correction" and item["set"] == "box", f"{name}: unknown projection")
        estimate, correction = of.inputs(name, "state"), of.inputs(item["correction"], "projection")
        total = total - term.factor * dot(weighted(term.weight, term.vector), correction)
        true, rate = spread(of.vector(item["true"]), len(estimate)), [of.rates[x] for x in estimate]
        nominal = replaced(rate, dict.fromkeys(correction, ZERO))
        found.append((f"the error of {name}", minus(term.vector, minus(estimate, true))))
        found.append((f"the rate of the true value of {name}", of.sure_rate(true)))
        found.append((f"the rate of {name}", minus(minus(rate, nominal), correction)))
    for item in of.lists["cross"]:  # a = sum_j share_j v_j
        left = of.term(item["term"], "cross").vector
        for share, k in item["by"]:
            v = of.term(k, "dissipated").vector
            left = minus(left, [x * y for x, y in zip(spread(of.vector(share), len(v)), v, strict=True)])
        found.append(("the vector of a cross term", left))
    for item in of.lists["masses"]:
        found += robot(of, item)
    for item in of.lists["steps"]:
        found += updated(of, item)
    return [("V", [ONE if of.lists["steps"] else V]), ("V(next) - V" if of.samples else "dV/dt", [total]), *found]


def complexity(nodes):
    """D + H of all polynomials that must not vanish at a random point: the numerators of these nodes and of divisors,
    and the differences x - y and x + y of arguments of one function, with 0 and 1 as further arguments.

    The size of a node bounds degree and log2 of the sum of coefficients, of its numerator and of its denominator.
    """
    sizes, total, arguments = {}, 0, {}
    for node in below(nodes):
        if node.name in ARITHMETIC or node.name == "inv":
            sizes[node] = sum(sizes[x] for x in node.of) + 1
            need(sizes[node] < 1 << max(SIZES), "the degree of an expression is too high")
            total += 2 * sizes[node] * (node.name == "inv")
        elif node.name == "number":
            sizes[node] = max(node.value.numerator.bit_length(), node.value.denominator.bit_length())
        else:
            sizes[node] = 2 if node.name in ("sin", "cos") else 1
        if node.of and node.name not in ARITHMETIC and node.name != "inv":
            arguments.setdefault("sin" if node.name == "cos" else node.name, set()).update(node.of)
    for found in arguments.values():
        total += (len(found) + 2) ** 2 * (8 * max((sizes[x] for x in found), default=0) + 8)
    return total + 2 * max(sizes.values())


def random_prime(bits):
    """By the test of Miller and Rabin with 64 random bases."""
    while True:
        n = secrets.randbits(bits) | 1 << (bits - 1) | 1
        if all(n % x for x in (3, 5, 7, 11, 13)) and all(passes(n, secrets.randbelow(n - 3) + 2) for _ in range(64)):
            return n


def passes(n, base):
    """base^odd is 1, or one of its first squares is -1, where n - 1 = odd 2^twos."""
    twos = (n - 1 & 1 - n).bit_length() - 1
    x = pow(base, n - 1 >> twos, n)
    return x == 1 or any(pow(x, 1 << k, n) == n - 1 for k in range(twos))


def identity(of):
    """log2 of the error bound and the number of points; raises `Refuted` at one where an equality does not hold."""
    found = equalities(of)
    nodes = [node for _, own in [*found, *of.vectors] for node in own] + of.divided
    degree = log2(complexity(nodes))
    bits = next((bits for bits in SIZES if degree + 3 - bits < -64), None)
    need(bits is not None, f"the degree of the identity is too high: D + H is 2^{degree:.0f}")
    points, tried = 0, 0
    while points * (degree + 3 - bits) > WANTED:
        field, tried = Field(random_prime(bits)), tried + 1
        need(tried < 40, "a divisor vanishes at every point")
        try:
            exact = {node: field.call(number(value)) for node, value in of.fixed.items()}
            evaluate(nodes, field, exact)
        except Undecided:
            continue
        for name, own in found:
            show(any(exact[node] for node in own) == (name == "V"), f"{name} does not hold")
        points += 1
    field = Field(random_prime(bits))  # no divisor vanishes with the file's numbers
    evaluate(of.divided, field, {x: field.call(number(i.lower)) for x, i in of.numbers.items() if i.lower == i.upper})
    return points * (degree + 3 - bits), points


# ---- Signs, conditions and small gain --------------------------------------------------------------------------------


class Signs:
    """Signs over the intervals of the file. `assumed` collects what they do not show."""

    def __init__(self, of):
        self.of, self.boxes, self.assumed, self.strict = of, {}, [], []

    def intervals(self, nodes, more=()):
        """Intervals of nodes; None if they depend on more than parameters, or on a function."""
        try:
            return evaluate(nodes, Interval, self.of.numbers | dict(more))
        except Undecided:
            return None

    def sign(self, nodes, size=0):
        """1 if all elements, or a matrix, are positive, 0 if none is negative, -1 otherwise or if not decided."""
        values = self.intervals(nodes)
        if values is None or (size > 1 and len(values) == size * size):
            return 1 if values and definite([values[i::size] for i in range(size)]) else -1
        least = min((x.lower for x in values), default=1)
        return (least > 0) - (least < 0)

    def weight(self, term):
        """Sign of a term."""
        size = len(term.vector) if term.rule == "square" else 0
        if size and term.role != "cross" and self.intervals(term.weight) is None:
            for item in self.of.lists["masses"]:
                if self.of.vector(item["weight"]) == term.weight and len(term.weight) == size * size:
                    return self.mass(item)
            if term.assumed is not None:
                self.assumed.append(f"{term.name}: its weight is positive: {term.assumed}")
                return 1
        scale = term.parts.get("scale", term.parts.get("width"))
        return self.sign(term.weight, size) if scale is None or self.sign(scale) == 1 else -1

    def mass(self, item):
        """A mass matrix is positive definite if each body's pseudo-inertia is, and no rotor's inertia is negative."""
        inertia = self.of.vector(item["inertia"])
        bodies = [flat(pseudo_inertia(inertia[k : k + 10])) for k in range(0, len(inertia), 10)]
        if self.intervals(inertia) is None:
            self.assumed.append("the load is a rigid body")
        elif min(self.sign(body, 4) for body in bodies) < 1:
            return -1
        return 1 if item["rotors"] is None or self.sign(self.of.vector(item["rotors"])) >= 0 else -1

    def check(self):
        """Checks all signs, and collects the terms with a positive weight in `strict`."""
        of = self.of
        for term in of.terms:
            if term.role != "residual":
                sign = self.weight(term)
                show(sign >= (term.role == "stored"), f"{term.name}: the sign of its weight is wrong, or not shown")
                self.strict += [term] * (sign == 1)
        for item in of.lists["projections"]:
            name, term = item["state"], of.term(item["term"], "stored")
            self.assumed.append(f"{name}: it starts in its box, and its law is this projection")
            need(len(term.weight) in (1, len(term.vector)), f"{name}: expected a diagonal metric")
            self.inside(name, item)
        for item in of.lists["steps"]:
            part, name = item["parts"], item["estimate"]
            positive = all(self.sign(of.vector(part[x])) == 1 for x in ("gain", "floor"))
            show(positive, f"{name}: gain and floor of its steps are not shown to be positive")
            if item["box"]:
                self.inside(name, part)
        for item in of.lists["conditions"]:
            margin = [] if item["margin"] is None else of.vector(item["margin"])
            if not margin or self.intervals(margin) is None:
                self.assumed.append(f"condition: {item['name']}")
            else:
                show(self.sign(margin) >= (item["strict"] is not False), f"condition: {item['name']}")

    def inside(self, name, item):
        """The true value of an estimate is inside its box."""
        estimate, of = self.of.inputs(name, "state"), self.of
        low, true, high = (
            self.intervals(spread(of.vector(item[x]), len(estimate))) for x in ("lower", "true", "upper")
        )
        show(low and high, f"{name}: its box is not made of parameters")
        show(all(a.upper <= b.lower for a, b in zip(low, high, strict=True)), f"{name}: its box is empty")
        if true is None:
            self.assumed.append(f"{name}: its true value is inside the box")
        for node, a, x, b in zip(estimate, low, true or low, high, strict=True):
            show(a.upper <= x.lower and x.upper <= b.lower, f"{name}: its true value is not inside the box")
            box = self.boxes.setdefault(node, Interval(a.lower, b.upper))
            need((box.lower, box.upper) == (a.lower, b.upper), f"{name}: two boxes")

    def kappa(self):
        """The least kappa with which the dissipation dominates the cross terms; None without any.

        c |sum a_j v_j|^2 <= c max(sum_j a_j^2 / W_j) sum_j |v_j|^2_(W_j), by the inequality of Cauchy.
        """
        of, needed, declared = self.of, {}, []
        for item in of.lists["cross"]:
            own, used = of.term(item["term"], "cross"), [of.term(k, "dissipated") for _, k in item["by"]]
            need(used and len({term.level for term in used}) == 1, "a cross term: expected squares of one level")
            need(not own.level and len(own.weight) == 1, "a cross term: expected one number as its weight")
            need(len({*used}) == len(used), "a cross term: a square that dominates twice")
            show({*used} <= {*self.strict}, "no square with a positive weight dominates a cross term")
            size = len(own.vector)
            shares = [spread(self.of.vector(share), size) for share, _ in item["by"]]
            weights = [spread(term.weight, size) for term in used]
            ratios = [dot([a * a for a in x], [ONE / w for w in y]) for x, y in zip(zip(*shares), zip(*weights))]
            bounds = self.intervals([own.weight[0] * x for x in ratios])
            show(bounds is not None, "the bound of a cross term is not made of parameters")
            key = frozenset(used)
            need(all(key == other or not key & other for other in needed), "cross terms share a part of their squares")
            needed[key] = needed.get(key, 0) + max(x.upper for x in bounds)
            show(used[0].level or needed[key] < 1, "the dissipation does not dominate a cross term")
            declared.append(own)
        for term in of.terms:
            show(term.role != "cross" or term in declared, f"{term.name}: nothing dominates its cross term")
        return max(needed.values(), default=None)


def definite(rows):
    """True if all symmetric matrices in these intervals are positive definite: their pivots are positive."""
    n = len(rows)
    if any(
        (rows[i][j].lower, rows[i][j].upper) != (rows[j][i].lower, rows[j][i].upper) for i in range(n) for j in range(i)
    ):
        return False
    while rows:
        (pivot, *first), *rest = rows
        if pivot.lower <= 0:
            return False
        factors = [row[0] * pivot.inverse() for row in rest]
        rows = [minus(row[1:], [x * y for y in first]) for x, row in zip(factors, rest, strict=True)]
    return True


# ---- Conclusions in continuous time ----------------------------------------------------------------------------------


def restricted(basis, slopes, p):
    """The directions in the span of a basis along which all functionals vanish; slopes[k] are theirs along basis[k]."""
    rows = [[*u, *own] for u, own in zip(basis, slopes, strict=True)]
    n = len(basis[0]) if basis else 0
    for k in range(n, n + len(slopes[0]) if slopes else n):
        pivot = next((row for row in rows if row[k]), None)
        if pivot is not None:
            scale = pow(pivot[k], -1, p)
            scaled = [x * scale % p for x in pivot]
            rows = [
                [(x - row[k] * y) % p for x, y in zip(row, scaled)] if row[k] else row
                for row in rows
                if row is not pivot
            ]
    return [row[:n] for row in rows]


def units(n):
    return [[int(i == k) for i in range(n)] for k in range(n)]


class Conclusions:
    """Bounded and vanishing signals, if V does not increase and trajectories, with their rates, are bounded.

    A direction of the state space is open if no bounded signal determines it. With all bounded functions frozen, a
    signal that does not change along a random open direction is bounded; a bounded signal that changes at a constant
    rate closes a direction. Parameters have the numbers of the file.
    """

    def __init__(self, of, signs):
        self.of, self.signs, self.p, self.gone = of, signs, random_prime(SIZES[0]), []
        moving = [label for label, kind in of.kinds.items() if kind in ("state", "time")]
        self.columns, field = [x for label in moving for x in of.symbols[label]], Field(self.p)
        self.given = {
            x: field.random(x) for label, own in of.symbols.items() if of.kinds[label] in CONSTANT for x in own
        }
        self.given |= {x: field.call(number(i.lower)) for x, i in of.numbers.items() if i.lower == i.upper}
        self.places = [(Field(self.p, frozen=True), dict(self.given)) for _ in range(2)]
        self.squares = [x.vector for x in signs.strict if (x.role, x.rule) == ("dissipated", "square")]
        self.points, self.linear, self.open = [], [], units(len(self.columns))
        self.wanted = [x for x in of.lists["conclusions"] if x["vector"] is not None and of.vector(x["vector"])]
        self.close()
        self.sources = list(self.premises())
        own = [of.vector(x["vector"]) for x in self.wanted if x["says"] == "goes to zero"]
        self.basis = units(4 + sum(map(len, own + [x for _, x, _ in self.sources])))

    def along(self, nodes, place, u):
        """Changes of nodes along u, with the bounded functions of a place."""
        field, values = self.places[place]
        moved = {x: (field.random(x) + step) % self.p for x, step in zip(self.columns, u, strict=True) if step}
        before, after = evaluate(nodes, field, values), evaluate(nodes, field, self.given | moved)
        return [(x - y) % self.p for x, y in zip(after, before, strict=True)]

    def bounded(self, nodes, within=()):
        """True if nodes are bounded. The correction of a projection is, where its nominal rate is: within the rates of
        these states, which must not depend on one another.
        """
        weights = [secrets.randbelow(self.p) for _ in self.open]
        u = [dot(weights, column) % self.p for column in zip(*self.open)] if weights else [0] * len(self.columns)
        if None in nodes or any(self.along(nodes, 0, u)):
            return False
        states = {item["correction"]: item["state"] for item in self.of.lists["projections"]}
        for label in {x.value[0] for x in symbols(nodes) if self.of.kinds[x.value[0]] == "projection"}:
            state = states.get(label)
            if (state,) != within[-1:]:
                known = state is not None and state not in within
                if not known or not self.bounded([self.of.rates[x] for x in self.of.symbols[state]], (*within, state)):
                    return False
        return True

    def close(self):
        """Closes all directions that bounded signals determine."""
        of, waiting = self.of, list(self.of.lists["linear"])
        signals = [x.vector for x in self.signs.strict if x.role == "stored"]
        fixed = {x for item in of.lists["projections"] for x in of.symbols[item["state"]]}
        self.restrict([[u[k] for k, x in enumerate(self.columns) if x in fixed] for u in self.open])
        free = [k for k, x in enumerate(self.columns) if x in of.rates and x not in fixed]
        steady = units(len(free))  # combinations of states whose rate is identically zero
        for row in self.sampled([of.rates[self.columns[k]] for k in free], len(free) + 3):
            steady = restricted(steady, [[dot(u, row) % self.p] for u in steady], self.p)
        self.restrict([[dot(x, [u[k] for k in free]) % self.p for x in steady] for u in self.open] if free else [])
        while True:
            while sum(self.grow(nodes) for nodes in signals):
                pass
            found = next((x for x in waiting if self.stable(x) and self.bounded(self.input(x))), None)
            if found is None:
                return
            waiting.remove(found)
            self.linear.append(found)
            signals += map(of.vector, found["vectors"])

    def restrict(self, slopes):
        """True if this closes a direction."""
        before = len(self.open)
        self.open = restricted(self.open, slopes, self.p) if slopes else self.open
        return len(self.open) < before

    def grow(self, nodes):
        """Closes directions along which a bounded signal changes at a constant rate; True if there was one."""
        read, still = symbols(nodes), [0] * len(nodes)
        moves = [any(step and x in read for x, step in zip(self.columns, u, strict=True)) for u in self.open]
        pairs = [list(zip(moves, self.open, strict=True))] * 2
        one, other = ([self.along(nodes, k, u) if moved else still for moved, u in pairs[k]] for k in (0, 1))
        steady = [k for k in range(len(nodes)) if all(a[k] == b[k] for a, b in zip(one, other, strict=True))]
        return self.restrict([[row[k] for k in steady] for row in one])

    def input(self, item):
        """dz_j/dt - sum_k A_jk z_k of a linear equation; None for an element without a derivative."""
        of, z, found = self.of, list(map(self.of.vector, item["vectors"])), []
        for own, row in zip(z, item["rates"], strict=True):
            driven = [weighted(spread(of.vector(k), len(x)), x) for k, x in zip(row, z, strict=True)]
            for rate, *parts in zip(of.rate(own), *driven, strict=True):
                found.append(None if rate is None else rate - sum(parts, ZERO))
        return found

    def stable(self, item):
        """True if dz/dt = A z is exponentially stable for each joint: one or two equations, over all intervals."""
        of, size = self.of, len(self.of.vector(item["vectors"][0]))
        A = [[spread(of.vector(k), size) for k in row] for row in item["rates"]]
        boxes = self.signs.boxes if len(A) == 1 else {}
        entries = [self.signs.intervals(row[0] if len(A) == 1 else flat(row), boxes) for row in A]
        if None in entries or len(A) > 2:
            return False
        if len(A) == 1:
            return all(x.upper < 0 for x in entries[0])
        (a, b), (c, d) = ((row[:size], row[size:]) for row in entries)
        return all((w + z).upper < 0 < (w * z - x * y).lower for w, x, y, z in zip(a, b, c, d, strict=True))

    def premises(self):
        """Signals of which the vanishing implies that of others, these, and what this assumes."""
        for item in self.linear:
            yield self.input(item), flat(map(self.of.vector, item["vectors"])), None
        for term in self.of.terms:
            if term.rule == "potential":  # a / sqrt(1 + (a / v)^2) has the zeros of a
                yield [a / root for a, root in zip(term.vector, term.roots(), strict=True)], term.vector, None
        for item in self.of.lists["ranks"]:
            R, b = self.of.rows(item["matrix"]), self.of.vector(item["vector"])
            (values,) = self.sampled(flat(R), 1)
            width = len(R[0])
            slopes = [values[k : k + width] for k in range(0, len(values), width)]
            if not restricted(units(len(R)), slopes, self.p):
                yield flat(product([b], R)), b, f"{item['name']} keeps full row rank, uniformly"

    def sampled(self, nodes, count):
        """Values at random points, with the file's parameters."""
        found, tried = [], 0
        while len(found) < count:
            if tried == len(self.points):
                self.points.append((Field(self.p), dict(self.given)))
            field, values = self.points[tried]
            tried += 1
            need(tried < count + 40, "a divisor vanishes at every point with the file's numbers")
            try:
                found.append(evaluate(nodes, field, values))
            except Undecided:
                continue
        return found

    def equal(self, one, other):
        if len(one) != len(other) or None in other:
            return False
        return all(row[: len(one)] == row[len(one) :] for row in self.sampled([*one, *other], 2))

    def slopes(self, nodes):
        """Products of these signals, at all points, with the directions that vanishing signals do not span."""
        columns = list(zip(*self.sampled(nodes, len(self.basis[0])), strict=True)) if self.basis else []
        return [[dot(u, column) % self.p for column in columns] for u in self.basis]

    def made(self, nodes):
        """True if each of these is a combination of vanishing signals with constant coefficients."""
        return bool(self.gone) and None not in nodes and not any(map(any, self.slopes(nodes)))

    def vanish(self, nodes):
        self.gone.append(nodes)
        self.basis = restricted(self.basis, self.slopes(nodes), self.p)

    def vanishes(self, nodes):
        """True if the square is integrable and the derivative bounded (Barbalat's lemma); if it is the derivative of a
        vanishing signal and its own derivative is bounded; or if vanishing signals make it.
        """
        ends = any(self.equal(nodes, x) for x in self.squares + [self.of.rate(x) for x in self.gone])
        return (ends and self.bounded(self.of.rate(nodes))) or self.made(nodes)

    def follows(self, item):
        nodes = self.of.vector(item["vector"])
        if item["says"] == "is bounded":
            return self.bounded(nodes)
        if item["says"] == "is square-integrable":
            return any(self.equal(nodes, x) for x in self.squares)
        return item["says"] == "goes to zero" and self.vanishes(nodes)

    def check(self):
        """The conclusions of the file that follow."""
        shown = []
        while True:
            new = [x for x in self.wanted if x not in shown and self.follows(x)]
            for item in new:
                if item["says"] == "goes to zero":
                    self.vanish(self.of.vector(item["vector"]))
            shown += new
            used = [x for x in self.sources if self.made(x[0]) and not self.made(x[1])]
            for _, nodes, text in used:
                self.vanish(nodes)
                self.signs.assumed += [text] * (text is not None)
            if not new and not used:
                return shown


# ---- The result ------------------------------------------------------------------------------------------------------


def from_steps(of):
    """What the lemma of update steps shows, whatever the rows are; eta is what the true parameters do not explain."""
    for item in of.lists["steps"]:
        name = item["estimate"]
        if item["box"]:
            yield f"{name} is bounded"
        yield f"|{name} - true value|^2 in the metric gain^-1 does not rise where eta is zero"
        yield f"the error of {name} in the direction of its rows is square-summable where eta is"


def check(data: dict) -> dict:
    """Result of the check, as JSON data; raises `Refused` or `Refuted`."""
    try:
        return checked(Certificate(data))
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, Undecided) as error:
        raise Refused(f"no valid certificate: {type(error).__name__}: {error}") from error


def checked(of):
    signs, shown, left = Signs(of), [], of.lists["conclusions"]
    error, points = identity(of)
    signs.check()
    kappa = signs.kappa()
    if of.samples:
        shown, left = list(from_steps(of)), [item for item in left if item["estimate"] is None]
    elif not any(term.role == "residual" for term in of.terms):
        once, again = (Conclusions(of, signs).check() for _ in range(2))  # with another prime
        shown = [f"{item['signal']} {item['says']}" for item in once if item in again]
        left = [item for item in left if item not in once or item not in again]
    given = [label for label, kind in of.kinds.items() if kind in GIVEN]
    still = [label for label, kind in of.kinds.items() if kind in ("constant", "stepping")]
    bounds = [f"bounded: {', '.join(given)}"] * bool(given and not of.samples)
    bounds += [f"constant: {', '.join(still)}"] * bool(still)
    weights = sorted({term.level for term in of.terms if term.level})
    bounds += [f"above kappa_above, and positive: {', '.join(weights)}"] * bool(weights)
    texts = [f"{item['signal']} {item['says']}" for item in left]
    return {
        "status": "re-proved",
        "statement": "V(next) - V" if of.samples else "dV/dt",
        "log2_error": round(error),
        "points": points,
        "robot": [
            f"a weight is the mass matrix of a chain of {len(item['joints'])} rigid bodies"
            + ("; its acceleration follows from the torque, for all masses" if item["motion"] is not None else "")
            for item in of.lists["masses"]
        ],
        "kappa_above": None if kappa is None else str(kappa),
        "only_at_exact_values_of": sorted({node.value[0] for node in of.fixed}),
        "conclusions": shown,
        "not_checked": texts,
        "assumed": [*ASSUMED, *bounds, *dict.fromkeys(signs.assumed), *of.assumed],
    }


def unique(pairs):
    need(len(dict(pairs)) == len(pairs), "a key occurs twice in one object")
    return dict(pairs)


def main(arguments):
    paths = [x for x in arguments if x != "--json"]
    if len(paths) != 1:
        sys.stderr.write("usage: python check.py FILE [--json]\n")
        return 2
    try:
        with open(paths[0], encoding="utf-8") as file:
            text = file.read(LONGEST)
        need(len(text) < LONGEST, "the file is too long")
        result, status = check(json.loads(text, object_pairs_hook=unique)), 0
    except Refuted as error:
        result, status = {"status": "refuted", "reason": str(error)}, 1
    except Exception as error:  # of a file that is no certificate
        result, status = {"status": "refused", "reason": f"{type(error).__name__}: {error}"}, 2
    if "--json" in arguments:
        print(json.dumps(result, indent=1))
        return status
    for name, value in result.items():
        lines = value if isinstance(value, list) else [value]
        print(f"{name.replace('_', ' ')}:", *lines, sep="\n  " if isinstance(value, list) else " ")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
