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
import os
import re
import secrets
import sys
from fractions import Fraction
from functools import partial
from itertools import accumulate
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
RULES = {  # of terms: their roles, their parts, and where they are known
    "square": ("stored dissipated residual", "vector weight", "flow sample"),
    "potential": ("stored", "vector scale weight", "flow"),
    "tanh": ("dissipated", "vector other scale weight", "flow"),
    "atan": ("dissipated", "vector other scale weight", "flow"),
    "projected": ("dissipated", "vector correction true lower upper weight", "flow sample"),
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
        return self * (ONE if other is ONE else Node("inv", other))


def number(value):
    return ZERO if value == 0 else ONE if value == 1 else Node("number", value=Fraction(value))


def built(name, *of):
    """The node of an operation."""
    return ONE / of[0] if name == "inv" else ARITHMETIC.get(name, partial(Node, name))(*of)


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


class Field:
    """Values modulo a prime. A function has a random value for each argument: what holds for all values holds for those
    of the function. sin and cos of one argument are a random point of the unit circle. If `frozen`, a bounded function
    keeps its value whatever its argument is. A divisor that vanishes is a ValueError.
    """

    def __init__(self, p, frozen=False):
        self.p, self.frozen, self.known = p, frozen, {}

    def random(self, *key):
        return self.known.setdefault(key, secrets.randbelow(self.p))

    def residues(self, numbers):
        return {node: x.numerator * pow(x.denominator, -1, self.p) % self.p for node, x in numbers.items()}

    def __call__(self, node, *given):
        name = node.name
        if name in ARITHMETIC:
            return ARITHMETIC[name](*given) % self.p
        if name == "number":
            return self.residues({node: node.value})[node]
        if name == "inv":
            return pow(*given, -1, self.p)
        if name in ("sin", "cos"):
            t = self.random("circle", *(node.of if self.frozen else given))
            return (1 - t * t if name == "cos" else 2 * t) * pow(1 + t * t, -1, self.p) % self.p
        still = name == "symbol" or (self.frozen and name in BOUNDED)
        return self.random(node) if still else self.random(name, *given)


def interval(node, *given):
    """Least and largest value of an operation over intervals of its operands, as rational numbers; an ArithmeticError
    where these do not decide.
    """
    name, (a, b) = node.name, given[0] if given else (node.value, node.value)
    if name in ("add", "mul"):
        values = [ARITHMETIC[name](x, y) for x in given[0] for y in given[1]]
        if name == "mul" and node.of[0] is node.of[1]:
            values = [max(x, Fraction(0)) for x in values]  # a square
    elif name == "sub":
        values = [a - given[1][1], b - given[1][0]]
    elif name == "fabs":
        values = [max(a, -b, Fraction(0)), max(-a, b)]
    elif name == "inv":
        need(a > 0 or b < 0, "a divisor may vanish", ArithmeticError)
        values = [1 / a, 1 / b]
    else:
        need(name == "number", "a symbol or a function without an interval", ArithmeticError)
        values = [a, b]
    need(all(max(abs(x.numerator), x.denominator) <= HIGHEST for x in values), "a number is too long", ArithmeticError)
    return min(values), max(values)


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


def unit(n):
    return [[int(i == k) for i in range(n)] for k in range(n)]


def matrix(elements, rows):
    """The rows of a matrix that is given column by column."""
    need(len(elements) % rows == 0, "a matrix: its number of rows")
    return [elements[i::rows] for i in range(rows)]


def weighted(weight, vector):
    """W a, with W a diagonal, or a matrix column by column."""
    n = len(vector)
    return times(weight, vector) if len(weight) == n else [dot(row, vector) for row in matrix(weight, n)]


def symmetric(weight, n):
    """The symmetric part of a matrix; a diagonal is its own."""
    if len(weight) == n:
        return weight
    rows, half = matrix(weight, n), [number(Fraction(1, 2))] * n
    return flat(times(half, plus(*pair)) for pair in zip(rows, zip(*rows), strict=True))


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
    fits = type(value) in (str, int) and value in shape if isinstance(shape, set) else type(value) is shape
    fits = fits and (type(value) is not int or 0 <= value < LARGEST)
    is_line = type(value) is not str or (value.isascii() and value.isprintable())  # letters may look alike
    need(fits and is_line, f"unknown: {value!a:.40}")
    return value


def name(value):
    """A name, which must not read as a statement."""
    need(read(value, str).strip() == value > "" and not re.search(r"\b(is|are|goes)\b", value), f"a name: {value:.40}")
    return value


def at(items, k):
    need(type(k) is int and 0 <= k < len(items), f"there is no number {k!r:.20}")
    return items[k]


def rational(text):
    need(len(text) < 4000 and re.fullmatch("-?[0-9]+(/0*[1-9][0-9]*)?", text), f"expected a fraction: {text:.40}")
    return Fraction(text)


class Certificate:
    """A file that has been read: its lists contain nodes in place of the numbers of vectors.

    `known` are intervals of constants, and of states in boxes; `exact` those that are one number. `listed` collects
    what is assumed.
    """

    def __init__(self, data):
        need(type(data) is dict and data.get("version") == 4, "version: expected 4; write the file again")
        NODES.clear()
        vector = self.vector
        joint = {"kind": {"revolute", "prismatic"}, "axis": vector, "place": vector, "body": self.read_body}
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
            "ranks": [{"name": name, "matrix": vector, "vector": vector}],
            "conditions": [{"name": str, "margin": (vector,), "strict": bool}],
            "conclusions": [{"signal": name, "says": str, "vector": (vector,)}],
            "assumed": [str],
        }
        need(data.keys() == shape.keys(), f"missing or unknown: {', '.join(sorted(data.keys() ^ shape.keys()))}")
        for key, own in shape.items():
            setattr(self, key, read(data[key], own))
        self.samples, self.derivatives, self.listed = self.over == "sample", {}, []
        need({*map(type, self.about.values())} <= {str}, "about: expected texts")
        need(not (self.samples and (self.robots or self.stable or self.ranks)), "a rule that is unknown over a sample")
        need(any(term.role == "stored" for term in self.terms), "V has no term")
        self.one_meaning()
        sizes = [(len(x.vector), {len(x.weight), len(x.loss)}) for x in self.stable]
        need(all(own <= {n, n * n} for n, own in sizes), "a linear equation: its sizes")
        corrections = [x for term in self.terms if term.rule == "projected" for x in term.parts.correction]
        need(self.samples or len({*corrections}) == len(corrections), "a correction occurs twice")
        for node, rate in self.rates.items():
            given = not self.samples and self.kinds_in([rate]) <= {"constant", "given", "time"}
            need(self.kind(node) == "state" or (self.kind(node) == "given" and given), f"{node.value[0]}: a rate")

    def one_meaning(self):
        """A name has one meaning; what is named once for each entry has the entry's position."""
        self.stated = [f"{item.signal} {item.says}" for item in self.conclusions]
        names = [("conclusion", text, k) for k, text in enumerate(self.stated)]
        names += [("condition", x.name, k) for k, x in enumerate(self.conditions)]
        names += [("assumed weight", x.name, k) for k, x in enumerate(self.terms) if x.assumed]
        names += [("signal", label, nodes) for label, nodes in self.symbols.items()]
        names += [("signal", x.signal, x.vector) for x in self.conclusions if x.vector]
        names += [("matrix", x.name, x.matrix) for x in self.ranks]
        boxed = [(k, x.name, x.parts) for k, x in enumerate(self.terms) if x.rule == "projected"]
        # over samples, several steps may end in one box
        names += [("box", text, [x.true, x.lower, x.upper] if self.samples else k) for k, text, x in boxed]
        known = {}
        for kind, name, meaning in names:
            need(known.setdefault((kind, name), meaning) == meaning, f"{name}: a {kind} of two meanings")

    def read_symbols(self, items):
        """The nodes of each label."""
        found, self.kinds, self.known, self.fixed = {}, {}, {}, {}
        items = read(items, [{"label": name, "kind": KINDS, "size": int, "numbers": ([[rational]],), "exact": bool}])
        need(sum(item.size for item in items) < LARGEST, "too many symbols")
        for item in items:
            given = item.numbers is not None
            need(item.size and item.label not in found, f"{item.label}: it has no elements, or occurs twice")
            need(item.kind == "constant" if given else not item.exact, f"{item.label}: its numbers")
            found[item.label] = [Node("symbol", value=(item.label, k)) for k in range(item.size)]
            self.kinds[item.label] = item.kind
            for node, (lower, upper) in zip(found[item.label], item.numbers or (), strict=given):
                need(lower == upper if item.exact else lower <= upper, f"{item.label}: its numbers")
                self.known[node] = lower, upper
                self.fixed |= {node: lower} if item.exact else {}
        self.exact = {node: lower for node, (lower, upper) in self.known.items() if lower == upper}
        return found

    def read_program(self, value):
        """A zero, and the nodes of all instructions."""
        shape = {"operations": [OPERATIONS], "code": [int], "a": [int], "b": [int], "constants": [rational]}
        program, labels, nodes, self.divisors = read(value, shape), list(self.symbols), [ZERO], []
        for k, first, second in zip(program.code, program.a, program.b, strict=True):
            operation = at(program.operations, k)
            if operation == "const":
                nodes.append(number(at(program.constants, first)))
            elif operation == "input":
                nodes.append(at(self.symbols[at(labels, first)], second))
            else:
                of = [at(nodes, k + 1) for k in (first, second)]
                nodes.append(built(operation, *of[: 1 if operation in UNARY else 2]))
                self.divisors += [ONE / of[1]] * (operation == "div")  # they must not vanish, even in a part times 0
        return nodes

    def read_vector(self, places):
        need(places and {*map(type, places)} == {int}, "a vector: expected places")
        return [at(self.program, k + 1) for k in places]

    def read_rates(self, value):
        """The rate, or the next value, of each symbol that has one."""
        return dict(flat(zip(self.symbols[label], self.vector(k), strict=True) for label, k in value.items()))

    def read_term(self, value):
        roles, parts, over = (text.split() for text in RULES.get(value["rule"], ("", "", "")))
        need(self.over in over, f"unknown rule {value['rule']!r:.20} over a {self.over}")
        parts = dict.fromkeys(parts, self.vector)
        return read(value, {"name": name, "role": {*roles}, "rule": str, "parts": parts, "assumed": (str,)})

    def read_body(self, k):
        """A pseudo-inertia from its elements on and below the diagonal, row by row."""
        elements = self.vector(k)
        return [[at(elements, max(i, k) * (max(i, k) + 1) // 2 + min(i, k)) for k in range(4)] for i in range(4)]

    def vector(self, k):
        return at(self.vectors, k)

    def kind(self, node):
        return self.kinds[node.value[0]] if node.name == "symbol" else ""

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

    def change(self, value):
        """The derivative, or the difference to the next sample."""
        if not self.samples:
            return self.sure_rate([value])[0]
        still = [x for x in symbols([value]) if x not in self.rates]
        need(self.kinds_in(still) <= {"constant"}, "V depends on what has no next value")
        return replaced([value], self.rates)[0] - value

    def sign(self, nodes, size=1):
        """1 if all elements, or a matrix, are positive, 0 if none is negative, -1 otherwise or if not decided."""
        is_matrix = size > 1 and len(nodes) == size * size
        nodes = pivots(matrix(symmetric(nodes, size), size)) if is_matrix else nodes
        try:
            least = min((lower for lower, _ in evaluate(nodes, interval, dict(self.known))), default=1)
        except ArithmeticError:
            return -1
        return (least > 0) - (least < 0)

    def decided(self, nodes):
        """Those that depend on numbers alone. What is assumed of a vector must hold for these."""
        parts, known = {"number", "fabs", "inv", *ARITHMETIC}, dict.fromkeys(self.known, True)
        found = evaluate(nodes, lambda node, *of: node.name in parts and all(of), known)
        return [x for x, is_decided in zip(nodes, found) if is_decided]


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
        return minus(clipped(part), part.vector)
    kinds = {of.kind(x) for x in part.vector}, {of.kind(x) for x in part.correction}
    need(kinds == ({"state"}, {"correction"}), "a projection: expected symbols")
    need(of.kinds_in(part.lower + part.upper) <= {"constant"}, "a box that moves")
    return minus([of.rates[x] for x in part.vector], nominal(of, part))


def nominal(of, part):
    """Rates of estimates without the corrections of their projection."""
    return replaced([of.rates[x] for x in part.vector], dict.fromkeys(part.correction, ZERO))


def clipped(part):
    return each(lambda x, low, high: Node("fmin", Node("fmax", x, low), high), part.vector, part.lower, part.upper)


def robot(of, item):
    """Names, and nodes that must vanish: the accelerations of a chain of rigid bodies follow from the torque.

    `place` is A = [R r], the rotation and the origin of a body in the frame of the one before. Its joint moves it with
    dA/dq = A K, where K is that of the axis. T_i places body i in the world, and S_i is the integral of r r' dm over
    its points r = (x, y, z, 1). By d'Alembert's principle, the force of joint j is sum_i tr(dT_i/dq_j S_i (d2T_i/dt2 -
    gravity)').
    """
    q, places = of.symbols[item.position], []
    speeds = of.sure_rate(q)
    states = {x for x in q + speeds if of.kind(x) == "state"}
    need(len(states) == 2 * len(q), "positions and speeds of the robot: expected states", Refuted)
    for joint, x in zip(item.joints, q, strict=True):
        still = of.kinds_in([*joint.axis, *flat(joint.body), *item.rotors, *item.gravity])
        still |= {of.kind(node) for node in symbols(joint.place) - {x}}
        need(still <= {"constant"}, "a joint, a body or gravity that moves by itself")
        A, (a, b, c) = [*matrix(joint.place, 3), [ZERO, ZERO, ZERO, ONE]], joint.axis
        first, second, third = (row[:3] for row in A[:3])
        norms = [dot(u, u) - ONE for u in (first, second, joint.axis)]
        cross = [first[k - 2] * second[k - 1] - first[k - 1] * second[k - 2] for k in range(3)]
        yield "a joint's rotation and axis", [*norms, dot(first, second), *minus(cross, third)]
        K = [[ZERO, ZERO - c, b, ZERO], [c, ZERO, ZERO - a, ZERO], [ZERO - b, a, ZERO, ZERO], [ZERO] * 4]
        if joint.kind == "prismatic":
            K = [[ZERO, ZERO, ZERO, u] for u in [*joint.axis, ZERO]]
        yield "a joint's motion", minus(slopes(flat(A), x), flat(product(A, K)))
        places.append(A)
    frames = list(map(flat, accumulate(places, product)))
    falls = flat([ZERO, ZERO, ZERO, g] for g in [*item.gravity, ZERO])
    accelerations = [minus(of.sure_rate(of.sure_rate(T)), falls) for T in frames]
    for x, ddx, rotor, torque in zip(q, of.sure_rate(speeds), item.rotors, item.torque, strict=True):
        force = rotor * ddx - torque
        for joint, T, acceleration in zip(item.joints, frames, accelerations):
            slope = slopes(T, x)
            momentum = product([slope[k : k + 4] for k in (0, 4, 8)], joint.body)
            force += dot(flat(momentum), acceleration[:12])
        yield "the robot's equation of motion", [force]


def slopes(nodes, symbol):
    """Derivatives by one symbol."""
    return rates(nodes, lambda node: ONE if node is symbol else ZERO, {})


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
    sizes, divisors, arguments = {}, 0, set()
    for node in below(nodes):
        value = fixed.get(node, node.value)
        if isinstance(value, Fraction):
            sizes[node] = max(value.numerator.bit_length(), value.denominator.bit_length())
        elif node.name in ARITHMETIC or node.name == "inv":
            sizes[node] = min(sum(sizes[x] for x in node.of) + 1, 1 << max(SIZES))
            divisors += sizes[node] * (node.name == "inv")
        else:
            sizes[node] = 2 if node.name in ("sin", "cos") else 1
            arguments.update(node.of)
    largest = max((sizes[x] for x in arguments), default=0)
    return 2 * max(sizes.values()) + 2 * divisors + len(arguments) ** 2 * (4 * largest + 4)


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
    nodes = flat([*(own for _, own in found), *of.vectors, of.divisors])
    error = log2(complexity(nodes, of.fixed)) + 3
    bits = next((bits for bits in SIZES if error - bits < -64), None)
    need(bits is not None, f"the degree of the identity is too high: 8 (D + H) is 2^{error:.0f}")
    points = ceil(WANTED / (error - bits))
    for _ in range(points):
        field = Field(random_prime(bits))
        values = field.residues(of.fixed)
        evaluate(nodes, field, values)
        for name, own in found:
            need(any(values[node] for node in own) == (name == "V"), f"{name} does not hold", Refuted)
    evaluate(of.divisors, field, field.residues(of.exact))  # no divisor vanishes with the file's numbers
    return points * (error - bits), points


# ---- Signs and conditions --------------------------------------------------------------------------------------------
def signs(of):
    """Checks that no term is negative: so is a weight, and a projection moves estimates towards all points of its box.

    Conclusions are drawn from terms with a positive weight alone.
    """
    for term in of.terms:
        part, residual, W = term.parts, term.role == "residual", term.parts.weight
        n = len(part.vector) if term.rule == "square" else 1
        sign, decided = of.sign(W, n), of.decided(W)
        if term.assumed and len(decided) < len(W) and not residual:
            of.listed.append(f"{term.name}: its weight is uniformly positive: {term.assumed}")
            sign = of.sign(of.decided(W[:: n + 1]) if len(W) == n * n else decided)
            need(sign == 1, f"{term.name}: its weight is not positive", Refuted)
        term.positive = sign == 1 and not residual
        fits = sign >= 0 and ("scale" not in vars(part) or of.sign(part.scale) == 1)
        need(fits or residual, f"{term.name}: the sign of its weight or scale is wrong, or not shown", Refuted)
        if term.rule == "projected":
            box(of, term.name, part)
    for item in of.robots:
        bodies = [of.sign(flat(joint.body), 4) for joint in item.joints]
        need(min(bodies) == 1 and of.sign(item.rotors) >= 0, "a body of the robot: its inertia", Refuted)
    for item in of.conditions:
        decided, text = of.decided(item.margin or []), f"condition: {item.name}"
        of.listed += [text] * (not item.margin or len(decided) < len(item.margin))
        need(of.sign(decided) >= item.strict, text, Refuted)


def box(of, name, part):
    room = minus(part.true, part.lower) + minus(part.upper, part.true)
    if len(of.decided(part.true)) < len(part.true):
        of.listed.append(f"{name}: its true value is inside its box")
        room = of.decided(room)
    fits = of.sign(minus(part.upper, part.lower)) >= 0 and of.sign(room) >= 0
    need(fits, f"{name}: its box is empty, or its true value is not inside", Refuted)
    if not of.samples:
        of.listed.append(f"{name}: it starts in its box, and its law is this projection")
        need(not of.known.keys() & {*part.vector}, f"{name}: two boxes")
        ends = [evaluate(nodes, interval, dict(of.known)) for nodes in (part.lower, part.upper)]
        of.known |= {x: (low[0], high[1]) for x, low, high in zip(part.vector, *ends, strict=True)}


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

    A direction of the space of states, corrections and time is open if no bounded signal determines it. With all
    bounded functions frozen, a signal that does not change along a random open direction is bounded; a bounded signal
    that changes at a constant rate closes a direction. Constants have the file's numbers.
    """

    def __init__(self, of):
        self.of, self.p, self.points, self.gone = of, random_prime(SIZES[1]), [], []
        field, elements = Field(self.p), flat(of.symbols.values())
        self.columns = [x for x in elements if of.kind(x) in ("state", "time", "correction")]
        need(len(self.columns) <= WIDEST, "too many states")
        self.given = {x: field.random(x) for x in elements if of.kind(x) == "constant"} | field.residues(of.exact)
        self.places = [(Field(self.p, frozen=True), dict(self.given)) for _ in range(2)]
        positive = [x for x in of.terms if x.positive]
        self.squares = flat(x.parts.vector for x in positive if (x.role, x.rule) == ("dissipated", "square"))
        self.bounds = [([], x.parts.vector) for x in positive if x.role == "stored"]
        self.limits, self.open = [], unit(len(self.columns))
        self.premises()
        self.wanted = [x for x in of.conclusions if x.vector]
        self.wanted += [SimpleNamespace(says="", premise=x, vector=y, assumed=z) for x, y, z in self.limits]
        while any(self.bounded(x) and not self.bounded(y) and self.close(y) for x, y in self.bounds):
            pass
        self.count = 4 + sum(len(x.vector) for x in self.wanted if x.says in ("goes to zero", ""))
        need(self.count <= WIDEST, "too many vanishing signals")
        self.basis = unit(self.count)

    def premises(self):
        """Where the first signals of `bounds` are bounded, the second are; where those of `limits` vanish, too."""
        of = self.of
        estimates = {x for term in of.terms if term.rule == "projected" for x in term.parts.vector}
        moving = [x for x in self.columns if x in of.rates and x not in estimates]
        steady = unit(len(moving))  # combinations of states whose rate is identically zero
        for row in self.sampled([of.rates[x] for x in moving], len(moving) + 3):
            steady = restricted(steady, [[dot(u, row) % self.p] for u in steady], self.p) if moving else []
        self.bounds += [([], [dot(map(number, u), moving)]) for u in steady]
        for part, rule in ((term.parts, term.rule) for term in of.terms):
            if rule == "projected":
                self.bounds += [([], part.vector), (nominal(of, part), part.correction)]
            if rule == "potential":  # a / sqrt(1 + (a / v)^2) has the zeros of a
                self.limits.append((over(part.vector, roots(part)), part.vector, []))
        for item in of.stable:  # W dz/dt = - L z + force
            z, rate, W = item.vector, of.rate(item.vector), symmetric(item.weight, len(item.vector))
            stable = of.sign(item.weight, len(z)) == of.sign(item.loss, len(z)) == 1
            if stable and of.kinds_in(W) <= {"constant"} and None not in rate:
                force = plus(weighted(W, rate), weighted(item.loss, z))
                self.bounds.append((force, z))
                self.limits.append((force, z, []))
        for item in of.ranks:
            R = matrix(item.matrix, len(item.vector))
            if not restricted(unit(len(R)), matrix(self.sampled(item.matrix, 1)[0], len(R)), self.p):
                forces = flat(product([item.vector], R))
                self.limits.append((forces, item.vector, [f"{item.name} keeps full row rank, uniformly"]))

    def along(self, nodes, place, u):
        """Changes of nodes along u, with the bounded functions of a place."""
        field, values = self.places[place]
        ahead = {x: (field.random(x) + step) % self.p for x, step in zip(self.columns, u, strict=True) if step}
        before, after = evaluate(nodes, field, values), evaluate(nodes, field, self.given | ahead)
        return [(x - y) % self.p for x, y in zip(after, before, strict=True)]

    def bounded(self, nodes):
        weights = [secrets.randbelow(self.p) for _ in self.open]
        u = [dot(weights, column) % self.p for column in zip(*self.open)] if weights else [0] * len(self.columns)
        return None not in nodes and not any(self.along(nodes, 0, u))

    def close(self, nodes):
        """Closes directions along which bounded signals change at a constant rate; True if there was one."""
        one, other = ([self.along(nodes, k, u) for u in self.open] for k in (0, 1))
        steady = [k for k in range(len(nodes)) if all(a[k] == b[k] for a, b in zip(one, other, strict=True))]
        before = len(self.open)
        self.open = restricted(self.open, [[row[k] for k in steady] for row in one], self.p)
        return len(self.open) < before

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
        if item.says == "":
            return self.vanish(item.premise) and not self.vanish(item.vector)
        nodes, says, integrable = item.vector, item.says, self.among(item.vector, self.squares)
        if says != "goes to zero":
            return (says == "is square-integrable" and integrable) or (says == "is bounded" and self.bounded(nodes))
        ends = integrable or self.among(nodes, [x for x in self.of.rate(self.gone) if x is not None])
        return (ends and self.bounded(self.of.rate(nodes))) or self.vanish(nodes)

    def check(self):
        """The conclusions of the file that follow."""
        shown = []
        while new := [x for x in self.wanted if x not in shown and self.follows(x)]:
            for item in new:
                if item.says in ("goes to zero", ""):
                    self.gone += item.vector
                    self.basis = restricted(self.basis, self.products(item.vector), self.p)
            self.of.listed += [text for item in new if item.says == "" for text in item.assumed]
            shown += new
        return [f"{item.signal} {item.says}" for item in shown if item.says]


def with_residual(of):
    """What holds for any residual: all that is dissipated is in sum at most V at the start and the residual."""
    yield "V does not rise where the residual is zero"
    squares = [x for x in of.terms if (x.role, x.rule) == ("dissipated", "square")]
    for name in dict.fromkeys(x.name for x in squares):
        if all(x.positive for x in squares if x.name == name):
            yield f"{name} is {'summable' if of.samples else 'integrable'} where the residual is"
    boxes = [term.parts for term in of.terms if term.rule == "projected" and of.samples]
    inside = {x for part in boxes if of.kinds_in(part.lower + part.upper) <= {"constant"} for x in clipped(part)}
    yield from (f"{label} is bounded" for label, nodes in of.symbols.items() if {*map(of.rates.get, nodes)} <= inside)


# ---- The result ------------------------------------------------------------------------------------------------------
def proved(of):
    error, points = identity(of)
    signs(of)
    residual = of.samples or any(term.role == "residual" for term in of.terms)
    shown = list(dict.fromkeys(with_residual(of))) if residual else Conclusions(of).check()
    given, still = ([x for x, kind in of.kinds.items() if kind == own] for own in ("given", "constant"))
    some = [label for label in still if not of.exact.keys() >= {*of.symbols[label]}]
    lists = {"bounded": given, "conclusions are for almost all values of": some} if not of.samples else {}
    texts = [f"{text}: {', '.join(x)}" for text, x in {"constant": still, **lists}.items() if x]
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
        "assumed": [*ASSUMED, *texts, *dict.fromkeys(of.listed), *of.assumed],
    }


def check(data: object) -> dict:
    """Result of the check of a parsed file; `status` is re-proved, refuted or refused, the latter two with a reason."""
    try:
        return proved(Certificate(data))
    except (Refuted, Refused) as error:
        return {"status": type(error).__name__.lower(), "reason": str(error)}
    except Exception as error:  # of data that have another form
        return {"status": "refused", "reason": f"no valid certificate: {type(error).__name__}: {error}"}


def unique(pairs):
    need(len(dict(pairs)) == len(pairs), "a key occurs twice in one object")
    return dict(pairs)


def not_whole(text):
    raise Refused(f"{text:.40} is not written as a whole number")


def checked(path):
    """Result of the check of a file."""
    try:
        with open(path, "rb") as file:
            content = file.read(LONGEST)
        need(content, "it is empty")
        need(len(content) < LONGEST, "it is too long")
        options = {"object_pairs_hook": unique, "parse_float": not_whole, "parse_constant": not_whole}
        return check(json.loads(content.decode(), **options))
    except Exception as error:  # of a file that is no JSON
        return {"status": "refused", "reason": f"cannot read the file: {error}"}


def main(arguments):
    paths = [x for x in arguments if x != "--json"]
    usage = {"status": "refused", "reason": "usage: python check.py FILE [--json]"}
    result = checked(paths[0]) if len(paths) == 1 else usage
    status, lines = {"re-proved": 0, "refuted": 1, "refused": 2}[result["status"]], [json.dumps(result, indent=1)]
    if "--json" not in arguments:
        texts = [[f"\n  {x}" for x in own] if isinstance(own, list) else [f" {own}"] for own in result.values()]
        lines = [f"{key.replace('_', ' ')}:{''.join(own)}" for key, own in zip(result, texts)]
    try:
        print("\n".join(lines).encode("ascii", "backslashreplace").decode(), flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return status if isinstance(error, BrokenPipeError) else 2  # a program such as head closes its pipe
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
