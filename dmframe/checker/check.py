"""Checks the certificate of a control loop: ``python check.py FILE [--json]``.

``dmframe verify GRAPH --certificate FILE`` writes the file. This program is independent of dmframe: it needs Python's
standard library alone, forms the derivative of the storage function V by itself, and shares no code with the framework
or with ``check.js``. The page ``docs/explanation/checker.md`` proves each rule.

Exit status: 0 re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).

A certificate contains symbols x (states, trajectories, parameters), a straight-line program of their rational
functions and of sin, cos, tanh, ..., the rates dx/dt (or the next values x+), and terms. It states that

    V = 1/2 sum_k w_k T_k,   dV/dt = - sum w_k d_k + sum cross terms + sum residual + projection terms

holds identically, or the same for V(x+) - V(x). T_k and d_k are formed from vectors and weights by a rule. The file
contains no value of V and no derivative.

Method: the difference of both sides is a fraction of polynomials. It is evaluated at random points of random prime
fields, the derivative in dual numbers. If the difference is not identically zero, a point misses this with a
probability of at most 8 (D + H) / 2^bits; D and H bound degrees and coefficients (`Degrees`). Points are added until
the probability is below 2^-300. Rational interval arithmetic decides signs of weights and conditions.
"""

import json
import secrets
import sys
from fractions import Fraction
from math import log2

SIZES, WANTED, LARGEST = (149, 269, 521), -300, 10**6
CONSTANT = ("parameter", "weight", "constant", "stepping")
KINDS = (*CONSTANT, "time", "state", "trajectory", "projection", "period", "noise", "command")
UNARY = set("neg sq twice inv sin cos tanh atan sqrt exp log fabs sign floor ceil not tan asin acos sinh cosh asinh "
            "acosh atanh erf erfinv expm1 log1p".split())  # fmt: skip
BINARY = set("add sub mul div pow constpow fmin fmax lt le eq ne and or if_else_zero atan2 hypot copysign fmod "
             "remainder".split())  # fmt: skip
BELIEVED = (
    "signals have the names of the file; its rates and next values are those of the loop that runs",
    "divisors, and arguments of roots and logarithms, stay away from 0",
)
BOUNDED = set("sin cos tanh atan atan2 sign lt le eq ne not and or erf".split())


class Refused(Exception):
    """The file is no valid certificate, or contains a rule that this program does not know."""


class Refuted(Exception):
    """A statement of the file is wrong, or its data do not show it."""


class Again(Exception):
    """A denominator vanishes at this point."""


def need(condition, text):
    if not condition:
        raise Refused(text)


# ---- Rings: numbers with add, sub, mul, inverse, number and call -----------------------------------------------------


class Field:
    """Residues modulo a random prime. A function has a random value for each argument: what holds for all values holds
    for those of the function. sin and cos of one argument are a random point of the unit circle.
    """

    def __init__(self, bits=SIZES[0], p=None):
        self.p, self.known = p or random_prime(bits), {}

    def random(self):
        return secrets.randbelow(self.p)

    def number(self, value):
        value = Fraction(value)
        return value.numerator * self.inverse(value.denominator) % self.p

    def add(self, a, b):
        return (a + b) % self.p

    def sub(self, a, b):
        return (a - b) % self.p

    def mul(self, a, b):
        return a * b % self.p

    def inverse(self, a):
        if a % self.p == 0:
            raise Again
        return pow(a, -1, self.p)

    def memo(self, *key):
        if key not in self.known:
            self.known[key] = self.random()
        return self.known[key]

    def call(self, place, name, *given):
        a, mirrored = given[0], -given[0] % self.p
        if name in ("sin", "cos"):
            return self.turned(self.memo("circle", min(a, mirrored)), name, a)
        if name == "fabs":
            return self.memo(name, min(a, mirrored))
        if name == "if_else_zero" and a in (0, 1):
            return a * given[1]
        if name == "not" and a == 0:
            return 1
        return self.memo(name, *given)

    def turned(self, t, name, angle):
        if angle == 0:
            return int(name == "cos")
        scale = self.inverse(1 + t * t)
        if name == "cos":
            return (1 - t * t) * scale % self.p
        return 2 * t * scale * (1 if 2 * angle < self.p else -1) % self.p


class Frozen(Field):
    """A field in which a bounded function keeps its value at each place of the program, whatever its argument is."""

    def call(self, place, name, *given):
        if name in ("sin", "cos"):
            return self.turned(self.memo("circle", place), name, 1)
        return self.memo(name, place) if name in BOUNDED else super().call(place, name, *given)


class Degrees:
    """Bounds on fractions of polynomials with whole coefficients: (degree, height) of numerator and of denominator,
    where the height is log2 of the sum of absolute coefficients.

    `inverted` and `arguments` collect the polynomials that must not vanish at a random point: numerators of divisors,
    and differences of the arguments of one function. Objects are distinguished by identity, so that each is a new one.
    """

    def __init__(self):
        self.inverted, self.arguments = {}, {}

    def random(self):
        return tuple([1, 0, 0, 0])

    def number(self, value):
        value = Fraction(value)
        return (0, abs(value.numerator).bit_length(), 0, value.denominator.bit_length())

    def add(self, a, b):
        return (max(a[0] + b[2], b[0] + a[2]), max(a[1] + b[3], b[1] + a[3]) + 1, a[2] + b[2], a[3] + b[3])

    sub = add

    def mul(self, a, b):
        return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])

    def inverse(self, a):
        self.inverted[id(a)] = a
        return (a[2], a[3], a[0], a[1])

    def call(self, place, name, *given):
        self.arguments.setdefault("sin" if name == "cos" else name, {}).update((id(x), x) for x in given)
        return tuple([2, 1, 2, 1]) if name in ("sin", "cos") else self.random()

    def total(self, elements):
        """D + H."""
        total = sum(a[0] + a[1] for a in self.inverted.values())
        total += max((a[0] for a in elements), default=0) + max((a[1] for a in elements), default=0)
        for found in self.arguments.values():  # x = y or x = -y of k arguments, x = 0 and 1, and 1 + t^2
            k = len(found) + 2
            total += k * k * (sum(max(a[i] for a in found.values()) for i in range(4)) + 2) + 3 * k
        return total


class Duals:
    """Pairs (value, derivative) over another ring; None is the derivative zero, and NONE one that does not exist."""

    NONE = object()

    def __init__(self, base):
        self.base = base

    def number(self, value):
        return (self.base.number(value), None)

    def sum(self, one, other):
        if one is None or other is self.NONE:
            return other
        return one if other is None or one is self.NONE else self.base.add(one, other)

    def scaled(self, factor, rate):
        return rate if rate is None or rate is self.NONE else self.base.mul(factor, rate)

    def add(self, a, b):
        return (self.base.add(a[0], b[0]), self.sum(a[1], b[1]))

    def sub(self, a, b):
        return (self.base.sub(a[0], b[0]), self.sum(a[1], self.scaled(self.base.number(-1), b[1])))

    def mul(self, a, b):
        return (self.base.mul(a[0], b[0]), self.sum(self.scaled(b[0], a[1]), self.scaled(a[0], b[1])))

    def inverse(self, a):
        inverse = self.base.inverse(a[0])
        slope = self.base.sub(self.base.number(0), self.base.mul(inverse, inverse))
        return (inverse, self.scaled(slope, a[1]))

    def call(self, place, name, *given):
        base, a = self.base, given[0][0]
        value, one = base.call(place, name, *(x[0] for x in given)), base.number(1)
        if all(x[1] is None for x in given):
            return (value, None)
        if name == "sin":
            slope = base.call(place, "cos", a)
        elif name == "cos":
            slope = base.sub(base.number(0), base.call(place, "sin", a))
        elif name == "tanh":
            slope = base.sub(one, base.mul(value, value))
        elif name == "atan":
            slope = base.inverse(base.add(one, base.mul(a, a)))
        elif name == "sqrt":
            slope = base.inverse(base.add(value, value))
        elif name in ("exp", "log"):
            slope = value if name == "exp" else base.inverse(a)
        else:
            return (value, self.NONE)
        return (value, self.scaled(slope, given[0][1]))


