"""Checks the certificate of a control loop: ``python check.py FILE [--json]``.

``dmframe verify GRAPH --certificate FILE`` writes the file. This program needs Python's standard library alone, and
shares no code with dmframe or ``check.js``. The page ``docs/explanation/checker.md`` proves each rule.

Exit status: 0 re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).

A certificate contains symbols x (states, trajectories, parameters), a program of their functions, the rates dx/dt (or
the next values x+), and terms. It states that

    V = 1/2 sum_k T_k,   dV/dt = - sum d_k + sum residual + projection terms

holds identically, or the same for V(x+) - V(x). T_k and d_k are formed from vectors and weights by a rule. The file
contains no value of V and no derivative. In the order of this program:

1. Expressions, their derivatives, and their values: modulo a prime, and in intervals.
2. The certificate, its terms, its robot, and its steps from sample to sample.
3. The identity. A fraction of polynomials that is not identically zero vanishes at a random point with a probability of
   at most 8 (D + H) / 2^bits, where D and H bound its degree and its coefficients.
4. Signs of weights, boxes and conditions, in intervals.
5. Conclusions: signals that are bounded, and those that go to zero.
"""

import json
import operator
import secrets
import sys
from fractions import Fraction
from functools import partial
from math import log2
from types import SimpleNamespace

