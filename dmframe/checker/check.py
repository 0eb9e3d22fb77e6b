"""Checks the certificate of a control loop: ``python check.py FILE [--json]``.

``dmframe verify GRAPH --certificate FILE`` writes the file. This program needs Python's standard library alone, and
shares no code with dmframe or ``check.js``; the page ``docs/explanation/checker.md`` proves each rule. Exit status: 0
re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).

A certificate contains symbols x (states, given signals, constants), a program of their functions, the rates dx/dt (or
the next values x+), and vectors and weights from which this program forms terms. It states that

    V = 1/2 sum of stored terms,   dV/dt = - sum of dissipated terms + sum of residual terms

holds identically, or the same for V(x+) - V(x). The file contains no value of V and no derivative.
"""

import json
import operator
import re
import secrets
import sys
from fractions import Fraction
from functools import partial
from math import ceil, log2
from types import SimpleNamespace

SIZES, WANTED = (149, 269, 521), -300  # bits of primes, and log2 of the largest error
LARGEST, LONGEST = 10**6, 2 * 10**7  # limits of lists and files
WIDEST, ROWS, HIGHEST = 1000, 300, 2**20000  # limits of bases, matrices and numbers
ARITHMETIC = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}
UNARY = set("sin cos tanh atan sqrt exp log fabs sign floor not".split())
BINARY = set("add sub mul div fmin fmax lt le eq and if_else_zero atan2".split())
OPERATIONS = {"const", "input", *UNARY, *BINARY}
BOUNDED = set("sin cos tanh atan atan2 sign lt le eq not and".split())
KINDS = {"constant", "given", "time", "state", "correction"}
RULES = {  # of terms: their roles, and their parts
    "square": ("stored dissipated residual", "vector weight"),
    "potential": ("stored", "vector scale weight"),
    "tanh": ("dissipated", "vector other scale weight"),
    "atan": ("dissipated", "vector other scale weight"),
    "projected": ("dissipated", "vector correction true lower upper weight"),
}
ASSUMED = [
    "names, rates and next values are those of the loop that runs, and its solutions exist for all time",
    "divisors, those of derivatives too, and arguments of logarithms stay away from 0; arguments of roots are positive",
]


class Refused(Exception):
    """The file is no valid certificate, or contains a rule that this program does not know."""


class Refuted(Exception):
    """A statement of the file is wrong, or its data do not show it."""


def need(condition, text, fault=Refused):
    if not condition:
        raise fault(text)


# ---- Expressions -----------------------------------------------------------------------------------------------------
NODES = {}


class Node:
    """A number, a symbol (value: its label and element), or an operation or function of other nodes.

    Equal nodes of a file are one object.
    """

    __slots__ = ("name", "of", "value")

    def __new__(cls, name, *of, value=None):
        key = name, frozenset(of) if name in ("add", "mul") else of, value
        if key not in NODES:
            need(len(NODES) < LARGEST, "too many expressions")
            NODES[key] = self = super().__new__(cls)
            self.name, self.of, self.value = name, of, value
        return NODES[key]

    def __add__(self, other):
        return other if self is ZERO else self if other is ZERO else Node("add", self, other)

    def __sub__(self, other):
        return self if other is ZERO else ZERO if self is other else Node("sub", self, other)

    def __mul__(self, other):
        if ZERO in (self, other):
            return ZERO
        return other if self is ONE else self if other is ONE else Node("mul", self, other)

    def __truediv__(self, other):
        return self * inverse(other)


def number(value):
    return ZERO if value == 0 else ONE if value == 1 else Node("number", value=Fraction(value))


def inverse(node):
    return ONE if node is ONE else Node("inv", node)


def built(name, *of):
    """The node of an operation."""
    if name == "inv":
        return inverse(*of)
    return ARITHMETIC[name](*of) if name in ARITHMETIC else Node(name, *of)