class Intervals:
    """Rational intervals (lower, upper), which contain all values over the intervals of the parameters."""

    def number(self, value):
        return (Fraction(value), Fraction(value))

    def add(self, a, b):
        return (a[0] + b[0], a[1] + b[1])

    def sub(self, a, b):
        return (a[0] - b[1], a[1] - b[0])

    def mul(self, a, b):
        if max(x.numerator.bit_length() + x.denominator.bit_length() for x in (*a, *b)) > LARGEST:
            raise Again
        ends = [x * y for x in a for y in b]
        if a is b and a[0] < 0 < a[1]:
            return (Fraction(0), max(ends))
        return (max(min(ends), Fraction(0)) if a is b else min(ends), max(ends))

    def inverse(self, a):
        if a[0] <= 0 <= a[1]:
            raise Again
        return (1 / a[1], 1 / a[0])

    def call(self, place, name, *given):
        if name in ("fmin", "fmax"):
            choose = min if name == "fmin" else max
            return (choose(x[0] for x in given), choose(x[1] for x in given))
        if name == "fabs":
            return (max(given[0][0], -given[0][1], Fraction(0)), max(-given[0][0], given[0][1]))
        raise Again


def random_prime(bits):
    """By the test of Miller and Rabin with 64 random bases."""
    while True:
        n = secrets.randbits(bits) | 1 << (bits - 1) | 1
        odd, twos = n - 1, 0
        while odd % 2 == 0:
            odd, twos = odd // 2, twos + 1
        if all(n % small for small in (3, 5, 7, 11, 13, 17, 19, 23)) and all(
            passes(n, pow(secrets.randbelow(n - 3) + 2, odd, n), twos) for _ in range(64)
        ):
            return n


def passes(n, x, twos):
    if x == 1:
        return True
    for _ in range(twos):
        if x == n - 1:
            return True
        x = x * x % n
    return False


# ---- The file --------------------------------------------------------------------------------------------------------


def rational(text):
    numerator, slash, denominator = text.partition("/")
    digits = numerator.removeprefix("-") + denominator
    need(
        len(text) < 4000 and digits.isascii() and digits.isdigit(), f"expected a number as a fraction, found {text:.40}"
    )
    need(numerator not in ("", "-") and (not slash or int(denominator)), f"expected a fraction, found {text:.40}")
    return Fraction(int(numerator), int(denominator or 1))


def whole(value, least, most, text):
    need(type(value) is int and least <= value < most, f"{text}: expected a whole number in [{least}, {most})")
    return value


def keys(item, text, names, optional=()):
    wrong = set(item) - set(names) - set(optional) | set(names) - set(item)
    need(not wrong, f"{text}: missing or unknown: {', '.join(sorted(map(str, wrong)))}")
    return item


LISTS = {
    "cross": ("term", "by"),
    "projections": ("term", "state", "correction", "set", "true", "lower", "upper"),
    "masses": ("weight", "position", "translations", "inertia", "rotors", "joints", "motion"),
    "linear": ("vectors", "rates"),
    "ranks": ("name", "matrix"),
    "conditions": ("name", "text", "margin", "strict"),
    "conclusions": ("signal", "says", "step", "assumes", "vector", "estimate"),
    "steps": ("rule", "estimate", "memory", "sizes", "rows", "box", "parts"),
    "lines": ("state", "newest", "before", "when"),
    "plant": ("momentum", "rest"),
}
PARTS = {
    "square": ("vector", "weight"),
    "monotone": ("weight", "first", "second", "scale"),
    "gathered": ("vector", "weight", "memory", "regressor", "by", "forgetting"),
    "potential": ("vector", "width", "weight"),
    "log_det": ("matrix", "true", "weight"),
}
ROLES = {
    "stored": ("square", "gathered", "potential", "log_det"),
    "dissipated": ("square", "monotone", "gathered"),
    "residual": ("square",),
    "cross": ("square",),
}


class Certificate:
    """A file that has been read: symbols, program, and statements about its vectors."""

    def __init__(self, data):
        top = ("format", "version", "about", "over", "symbols", "numbers", "program", "vectors", "rates", "terms")
        keys(data, "the file", top, (*LISTS, "assumed", "between", "solved"))
        need(data["format"] == "dmframe-certificate", "format: expected dmframe-certificate")
        whole(data["version"], 1, 2, "version")
        need(data["over"] in ("flow", "sample"), "over: expected flow or sample")
        self.samples = data["over"] == "sample"
        self.labels, self.kinds, self.sizes, self.fixed = {}, [], [], {}
        for item in data["symbols"]:
            self.read_symbol(keys(item, "a symbol", ("label", "kind", "size"), ("values",)))
        self.nodes = list(
            self.read_program(keys(data["program"], "program", ("operations", "code", "a", "b", "constants")))
        )
        self.numbers = {label: self.read_numbers(label, values) for label, values in data["numbers"].items()}
        self.vectors = []
        for rows, elements in data["vectors"]:
            need(all(whole(x, -1, len(self.nodes), "a vector") >= -1 for x in elements), "a vector")
            need(
                len(elements) % whole(rows, 1 if elements else 0, LARGEST, "rows") == 0 if elements else True,
                "a vector",
            )
            self.vectors.append((rows, elements))
        for name, known in LISTS.items():
            for item in data.get(name, []):
                keys(item, name, (), known)
            setattr(self, name, data.get(name, []))
        foreign = ("cross", "projections", "masses", "linear", "ranks") if self.samples else ("steps", "lines", "plant")
        need(not any(data.get(name) for name in foreign), f"{', '.join(foreign)}: not in a claim over a {data['over']}")
        need(self.samples or not (data.get("between") or data.get("solved")), "between, solved: only over samples")
        self.assumed, self.solved = data.get("assumed", []), data.get("solved", [])
        self.rates, self.between = (self.read_rates(item) for item in (data["rates"], data.get("between", {})))
        self.terms = data["terms"]
        for term in self.terms:
            keys(term, "a term", ("name", "level", "role", "rule", "parts"), ("assumed", "phi"))
            need(
                term["rule"] in ROLES[term["role"]],
                f"{term['name']}: unknown rule {term['rule']} of a {term['role']} term",
            )
            keys(term["parts"], term["name"], PARTS[term["rule"]])
            need(term["level"] == "" or self.kind(term["level"]) == "weight", f"{term['name']}: its level")
            need(
                term["rule"] != "monotone" or term["phi"] in ("tanh", "atan"),
                f"{term['name']}: unknown function {term.get('phi')}",
            )
        stored = [k for term in self.terms if term["role"] == "stored" for k in term["parts"].values()]
        self.stored, need_rate = self.slice(stored), self.reads(stored)
        need(stored or self.steps, "V has no term")
        for label in need_rate:
            moves = label in self.rates or (self.kind(label) == "time" and not self.samples)
            need(moves or self.kind(label) in CONSTANT, f"V depends on {label}, which has no rate")
        for steps in self.steps:
            need(all(whole(n, 1, LARGEST, "a size") for n in [steps["rows"], *steps["sizes"]]), "steps")
            for name in steps["parts"]:
                if name in ("true", "gain", "floor", "retention", "lower", "upper"):
                    for label in self.reads([steps["parts"][name]]):
                        need(self.kind(label) in CONSTANT, f"{steps['estimate']}: {name} depends on {label}")

    def read_symbol(self, item):
        label, size = item["label"], whole(item["size"], 0, LARGEST, "the size of a symbol")
        need(label not in self.labels and item["kind"] in KINDS, f"{label}: found twice, or of an unknown kind")
        need(size == 1 or item["kind"] not in ("time", "weight", "period"), f"{label}: expected one number")
        self.labels[label] = len(self.kinds)
        self.kinds.append(item["kind"])
        self.sizes.append(size)
        if "values" in item:
            self.fixed[label] = [rational(x) for x in item["values"]]
            need(item["kind"] == "parameter" and len(self.fixed[label]) == size, f"{label}: its values")

    def read_program(self, given):
        names, constants = given["operations"], [rational(x) for x in given["constants"]]
        for k, (code, a, b) in enumerate(zip(given["code"], given["a"], given["b"], strict=True)):
            name = names[whole(code, 0, len(names), "an operation")]
            if name == "const":
                yield (name, constants[whole(a, 0, len(constants), "a constant")], 0)
            elif name == "input":
                yield (name, whole(a, 0, len(self.sizes), "an input"), whole(b, 0, self.sizes[a], "an input"))
            else:
                need(name in UNARY or name in BINARY, f"unknown operation {name!r}")
                yield (name, whole(a, 0, k, "an operand"), whole(b, 0, k, "an operand"))

    def read_numbers(self, label, values):
        need(self.kind(label) == "parameter", f"{label}: numbers of a {self.kind(label)}")
        found = [tuple(rational(x) for x in (value if isinstance(value, list) else (value, value))) for value in values]
        need(
            len(found) == self.sizes[self.labels[label]] and all(low <= high for low, high in found),
            f"{label}: its numbers",
        )
        exact = [(x, x) for x in self.fixed.get(label, [])]
        need(not exact or found == exact, f"{label}: other numbers than its exact values")
        return found

    def read_rates(self, given):
        for label, k in given.items():
            kinds = ("state",) if self.samples else ("state", "trajectory")
            need(
                self.kind(label) in kinds and len(self.elements(k)) == self.sizes[self.labels[label]],
                f"the rate of {label}",
            )
        return given

    def kind(self, label):
        need(label in self.labels, f"unknown symbol {label!r}")
        return self.kinds[self.labels[label]]

    def term(self, k):
        return self.terms[whole(k, 0, len(self.terms), "a term")]

    def elements(self, k):
        return self.vectors[whole(k, 0, len(self.vectors), "a vector")][1]

    def shape(self, k):
        rows, elements = self.vectors[whole(k, 0, len(self.vectors), "a vector")]
        return rows, len(elements) // rows if rows else 0

    def slice(self, vectors):
        """Places of the instructions that these vectors depend on."""
        wanted = {element for k in vectors for element in self.elements(k) if element >= 0}
        for k in range(max(wanted, default=-1), -1, -1):
            if k in wanted and self.nodes[k][0] not in ("input", "const"):
                wanted |= set(self.nodes[k][1:])
        return wanted

    def reads(self, vectors):
        """Labels of the symbols that these vectors depend on."""
        names = list(self.labels)
        return {names[self.nodes[k][1]] for k in self.slice(vectors) if self.nodes[k][0] == "input"}