SIZES, WANTED, LARGEST, LONGEST = (149, 269, 521), -300, 10**6, 2 * 10**7
CONSTANT = {"parameter", "constant", "stepping"}
GIVEN = {"trajectory", "period", "noise", "command"}
KINDS = CONSTANT | GIVEN | {"time", "state", "projection"}
ARITHMETIC = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}
BOUNDED = set("sin cos tanh atan atan2 sign lt le eq not and".split())
UNARY = set("sin cos tanh atan sqrt exp log fabs sign floor not".split())
BINARY = set("fmin fmax lt le eq and if_else_zero atan2".split())
ASSUMED = (
    "names, rates and next values are those of the loop that runs, and its solutions exist for all time",
    "divisors, those of derivatives too, and arguments of logarithms stay away from 0; arguments of roots are positive",
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


def number(value):
    return ZERO if value == 0 else ONE if value == 1 else Node("number", value=Fraction(value))


ZERO, ONE = Node("number", value=Fraction(0)), Node("number", value=Fraction(1))
HALF = number(Fraction(1, 2))
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


def each(function, *vectors):
    """A function of the elements of vectors of one size."""
    return [function(*elements) for elements in zip(*vectors, strict=True)]


plus, minus, times, over = (partial(each, operation) for operation in ARITHMETIC.values())


def dot(left, right):
    first, *rest = times(left, right)
    return sum(rest, first)


def product(rows, others):
    return [[dot(row, column) for column in zip(*others, strict=True)] for row in rows]


def flat(rows):
    return [x for row in rows for x in row]


def weighted(weight, vector):
    """W a, with W a diagonal, or a matrix column by column."""
    n = len(vector)
    return times(weight, vector) if len(weight) == n else each(lambda row: dot(row, vector), matrix(weight, n))


def matrix(elements, rows):
    """The rows of a matrix that is given column by column."""
    need(type(rows) is int and rows > 0 and len(elements) % rows == 0, "a matrix: its number of rows")
    return [elements[i::rows] for i in range(rows)]


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

    def number(self, value):
        return value.numerator * self.inverse(value.denominator) % self.p

    def call(self, node, *given):
        name, circle = node.name, node.name in ("sin", "cos")
        if name == "number":
            return self.number(node.value)
        if name == "symbol" or (self.frozen and name in BOUNDED and not circle):
            return self.random(node)
        if name == "inv":
            return self.inverse(*given)
        if circle:
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

RULES = {"square": {"stored", "dissipated", "residual"}, "monotone": {"dissipated"}, "potential": {"stored"}}
PARTS = {"square": "vector weight", "monotone": "weight first second scale", "potential": "vector width weight"}


def read(value, shape, where):
    """A value of a shape: an object with these keys, a list, one of a set, (shape,) or null, a type, or a function."""
    if isinstance(shape, dict):
        wrong = sorted(value.keys() ^ shape.keys())
        need(not wrong, f"{where}: missing or unknown: {', '.join(wrong)}")
        return SimpleNamespace(**{key: read(value[key], own, key) for key, own in shape.items()})
    if isinstance(shape, list):
        need(type(value) is list, f"{where}: expected a list")
        return [read(item, shape[0], where) for item in value]
    if isinstance(shape, tuple):
        return None if value is None else read(value, shape[0], where)
    if isinstance(shape, set | type):
        found = type(value) in (str, int) and value in shape if isinstance(shape, set) else type(value) is shape
        fits = value.isprintable() if type(value) is str else type(value) is not int or 0 <= value < LARGEST
        need(found and fits, f"unknown {where}: {value!r:.40}")
        return value
    return shape(value)


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
    """A file that has been read: its lists contain nodes in place of the numbers of vectors and terms."""

    def __init__(self, data):
        need(type(data) is dict and data.get("version") == 3, "version: expected 3; write the file again")
        self.symbols, self.kinds, self.numbers, self.fixed, self.rates, self.derivatives = ({} for _ in range(6))
        self.nodes, self.divided, self.vectors, self.terms, vector = [ZERO], [], [], [], self.vector
        joint = {"kind": {"revolute", "prismatic"}, "axis": [rational], "rotation": [rational]}
        motion = dict.fromkeys(("velocity", "acceleration", "gravity", "torque"), vector)
        chain = dict.fromkeys(("weight", "position", "translations", "inertia"), vector)
        box = dict.fromkeys(("true", "lower", "upper"), vector)
        steps = {"rule": {"normalised"}, "estimate": self.state, "rows": int, "sizes": [int], "box": bool}
        shape = {  # in the order of reading
            "format": {"dmframe-certificate"},
            "version": {3},
            "about": dict,
            "over": {"flow", "sample"},
            "symbols": [self.read_symbol],
            "program": self.read_program,
            "vectors": [self.read_vector],
            "rates": self.read_rates,
            "terms": [self.read_term],
            "projections": [{"term": self.stored_square, "state": self.state, "set": {"box"}, **box}],
            "masses": [{**chain, "rotors": (vector,), "motion": (motion,), "joints": [joint]}],
            "linear": [{"vectors": [vector], "rates": [[vector]]}],
            "ranks": [{"name": str, "matrix": self.matrix, "vector": vector}],
            "steps": [{**steps, "parts": lambda parts: {name: vector(k) for name, k in parts.items()}}],
            "conditions": [{"name": str, "margin": (vector,), "strict": bool}],
            "conclusions": [{"signal": str, "says": str, "vector": (vector,)}],
            "assumed": [str],
        }
        self.__dict__ = vars(read(data, shape, "the file")) | self.__dict__
        self.samples = self.over == "sample"
        flow, sample = (self.projections, self.masses, self.linear, self.ranks), (self.steps,)
        need(not any(flow if self.samples else sample), f"a rule that is unknown over a {self.over}")
        need(not self.samples or all(x.rule == "square" for x in self.terms), "a rule that is unknown over a sample")
        for node, rate in self.rates.items():
            kind, seen = self.kinds[node.value[0]], {self.kinds[x.value[0]] for x in symbols([rate])}
            given = kind == "trajectory" and not self.samples and seen <= CONSTANT | GIVEN | {"time"}
            need(kind == "state" or given, f"{node.value[0]}: a rate")
        self.stated = [f"{item.signal} {item.says}" for item in self.conclusions]
        need(len({*self.stated}) == len(self.stated), "a conclusion occurs twice")
        stored = [node for term in self.terms if term.role == "stored" for node in flat(vars(term.parts).values())]
        need(stored or self.steps, "V has no term")
        for node in symbols(stored):
            moves = node in self.rates or (self.kinds[node.value[0]] == "time" and not self.samples)
            need(moves or self.constant([node]), f"V depends on {node.value[0]}, which has no rate")

    def read_symbol(self, value):
        shape = {"label": str, "kind": KINDS, "size": int, "numbers": ([[rational]],), "exact": bool}
        item = read(value, shape, "a symbol")
        need(item.label not in self.symbols, f"{item.label}: a symbol occurs twice")
        need(item.size == 1 or item.kind not in ("time", "period"), f"{item.label}: expected one number")
        free = item.numbers is None and not item.exact
        need(free or item.kind == "parameter", f"{item.label}: numbers of a {item.kind}")
        self.symbols[item.label] = nodes = [Node("symbol", value=(item.label, k)) for k in range(item.size)]
        self.kinds[item.label] = item.kind
        need(sum(map(len, self.symbols.values())) < LARGEST, "symbols: too many elements")
        for node, (lower, upper) in zip(nodes, item.numbers or (), strict=not free):
            need(lower <= upper and (lower == upper or not item.exact), f"{item.label}: its numbers")
            self.numbers[node] = Interval(lower, upper)
            self.fixed |= {node: lower} if item.exact else {}

    def read_program(self, value):
        shape = {"operations": [str], "code": [int], "a": [int], "b": [int], "constants": [rational]}
        program, labels = read(value, shape, "the program"), list(self.symbols)
        numbers, nodes = list(map(number, program.constants)), []
        for k, first, second in zip(program.code, program.a, program.b, strict=True):
            name = at(program.operations, k, "an operation")
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
        self.nodes += nodes  # -1 is the place of a zero

    def read_vector(self, value):
        rows, elements = value
        self.vectors.append((rows, [at(self.nodes, k + 1, "a vector") for k in elements]))

    def read_rates(self, value):
        for label, k in value.items():
            self.rates |= dict(zip(self.symbols[label], self.vector(k), strict=True))

    def read_term(self, value):
        rule, role = value["rule"], value["role"]
        need(rule in RULES and role in RULES[rule], f"unknown rule {rule!r:.20} of a {role!r:.20} term")
        parts = dict.fromkeys(PARTS[rule].split(), self.vector)
        shape = {"name": str, "role": {role}, "rule": {rule}, "parts": parts, "assumed": (str,), "phi": (str,)}
        self.terms.append(term := read(value, shape, "a term"))
        need(
            term.phi in (("tanh", "atan") if rule == "monotone" else (None,)),
            f"{term.name}: unknown function {term.phi}",
        )
        return term

    def vector(self, k):
        return at(self.vectors, k, "a vector")[1]

    def matrix(self, k):
        rows, elements = at(self.vectors, k, "a matrix")
        return matrix(elements, rows)

    def state(self, label):
        need(self.kinds.get(label) == "state", f"{label}: expected a state")
        return label

    def stored_square(self, k):
        term = at(self.terms, k, "a term")
        need((term.role, term.rule) == ("stored", "square"), f"{term.name}: expected a stored square")
        return term

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


def term_value(term):
    part = term.parts
    if term.rule == "square":  # |a|^2 in the weight W
        return dot(part.vector, weighted(part.weight, part.vector))
    if term.rule == "monotone":  # sum w (a - b) (phi(a / v) - phi(b / v))
        phi = [[Node(term.phi, x) for x in over(own, part.scale)] for own in (part.first, part.second)]
        return dot(times(part.weight, minus(part.first, part.second)), minus(*phi))
    # potential: sum 2 w v^2 (sqrt(1 + (a / v)^2) - 1)
    gains = each(lambda v, root: v * v * (root - ONE), part.width, roots(term))
    return dot(part.weight, gains) / HALF


def roots(term):
    """sqrt(1 + (a / v)^2) of a potential."""
    return [Node("sqrt", ONE + x * x) for x in over(term.parts.vector, term.parts.width)]


def robot(of, item):
    """Names, and nodes that must vanish: a weight is the mass matrix of a chain of rigid bodies, and the acceleration
    follows from the torque. `translations` are those of the joints in their parents' frames.

    T_i places body i in the world, and S_i is the integral of r r' dm over its points r = (x, y, z, 1). By d'Alembert's
    principle, the force of joint j is sum_i tr(dT_i/dq_j S_i (d2T_i/dt2 - gravity)').
    """
    n, T, frames = len(item.position), [[ONE if i == k else ZERO for k in range(4)] for i in range(3)], []
    q, dq, ddq = ([Node("symbol", value=(None, name)) for _ in range(n)] for name in ("q", "dq", "ddq"))
    rotors = [ZERO] * n if item.rotors is None else item.rotors
    sizes = (len(item.joints), len(item.translations) // 3, len(item.inertia) / 10, len(rotors))
    need(sizes[0] == n == sizes[2] == sizes[3] and sizes[1] >= n > 0, "a chain: sizes of its parts")
    for i, joint in enumerate(item.joints):
        T = product(T, placed(joint, q[i], item.translations[3 * i : 3 * i + 3]))
        frames.append(flat(T))
    bodies = list(pseudo_inertias(item.inertia))

    def force(slopes, accelerations):
        """Sum over the bodies of the trace of a slope of T times S times an acceleration."""
        parts = [(x[r : r + 4], S, y[r : r + 4]) for x, S, y in zip(slopes, bodies, accelerations) for r in (0, 4, 8)]
        return sum((dot(x, [dot(row, y) for row in S]) for x, S, y in parts), ZERO)

    slopes = [[rates(T, lambda x, own=own: ONE if x is own else ZERO, {}) for T in frames] for own in q]
    mass = [force(slopes[j], slopes[k]) + (rotors[j] if j == k else ZERO) for k in range(n) for j in range(n)]
    yield "the mass matrix", minus(item.weight, replaced(mass, dict(zip(q, item.position))))
    yield "the rates of the bodies", of.sure_rate([*item.translations, *item.inertia, *rotors])
    if (motion := item.motion) is not None:
        moves = dict(zip([*q, *dq], [*dq, *ddq]))
        falls = [ZERO if k % 4 < 3 else motion.gravity[k // 4] for k in range(12)]
        speeds = [rates(T, lambda x: moves.get(x, ZERO), {}) for T in frames]
        seconds = [minus(rates(x, lambda x: moves.get(x, ZERO), {}), falls) for x in speeds]
        forces = [force(slopes[j], seconds) + rotors[j] * ddq[j] for j in range(n)]
        actual = dict(zip([*q, *dq, *ddq], [*item.position, *motion.velocity, *motion.acceleration], strict=True))
        yield "the robot's velocity", minus(of.sure_rate(item.position), motion.velocity)
        yield "the robot's acceleration", minus(of.sure_rate(motion.velocity), motion.acceleration)
        yield "the robot's equation of motion", minus(replaced(forces, actual), motion.torque)


def placed(joint, q, origin):
    """Transform from the parent's frame to that of a joint, of 4 rows."""
    axis, R = joint.axis, [joint.rotation[k : k + 3] for k in (0, 3, 6)]
    x, y, z = R
    third = [x[i - 2] * y[i - 1] - x[i - 1] * y[i - 2] for i in range(3)]
    proper = (dot(axis, axis), dot(x, x), dot(y, y), dot(x, y)) == (1, 1, 1, 0) and z == third
    need(proper and len(axis) == 3 and len(joint.rotation) == 9, "a joint: expected a unit axis and a rotation")
    R, a = [list(map(number, row)) for row in R], list(map(number, axis))
    turn = [[ONE if i == k else ZERO for k in range(3)] for i in range(3)]
    if joint.kind == "revolute":  # cos 1 + sin [a]x + (1 - cos) a a'
        c, s = Node("cos", q), Node("sin", q)
        skew = [[ZERO, ZERO - a[2], a[1]], [a[2], ZERO, ZERO - a[0]], [ZERO - a[1], a[0], ZERO]]
        turn = [[c * turn[i][k] + s * skew[i][k] + (ONE - c) * a[i] * a[k] for k in range(3)] for i in range(3)]
    else:
        origin = each(lambda x, row: x + dot(row, a) * q, origin, R)
    return [*([*row, x] for row, x in zip(product(R, turn), origin, strict=True)), [ZERO, ZERO, ZERO, ONE]]


def pseudo_inertias(values):
    """S of each body, from m, m c (3), and I_xx, I_xy, I_yy, I_xz, I_yz, I_zz about the origin of its frame."""
    for k in range(0, len(values), 10):
        m, x, y, z, xx, xy, yy, xz, yz, zz = values[k : k + 10]
        xy, xz, yz, half = ZERO - xy, ZERO - xz, ZERO - yz, HALF * (xx + yy + zz)
        yield [[half - xx, xy, xz, x], [xy, half - yy, yz, y], [xz, yz, half - zz, z], [x, y, z, m]]


def updated(of, item):
    """Names, and nodes that must vanish: the next value of an estimate is that of its steps.

    For each output and each of its rows (h, y) in turn: theta <- theta + D h e / n, with e = y - h'theta, n = floor +
    h' D h, and D the gain. Then |theta - true|^2_(1/D) changes by exactly -(h'(theta - true))^2 / n - floor e^2 / n^2 +
    eta^2 / n, where eta = y - h'true. A box with the true value inside moves theta towards it.
    """
    part, state, moved, end = item.parts, of.symbols[item.estimate], [], 0
    fixed = ["gain", "floor", "true", *["lower", "upper"] * item.box]
    names = {*fixed, *(f"{x}{k}" for x in "hy" for k in range(item.rows))}
    need(part.keys() == names and item.rows, f"{item.estimate}: parts of its steps")
    need(of.constant([node for x in fixed for node in part[x]]), f"{item.estimate}: parts that are not constant")
    need(all(item.sizes) and sum(item.sizes) == len(state), f"{item.estimate}: its sizes")
    (floor,) = part["floor"]
    for j, n in enumerate(item.sizes):
        own, end = slice(end, end + n), end + n
        theta, gain = state[own], part["gain"][own]
        for k in range(item.rows):
            h, y = part[f"h{k}"][own], part[f"y{k}"][j]
            direction = times(gain, h)
            step = (y - dot(h, theta)) / (floor + dot(h, direction))
            theta = plus(theta, [d * step for d in direction])
            if item.box:
                bounds = part["lower"][own], part["upper"][own]
                theta = each(lambda x, low, high: Node("fmin", Node("fmax", x, low), high), theta, *bounds)
        moved += theta
    yield f"the next value of {item.estimate}", minus([of.rates[x] for x in state], moved)


# ---- The identity ----------------------------------------------------------------------------------------------------


def equalities(of):
    """Names, and nodes that must vanish; the first one is V, which must not."""
    V, total, found = ZERO, ZERO, []
    for term in of.terms:
        value = term_value(term)
        if term.role == "stored":
            V += value
            total += HALF * (replaced([value], of.rates)[0] - value if of.samples else of.sure_rate([value])[0])
        else:
            total = total + value if term.role == "dissipated" else total - value
    for item in of.projections:  # (estimate - true value)' W correction
        name, part, estimate = item.state, item.term.parts, of.symbols[item.state]
        need(of.kinds.get(f"{name}, correction") == "projection", f"{name}: expected its correction")
        correction, rate = of.symbols[f"{name}, correction"], [of.rates[x] for x in estimate]
        total -= dot(weighted(part.weight, part.vector), correction)
        nominal = replaced(rate, dict.fromkeys(correction, ZERO))
        found.append((f"the error of {name}", minus(part.vector, minus(estimate, item.true))))
        found.append((f"the rate of the true value of {name}", of.sure_rate(item.true)))
        found.append((f"the rate of {name}", minus(minus(rate, nominal), correction)))
    for item in of.masses:
        found += robot(of, item)
    for item in of.steps:
        found += updated(of, item)
    return [("V", [ONE if of.steps else V]), ("V(next) - V" if of.samples else "dV/dt", [total]), *found]


def complexity(nodes, fixed):
    """D + H of all polynomials that must not vanish at a random point: the numerators of these nodes and of divisors,
    and the differences x - y and x + y of arguments of one function, with 0 and 1 as further arguments. `fixed`
    contains the numbers of symbols with exact ones.

    The size of a node bounds degree and log2 of the sum of coefficients, of its numerator and of its denominator.
    """
    sizes, total, arguments = {}, 0, {}
    for node in below(nodes):
        rational = node.name in ARITHMETIC or node.name == "inv"
        if rational:
            sizes[node] = sum(sizes[x] for x in node.of) + 1
            need(sizes[node] < 1 << max(SIZES), "the degree of an expression is too high")
            total += 2 * sizes[node] * (node.name == "inv")
        elif node.name == "number" or node in fixed:
            value = fixed.get(node, node.value)
            sizes[node] = max(value.numerator.bit_length(), value.denominator.bit_length())
        else:
            sizes[node] = 2 if node.name in ("sin", "cos") else 1
        if node.of and not rational:
            arguments.setdefault("sin" if node.name == "cos" else node.name, set()).update(node.of)
    for found in arguments.values():
        total += (len(found) + 2) ** 2 * (8 * max((sizes[x] for x in found), default=0) + 8)
    return total + 2 * max(sizes.values())


def random_prime(bits):
    """By the test of Miller and Rabin: base^odd is 1, or one of its first squares is -1, for 64 random bases."""
    while True:
        n = secrets.randbits(bits) | 1 << (bits - 1) | 1
        twos, tried = (n - 1 & 1 - n).bit_length() - 1, 0
        while tried < 64:
            x = pow(secrets.randbelow(n - 3) + 2, n - 1 >> twos, n)
            if x != 1 and all(pow(x, 1 << k, n) != n - 1 for k in range(twos)):
                break
            tried += 1
        else:
            return n


def identity(of):
    """log2 of the error bound and the number of points; raises `Refuted` at one where an equality does not hold."""
    found = equalities(of)
    nodes = flat([*(own for _, own in found), *(own for _, own in of.vectors), of.divided])
    degree = log2(complexity(nodes, of.fixed))
    bits = next((bits for bits in SIZES if degree + 3 - bits < -64), None)
    need(bits is not None, f"the degree of the identity is too high: D + H is 2^{degree:.0f}")
    points, tried = 0, 0
    while points * (degree + 3 - bits) > WANTED:
        field, tried = Field(random_prime(bits)), tried + 1
        need(tried < 40, "a divisor vanishes at every point")
        try:
            values = {node: field.number(value) for node, value in of.fixed.items()}
            evaluate(nodes, field, values)
        except Undecided:
            continue
        for name, own in found:
            show(any(values[node] for node in own) == (name == "V"), f"{name} does not hold")
        points += 1
    field = Field(random_prime(bits))  # no divisor vanishes with the file's numbers
    evaluate(of.divided, field, {x: field.number(i.lower) for x, i in of.numbers.items() if i.lower == i.upper})
    return points * (degree + 3 - bits), points


# ---- Signs and conditions --------------------------------------------------------------------------------------------


class Signs:
    """Signs over the intervals of the file. `assumed` collects what they do not show, `strict` contains the terms with
    a positive weight, `boxes` the intervals of estimates.
    """

    def __init__(self, of):
        self.of, self.boxes, self.assumed, self.strict = of, {}, [], []
        for item in of.masses:
            self.bodies(item)
        for term in of.terms:
            if term.role != "residual":
                sign = self.weight(term)
                show(sign >= (term.role == "stored"), f"{term.name}: the sign of its weight is wrong, or not shown")
                self.strict += [term] * (sign == 1)
        for item in of.projections:
            self.assumed.append(f"{item.state}: it starts in its box, and its law is this projection")
            part = item.term.parts
            need(len(part.weight) == len(part.vector), f"{item.state}: expected a diagonal metric")
            self.inside(item.state, item.lower, item.true, item.upper)
        for item in of.steps:
            part = item.parts
            positive = self.sign(part["gain"]) == self.sign(part["floor"]) == 1
            show(positive, f"{item.estimate}: gain and floor of its steps are not shown to be positive")
            if item.box:
                self.inside(item.estimate, part["lower"], part["true"], part["upper"])
        for item in of.conditions:
            if not item.margin or self.intervals(item.margin) is None:
                self.assumed.append(f"condition: {item.name}")
            else:
                show(self.sign(item.margin) >= item.strict, f"condition: {item.name}")

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
            return 1 if values and definite(matrix(values, size)) else -1
        least = min((x.lower for x in values), default=1)
        return (least > 0) - (least < 0)

    def weight(self, term):
        """Sign of a term."""
        part, size = term.parts, 0
        if term.rule == "square":
            size = len(part.vector)
            if self.intervals(part.weight) is None:
                if len(part.weight) == size * size and part.weight in [item.weight for item in self.of.masses]:
                    return 1
                if term.assumed:
                    self.assumed.append(f"{term.name}: its weight is uniformly positive: {term.assumed}")
                    return 1
        elif self.sign(part.scale if term.rule == "monotone" else part.width) < 1:
            return -1
        return self.sign(part.weight, size)

    def bodies(self, item):
        """A mass matrix is positive definite if each pseudo-inertia is, and no rotor's inertia is negative. What a
        trajectory, the load, adds to a body is assumed to be a body.
        """
        for S in map(flat, pseudo_inertias(item.inertia)):
            loads = [x for x in symbols(S) if self.of.kinds[x.value[0]] == "trajectory"]
            for label in sorted({x.value[0] for x in loads}):
                self.assumed.append(f"what {label} adds to a body of the robot is a rigid body")
            show(self.sign(replaced(S, dict.fromkeys(loads, ZERO)), 4) == 1, "a body of the robot: its pseudo-inertia")
        show(item.rotors is None or self.sign(item.rotors) >= 0, "a rotor of the robot: its inertia")

    def inside(self, name, *box):
        """The true value of an estimate is inside its box."""
        low, true, high = map(self.intervals, box)
        show(low and high, f"{name}: its box is not made of parameters")
        show(all(each(lambda a, b: a.upper <= b.lower, low, high)), f"{name}: its box is empty")
        if true is None:
            self.assumed.append(f"{name}: its true value is inside the box")
        for node, a, x, b in zip(self.of.symbols[name], low, true or low, high, strict=True):
            show(a.upper <= x.lower and x.upper <= b.lower, f"{name}: its true value is not inside the box")
            box = self.boxes.setdefault(node, Interval(a.lower, b.upper))
            need((box.lower, box.upper) == (a.lower, b.upper), f"{name}: two boxes")


def definite(rows):
    """True if all symmetric matrices in these intervals are positive definite: their pivots are positive."""
    ends = [[(x.lower, x.upper) for x in row] for row in rows]
    if ends != list(map(list, zip(*ends, strict=True))):
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
    for k in range(n, len(rows[0]) if rows else n):
        pivot = next((row for row in rows if row[k]), None)
        if pivot is not None:
            scale = pow(pivot[k], -1, p)
            scaled = [x * scale % p for x in pivot]
            others = [row for row in rows if row is not pivot]
            rows = [[(x - row[k] * y) % p for x, y in zip(row, scaled)] if row[k] else row for row in others]
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
        labels, field = of.symbols.items(), Field(self.p)
        self.columns = [x for label, own in labels if of.kinds[label] in ("state", "time") for x in own]
        self.given = {x: field.random(x) for label, own in labels if of.kinds[label] in CONSTANT for x in own}
        self.given |= {x: field.number(i.lower) for x, i in of.numbers.items() if i.lower == i.upper}
        self.places = [(Field(self.p, frozen=True), dict(self.given)) for _ in range(2)]
        self.squares = flat(x.parts.vector for x in signs.strict if (x.role, x.rule) == ("dissipated", "square"))
        self.points, self.linear, self.open = [], [], units(len(self.columns))
        self.wanted = [x for x in of.conclusions if x.vector]
        self.close()
        self.sources = list(self.premises())
        own = [x.vector for x in self.wanted if x.says == "goes to zero"]
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
        states = {f"{item.state}, correction": item.state for item in self.of.projections}
        for label in {x.value[0] for x in symbols(nodes) if self.of.kinds[x.value[0]] == "projection"}:
            state = states.get(label)
            if (state,) != within[-1:]:
                known = state is not None and state not in within
                if not known or not self.bounded([self.of.rates[x] for x in self.of.symbols[state]], (*within, state)):
                    return False
        return True

    def close(self):
        """Closes all directions that bounded signals determine."""
        of, waiting = self.of, list(self.of.linear)
        signals = [x.parts.vector for x in self.signs.strict if x.role == "stored"]
        fixed = {x for item in of.projections for x in of.symbols[item.state]}
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
            signals += found.vectors

    def restrict(self, slopes):
        """True if this closes a direction."""
        before = len(self.open)
        self.open = restricted(self.open, slopes, self.p) if slopes else self.open
        return len(self.open) < before

    def grow(self, nodes):
        """Closes directions along which a bounded signal changes at a constant rate; True if there was one."""
        one, other = ([self.along(nodes, k, u) for u in self.open] for k in (0, 1))
        steady = [k for k in range(len(nodes)) if all(a[k] == b[k] for a, b in zip(one, other, strict=True))]
        return self.restrict([[row[k] for k in steady] for row in one])

    def input(self, item):
        """dz_j/dt - sum_k A_jk z_k of a linear equation; None for an element without a derivative."""
        found = []
        for z, row in zip(item.vectors, item.rates, strict=True):
            driven = [times(A, other) for A, other in zip(row, item.vectors, strict=True)]
            for rate, *parts in zip(self.of.rate(z), *driven, strict=True):
                found.append(None if rate is None else rate - sum(parts, ZERO))
        return found

    def stable(self, item):
        """True if dz/dt = A z is exponentially stable for each joint: one or two equations, over all intervals."""
        need(len({*map(len, [*item.vectors, *flat(item.rates)])}) == 1, "a linear equation: sizes of its vectors")
        A = [self.signs.intervals(x, self.signs.boxes if len(item.rates) == 1 else {}) for x in flat(item.rates)]
        if None in A or len(A) not in (1, 4):
            return False
        if len(A) == 1:
            return all(x.upper < 0 for x in A[0])
        return all((w + z).upper < 0 < (w * z - x * y).lower for w, x, y, z in zip(*A, strict=True))

    def premises(self):
        """Signals of which the vanishing implies that of others, these, and what this assumes."""
        for item in self.linear:
            yield self.input(item), flat(item.vectors), None
        for term in self.of.terms:
            if term.rule == "potential":  # a / sqrt(1 + (a / v)^2) has the zeros of a
                yield over(term.parts.vector, roots(term)), term.parts.vector, None
        for item in self.of.ranks:
            R, (values,) = item.matrix, self.sampled(flat(item.matrix), 1)
            if not restricted(units(len(R)), matrix(values, len(R)), self.p):
                yield flat(product([item.vector], R)), item.vector, f"{item.name} keeps full row rank, uniformly"

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

    def among(self, nodes, others):
        """True if each of these is one of the others."""
        known = [x for x in others if x is not None]
        values = list(zip(*self.sampled([*nodes, *known], 2), strict=True))
        return {*values[: len(nodes)]} <= {*values[len(nodes) :]}

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

    def follows(self, item):
        """True if a conclusion follows. A signal vanishes if its square is integrable and its derivative bounded
        (Barbalat's lemma), if it is the derivative of a vanishing signal and its own derivative is bounded, or if
        vanishing signals make it.
        """
        nodes, integrable = item.vector, self.among(item.vector, self.squares)
        if item.says != "goes to zero":
            return (
                integrable if item.says == "is square-integrable" else item.says == "is bounded" and self.bounded(nodes)
            )
        ends = integrable or self.among(nodes, flat(map(self.of.rate, self.gone)))
        return (ends and self.bounded(self.of.rate(nodes))) or self.made(nodes)

    def check(self):
        """The conclusions of the file that follow."""
        shown = []
        while True:
            new = [x for x in self.wanted if x not in shown and self.follows(x)]
            for item in new:
                if item.says == "goes to zero":
                    self.vanish(item.vector)
            shown += new
            used = [x for x in self.sources if self.made(x[0]) and not self.made(x[1])]
            for _, nodes, assumption in used:
                self.vanish(nodes)
                self.signs.assumed += [assumption] * (assumption is not None)
            if not new and not used:
                return shown


# ---- The result ------------------------------------------------------------------------------------------------------


def from_steps(of):
    """What the lemma of update steps shows, whatever the rows are; eta is what the true parameters do not explain."""
    for item in of.steps:
        name = item.estimate
        if item.box:
            yield f"{name} is bounded"
        yield f"|{name} - true value|^2 in the metric gain^-1 does not rise where eta is zero"
        yield f"h'({name} - true value) / sqrt(n) is square-summable where eta / sqrt(n) is"


def check(data: dict) -> dict:
    """Result of the check, as JSON data; raises `Refused` or `Refuted`."""
    try:
        return checked(Certificate(data))
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, Undecided) as error:
        raise Refused(f"no valid certificate: {type(error).__name__}: {error}") from error


def checked(of):
    (error, points), signs, shown = identity(of), Signs(of), list(from_steps(of))
    if not of.samples and all(term.role != "residual" for term in of.terms):
        once, again = (Conclusions(of, signs).check() for _ in range(2))  # with another prime
        shown = [f"{item.signal} {item.says}" for item in once if item in again]
    given, still = ([x for x, kind in of.kinds.items() if kind in kinds] for kinds in (GIVEN, CONSTANT))
    bounds = [f"bounded: {', '.join(given)}"] * bool(given and not of.samples)
    bounds += [f"constant: {', '.join(still)}"] * bool(still)
    exact = {x for x, i in of.numbers.items() if i.lower == i.upper}
    some = [label for label in still if not exact.issuperset(of.symbols[label])]
    bounds += [f"conclusions are for almost all values of: {', '.join(some)}"] * bool(some and not of.samples)
    return {
        "status": "re-proved",
        "statement": "V(next) - V" if of.samples else "dV/dt",
        "log2_error": round(error),
        "points": points,
        "robot": [described(item) for item in of.masses],
        "only_at_exact_values_of": sorted({node.value[0] for node in of.fixed}),
        "conclusions": shown,
        "not_checked": [x for x in of.stated if x not in shown],
        "assumed": [*ASSUMED, *bounds, *dict.fromkeys(signs.assumed), *of.assumed],
    }


def described(item):
    chain = f"a chain of {len(item.joints)} rigid bodies"
    if item.motion is None:
        return chain
    reads = ", ".join(sorted({x.value[0] for x in symbols(item.motion.torque)}))
    return f"{chain}, whose acceleration follows from a torque of {reads}"


def unique(pairs):
    need(len(dict(pairs)) == len(pairs), "a key occurs twice in one object")
    return dict(pairs)


def main(arguments):
    sys.stdout.reconfigure(errors="backslashreplace")
    paths = [x for x in arguments if x != "--json"]
    if len(paths) != 1:
        sys.stderr.write("usage: python check.py FILE [--json]\n")
        return 2
    try:
        with open(paths[0], encoding="utf-8") as file:
            content = file.read(LONGEST)
        need(len(content) < LONGEST, "the file is too long")
        result, status = check(json.loads(content, object_pairs_hook=unique, parse_constant=rational)), 0
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