ZERO, ONE = Node("number", value=Fraction(0)), Node("number", value=Fraction(1))
SLOPES = {  # derivatives of a function f by its operands
    "add": lambda f, x, y: [ONE, ONE],
    "sub": lambda f, x, y: [ONE, ZERO - ONE],
    "mul": lambda f, x, y: [y, x],
    "inv": lambda f, x: [ZERO - f * f],
    "sin": lambda f, x: [Node("cos", x)],
    "cos": lambda f, x: [ZERO - Node("sin", x)],
    "tanh": lambda f, x: [ONE - f * f],
    "atan": lambda f, x: [ONE / (ONE + x * x)],
    "sqrt": lambda f, x: [ONE / (f + f)],
    "exp": lambda f, x: [f],
    "log": lambda f, x: [ONE / x],
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


def evaluate(nodes, call, values):
    """Values of nodes, each by a `call` with the node and the values of its operands. `values` keeps all of them."""
    for node in below(nodes, values):
        values[node] = call(node, *[values[x] for x in node.of])
    return [values[node] for node in nodes]


def replaced(nodes, given):
    """The nodes with others in place of some."""
    return evaluate(nodes, lambda node, *of: built(node.name, *of) if of else node, dict(given))


def rates(nodes, moves, found):
    """Derivatives, with those of symbols from the function `moves`; None where there is none. `found` keeps all."""

    def call(node, *slopes):
        if node.name == "symbol":
            return moves(node)
        if None not in slopes and all(slope is ZERO for slope in slopes):
            return ZERO
        return dot(SLOPES[node.name](node, *node.of), slopes) if None not in slopes and node.name in SLOPES else None

    return evaluate(nodes, call, found)


def slopes(nodes, symbol):
    """Derivatives by one symbol."""
    return rates(nodes, lambda node: ONE if node is symbol else ZERO, {})


class Field:
    """Values modulo a prime. A function has a random value for each argument: what holds for all values holds for those
    of the function. sin and cos of one argument are a random point of the unit circle. If `frozen`, a bounded function
    keeps its value whatever its argument is. A divisor that vanishes is a ValueError.
    """

    def __init__(self, p, frozen=False):
        self.p, self.frozen, self.known = p, frozen, {}

    def random(self, *key):
        return self.known.setdefault(key, secrets.randbelow(self.p))

    def number(self, value):
        return value.numerator * pow(value.denominator, -1, self.p) % self.p

    def __call__(self, node, *given):
        name = node.name
        if name in ARITHMETIC:
            return ARITHMETIC[name](*given) % self.p
        if name == "number":
            return self.number(node.value)
        if name == "inv":
            return pow(*given, -1, self.p)
        if name in ("sin", "cos"):
            t = self.random("circle", *(node.of if self.frozen else given))
            return (1 - t * t if name == "cos" else 2 * t) * pow(1 + t * t, -1, self.p) % self.p
        still = name == "symbol" or (self.frozen and name in BOUNDED)
        return self.random(node) if still else self.random(name, *given)


class Interval:
    """A rational interval, which contains all values over the intervals of the symbols. Where these do not decide, an
    ArithmeticError is raised.
    """

    def __init__(self, *values):
        short = all(max(abs(x.numerator), x.denominator) <= HIGHEST for x in values)
        need(short, "a number is too long", ArithmeticError)
        self.lower, self.upper = min(values), max(values)

    def __add__(self, other):
        return Interval(self.lower + other.lower, self.upper + other.upper)

    def __sub__(self, other):
        return Interval(self.lower - other.upper, self.upper - other.lower)

    def __mul__(self, other):
        product = Interval(*(x * y for x in (self.lower, self.upper) for y in (other.lower, other.upper)))
        return Interval(max(product.lower, Fraction(0)), product.upper) if self is other else product

    @staticmethod
    def call(node, *given):
        if node.name == "number":
            return Interval(node.value, node.value)
        if node.name in ARITHMETIC:
            return ARITHMETIC[node.name](*given)
        need(node.name in ("fabs", "inv"), "a symbol or a function without an interval", ArithmeticError)
        (a,) = given
        if node.name == "fabs":
            return Interval(max(a.lower, -a.upper, Fraction(0)), max(-a.lower, a.upper))
        need(a.lower > 0 or a.upper < 0, "a divisor may vanish", ArithmeticError)
        return Interval(1 / a.upper, 1 / a.lower)


# ---- Vectors and matrices --------------------------------------------------------------------------------------------
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


def unit(n, zero=0, one=1):
    return [[one if i == k else zero for i in range(n)] for k in range(n)]


def matrix(elements, rows):
    """The rows of a matrix that is given column by column."""
    need(len(elements) % rows == 0, "a matrix: its number of rows")
    return [elements[i::rows] for i in range(rows)]


def weighted(weight, vector):
    """W a, with W a diagonal, or a matrix column by column."""
    n = len(vector)
    return times(weight, vector) if len(weight) == n else each(lambda row: dot(row, vector), matrix(weight, n))


def symmetric(weight, n):
    """The symmetric part of a matrix; a diagonal is its own."""
    rows = matrix(weight, n)
    pairs = zip(rows, zip(*rows), strict=len(weight) != n)
    half = number(Fraction(1, 2))
    return weight if len(weight) == n else [half * (x + y) for pair in pairs for x, y in zip(*pair)]


def pivots(rows):
    """Pivots of a symmetric matrix by elimination: they are positive if and only if the matrix is positive definite."""
    need(len(rows) <= ROWS, "a matrix is too large")
    found = []
    while rows:
        (pivot, *first), *rest = rows
        found.append(pivot)
        rows = [minus(row[1:], [row[0] / pivot * x for x in first]) for row in rest]
    return found


# ---- The file --------------------------------------------------------------------------------------------------------
def read(value, shape):
    """A value of a shape: an object with these keys, a list, (shape,) or null, one of a set, a type, or a function."""
    if isinstance(shape, dict):
        need(value.keys() == shape.keys(), f"missing or unknown: {', '.join(sorted(value.keys() ^ shape.keys()))}")
        return SimpleNamespace(**{key: read(value[key], own) for key, own in shape.items()})
    if isinstance(shape, list):
        need(type(value) is list and len(value) < LARGEST, "expected a list")
        return [read(item, shape[0]) for item in value]
    if isinstance(shape, tuple):
        return None if value is None else read(value, shape[0])
    if not isinstance(shape, set | type):
        return shape(value)
    found = type(value) in (str, int) and value in shape if isinstance(shape, set) else type(value) is shape
    fits = type(value) is not int or 0 <= value < LARGEST
    if type(value) is str:
        fits = value.isascii() and value.isprintable()  # letters of two alphabets may look alike
    need(found and fits, f"unknown: {value!a:.40}")
    return value


def at(items, k):
    need(type(k) is int and 0 <= k < len(items), f"there is no number {k!r:.20}")
    return items[k]


def rational(text):
    need(len(text) < 4000 and re.fullmatch("-?[0-9]+(/0*[1-9][0-9]*)?", text), f"expected a fraction: {text:.40}")
    return Fraction(text)


class Certificate:
    """A file that has been read: its lists contain nodes in place of the numbers of vectors."""

    def __init__(self, data):
        need(type(data) is dict and data.get("version") == 4, "version: expected 4; write the file again")
        NODES.clear()
        vector = self.vector
        joint = {"kind": {"revolute", "prismatic"}, "axis": vector, "place": vector, "body": vector}
        shape = {  # in the order of reading
            "format": {"dmframe-certificate"},
            "version": {4},
            "about": dict,
            "over": {"flow", "sample"},
            "symbols": self.read_symbols,
            "program": self.read_program,
            "vectors": [self.read_vector],
            "rates": self.read_rates,
            "terms": [self.read_term],
            "robots": [{"position": str, "joints": [joint], "rotors": vector, "gravity": vector, "torque": vector}],
            "stable": [{"vector": vector, "weight": vector, "loss": vector}],
            "ranks": [{"name": str, "matrix": vector, "vector": vector}],
            "conditions": [{"name": str, "margin": (vector,), "strict": bool}],
            "conclusions": [{"signal": str, "says": str, "vector": (vector,)}],
            "assumed": [str],
        }
        need(data.keys() == shape.keys(), f"missing or unknown: {', '.join(sorted(data.keys() ^ shape.keys()))}")
        for key, own in shape.items():
            setattr(self, key, read(data[key], own))
        self.samples, self.derivatives = self.over == "sample", {}
        need({*map(type, self.about.values())} <= {str}, "about: expected texts")
        flow = self.robots or self.stable or self.ranks or {x.rule for x in self.terms} - {"square", "projected"}
        need(not (self.samples and flow), "a rule that is unknown over a sample")
        need(any(term.role == "stored" for term in self.terms), "V has no term")
        corrections = [x for term in self.terms if term.rule == "projected" for x in term.parts.correction]
        need(self.samples or len({*corrections}) == len(corrections), "a correction occurs twice")
        self.stated = [f"{item.signal} {item.says}" for item in self.conclusions]
        conditions, weights = [x.name for x in self.conditions], [x.name for x in self.terms if x.assumed]
        matrices = [name for name, *_ in {(x.name, *x.matrix) for x in self.ranks}]
        for names in (self.stated, conditions, weights, matrices):
            need(len({*names}) == len(names), "a name of two conclusions, conditions, assumed weights or matrices")
        for node, rate in self.rates.items():
            given = not self.samples and self.kinds_in([rate]) <= {"constant", "given", "time"}
            need(self.kind(node) == "state" or (self.kind(node) == "given" and given), f"{node.value[0]}: a rate")

    def read_symbols(self, items):
        """The nodes of each label."""
        found, self.kinds, self.numbers, self.fixed = {}, {}, {}, {}
        shape = {"label": str, "kind": KINDS, "size": int, "numbers": ([[rational]],), "exact": bool}
        items = read(items, [shape])
        need(sum(item.size for item in items) < LARGEST, "too many symbols")
        for item in items:
            given = item.numbers is not None
            need(item.size, f"{item.label}: no elements")
            need(item.label not in found, f"{item.label}: a symbol occurs twice")
            need(item.kind == "constant" if given else not item.exact, f"{item.label}: its numbers")
            nodes = [Node("symbol", value=(item.label, k)) for k in range(item.size)]
            found[item.label], self.kinds[item.label] = nodes, item.kind
            for node, (lower, upper) in zip(nodes, item.numbers or (), strict=given):
                need(lower == upper if item.exact else lower <= upper, f"{item.label}: its numbers")
                self.numbers[node] = Interval(lower, upper)
                self.fixed |= {node: lower} if item.exact else {}
        return found

    def read_program(self, value):
        """A zero, and the nodes of all instructions."""
        shape = {"operations": [OPERATIONS], "code": [int], "a": [int], "b": [int], "constants": [rational]}
        program, labels, nodes, self.divided = read(value, shape), list(self.symbols), [ZERO], []
        constants = list(map(number, program.constants))
        for k, first, second in zip(program.code, program.a, program.b, strict=True):
            name = at(program.operations, k)
            if name == "const":
                nodes.append(at(constants, first))
            elif name == "input":
                nodes.append(at(self.symbols[at(labels, first)], second))
            else:
                x, y = at(nodes, first + 1), at(nodes, second + 1)
                nodes.append(built(name, x) if name in UNARY else built(name, x, y))
                self.divided += [inverse(y)] * (name == "div")  # a divisor must not vanish, even in a part times 0
        return nodes

    def read_vector(self, places):
        need(places and {*map(type, places)} == {int}, "a vector: expected places")
        return [at(self.program, k + 1) for k in places]

    def read_rates(self, value):
        """The rate, or the next value, of each symbol that has one."""
        return dict(flat(zip(self.symbols[label], self.vector(k), strict=True) for label, k in value.items()))

    def read_term(self, value):
        need(value["rule"] in RULES, f"unknown rule {value['rule']!r:.20}")
        roles, parts = (text.split() for text in RULES[value["rule"]])
        parts = dict.fromkeys(parts, self.vector)
        return read(value, {"name": str, "role": {*roles}, "rule": str, "parts": parts, "assumed": (str,)})

    def vector(self, k):
        return at(self.vectors, k)

    def kind(self, node):
        return self.kinds[node.value[0]]

    def kinds_in(self, nodes):
        return {self.kind(x) for x in symbols(nodes)}

    def rate(self, nodes):
        """Derivatives along the file's rates; None where there is none, or of a symbol without a rate."""
        still = {"time": ONE, "constant": ZERO}
        return rates(nodes, lambda x: self.rates.get(x, still.get(self.kind(x))), self.derivatives)

    def sure_rate(self, nodes):
        found = self.rate(nodes)
        need(None not in found, "a derivative that does not exist, or of a function without a rule")
        return found

    def change(self, node):
        """The derivative, or the difference to the next sample."""
        if not self.samples:
            return self.sure_rate([node])[0]
        still = [x for x in symbols([node]) if x not in self.rates]
        need(self.kinds_in(still) <= {"constant"}, "V depends on what has no next value")
        return replaced([node], self.rates)[0] - node


# ---- Terms and the robot ---------------------------------------------------------------------------------------------
def term_value(of, term):
    """The sum over the elements of one rule."""
    part, a, w = term.parts, term.parts.vector, term.parts.weight
    if term.rule == "square":  # |a|^2 in the weight W
        return dot(a, weighted(w, a))
    if term.rule == "projected":  # -w (x - true) c, with x = a over a flow, and x = a + c over samples
        x = plus(a, part.correction) if of.samples else a
        return ZERO - dot(w, times(minus(x, part.true), part.correction))
    if term.rule == "potential":  # 2 w v^2 (sqrt(1 + (a / v)^2) - 1)
        return dot(w, each(lambda v, root: v * v * (root - ONE), part.scale, roots(part))) * number(2)
    phi = [[Node(term.rule, x) for x in over(own, part.scale)] for own in (a, part.other)]
    return dot(w, times(minus(a, part.other), minus(*phi)))  # w (a - b) (phi(a / v) - phi(b / v))


def roots(part):
    """sqrt(1 + (a / v)^2) of a potential."""
    return [Node("sqrt", ONE + x * x) for x in over(part.vector, part.scale)]


def correction(of, part):
    """What a projection adds to the rates of estimates; over samples, what moves values into their box."""
    if of.samples:
        box = part.vector, part.lower, part.upper
        return minus(each(lambda x, low, high: Node("fmin", Node("fmax", x, low), high), *box), part.vector)
    symbol = {("symbol", "state"), ("symbol", "correction")}
    need({(x.name, of.kind(x)) for x in part.vector + part.correction} == symbol, "a projection: expected symbols")
    need(of.kinds_in(part.lower + part.upper) <= {"constant"}, "a box that moves")
    return minus([of.rates[x] for x in part.vector], nominal(of, part))


def nominal(of, part):
    """Rates of estimates without the corrections of their projection."""
    return replaced([of.rates[x] for x in part.vector], dict.fromkeys(part.correction, ZERO))


def robot(of, item):
    """Names, and nodes that must vanish: the accelerations of a chain of rigid bodies follow from the torque.

    `place` is A = [R r], the rotation and the origin of a body in the frame of the one before. Its joint moves it with
    dA/dq = A K, where K is that of the axis. T_i places body i in the world, and S_i is the integral of r r' dm over
    its points r = (x, y, z, 1). By d'Alembert's principle, the force of joint j is sum_i tr(dT_i/dq_j S_i (d2T_i/dt2 -
    gravity)').
    """
    q, T, frames, last = of.symbols[item.position], unit(4, ZERO, ONE), [], [ZERO, ZERO, ZERO, ONE]
    moving = {x for x in [*q, *of.sure_rate(q)] if x.name == "symbol" and of.kind(x) == "state"}
    need(len(moving) == 2 * len(q), "positions and speeds of the robot: expected states", Refuted)
    for joint, x in zip(item.joints, q, strict=True):
        still = of.kinds_in([*joint.axis, *joint.body, *item.rotors, *item.gravity])
        still |= {of.kind(node) for node in symbols(joint.place) - {x}}
        need(still <= {"constant"}, "a joint, a body or gravity that moves by itself")
        A, (a, b, c) = [*matrix(joint.place, 3), last], joint.axis
        first, second, third = (row[:3] for row in A[:3])
        norms = [dot(u, u) - ONE for u in (first, second, joint.axis)]
        cross = [first[k - 2] * second[k - 1] - first[k - 1] * second[k - 2] for k in range(3)]
        yield "a joint's rotation and axis", [*norms, dot(first, second), *minus(cross, third)]
        K = [[ZERO, ZERO - c, b, ZERO], [c, ZERO, ZERO - a, ZERO], [ZERO - b, a, ZERO, ZERO]]
        if joint.kind == "prismatic":
            K = [[ZERO, ZERO, ZERO, u] for u in joint.axis]
        moved = flat(product(A[:3], [*K, [ZERO] * 4]))
        yield "a joint's motion", minus(slopes(flat(A[:3]), x), moved)
        T = product(T, A)
        frames.append(flat(T[:3]))
    falls = flat([ZERO, ZERO, ZERO, g] for g in item.gravity)
    accelerations = [minus(of.sure_rate(of.sure_rate(T)), falls) for T in frames]
    for x, ddx, rotor, torque in zip(q, of.sure_rate(of.sure_rate(q)), item.rotors, item.torque, strict=True):
        force = rotor * ddx - torque
        for joint, T, acceleration in zip(item.joints, frames, accelerations):
            slope = slopes(T, x)
            momentum = product([slope[k : k + 4] for k in (0, 4, 8)], pseudo_inertia(joint))
            force += dot(flat(momentum), acceleration)
        yield "the robot's equation of motion", [force]


def pseudo_inertia(joint):
    """S from its elements on and below the diagonal, row by row."""
    return [[joint.body[max(i, k) * (max(i, k) + 1) // 2 + min(i, k)] for k in range(4)] for i in range(4)]


# ---- The identity ----------------------------------------------------------------------------------------------------
def equalities(of):
    """Names, and nodes that must vanish; the first one is V, which must not."""
    V, total, found = ZERO, ZERO, flat(robot(of, item) for item in of.robots)
    for term in of.terms:
        value = term_value(of, term)
        if term.role == "stored":
            V, total = V + value, total + number(Fraction(1, 2)) * of.change(value)
        else:
            total = total + value if term.role == "dissipated" else total - value
        if term.rule == "projected":
            found.append((f"the correction of {term.name}", minus(correction(of, term.parts), term.parts.correction)))
    return [("V", [V]), ("V(next) - V" if of.samples else "dV/dt", [total]), *found]


def complexity(nodes, fixed):
    """D + H of all polynomials that must not vanish at a random point: the numerators of these nodes and of divisors,
    and the differences of arguments of functions. `fixed` contains the numbers of symbols with exact ones.

    The size of a node bounds degree and log2 of the sum of coefficients, of its numerator and of its denominator.
    """
    sizes, total, arguments = {}, 0, set()
    for node in below(nodes):
        if node.name in ARITHMETIC or node.name == "inv":
            sizes[node] = sum(sizes[x] for x in node.of) + 1
            need(sizes[node] < 1 << max(SIZES), "the degree of an expression is too high")
            total += 2 * sizes[node] * (node.name == "inv")
        elif node.name == "number" or node in fixed:
            value = fixed.get(node, node.value)
            sizes[node] = max(value.numerator.bit_length(), value.denominator.bit_length())
        else:
            sizes[node] = 2 if node.name in ("sin", "cos") else 1
            arguments.update(node.of)
    total += len(arguments) ** 2 * (4 * max((sizes[x] for x in arguments), default=0) + 4)
    return total + 2 * max(sizes.values())


def random_prime(bits):
    """A prime p = 3 mod 4, of which -1 is no square, by the test of Miller and Rabin with 64 random bases."""
    while True:
        p = secrets.randbits(bits) | 1 << (bits - 1) | 3
        if all(pow(secrets.randbelow(p - 3) + 2, p // 2, p) in (1, p - 1) for _ in range(64)):
            return p


def identity(of):
    """log2 of the error bound and the number of points. A fraction of polynomials that is not identically zero vanishes
    at a random point with a probability of at most 8 (D + H) / 2^bits, where D and H bound its degree and coefficients.
    """
    found = equalities(of)
    nodes = flat([*(own for _, own in found), *of.vectors, of.divided])
    error = log2(complexity(nodes, of.fixed)) + 3
    bits = next((bits for bits in SIZES if error - bits < -64), None)
    need(bits is not None, f"the degree of the identity is too high: 8 (D + H) is 2^{error:.0f}")
    points = ceil(WANTED / (error - bits))
    for _ in range(points):
        field = Field(random_prime(bits))
        values = {node: field.number(value) for node, value in of.fixed.items()}
        evaluate(nodes, field, values)
        for name, own in found:
            need(any(values[node] for node in own) == (name == "V"), f"{name} does not hold", Refuted)
    evaluate(of.divided, field, with_numbers(of, field))  # no divisor vanishes with the file's numbers
    return points * (error - bits), points


def with_numbers(of, field):
    """Values of constants whose interval is one number."""
    return {x: field.number(i.lower) for x, i in of.numbers.items() if i.lower == i.upper}


# ---- Signs and conditions --------------------------------------------------------------------------------------------
class Signs:
    """Signs over the intervals of constants, and of states in boxes. `assumed` collects what they do not show, `strict`
    contains the terms with a positive weight.
    """

    def __init__(self, of):
        self.of, self.known, self.assumed, self.strict = of, dict(of.numbers), [], []
        for term in of.terms:
            if term.role != "residual":
                self.term(term)
        for item in of.robots:
            bodies = [self.sign(flat(pseudo_inertia(joint)), 4) for joint in item.joints]
            need(min(bodies) == 1 and self.sign(item.rotors) >= 0, "a body of the robot: its inertia", Refuted)
        for item in of.conditions:
            if not item.margin or self.intervals(item.margin) is None:
                self.assumed.append(f"condition: {item.name}")
            else:
                need(self.sign(item.margin) >= item.strict, f"condition: {item.name}", Refuted)

    def intervals(self, nodes):
        """Intervals of nodes; None if they depend on more than these, or on a function."""
        try:
            return evaluate(nodes, Interval.call, dict(self.known))
        except ArithmeticError:
            return None

    def sign(self, nodes, size=0):
        """1 if all elements, or a matrix, are positive, 0 if none is negative, -1 otherwise or if not decided."""
        is_matrix = size > 1 and len(nodes) == size * size
        values = self.intervals(pivots(matrix(symmetric(nodes, size), size)) if is_matrix else nodes)
        least = -1 if values is None else min((x.lower for x in values), default=1)
        return (least > 0) - (least < 0)

    def term(self, term):
        """The term is not negative: so is a weight, and a projection moves estimates towards all points of its box."""
        part, sign = term.parts, self.sign(term.parts.weight, len(term.parts.vector) * (term.rule == "square"))
        if term.assumed and self.intervals(part.weight) is None:
            self.assumed.append(f"{term.name}: its weight is uniformly positive: {term.assumed}")
            sign = 1
        scaled = "scale" not in vars(part) or self.sign(part.scale) == 1
        need(sign >= 0 and scaled, f"{term.name}: the sign of its weight or scale is wrong, or not shown", Refuted)
        self.strict += [term] * (sign == 1)
        if term.rule == "projected":
            self.box(term)

    def box(self, term):
        part, known = term.parts, self.intervals(term.parts.true) is not None
        room = [minus(part.true, part.lower), minus(part.upper, part.true)] * known
        self.assumed += [f"{term.name}: its true value is inside its box"] * (not known)
        signs = [self.sign(x) for x in (minus(part.upper, part.lower), *room)]
        need(min(signs) >= 0, f"{term.name}: its box is empty, or its true value is not inside", Refuted)
        if self.of.samples:
            return
        self.assumed.append(f"{term.name}: it starts in its box, and its law is this projection")
        for x, low, high in zip(part.vector, self.intervals(part.lower), self.intervals(part.upper), strict=True):
            need(x not in self.known, f"{term.name}: two boxes")
            self.known[x] = Interval(low.lower, high.upper)


# ---- Conclusions -----------------------------------------------------------------------------------------------------
def restricted(basis, slopes, p):
    """The directions in the span of a basis along which all functionals vanish; slopes[k] are theirs along basis[k]."""
    rows, n = [[*u, *own] for u, own in zip(basis, slopes, strict=True)], len(basis[0]) if basis else 0
    for k in range(n, len(rows[0]) if rows else n):
        pivot = next((row for row in rows if row[k]), None)
        if pivot is not None:
            scale = pow(pivot[k], -1, p)
            others = [row for row in rows if row is not pivot]
            factors = [row[k] * scale % p for row in others]
            rows = [[(x - f * y) % p for x, y in zip(row, pivot)] if f else row for f, row in zip(factors, others)]
    return [row[:n] for row in rows]


class Conclusions:
    """Bounded and vanishing signals, if V does not increase and given signals, with their rates, are bounded.

    A direction of the space of states and time is open if no bounded signal determines it. With all bounded functions
    frozen, a signal that does not change along a random open direction is bounded; a bounded signal that changes at a
    constant rate closes a direction. `loose` are corrections that may be unbounded. Constants have the file's numbers.
    """

    def __init__(self, of, signs):
        self.of, self.signs, self.p, self.points, self.gone = of, signs, random_prime(SIZES[1]), [], []
        field, elements = Field(self.p), flat(of.symbols.values())
        self.columns = [x for x in elements if of.kind(x) in ("state", "time")]
        need(len(self.columns) <= WIDEST, "too many states")
        self.loose = {x for x in elements if of.kind(x) == "correction"}
        self.given = {x: field.random(x) for x in elements if of.kind(x) == "constant"} | with_numbers(of, field)
        self.places = [(Field(self.p, frozen=True), dict(self.given)) for _ in range(2)]
        self.squares = flat(x.parts.vector for x in signs.strict if (x.role, x.rule) == ("dissipated", "square"))
        self.wanted = [x for x in of.conclusions if x.vector]
        self.limits, self.open = [], unit(len(self.columns))
        self.premises()
        while sum([self.bounded(x) and not self.bounded(y) and self.close(y) for x, y in self.bounds]):
            pass
        ends = [x.vector for x in self.wanted if x.says == "goes to zero"] + [nodes for _, nodes, _ in self.limits]
        self.count = 4 + sum(map(len, ends))
        need(self.count <= WIDEST, "too many vanishing signals")
        self.basis = unit(self.count)

    def premises(self):
        """Where the first signals of `bounds` are bounded, the second are; where those of `limits` vanish, too."""
        of, projected = self.of, [x.parts for x in self.of.terms if x.rule == "projected"]
        boxed = {node for x in projected for node in x.vector}
        moving = [x for x in self.columns if x in of.rates and x not in boxed]
        steady = unit(len(moving))  # combinations of states whose rate is identically zero
        for row in self.sampled([of.rates[x] for x in moving], len(moving) + 3):
            steady = restricted(steady, [[dot(u, row) % self.p] for u in steady], self.p) if moving else []
        self.bounds = [([], x.vector) for x in projected] + [([], [dot(map(number, u), moving)]) for u in steady]
        self.bounds += [(nominal(of, x), x.correction) for x in projected]
        for term in of.terms:
            part = term.parts
            if term.role == "stored" and term in self.signs.strict:
                self.bounds.append(([], part.vector))
            if term.rule == "potential":  # a / sqrt(1 + (a / v)^2) has the zeros of a
                self.limits.append((over(part.vector, roots(part)), part.vector, ""))
        for item in of.stable:  # W dz/dt = - L z + force
            z, rate = item.vector, of.rate(item.vector)
            stable = self.signs.sign(item.weight, len(z)) == self.signs.sign(item.loss, len(z)) == 1
            if stable and of.kinds_in(item.weight) <= {"constant"} and None not in rate:
                force = plus(weighted(symmetric(item.weight, len(z)), rate), weighted(item.loss, z))
                self.bounds.append((force, z))
                self.limits.append((force, z, ""))
        for item in of.ranks:
            R = matrix(item.matrix, len(item.vector))
            values = matrix(self.sampled(item.matrix, 1)[0], len(R))
            if not restricted(unit(len(R)), values, self.p):
                forces = flat(product([item.vector], R))
                self.limits.append((forces, item.vector, f"{item.name} keeps full row rank, uniformly"))

    def along(self, nodes, place, u):
        """Changes of nodes along u, with the bounded functions of a place."""
        field, values = self.places[place]
        ahead = {x: (field.random(x) + step) % self.p for x, step in zip(self.columns, u, strict=True) if step}
        before, after = evaluate(nodes, field, values), evaluate(nodes, field, self.given | ahead)
        return [(x - y) % self.p for x, y in zip(after, before, strict=True)]

    def bounded(self, nodes):
        weights = [secrets.randbelow(self.p) for _ in self.open]
        u = [dot(weights, column) % self.p for column in zip(*self.open)] if weights else [0] * len(self.columns)
        return None not in nodes and not symbols(nodes) & self.loose and not any(self.along(nodes, 0, u))

    def close(self, nodes):
        """Closes directions along which bounded signals change at a constant rate; True if there was one."""
        one, other = ([self.along(nodes, k, u) for u in self.open] for k in (0, 1))
        steady = [k for k in range(len(nodes)) if all(a[k] == b[k] for a, b in zip(one, other, strict=True))]
        before = len(self.open) + len(self.loose)
        self.open = restricted(self.open, [[row[k] for k in steady] for row in one], self.p)
        self.loose -= {*nodes}
        return len(self.open) + len(self.loose) < before

    def sampled(self, nodes, count):
        """Values at random points, with the file's constants."""
        while len(self.points) < count:
            self.points.append((Field(self.p), dict(self.given)))
        return [evaluate(nodes, *point) for point in self.points[:count]]

    def among(self, nodes, others):
        """True if each of these is one of the others."""
        values = list(zip(*self.sampled([*nodes, *others], 2), strict=True))
        return {*values[: len(nodes)]} <= {*values[len(nodes) :]}

    def products(self, nodes):
        """Products of these signals, at all points, with the vectors that are orthogonal to all vanishing signals."""
        columns = list(zip(*self.sampled(nodes, self.count), strict=True))
        return [[dot(u, column) % self.p for column in columns] for u in self.basis]

    def vanish(self, nodes):
        """True if each of these is a combination of vanishing signals with constant coefficients."""
        return not any(map(any, self.products(nodes)))

    def follows(self, item):
        """True if a conclusion follows. A signal vanishes if its square is integrable and its derivative bounded
        (Barbalat's lemma), if it is the derivative of a vanishing signal and its own derivative is bounded, or if
        vanishing signals make it.
        """
        nodes, says, integrable = item.vector, item.says, self.among(item.vector, self.squares)
        if says != "goes to zero":
            return (says == "is square-integrable" and integrable) or (says == "is bounded" and self.bounded(nodes))
        ends = integrable or self.among(nodes, [x for x in self.of.rate(self.gone) if x is not None])
        return (ends and self.bounded(self.of.rate(nodes))) or self.vanish(nodes)

    def check(self):
        """The conclusions of the file that follow."""
        shown = []
        while True:
            new = [x for x in self.wanted if x not in shown and self.follows(x)]
            used = [x for x in self.limits if self.vanish(x[0]) and not self.vanish(x[1])]
            for nodes in [x.vector for x in new if x.says == "goes to zero"] + [nodes for _, nodes, _ in used]:
                self.gone += nodes
                self.basis = restricted(self.basis, self.products(nodes), self.p)
            self.signs.assumed += [text for *_, text in used if text]
            shown += new
            if not new + used:
                return [f"{item.signal} {item.says}" for item in shown]


def with_residual(of, strict):
    """What holds for any residual: all that is dissipated is in sum at most V at the start and the residual."""
    yield "V does not rise where the residual is zero"
    for term in strict:
        if term.role == "dissipated" and term.rule == "square":
            yield f"{term.name} is {'summable' if of.samples else 'integrable'} where the residual is"
    for label, nodes in of.symbols.items() if of.samples else ():
        if nodes and all(clipped(of, of.rates.get(x, ZERO)) for x in nodes):
            yield f"{label} is bounded"


def clipped(of, node):
    """True for fmin(fmax(z, lower), upper) with constants."""
    inner, *upper = node.of if node.name == "fmin" else [ZERO]
    return inner.name == "fmax" and of.kinds_in([inner.of[1], *upper]) <= {"constant"}


# ---- The result ------------------------------------------------------------------------------------------------------
def proved(of):
    (error, points), signs = identity(of), Signs(of)
    if of.samples or any(term.role == "residual" for term in of.terms):
        shown = list(dict.fromkeys(with_residual(of, signs.strict)))
    else:
        shown = Conclusions(of, signs).check()
    given, still = ([x for x, kind in of.kinds.items() if kind == own] for own in ("given", "constant"))
    exact = {x for x, ends in of.numbers.items() if ends.lower == ends.upper}
    some = [label for label in still if not exact >= {*of.symbols[label]}]
    lists = {"constant": still, "bounded": given, "conclusions are for almost all values of": some}
    texts = [f"{text}: {', '.join(x)}" for text, x in lists.items() if x and (text == "constant" or not of.samples)]
    chain = "{}: a chain of {} rigid bodies, whose acceleration follows from a torque of {}"
    reads = [", ".join(sorted({x.value[0] for x in symbols(item.torque)})) for item in of.robots]
    return {
        "status": "re-proved",
        "statement": "V(next) - V" if of.samples else "dV/dt",
        "log2_error": round(error),
        "points": points,
        "robot": [chain.format(x.position, len(x.joints), text) for x, text in zip(of.robots, reads)],
        "only_at_exact_values_of": sorted({node.value[0] for node in of.fixed}),
        "conclusions": shown,
        "not_checked": [x for x in of.stated if x not in shown],
        "assumed": [*ASSUMED, *texts, *dict.fromkeys(signs.assumed), *of.assumed],
    }


def check(data: object) -> dict:
    """Result of the check of a parsed file; `status` is re-proved, refuted or refused, the latter two with a reason."""
    try:
        return proved(Certificate(data))
    except Refuted as error:
        return {"status": "refuted", "reason": str(error)}
    except (Exception, RecursionError) as error:
        return {"status": "refused", "reason": f"{type(error).__name__}: {error}"}


def unique(pairs):
    need(len(dict(pairs)) == len(pairs), "a key occurs twice in one object")
    return dict(pairs)


def main(arguments):
    paths = [x for x in arguments if x != "--json"]
    try:
        need(len(paths) == 1, "usage: python check.py FILE [--json]")
        with open(paths[0], "rb") as file:
            content = file.read(LONGEST)
        need(len(content) < LONGEST, "the file is too long")
        result = check(json.loads(content.decode(), object_pairs_hook=unique, parse_constant=rational))
    except Exception as error:  # of a file that is no certificate
        result = {"status": "refused", "reason": f"{type(error).__name__}: {error}"}
    sys.stdout.reconfigure(errors="backslashreplace")
    if "--json" in arguments:
        print(json.dumps(result, indent=1))
    else:
        for name, value in result.items():
            lines = ["", *value] if isinstance(value, list) else [f" {value}"]
            print(f"{name.replace('_', ' ')}:" + "\n  ".join(map(str, lines)))
    return {"re-proved": 0, "refuted": 1, "refused": 2}[result["status"]]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