class Point:
    """Values of the program, or of the instructions at some places, at one point of a ring."""

    def __init__(self, of, ring, inputs, places=None):
        self.of, self.ring, self.values = of, ring, [None] * len(of.nodes)
        values, zero, two = self.values, ring.number(0), ring.number(2)
        for k in range(len(values)) if places is None else sorted(places):
            name, a, b = of.nodes[k]
            if name == "mul":
                values[k] = ring.mul(values[a], values[b])
            elif name == "add":
                values[k] = ring.add(values[a], values[b])
            elif name == "sub":
                values[k] = ring.sub(values[a], values[b])
            elif name == "input":
                values[k] = inputs[a][b]
            elif name == "const":
                values[k] = ring.number(a)
            elif name == "sq":
                values[k] = ring.mul(values[a], values[a])
            elif name == "neg":
                values[k] = ring.sub(zero, values[a])
            elif name == "twice":
                values[k] = ring.mul(two, values[a])
            elif name in ("div", "inv"):
                inverse = ring.inverse(values[b if name == "div" else a])
                values[k] = ring.mul(values[a], inverse) if name == "div" else inverse
            elif name in ("pow", "constpow") and of.nodes[b][0] == "const" and of.nodes[b][1] in range(-99, 100):
                values[k] = power(ring, values[a], int(of.nodes[b][1]))
            else:
                values[k] = ring.call(k, name, *((values[a], values[b]) if name in BINARY else (values[a],)))

    def vector(self, k):
        zero = self.ring.number(0)
        return [self.values[element] if element >= 0 else zero for element in self.of.elements(k)]

    def matrix(self, k):
        """Rows of a matrix, which a vector contains column by column."""
        flat, (rows, _) = self.vector(k), self.of.shape(k)
        return [flat[i::rows] for i in range(rows)]


class Plain(Point):
    """The values of a point of dual numbers."""

    def __init__(self, point):
        self.of, self.ring, self.values = point.of, point.ring.base, [x and x[0] for x in point.values]


def power(ring, value, n):
    value, result = (ring.inverse(value) if n < 0 else value), ring.number(1)
    for _ in range(abs(n)):
        result = ring.mul(result, value)
    return result


def dot(ring, left, right):
    total = ring.number(0)
    for a, b in zip(left, right, strict=True):
        total = ring.add(total, ring.mul(a, b))
    return total


def minus(ring, left, right):
    return [ring.sub(a, b) for a, b in zip(left, right, strict=True)]


def spread(item, size):
    need(len(item) in (1, size), "a diagonal: expected one number, or one for each element")
    return item * size if len(item) == 1 else item


def times(ring, weight, vector):
    """W a, with W one number, a diagonal, or a matrix column by column."""
    n = len(vector)
    if len(weight) in (1, n):
        return [ring.mul(w, x) for w, x in zip(spread(weight, n), vector)]
    need(len(weight) == n * n, "a weight: expected one number, a diagonal or a matrix")
    return [dot(ring, weight[i::n], vector) for i in range(n)]


def solve(ring, matrix, columns):
    """matrix^-1 columns, by elimination."""
    rows = [[*row, *more] for row, more in zip(matrix, columns, strict=True)]
    for k in range(len(rows)):
        pivot = ring.inverse(rows[k][k])
        rows[k] = [ring.mul(x, pivot) for x in rows[k]]
        for i in range(len(rows)):
            if i != k:
                rows[i] = [ring.sub(x, ring.mul(rows[i][k], y)) for x, y in zip(rows[i], rows[k])]
    return [row[len(rows) :] for row in rows]


def rates(ring, pairs):
    """Derivatives of dual numbers."""
    need(
        all(x[1] is not Duals.NONE for x in pairs), "a derivative that does not exist, or of a function without a rule"
    )
    return [ring.number(0) if x[1] is None else x[1] for x in pairs]


# ---- Terms -----------------------------------------------------------------------------------------------------------


def term_value(point, term):
    """T of a term; in a ring of dual numbers, with its derivative."""
    ring, part = point.ring, {name: point.vector(k) for name, k in term["parts"].items()}
    if term["rule"] == "square":
        return dot(ring, part["vector"], times(ring, part["weight"], part["vector"]))
    if term["rule"] == "gathered":  # c |a|^2_G
        need(len(part["weight"]) == 1 and len(part["memory"]) == len(part["vector"]) ** 2, "an information matrix")
        a, G = part["vector"], point.matrix(term["parts"]["memory"])
        return ring.mul(part["weight"][0], dot(ring, a, [dot(ring, row, a) for row in G]))
    if term["rule"] == "monotone":  # sum w (a - b) (phi(a / v) - phi(b / v))
        n, total = len(part["first"]), ring.number(0)
        for w, a, b, v in zip(
            spread(part["weight"], n), part["first"], part["second"], spread(part["scale"], n), strict=True
        ):
            phi = [ring.call(None, term["phi"], ring.mul(x, ring.inverse(v))) for x in (a, b)]
            total = ring.add(total, ring.mul(w, ring.mul(ring.sub(a, b), ring.sub(*phi))))
        return total
    if term["rule"] == "potential":  # sum 2 w v^2 (sqrt(1 + (a / v)^2) - 1)
        n, one, total = len(part["vector"]), ring.number(1), ring.number(0)
        for w, a, v in zip(spread(part["weight"], n), part["vector"], spread(part["width"], n), strict=True):
            ratio = ring.mul(a, ring.inverse(v))
            root = ring.call(None, "sqrt", ring.add(one, ring.mul(ratio, ratio)))
            size = ring.mul(ring.number(2), ring.mul(w, ring.mul(v, v)))
            total = ring.add(total, ring.mul(size, ring.sub(root, one)))
        return total
    # c (log det A - log det B + tr(A^-1 B) - n); its derivative is c (tr(A^-1 A') - tr(A^-1 A' A^-1 B))
    base, A, B = ring.base, point.matrix(term["parts"]["matrix"]), point.matrix(term["parts"]["true"])
    need(all(x[1] is None for row in (*B, part["weight"]) for x in row), "a divergence: expected constants")
    columns = [[*rates(base, row), *(x[0] for x in other)] for row, other in zip(A, B, strict=True)]
    steps, n, total = solve(base, [[x[0] for x in row] for row in A], columns), len(A), base.number(0)
    for i in range(n):
        both = dot(base, steps[i][:n], [steps[k][n + i] for k in range(n)])
        total = base.add(total, base.sub(steps[i][i], both))
    return (base.random(), base.mul(part["weight"][0][0], total))


class Chain:
    """A chain of rigid bodies: forces by the recursion of Newton and Euler, in the links' frames.

    `translations` are those of each joint in its parent's frame; `inertia` holds, of each link, m, m c (3), and I_xx,
    I_xy, I_yy, I_xz, I_yz, I_zz about the joint's origin; `joints` hold the kind, the axis and the rotation at q = 0.
    """

    def __init__(self, point, item):
        self.ring = ring = point.ring
        q, moves, self.inertia = (point.vector(item[name]) for name in ("position", "translations", "inertia"))
        self.joints, self.zero = [], [ring.number(0)] * 3
        self.rotors = self.zero[:1] * len(q) if item["rotors"] is None else spread(point.vector(item["rotors"]), len(q))
        for i, joint in enumerate(item["joints"]):
            need(joint["kind"] in ("revolute", "prismatic"), "a joint: expected revolute or prismatic")
            axis, flat = ([rational(x) for x in joint[name]] for name in ("axis", "rotation"))
            x, y, z = flat[0:3], flat[3:6], flat[6:9]
            proper = [sum(a * a for a in v) for v in (axis, x, y)] == [1, 1, 1] and not sum(a * b for a, b in zip(x, y))
            need(proper and z == [x[i - 2] * y[i - 1] - x[i - 1] * y[i - 2] for i in range(3)], "a joint: its rotation")
            axis, flat = [ring.number(a) for a in axis], [ring.number(a) for a in flat]
            R, origin, turns = [flat[0:3], flat[3:6], flat[6:9]], moves[3 * i : 3 * i + 3], joint["kind"] == "revolute"
            if turns:
                R = [[dot(ring, row, column) for column in zip(*rotation(ring, axis, q[i]))] for row in R]
            else:
                origin = plus(ring, origin, [dot(ring, row, [ring.mul(a, q[i]) for a in axis]) for row in R])
            self.joints.append((turns, axis, R, origin))
        need(len(self.joints) == len(q), "a chain: one joint for each position")

    def forces(self, dq, ddq, gravity):
        """Torques, and forces of prismatic joints: M(q) ddq + C(q, dq) dq + g, with the rotors' inertia in M."""
        ring = self.ring
        w, dw, acceleration, links = self.zero, self.zero, minus(ring, self.zero, gravity), []
        for i, (turns, axis, R, origin) in enumerate(self.joints):
            inner = across(ring, w, across(ring, w, origin))
            acceleration = plus(ring, acceleration, plus(ring, across(ring, dw, origin), inner))
            w, dw, acceleration = ([dot(ring, row, x) for row in zip(*R)] for x in (w, dw, acceleration))
            along, pushed = ([ring.mul(a, x) for a in axis] for x in (dq[i], ddq[i]))
            turning = across(ring, w, along)
            if turns:
                w, dw = plus(ring, w, along), plus(ring, dw, plus(ring, pushed, turning))
            else:
                acceleration = plus(ring, acceleration, plus(ring, pushed, plus(ring, turning, turning)))
            m, hx, hy, hz, xx, xy, yy, xz, yz, zz = self.inertia[10 * i : 10 * i + 10]
            h, tensor = (hx, hy, hz), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
            Iw, Idw = ([dot(ring, row, x) for row in tensor] for x in (w, dw))
            force = plus(ring, [ring.mul(m, x) for x in acceleration], across(ring, dw, h))
            force = plus(ring, force, across(ring, w, across(ring, w, h)))
            moment = plus(ring, Idw, plus(ring, across(ring, w, Iw), across(ring, h, acceleration)))
            links.append((force, moment))
        found, force, moment = [], self.zero, self.zero  # of the links beyond, in the parent's frame
        for i in range(len(links) - 1, -1, -1):
            (turns, axis, R, origin), own = self.joints[i], links[i]
            force, moment = plus(ring, own[0], force), plus(ring, own[1], moment)
            found.insert(0, ring.add(dot(ring, axis, moment if turns else force), ring.mul(self.rotors[i], ddq[i])))
            force, moment = ([dot(ring, row, x) for row in R] for x in (force, moment))
            moment = plus(ring, moment, across(ring, origin, force))
        return found

    def equalities(self, moving, point, item):
        """The weight is the mass matrix, column by column, and the acceleration that of the exported torque."""
        ring, n = self.ring, len(self.joints)
        still, unit = self.zero[:1] * n, [[ring.number(int(i == k)) for i in range(n)] for k in range(n)]
        columns = [x for k in range(n) for x in self.forces(still, unit[k], self.zero)]
        yield "the mass matrix", minus(ring, point.vector(item["weight"]), columns)
        if item["motion"] is not None:
            names = ("velocity", "acceleration", "gravity", "torque")
            velocity, acceleration, gravity, torque = (point.vector(item["motion"][name]) for name in names)
            yield "the robot's velocity", minus(ring, rates(ring, moving.vector(item["position"])), velocity)
            slopes = rates(ring, moving.vector(item["motion"]["velocity"]))
            yield "the robot's acceleration", minus(ring, slopes, acceleration)
            yield "the robot's equation of motion", minus(ring, self.forces(velocity, acceleration, gravity), torque)


def plus(ring, left, right):
    return [ring.add(a, b) for a, b in zip(left, right, strict=True)]


def across(ring, a, b):
    return [ring.sub(ring.mul(a[i - 2], b[i - 1]), ring.mul(a[i - 1], b[i - 2])) for i in range(3)]


def rotation(ring, a, angle):
    """Cos 1 + sin [a]x + (1 - cos) a a' about the unit vector a."""
    c, s, zero = ring.call(None, "cos", angle), ring.call(None, "sin", angle), ring.number(0)
    rest, (x, y, z) = ring.sub(ring.number(1), c), (ring.mul(s, e) for e in a)
    skew = ((c, ring.sub(zero, z), y), (z, c, ring.sub(zero, x)), (ring.sub(zero, y), x, c))
    return [[ring.add(skew[i][j], ring.mul(rest, ring.mul(a[i], a[j]))) for j in range(3)] for i in range(3)]


# ---- Steps of an estimate from sample to sample ----------------------------------------------------------------------


def pieces(column, sizes):
    ends = [sum(sizes[: k + 1]) for k in range(len(sizes))]
    need(ends and ends[-1] == len(column), "the steps of an estimate: sizes of its parts")
    return [column[end - size : end] for end, size in zip(ends, sizes)]


def next_values(point, steps):
    """Next values of an estimate and its memory, by label.

    For each output and each of its rows (h, y) in turn, with e = y - h'theta:

    normalised     theta <- theta + D h e / n, n = floor + h' D h, D the gain. |theta - true|^2_(1/D) changes by exactly
                   -(h'(theta - true))^2 / n - floor e^2 / n^2 + eta^2 / n, where eta = y - h'true.
    least_squares  theta <- theta + P h e / n, P = (G + 1/D)^-1, n = floor + h' P h, then G <- G + h h' / floor.
                   |theta - true|^2_(G + 1/D) changes by exactly -e^2 / n + eta^2 / floor.
    A box with the true value inside moves theta towards it; a factor of G in [0, 1] forgets.
    """
    ring, part = point.ring, {name: point.vector(k) for name, k in steps["parts"].items()}
    sizes, squares, (floor,) = steps["sizes"], steps["rule"] == "least_squares", part["floor"]
    need(squares or steps["rule"] == "normalised", f"unknown rule {steps['rule']} of steps")
    theta, gain = pieces(part["theta"], sizes), pieces(part["gain"], sizes)
    box = [pieces(part[name], sizes) for name in ("lower", "upper")] if steps["box"] else None
    rows = [(pieces(part[f"h{k}"], sizes), part[f"y{k}"]) for k in range(steps["rows"])]
    triangles = pieces(part["gathered"], [n * (n + 1) // 2 for n in sizes]) if squares else []
    moved, kept = [], []
    for j, n in enumerate(sizes):
        now, metric = theta[j], [ring.inverse(x) for x in gain[j]]
        G = unpacked(n, triangles[j]) if squares else None
        for row, measured in rows:
            h, y = row[j], measured[j]
            if squares:
                direction = [line[0] for line in solve(ring, plus_diagonal(ring, G, metric), [[x] for x in h])]
                scaled = [ring.mul(x, ring.inverse(floor)) for x in h]
                G = [[ring.add(G[i][k], ring.mul(h[i], scaled[k])) for k in range(n)] for i in range(n)]
            else:
                direction = [ring.mul(x, g) for x, g in zip(h, gain[j], strict=True)]
            scale = ring.inverse(ring.add(floor, dot(ring, h, direction)))
            step = ring.mul(ring.sub(y, dot(ring, h, now)), scale)
            now = [ring.add(x, ring.mul(d, step)) for x, d in zip(now, direction)]
            if box:
                now, G = into_box(ring, now, G, metric, box[0][j], box[1][j])
        moved += now
        kept += [ring.mul(part["retention"][0], G[i][k]) for k in range(n) for i in range(k, n)] if squares else []
    return {steps["estimate"]: moved, **({steps["memory"]: kept} if squares else {})}


def unpacked(n, triangle):
    """A symmetric matrix from its lower triangle, column by column."""
    places = {pair: k for k, pair in enumerate((row, column) for column in range(n) for row in range(column, n))}
    return [[triangle[places[max(i, k), min(i, k)]] for k in range(n)] for i in range(n)]


def plus_diagonal(ring, G, metric):
    return [[ring.add(x, metric[i]) if i == k else x for k, x in enumerate(row)] for i, row in enumerate(G)]


def into_box(ring, theta, G, metric, lower, upper):
    """Projection onto a box. Least squares: onto one face after the other in the norm of G + 1/D, then by clipping,
    which sets G to zero where it changes an element.
    """

    def clip(value, low, high):
        return ring.call(None, "fmin", ring.call(None, "fmax", value, low), high)

    n, theta = len(theta), list(theta)
    if G is None:
        return [clip(*x) for x in zip(theta, lower, upper, strict=True)], None
    P = solve(ring, plus_diagonal(ring, G, metric), [[ring.number(int(i == k)) for k in range(n)] for i in range(n)])
    for i in range(n):
        face = clip(theta[i], lower[i], upper[i])
        factor = ring.mul(ring.sub(theta[i], face), ring.inverse(P[i][i]))
        theta = [face if k == i else ring.sub(x, ring.mul(P[k][i], factor)) for k, x in enumerate(theta)]
    cut, kept = [clip(*x) for x in zip(theta, lower, upper, strict=True)], ring.number(1)
    for i in range(n - 1):
        kept = ring.mul(kept, ring.call(None, "eq", theta[i], cut[i]))
    return cut, [[ring.mul(x, kept) for x in row] for row in G]


def shifted(point, line):
    """A delay line at the next sample: the newest entry comes first, the oldest is dropped."""
    ring, newest, before = point.ring, point.vector(line["newest"]), point.vector(line["before"])
    (rows, columns), (height, width) = point.of.shape(line["newest"]), point.of.shape(line["before"])
    if columns == width:
        pairs = [(r, c) for c in range(width) for r in range(height)]
        after = [newest[r + c * rows] if r < rows else before[r - rows + c * height] for r, c in pairs]
    else:
        after = [*newest, *before[: height * (width - columns)]]
    if line["when"] is None:
        return after
    (when,) = point.vector(line["when"])
    both = zip(after, before, strict=True)
    kept = ring.call(None, "not", when)
    return [
        ring.add(ring.call(None, "if_else_zero", when, a), ring.call(None, "if_else_zero", kept, b)) for a, b in both
    ]


# ---- The identity ----------------------------------------------------------------------------------------------------


def moving(of, ring, inputs, given):
    """Inputs as dual numbers; the time has the rate 1, a constant None, and a symbol without a rate no derivative."""
    plain = Point(of, ring, inputs, of.slice(given.values()))
    slope = {"time": ring.number(1)} | dict.fromkeys(CONSTANT)
    found = [[(x, slope.get(kind, Duals.NONE)) for x in row] for row, kind in zip(inputs, of.kinds)]
    for label, k in given.items():
        found[of.labels[label]] = list(zip(inputs[of.labels[label]], plain.vector(k)))
    return found


def in_flow(of, ring, inputs):
    """Names and numbers that must vanish in continuous time; the first one is V, which must not."""
    point = Point(of, Duals(ring), moving(of, ring, inputs, of.rates))
    plain, half, V, total = Plain(point), ring.inverse(ring.number(2)), ring.number(0), ring.number(0)
    for term in of.terms:
        weight = inputs[of.labels[term["level"]]][0] if term["level"] else ring.number(1)
        if term["role"] == "stored":
            value = term_value(point, term)
            V = ring.add(V, ring.mul(weight, value[0]))
            total = ring.add(total, ring.mul(weight, ring.mul(half, rates(ring, [value])[0])))
        else:
            sign = ring.add if term["role"] == "dissipated" else ring.sub
            total = sign(total, ring.mul(weight, term_value(plain, term)))
    yield "V", [V]
    for item in of.projections:  # (estimate - true value)' W correction
        term, correction, name = of.term(item["term"]), inputs[of.labels[item["correction"]]], item["state"]
        need(item["correction"] == f"{name}, correction" and of.kind(name) == "state", f"{name}: its projection")
        need(of.kind(item["correction"]) == "projection" and term["rule"] == "square", f"{name}: its projection")
        error, metric, true = (
            plain.vector(k) for k in (term["parts"]["vector"], term["parts"]["weight"], item["true"])
        )
        weight = inputs[of.labels[term["level"]]][0] if term["level"] else ring.number(1)
        total = ring.sub(total, ring.mul(weight, dot(ring, times(ring, metric, error), correction)))
        estimate = inputs[of.labels[name]]
        yield f"the error of {name}", minus(ring, error, minus(ring, estimate, spread(true, len(estimate))))
        yield f"the rate of the true value of {name}", rates(ring, point.vector(item["true"]))
        nominal = list(inputs)
        nominal[of.labels[item["correction"]]] = [ring.number(0) for _ in correction]
        without = Point(of, ring, nominal, of.slice([of.rates[name]])).vector(of.rates[name])
        yield f"the rate of {name}", minus(ring, minus(ring, plain.vector(of.rates[name]), without), correction)
    yield "dV/dt", [total]
    for cross in of.cross:  # a = sum_j share_j v_j
        left = plain.vector(of.term(cross["term"])["parts"]["vector"])
        for share, k in cross["by"]:
            v = plain.vector(of.term(k)["parts"]["vector"])
            left = minus(ring, left, [ring.mul(x, y) for x, y in zip(spread(plain.vector(share), len(v)), v)])
        yield "the vector of a cross term", left
    for term in of.terms:
        parts = term["parts"]
        if term["rule"] == "gathered":  # dG/dt = W' diag(r) W - forgetting G
            W, (forgetting,), columns = plain.matrix(parts["regressor"]), plain.vector(parts["forgetting"]), []
            by = spread(plain.vector(parts["by"]), len(W))
            for column in zip(*W):
                scaled = [ring.mul(r, x) for r, x in zip(by, column)]
                columns += [dot(ring, other, scaled) for other in zip(*W)]
            decay = [ring.mul(forgetting, x) for x in plain.vector(parts["memory"])]
            yield "dG/dt", minus(ring, rates(ring, point.vector(parts["memory"])), minus(ring, columns, decay))
        for name in ("matrix", "true") if term["rule"] == "log_det" else ():
            A = plain.matrix(parts[name])
            yield f"symmetry of {term['name']}", [ring.sub(A[i][j], A[j][i]) for i in range(len(A)) for j in range(i)]
    for item in of.masses:
        yield from Chain(plain, item).equalities(point, plain, item)


def over_samples(of, ring, inputs):
    """Names and numbers that must vanish from sample to sample; the first one is V, which must not."""
    now, then = Point(of, ring, inputs), list(inputs)
    for label, k in of.rates.items():
        then[of.labels[label]] = now.vector(k)
    later, half, V, total = (
        Point(of, ring, then, of.stored),
        ring.inverse(ring.number(2)),
        ring.number(0),
        ring.number(0),
    )
    for term in of.terms:
        need(
            term["rule"] == "square" and not term["level"] and term["role"] != "cross", "over samples: expected squares"
        )
        value = term_value(now, term)
        if term["role"] == "stored":
            V, value = ring.add(V, value), ring.mul(half, ring.sub(term_value(later, term), value))
        total = (ring.sub if term["role"] == "residual" else ring.add)(total, value)
    yield "V", [ring.number(1) if of.steps else V]
    yield "V(next) - V", [total]
    for steps in of.steps:
        yield steps["estimate"], minus(ring, now.vector(steps["parts"]["theta"]), inputs[of.labels[steps["estimate"]]])
        for label, values in next_values(now, steps).items():
            yield f"the next value of {label}", minus(ring, now.vector(of.rates[label]), values)
        if steps["rule"] == "least_squares":
            yield (
                steps["memory"],
                minus(ring, now.vector(steps["parts"]["gathered"]), inputs[of.labels[steps["memory"]]]),
            )
    for line in of.lines:
        yield line["state"], minus(ring, now.vector(line["before"]), inputs[of.labels[line["state"]]])
        yield f"the next value of {line['state']}", minus(ring, now.vector(of.rates[line["state"]]), shifted(now, line))
    if of.plant:
        point = Point(
            of, Duals(ring), moving(of, ring, inputs, of.between), of.slice([x["momentum"] for x in of.plant])
        )
        for item in of.plant:  # d/dt momentum + rest = 0
            change = rates(ring, point.vector(item["momentum"]))
            yield "a plant identity", [ring.add(x, y) for x, y in zip(change, now.vector(item["rest"]), strict=True)]
    for k in of.solved:
        yield "an equation that an output solves", now.vector(k)


def identity(of):
    """log2 of the error bound and the number of points; raises `Refuted` at one where an equality does not hold."""
    equalities = over_samples if of.samples else in_flow

    def inputs(ring):
        known = [[ring.number(x) for x in of.fixed[label]] if label in of.fixed else None for label in of.labels]
        return [[ring.random() for _ in range(size)] if row is None else row for row, size in zip(known, of.sizes)]

    ring = Degrees()
    total = ring.total([x for _, values in equalities(of, ring, inputs(ring)) for x in values])
    bits = next((bits for bits in SIZES if log2(total) + 3 - bits < -64), None)
    need(bits is not None, f"the degree of the identity is too high: D + H is 2^{log2(total):.0f}")
    error, points, tried = 3 + log2(total) - bits, 0, 0
    while points * error > WANTED:
        field, tried = Field(bits), tried + 1
        need(tried < 40, "a denominator vanishes at every point")
        try:
            for name, values in equalities(of, field, inputs(field)):
                if any(x % field.p for x in values) == (name != "V"):
                    raise Refuted(f"{name} does not hold")
            points += 1
        except Again:
            continue
    return points * error, points


# ---- Signs, conditions and small gain --------------------------------------------------------------------------------


class Signs:
    """Signs of vectors of parameters, over the intervals of the file. `believed` collects what they do not show."""

    def __init__(self, of):
        self.of, self.ring, self.boxes, self.believed = of, Intervals(), {}, []
        self.known = {label: [(x, x) for x in values] for label, values in of.fixed.items()} | of.numbers

    def vector(self, k, boxes=False):
        """Intervals of a vector's elements; None if it depends on more than parameters, or on a function."""
        known = self.known | self.boxes if boxes else self.known
        if not self.of.reads([k]) <= known.keys():
            return None
        try:
            return Point(self.of, self.ring, [known.get(x) for x in self.of.labels], self.of.slice([k])).vector(k)
        except Again:
            return None

    def sign(self, k, size=0):
        """1 if all elements, or a matrix, are positive, 0 if none is negative, -1 otherwise or if not decided."""
        values = self.vector(k)
        if values is None or (size > 1 and len(values) == size * size):
            return 1 if values and definite([values[i::size] for i in range(size)]) else -1
        least = min((x[0] for x in values), default=Fraction(1))
        return 1 if least > 0 else 0 if least == 0 else -1

    def inside(self, name, lower, true, upper):
        """The true value of an estimate is inside its box; returns the box."""
        low, value, high = (self.vector(k) for k in (lower, true, upper))
        if low is None or high is None:
            raise Refuted(f"{name}: its box is not made of parameters")
        if any(a[1] > b[0] for a, b in zip(low, high, strict=True)):
            raise Refuted(f"{name}: its box is empty")
        if value is None:
            self.believed.append(f"{name}: its true value is inside the box")
        elif not all(a[1] <= x[0] and x[1] <= b[0] for a, x, b in zip(low, spread(value, len(low)), high, strict=True)):
            raise Refuted(f"{name}: its true value is not inside the box")
        return [(a[0], b[1]) for a, b in zip(low, high)]

    def weight(self, term):
        """Sign of a term."""
        part, rule, name = term["parts"], term["rule"], term["name"]
        sign = self.sign(part["weight"], len(self.of.elements(part["vector"])) if rule == "square" else 0)
        if rule == "square" and self.vector(part["weight"]) is None and term["role"] != "cross":
            own, size = self.of.elements(part["weight"]), len(self.of.elements(part["vector"]))
            for item in self.of.masses:
                if self.of.elements(item["weight"]) == own and len(own) == size * size:
                    return self.mass(item)
            if "assumed" in term:
                self.believed.append(f"{name}: its weight is positive: {term['assumed']}")
                return 1
        if rule in ("monotone", "potential") and self.sign(part["scale" if rule == "monotone" else "width"]) != 1:
            return -1
        if rule == "gathered":
            self.believed.append(f"{name}: its information matrix starts at zero")
            return min(0, sign, self.sign(part["by"]), self.sign(part["forgetting"]))
        if rule == "log_det":
            self.believed.append(f"{name}: it starts positive definite")
            return min(sign, self.sign(part["true"], self.of.shape(part["true"])[0]))
        return sign

    def mass(self, item):
        """A mass matrix is positive definite if each link's pseudo-inertia is, and no rotor's inertia is negative."""
        inertia, ring = self.vector(item["inertia"]), self.ring
        rotors = 1 if item["rotors"] is None else self.sign(item["rotors"])
        if inertia is None:
            self.believed.append("the load of the mass matrix is a rigid body")
            return 1 if rotors >= 0 else -1
        for k in range(0, len(inertia), 10):
            m, hx, hy, hz, xx, xy, yy, xz, yz, zz = inertia[k : k + 10]
            half = ring.mul(ring.add(ring.add(xx, yy), zz), ring.number(Fraction(1, 2)))
            xy, xz, yz = (ring.sub(ring.number(0), x) for x in (xy, xz, yz))
            diagonal = [ring.sub(half, x) for x in (xx, yy, zz)]
            rows = [[diagonal[0], xy, xz, hx], [xy, diagonal[1], yz, hy], [xz, yz, diagonal[2], hz], [hx, hy, hz, m]]
            if not definite(rows):
                return -1
        return 1 if rotors >= 0 else -1

    def check(self):
        """Checks all signs; returns the places of the terms with a positive weight."""
        of, strict = self.of, set()
        for k, term in enumerate(of.terms):
            if term["role"] != "residual":
                sign = self.weight(term)
                if sign < (term["role"] == "stored" and term["rule"] != "gathered"):
                    raise Refuted(f"{term['name']}: the sign of its weight is wrong, or not shown")
                strict |= {k} if sign == 1 else set()
        for item in of.projections:
            name, term = item["state"], of.term(item["term"])
            self.believed.append(
                f"{name}: it starts inside its {item['set']}, and the law that runs is this projection"
            )
            if item["set"] == "box":
                size = len(of.elements(item["true"]))
                diagonal = term["rule"] == "square" and len(of.elements(term["parts"]["weight"])) in (1, size)
                need(diagonal and item["term"] in strict, f"{name}: expected a box with a diagonal metric")
                self.boxes[name] = self.inside(name, item["lower"], item["true"], item["upper"])
            else:
                text = f"{name}: its {item['set']} is bounded, contains the true value, and suits the metric"
                self.believed.append(text)
        for steps in of.steps:
            part, name = steps["parts"], steps["estimate"]
            if self.sign(part["gain"]) != 1 or self.sign(part["floor"]) != 1:
                raise Refuted(f"{name}: gain and floor of its steps are not shown to be positive")
            if steps["box"]:
                self.boxes[name] = self.inside(name, part["lower"], part["true"], part["upper"])
            kept = self.vector(part["retention"]) if "retention" in part else [(0, 1)]
            if kept is None or kept[0][0] < 0 or kept[0][1] > 1:
                raise Refuted(f"{name}: its factor of forgetting is not shown to be in [0, 1]")
        for item in of.conditions:
            if "margin" not in item or self.vector(item["margin"]) is None:
                self.believed.append(f"condition: {item['name']}")
            elif self.sign(item["margin"]) < bool(item["strict"]):
                raise Refuted(f"condition: {item['name']}")
        return strict

    def kappa(self, strict):
        """The least kappa with which the dissipation dominates the cross terms; None without any.

        c |sum a_j v_j|^2 <= c max(sum_j a_j^2 / W_j) sum_j |v_j|^2_(W_j), by the inequality of Cauchy.
        """
        of, ring, needed = self.of, self.ring, {}
        for cross in of.cross:
            c, total = self.vector(of.term(cross["term"])["parts"]["weight"]), None
            need(c is None or len(c) == 1, "a cross term: expected one number as its weight")
            for share, k in cross["by"]:
                term, a = of.term(k), self.vector(share)
                W, size = self.vector(term["parts"]["weight"]), len(of.elements(term["parts"]["vector"]))
                if k not in strict or term["role"] != "dissipated" or term["rule"] != "square" or None in (a, c, W):
                    raise Refuted("no square with a positive weight of parameters dominates a cross term")
                each = [ring.mul(ring.mul(x, x), ring.inverse(w)) for x, w in zip(spread(a, size), spread(W, size))]
                total = each if total is None else [ring.add(x, y) for x, y in zip(total, each, strict=True)]
            used, levels = frozenset(k for _, k in cross["by"]), {of.term(k)["level"] for _, k in cross["by"]}
            need(len(used) == len(cross["by"]) and len(levels) == 1, "a cross term: expected squares of one level")
            need(
                all(used == other or not used & other for other in needed), "cross terms share a part of their squares"
            )
            own = of.term(cross["term"])
            need(own["role"] == "cross" and not own["level"], "a cross term: expected one with the weight 1")
            needed[used] = needed.get(used, 0) + max(ring.mul(c[0], x)[1] for x in total)
            if not max(levels) and needed[used] >= 1:
                raise Refuted("the dissipation does not dominate a cross term")
        declared = {k for cross in of.cross for k in [cross["term"]]}
        for k, term in enumerate(of.terms):
            if term["role"] == "cross" and k not in declared:
                raise Refuted(f"{term['name']}: nothing dominates its cross term")
        return max(needed.values(), default=None)


def definite(rows):
    """True if all symmetric matrices in these intervals are positive definite: their pivots are positive."""
    ring, rows = Intervals(), [list(row) for row in rows]
    if any(rows[i][j] != rows[j][i] for i in range(len(rows)) for j in range(i)):
        return False
    while rows:
        if rows[0][0][0] <= 0:
            return False
        factors = [ring.mul(row[0], ring.inverse(rows[0][0])) for row in rows]
        rows = [minus(ring, row[1:], [ring.mul(f, y) for y in rows[0][1:]]) for f, row in zip(factors[1:], rows[1:])]
    return True


# ---- Conclusions in continuous time ----------------------------------------------------------------------------------


class Echelon:
    """Rows in reduced echelon form modulo p, and their null space."""

    def __init__(self, p, columns):
        self.p, self.columns, self.rows = p, columns, {}

    def add(self, row):
        """Add a row; False if it is a combination of the others."""
        row = list(row)
        for pivot, other in self.rows.items():
            if factor := row[pivot] % self.p:
                row = [(x - factor * y) % self.p for x, y in zip(row, other)]
        pivot = next((k for k, x in enumerate(row) if x % self.p), None)
        if pivot is None:
            return False
        scale = pow(row[pivot], -1, self.p)
        row = [x * scale % self.p for x in row]
        for k, other in self.rows.items():
            if factor := other[pivot]:
                self.rows[k] = [(x - factor * y) % self.p for x, y in zip(other, row)]
        self.rows[pivot] = row
        return True

    def null_space(self):
        """Pairs (free column, direction with 1 there)."""
        for free in range(self.columns):
            if free not in self.rows:
                u = [int(k == free) for k in range(self.columns)]
                for pivot, row in self.rows.items():
                    u[pivot] = -row[free] % self.p
                yield free, u


class Conclusions:
    """Bounded and vanishing signals, if V does not increase and trajectories, with their rates, are bounded.

    A direction of the state space is open if no bounded signal determines it. With all bounded functions frozen at
    their places of the program, a signal that does not change along a random open direction is bounded; a bounded
    signal that changes at a constant rate closes a direction. Parameters have the numbers of the file.
    """

    def __init__(self, of, signs, strict):
        self.of, self.signs, self.strict, self.at, self.rows = of, signs, strict, {}, {}
        self.field, self.linear, n = Frozen(), [], 0
        self.p = self.field.p
        own = {
            label: [self.field.number(x) if x == y else None for x, y in given] for label, given in signs.known.items()
        }
        self.parameters = [
            [self.field.random() if x is None else x for x in own.get(label, [None] * size)]
            for label, size in zip(of.labels, of.sizes)
        ]
        for label, k in of.labels.items():
            if of.kinds[k] in ("state", "time"):
                self.rows[label] = range(n, n + of.sizes[k])
                n += of.sizes[k]
        self.known, self.columns = Echelon(self.p, n), n
        self.points = [(Frozen(p=self.p), self.drawn()) for _ in range(2)]
        self.close()

    def drawn(self):
        """Inputs at a random point."""
        return [
            own if kind in CONSTANT else [self.field.random() for _ in own]
            for own, kind in zip(self.parameters, self.of.kinds)
        ]

    def evaluate(self, wanted, ring, inputs):
        """Numbers of ("value", k), ("rate", k), and ("input", i, j): dz_j/dt - (A z)_j of a linear equation."""
        of, vectors = self.of, []
        for kind, k, *row in wanted:
            item = of.linear[k] if kind == "input" else None
            vectors += [*item["vectors"], *item["rates"][row[0]]] if item else [k]
        used, given = of.slice(vectors), of.reads(vectors)
        if all(kind == "value" for kind, *_ in wanted):
            point = Point(of, ring, inputs, used)
            return [x for _, k in wanted for x in point.vector(k)]
        duals, found = Duals(ring), []
        moves = {label: k for label, k in of.rates.items() if label in given}
        point = Point(of, duals, moving(of, ring, inputs, moves), used)
        for kind, k, *row in wanted:
            part = point.vector(of.linear[k]["vectors"][row[0]] if kind == "input" else k)
            part = [x[kind != "value"] for x in part]
            if kind == "input":
                for z, rate in zip(of.linear[k]["vectors"], of.linear[k]["rates"][row[0]], strict=True):
                    z = [x[0] for x in point.vector(z)]
                    factors = spread([x[0] for x in point.vector(rate)], len(z))
                    part = [duals.sum(x, ring.number(-a * b)) for x, a, b in zip(part, factors, z, strict=True)]
            found += part
        return [0 if x is None else x for x in found]

    def along(self, wanted, place, u):
        """Changes along u, with the bounded functions of the point; None where a derivative does not exist."""
        ring, inputs = self.points[place]
        if (key := (*wanted, place)) not in self.at:
            self.at[key] = self.evaluate(wanted, ring, inputs)
        moved = list(inputs)
        for label, rows in self.rows.items():
            k = self.of.labels[label]
            moved[k] = [(x + step) % self.p for x, step in zip(inputs[k], u[rows.start : rows.stop])]
        pairs = zip(self.evaluate(wanted, ring, moved), self.at[key])
        return [None if Duals.NONE in (x, y) else (x - y) % self.p for x, y in pairs]

    def random_open(self):
        total = [0] * self.columns
        for _, u in self.known.null_space():
            factor = self.field.random()
            total = [(x + factor * y) % self.p for x, y in zip(total, u)]
        return total

    def bounded(self, wanted, own="", seen=()):
        """True if these numbers are bounded. The correction of a projection is, where its nominal rate is, if that does
        not depend on a correction that is being decided; `own` is the state whose rate is decided.
        """
        if any(x != 0 for x in self.along(wanted, 0, self.random_open())):
            return False
        of, reads = self.of, set()
        for kind, k, *row in wanted:
            part = [of.linear[k]["vectors"][row[0]]] if kind == "input" else [k]
            reads |= of.reads(part if kind != "input" else [*part, *of.linear[k]["rates"][row[0]]])
            if kind != "value":
                reads |= of.reads([of.rates[label] for label in of.reads(part) if label in of.rates])
        corrected = [x["state"] for x in of.projections if x["correction"] in reads and x["state"] != own]
        return not {*corrected} & {*seen} and all(
            self.bounded([("value", of.rates[label])], label, (*seen, label)) for label in corrected
        )

    def close(self):
        """Closes all directions that bounded signals determine."""
        of, vectors, waiting = self.of, [], list(range(len(self.of.linear)))
        for k in self.strict:
            if of.term(k)["role"] == "stored":
                vectors.append(of.term(k)["parts"]["matrix" if of.term(k)["rule"] == "log_det" else "vector"])
        for item in of.projections:
            for column in self.rows[item["state"]]:
                self.known.add([int(column == k) for k in range(self.columns)])
        self.close_constants()
        while True:
            while self.grow([("value", k) for k in vectors]):
                pass
            found = next((k for k in waiting if self.stable(of.linear[k]) and self.bounded(self.inputs(k))), None)
            if found is None:
                return
            waiting.remove(found)
            self.linear.append(found)
            vectors += of.linear[found]["vectors"]

    def inputs(self, k):
        return [("input", k, j) for j in range(len(self.of.linear[k]["vectors"]))]

    def close_constants(self):
        """A combination of states whose rate is identically zero is constant."""
        labels = [
            label for label in self.rows if label in self.of.rates and self.rows[label].start not in self.known.rows
        ]
        columns = [column for label in labels for column in self.rows[label]]
        sampled = Echelon(self.p, len(columns))
        for row in self.sampled([("value", self.of.rates[label]) for label in labels], len(columns) + 3):
            sampled.add(row)
        for _, combination in sampled.null_space():
            row = [0] * self.columns
            for column, factor in zip(columns, combination):
                row[column] = factor
            self.known.add(row)

    def grow(self, vectors):
        """Closes directions along which a bounded signal changes at a constant rate; True if there was one."""
        directions, u = list(self.known.null_space()), self.random_open()
        pairs = zip(*(self.along(vectors, place, u) for place in (0, 1)))
        steady, grown = [k for k, (a, b) in enumerate(pairs) if a and a == b], False
        changes = [(free, self.along(vectors, 0, direction)) for free, direction in directions if steady]
        for k in steady:
            functional = [0] * self.columns
            for free, change in changes:
                functional[free] = change[k]
            grown |= self.known.add(functional)
        return grown

    def stable(self, item):
        """True if dz/dt = A z is exponentially stable for each joint: one or two equations, over all intervals."""
        ring, moving_box = self.signs.ring, any(self.of.reads(row) & self.signs.boxes.keys() for row in item["rates"])
        A = [[self.signs.vector(k, boxes=True) for k in row] for row in item["rates"]]
        if any(entry is None for row in A for entry in row) or len(A) > (1 if moving_box else 2):
            return False
        size = max(len(entry) for row in A for entry in row)
        entries = zip(*(spread(entry, size) for row in A for entry in row))
        if len(A) == 1:
            return all(a[1] < 0 for (a,) in entries)
        return all(ring.add(a, d)[1] < 0 < ring.sub(ring.mul(a, d), ring.mul(b, c))[0] for a, b, c, d in entries)

    def sampled(self, wanted, count, change=lambda ring, row: row):
        """Numbers at random points, with the file's parameters, and what is computed from them there."""
        found, tried = [], 0
        while len(found) < count:
            ring, tried = Field(p=self.p), tried + 1
            need(tried < count + 40, "a divisor vanishes at every point with the file's numbers")
            try:
                found.append(change(ring, self.evaluate(wanted, ring, self.drawn())))
            except Again:
                continue
        return found

    def equal(self, one, other, kind="value"):
        """True if a vector is identically another one, or its derivative."""
        n = len(self.of.elements(one))
        if n != len(self.of.elements(other)):
            return False
        return all(row[:n] == row[n:] for row in self.sampled([("value", one), (kind, other)], 2))

    def made_of(self, wanted, parts, change=lambda ring, row, last: (row, last)):
        """True if each target is a combination, with constant coefficients, of the elements of these vectors."""
        width = sum(len(self.of.elements(k)) for k in parts)

        def split(ring, row):
            return None if Duals.NONE in row else change(ring, row[: len(row) - width], row[len(row) - width :])

        rows = self.sampled([*wanted, *(("value", k) for k in parts)], width + 4, split)
        if None in rows:
            return False
        targets, basis = (list(zip(*(row[side] for row in rows))) for side in (0, 1))
        echelon = Echelon(self.p, len(rows))
        for column in basis:
            echelon.add(column)
        return not any(echelon.add(column) for column in targets)

    def vanishes(self, k, squares, gone):
        """True if a signal converges to zero: its square is integrable and its derivative bounded (Barbalat's lemma),
        it is the derivative of a vanishing signal and its own derivative is bounded, or it follows from others.
        """
        linear = [
            item
            for item in map(self.of.linear.__getitem__, self.linear)
            if any(self.equal(k, z) for z in item["vectors"])
        ]
        if self.bounded([("rate", k)]) and (
            any(self.equal(k, other) for other in squares) or any(self.equal(k, z, "rate") for z in gone)
        ):
            return True
        if any(self.made_of(self.inputs(self.of.linear.index(item)), gone) for item in linear if gone):
            return True
        widths = [
            term["parts"]["width"]
            for term in self.of.terms
            if term["rule"] == "potential" and self.equal(k, term["parts"]["vector"])
        ]
        return bool(gone) and any(self.follows_from(k, gone, width) for width in [None, *widths])

    def follows_from(self, k, gone, width):
        """True if a, or a / sqrt(1 + (a / v)^2) with the same zeros, is made of vanishing signals z; or R'a is, or a is
        part of the least-squares solutions of R'b = z, with a matrix R that is believed to keep full row rank.
        """
        of, n, both = self.of, len(self.of.elements(k)), [("value", k)] + [("value", width)] * (width is not None)

        def target(ring, row):
            a, v, one = row[:n], spread(row[n:], n) if width is not None else [], ring.number(1)
            ratios = [ring.mul(x, ring.inverse(y)) for x, y in zip(a, v)]
            roots = [ring.call(None, "sqrt", ring.add(one, ring.mul(x, x))) for x in ratios]
            return [ring.mul(x, ring.inverse(y)) for x, y in zip(a, roots)] if width is not None else a

        if self.made_of(both, gone, lambda ring, row, z: (target(ring, row), z)):
            return True
        for item in of.ranks:
            (rows, columns), size = of.shape(item["matrix"]), len(of.elements(item["matrix"]))

            def through(ring, row, z, rows=rows, columns=columns, size=size):
                R, a = [row[-size:][i::rows] for i in range(rows)], target(ring, row[:-size])
                if rows == n:
                    return [dot(ring, column, a) for column in zip(*R)], z
                square, basis = [[dot(ring, one, other) for other in R] for one in R], []
                for first in range(0, len(z) - columns + 1, columns):
                    right = [[dot(ring, line, z[first : first + columns])] for line in R]
                    basis += [line[0] for line in solve(ring, square, right)]
                return a, basis

            (row,) = self.sampled([("value", item["matrix"])], 1)
            echelon = Echelon(self.p, columns)
            if not all(echelon.add(row[i::rows]) for i in range(rows)):
                continue
            parts = [gone] if rows == n else [[z] for z in gone if len(of.elements(z)) % columns == 0 and rows > n]
            if any(self.made_of([*both, ("value", item["matrix"])], z, through) for z in parts):
                self.signs.believed.append(f"{item['name']} keeps full row rank, uniformly")
                return True
        return False

    def check(self):
        """The conclusions of the file that follow, and the others."""
        shown, left, gone, squares = [], list(self.of.conclusions), [], []
        for k in self.strict:
            term = self.of.term(k)
            squares += [term["parts"]["vector"]] if term["role"] == "dissipated" and term["rule"] == "square" else []
        while True:
            found = next((item for item in left if "vector" in item and self.follows(item, squares, gone)), None)
            if found is None:
                return shown, left
            left.remove(found)
            shown.append(found)
            gone += [found["vector"]] if found["says"] == "goes to zero" else []

    def follows(self, item, squares, gone):
        if item["says"] == "is bounded":
            return self.bounded([("value", item["vector"])])
        if item["says"] == "stays in a compact set of positive definite matrices":
            terms = [self.of.term(k) for k in self.strict if self.of.term(k)["rule"] == "log_det"]
            return any(self.equal(item["vector"], term["parts"]["matrix"]) for term in terms)
        if item["says"] == "is square-integrable":
            return any(self.equal(item["vector"], other) for other in squares)
        return item["says"] == "goes to zero" and self.vanishes(item["vector"], squares, gone)


def bounded_by_belief(of):
    given = [label for label, kind in zip(of.labels, of.kinds) if kind == "trajectory"]
    return [f"bounded: {', '.join(given)}"] if given and not of.samples else []


def robot_text(item):
    rates = "; its acceleration follows from the torque, for all masses" if item["motion"] is not None else ""
    return f"a weight is the mass matrix of a chain of {len(item['joints'])} rigid bodies{rates}"


def from_steps(of):
    """What the lemmas of update steps show, whatever the rows are; eta is what the true parameters do not explain."""
    for steps in of.steps:
        name, metric = steps["estimate"], "gain^-1" if steps["rule"] == "normalised" else "G + gain^-1"
        if steps["box"]:
            yield {"signal": name, "says": "is bounded"}
        yield {"signal": f"|{name} - true value|^2 in the metric {metric}", "says": "does not rise where eta is zero"}
        yield {"signal": f"the error of {name} in the direction of its rows", "says": "is square-summable where eta is"}


def check(data: dict) -> dict:
    """Result of the check, as JSON data; raises `Refused` or `Refuted`."""
    of = Certificate(data)
    signs = Signs(of)
    error, points = identity(of)
    strict = signs.check()
    kappa, shown, left = signs.kappa(strict), [], of.conclusions
    if of.samples:
        shown = list(from_steps(of))
        left = [item for item in left if "estimate" not in item]
    elif not any(term["role"] == "residual" for term in of.terms):
        shown, left = Conclusions(of, signs, strict).check()
        again, _ = Conclusions(of, signs, strict).check()  # with another prime
        shown, left = [x for x in shown if x in again], [*left, *(x for x in shown if x not in again)]

    def named(items):
        return [f"{item['signal']} {item['says']}" for item in items]

    return {
        "status": "re-proved",
        "statement": "V(next) - V" if of.samples else "dV/dt",
        "log2_error": round(error),
        "points": points,
        "robot": [robot_text(item) for item in of.masses],
        "kappa_above": None if kappa is None else str(kappa),
        "only_at_exact_values_of": sorted(of.fixed),
        "conclusions": named(shown),
        "believed": [*BELIEVED, *bounded_by_belief(of), *dict.fromkeys(signs.believed), *named(left)],
        "assumed": of.assumed,
    }


def main(arguments: list) -> int:
    paths = [x for x in arguments if x != "--json"]
    if len(paths) != 1:
        sys.stderr.write("usage: python check.py FILE [--json]\n")
        return 2
    try:
        with open(paths[0], encoding="utf-8") as file:
            result, status = check(json.load(file)), 0
    except Refuted as error:
        result, status = {"status": "refuted", "reason": str(error)}, 1
    except Exception as error:  # of data that are not a certificate
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
