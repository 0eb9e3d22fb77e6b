"""Checks the certificate of a control loop: ``python check.py FILE [--json]``.

``dmframe verify GRAPH --certificate FILE`` writes the file. This program is independent of dmframe: it needs the
standard library of Python alone, it forms the derivative of the storage function V by itself, and it shares no code
with the framework or with ``check.js``. The page ``docs/explanation/checker.md`` proves each rule.

Exit status: 0 re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).

A certificate states, with the symbols x (states, trajectories, parameters) and a straight-line program of rational
operations and a few functions of them:

    V = 1/2 sum_k w_k T_k,   dV/dt = - sum dissipated + sum cross terms + sum residual + projection terms

in continuous time, or the same for V(next) - V from sample to sample. T_k are terms such as |vector|^2_weight. The
program contains the rates dx/dt (or the next values), and neither V nor a derivative of V.

Method: the difference of both sides is a rational function. It is evaluated at random points of prime fields with 149
bits, the derivative in dual numbers a + b eps, eps^2 = 0. If the difference is not identically zero, a point shows this
except with a probability below 8 (D + H) / 2^149; D and H bound degrees and coefficients (`Degrees`). Points are added
until the probability is below 2^-300. Signs of weights and conditions are decided by rational interval arithmetic.
"""

import json
import secrets
import sys
from fractions import Fraction
from math import inf, log2

BITS, WANTED, VERSION, LARGEST = 149, -300, 1, 10**6
CONSTANT_KINDS = ("parameter", "weight", "constant", "stepping")
KINDS = (*CONSTANT_KINDS, "time", "state", "trajectory", "projection", "period", "noise", "command")
BOUNDED = ("sin", "cos", "tanh", "atan", "sign", "lt", "le", "eq", "ne", "not", "and", "or", "erf", "atan2")
UNARY = ("neg", "sq", "twice", "inv", "sin", "cos", "tanh", "atan", "sqrt", "exp", "log", "fabs", "sign", "floor",
         "ceil", "not", "tan", "asin", "acos", "sinh", "cosh", "asinh", "acosh", "atanh", "erf", "erfinv", "expm1",
         "log1p")  # fmt: skip
BINARY = ("add", "sub", "mul", "div", "pow", "constpow", "fmin", "fmax", "lt", "le", "eq", "ne", "and", "or",
          "if_else_zero", "atan2", "hypot", "copysign", "fmod", "remainder")  # fmt: skip


class Refused(Exception):
    """The file is no valid certificate, or contains a rule that this program does not know."""


class Refuted(Exception):
    """A statement of the file is wrong, or not shown by its data."""


class Again(Exception):
    """A denominator vanishes at this point."""


# ---------------------------------------------------------------------------------------------------------------------
# Rings: numbers with add, sub, mul, inverse, number, call


class Field:
    """Residues modulo a random prime; a function has a random value for each argument.

    sin and cos of one argument are a random point of the unit circle. Any other function is a free value: what holds
    for all values holds for those of the function. Equal arguments have equal values.
    """

    def __init__(self):
        self.p = random_prime()
        self.known = {}

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
        try:
            return pow(a, -1, self.p)
        except ValueError:
            raise Again from None

    def call(self, place, name, *given):
        if name in ("sin", "cos"):
            return self.turned(("circle", min(given[0], self.p - given[0])), name, given[0])
        if name == "fabs":
            return self.memo((name, min(given[0], -given[0] % self.p)), self.random)
        if name == "sign" and given[0] > self.p - given[0]:
            return -self.memo((name, self.p - given[0]), self.random) % self.p
        if name == "if_else_zero" and given[0] in (0, 1):
            return given[0] * given[1]
        if name == "not" and given[0] == 0:
            return 1
        return self.memo((name, given), self.random)

    def turned(self, key, name, angle):
        if angle == 0:
            return int(name == "cos")
        t = self.memo(key, self.random)
        scale = self.inverse(1 + t * t)
        if name == "cos":
            return (1 - t * t) * scale % self.p
        return 2 * t * scale * (1 if 2 * angle < self.p else -1) % self.p

    def memo(self, key, make):
        if key not in self.known:
            self.known[key] = make()
        return self.known[key]


class Frozen(Field):
    """A field in which a bounded function keeps its value at each place of the program, whatever its argument."""

    def call(self, place, name, *given):
        if name in ("sin", "cos") and place is not None:
            return self.turned((place, "circle"), name, 1)
        if name in BOUNDED and place is not None:
            return self.memo((place, name), self.random)
        return super().call(None, name, *given)


class Degrees:
    """Bounds on a fraction of polynomials with whole coefficients: degrees, and log2 of the sums of coefficients.

    A number is (degree, height) of the numerator, then of the denominator. `bad` adds up the polynomials that must not
    vanish at a random point: numerators of divisors, and differences of the arguments of one function.
    """

    def __init__(self):
        self.bad, self.inverted, self.arguments = [0, 0], {}, {}

    @staticmethod
    def free():
        return tuple([1, 0, 0, 0])  # a new object: the arguments of a function are told apart by identity

    def number(self, value):
        value = Fraction(value)
        return (0, abs(value.numerator).bit_length(), 0, value.denominator.bit_length())

    def add(self, a, b):
        return (max(a[0] + b[2], b[0] + a[2]), max(a[1] + b[3], b[1] + a[3]) + 1, a[2] + b[2], a[3] + b[3])

    sub = add

    def mul(self, a, b):
        return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])

    def inverse(self, a):
        if id(a) not in self.inverted:  # the same divisor again vanishes at the same points
            self.inverted[id(a)] = a
            self.bad[0] += a[0]
            self.bad[1] += a[1]
        return (a[2], a[3], a[0], a[1])

    def call(self, place, name, *given):
        kind = self.arguments.setdefault({"cos": "sin"}.get(name, name), {})
        for item in given:
            kind[id(item)] = item
        return tuple([2, 1, 2, 1]) if name in ("sin", "cos") else self.free()

    def log2_error(self, elements):
        degree, height = (max((item[k] for item in elements), default=0) for k in (0, 1))
        degree, height = degree + self.bad[0], height + self.bad[1]
        for name, found in self.arguments.items():  # x = y, x = -y, and x equal to 0 or 1, of k arguments
            k, items = len(found) + 2, found.values()
            degree += k * k * (max(x[0] for x in items) + max(x[2] for x in items) + 1)
            height += k * k * (max(x[1] for x in items) + max(x[3] for x in items) + 1)
            if name == "sin":  # 1 + t^2, which is inverted
                degree, height = degree + 2 * k, height + k
        return min(0.0, 3 + log2(max(1, degree + height)) - BITS)


class Duals:
    """Pairs (value, derivative) over another ring; None is a derivative that is zero, `Duals.none` one that is not
    defined."""

    none = object()

    def __init__(self, base):
        self.base = base

    def number(self, value):
        return (self.base.number(value), None)

    def add(self, a, b):
        return (self.base.add(a[0], b[0]), self.sum(a[1], b[1]))

    def sub(self, a, b):
        return (self.base.sub(a[0], b[0]), self.sum(a[1], self.times(self.base.number(-1), b[1])))

    def mul(self, a, b):
        base = self.base
        return (base.mul(a[0], b[0]), self.sum(self.times(b[0], a[1]), self.times(a[0], b[1])))

    def inverse(self, a):
        inverse = self.base.inverse(a[0])
        square = self.base.mul(inverse, inverse)
        return (inverse, self.times(self.base.sub(self.base.number(0), square), a[1]))

    def sum(self, one, other):
        if one is None or other is self.none:
            return other
        if other is None or one is self.none:
            return one
        return self.base.add(one, other)

    def times(self, factor, derivative):
        return derivative if derivative is None or derivative is self.none else self.base.mul(factor, derivative)

    def call(self, place, name, *given):
        base, (a, rate) = self.base, given[0]
        value = base.call(place, name, *(item[0] for item in given))
        if all(item[1] is None for item in given):
            return (value, None)
        one = base.number(1)
        slopes = {
            "sin": lambda: base.call(place, "cos", a),
            "cos": lambda: base.sub(base.number(0), base.call(place, "sin", a)),
            "tanh": lambda: base.sub(one, base.mul(value, value)),
            "atan": lambda: base.inverse(base.add(one, base.mul(a, a))),
            "sqrt": lambda: base.inverse(base.add(value, value)),
            "exp": lambda: value,
            "log": lambda: base.inverse(a),
        }
        return (value, self.times(slopes[name](), rate) if name in slopes else self.none)


class Intervals:
    """Rational intervals (lower, upper): they contain all values over the intervals of the parameters."""

    @staticmethod
    def number(value):
        return (Fraction(value), Fraction(value))

    @staticmethod
    def add(a, b):
        return (a[0] + b[0], a[1] + b[1])

    @staticmethod
    def sub(a, b):
        return (a[0] - b[1], a[1] - b[0])

    @staticmethod
    def mul(a, b):
        ends = [x * y for x in set(a) for y in set(b)]
        return (min(ends), max(ends))

    @staticmethod
    def square(a):
        ends = (a[0] * a[0], a[1] * a[1])
        return (Fraction(0) if a[0] < 0 < a[1] else min(ends), max(ends))

    @staticmethod
    def inverse(a):
        if a[0] <= 0 <= a[1]:
            raise Again
        return (1 / a[1], 1 / a[0])

    @staticmethod
    def call(place, name, *given):
        if name == "fmin":
            return (min(given[0][0], given[1][0]), min(given[0][1], given[1][1]))
        if name == "fmax":
            return (max(given[0][0], given[1][0]), max(given[0][1], given[1][1]))
        if name == "fabs":
            low, high = given[0]
            return (max(low, -high, Fraction(0)), max(-low, high))
        raise Again


def random_prime():
    """A random prime with `BITS` bits, by the test of Miller and Rabin with 64 random bases."""
    while True:
        n = secrets.randbits(BITS) | 1 << (BITS - 1) | 1
        if all(n % small for small in (3, 5, 7, 11, 13, 17, 19, 23, 29, 31)) and is_prime(n):
            return n


def is_prime(n):
    odd, twos = n - 1, 0
    while odd % 2 == 0:
        odd, twos = odd // 2, twos + 1
    for _ in range(64):
        x = pow(secrets.randbelow(n - 3) + 2, odd, n)
        if x in (1, n - 1):
            continue
        for _ in range(twos - 1):
            x = x * x % n
            if x == n - 1:
                break
        else:
            return False
    return True


# ---------------------------------------------------------------------------------------------------------------------
# The file


def need(condition, text):
    if not condition:
        raise Refused(text)


def keys(item, text, names, optional=()):
    need(isinstance(item, dict), f"{text}: expected an object")
    wrong = (set(item) - set(names) - set(optional)) | (set(names) - set(item))
    need(not wrong, f"{text}: missing or unknown: {', '.join(sorted(map(str, wrong)))}")
    return item


def rational(text):
    need(isinstance(text, str) and len(text) < 4000, f"expected a number as a fraction, found {text!r:.40}")
    numerator, _, denominator = text.partition("/")
    digits = numerator.removeprefix("-")
    need(digits.isascii() and digits.isdigit() and (not denominator or (denominator.isascii() and denominator.isdigit())),
         f"expected a whole number or a fraction, found {text:.40}")  # fmt: skip
    need(not denominator or int(denominator) > 0, "a fraction with the denominator 0")
    return Fraction(int(numerator), int(denominator or 1))


def whole(value, least, most, text):
    need(type(value) is int and least <= value < most, f"{text}: expected a whole number in [{least}, {most})")
    return value


class Certificate:
    """A file that has been read: symbols, program, and the statements about its vectors."""

    TOP = ("format", "version", "about", "over", "symbols", "numbers", "program", "vectors", "rates", "terms")
    MORE = ("cross", "projections", "masses", "linear", "conditions", "conclusions", "assumed", "steps", "lines",
            "plant", "between", "solved", "ranks")  # fmt: skip

    def __init__(self, data):
        keys(data, "the file", self.TOP, self.MORE)
        need(data["format"] == "dmframe-certificate", "format: expected dmframe-certificate")
        need(type(data["version"]) is int and data["version"] == VERSION, f"version: expected {VERSION}")
        need(data["over"] in ("flow", "sample"), "over: expected flow or sample")
        self.samples, self.data, self.about = data["over"] == "sample", data, data["about"]
        need(isinstance(self.about, dict), "about: expected an object")
        self._symbols(data["symbols"])
        self._program(data["program"])
        self._numbers(data["numbers"])
        self.vectors = [self._vector(item) for item in data["vectors"]]
        for name in self.MORE:
            need(isinstance(data.get(name, {} if name == "between" else []), dict if name == "between" else list), f"{name}: expected a list")
            setattr(self, name, data.get(name, {} if name == "between" else []))
        self.rates, self.plant_rates = (self._rates(given) for given in (data["rates"], data.get("between", {})))
        stored = [k for term in data["terms"] if term["role"] == "stored" for k in term["parts"].values()]
        self.later = self.slice(stored)
        self.terms = data["terms"]
        for k, term in enumerate(self.terms):
            keys(term, f"term {k}", ("name", "level", "role", "rule", "parts"), ("assumed", "phi"))
            need(term["role"] in ("stored", "dissipated", "residual", "cross"), f"term {k}: role {term['role']!r}")
            need(term["level"] == "" or self.kind_of(term["level"]) == "weight", f"term {k}: level {term['level']!r}")
            need(isinstance(term["parts"], dict), f"term {k}: parts")
            for part in term["parts"].values():
                whole(part, 0, len(self.vectors), f"term {k}")

    def _symbols(self, given):
        self.labels, self.kinds, self.sizes, self.fixed, total = {}, [], [], {}, 0
        for item in given:
            keys(item, "a symbol", ("label", "kind", "size"), ("values",))
            need(isinstance(item["label"], str) and item["label"] not in self.labels, f"symbol {item['label']!r} twice")
            need(item["kind"] in KINDS, f"{item['label']}: unknown kind {item['kind']!r}")
            total += whole(item["size"], 0, LARGEST, item["label"])
            need(total < LARGEST, "too many symbols")
            self.labels[item["label"]] = len(self.kinds)
            self.kinds.append(item["kind"])
            self.sizes.append(item["size"])
            if "values" in item:
                need(item["kind"] == "parameter", f"{item['label']}: values of a parameter only")
                values = [rational(x) for x in item["values"]]
                need(len(values) == item["size"], f"{item['label']}: one value for each element")
                self.fixed[item["label"]] = values
            if item["kind"] in ("time", "weight", "period"):
                need(item["size"] == 1, f"{item['label']}: expected one number")

    def kind_of(self, label):
        need(label in self.labels, f"unknown symbol {label!r}")
        return self.kinds[self.labels[label]]

    def _program(self, given):
        keys(given, "the program", ("operations", "code", "a", "b", "constants"))
        names, code, a, b = given["operations"], given["code"], given["a"], given["b"]
        constants = [rational(x) for x in given["constants"]]
        need(len(code) == len(a) == len(b) < 10**7, "the program: columns of one length")
        self.nodes = []
        for k, (c, i, j) in enumerate(zip(code, a, b)):
            name = names[whole(c, 0, len(names), f"instruction {k}")]
            if name == "const":
                self.nodes.append((name, constants[whole(i, 0, len(constants), f"constant {k}")], 0))
            elif name == "input":
                size = self.sizes[whole(i, 0, len(self.sizes), f"input {k}")]
                self.nodes.append((name, i, whole(j, 0, size, f"input {k}")))
            else:
                need(name in UNARY or name in BINARY, f"unknown operation {name!r}")
                whole(i, 0, k, f"instruction {k}")
                self.nodes.append((name, i, whole(j, 0, k, f"instruction {k}") if name in BINARY else i))

    def _numbers(self, given):
        self.numbers = {}
        for label, values in given.items():
            need(self.kind_of(label) == "parameter", f"numbers of {label}: no parameter")
            found = [tuple(map(rational, x)) if isinstance(x, list) else (rational(x),) * 2 for x in values]
            need(len(found) == self.sizes[self.labels[label]], f"numbers of {label}: one for each element")
            need(all(len(x) == 2 and x[0] <= x[1] for x in found), f"numbers of {label}: expected intervals")
            self.numbers[label] = found
            for exact, own in zip(self.fixed.get(label, []), found):
                need(own == (exact, exact), f"numbers of {label}: other than its exact values")

    def _vector(self, item):
        need(isinstance(item, list) and len(item) == 2, "a vector: expected its rows and elements")
        rows, elements = item
        whole(rows, 0, LARGEST, "a vector's rows")
        for element in elements:
            whole(element, -1, len(self.nodes), "a vector's element")
        need(rows and len(elements) % rows == 0 or not elements, "a vector: expected whole columns")
        return (rows, elements)

    def _rates(self, given):
        found = {}
        for label, vector in given.items():
            kind = self.kind_of(label)
            need(kind == "state" or (kind == "trajectory" and not self.samples), f"rate of {label}, a {kind}")
            whole(vector, 0, len(self.vectors), f"rate of {label}")
            need(len(self.vectors[vector][1]) == self.sizes[self.labels[label]], f"rate of {label}: its size")
            found[label] = vector
        return found

    def reads(self, vectors):
        """Labels of the symbols that these vectors depend on."""
        names = list(self.labels)
        return {names[self.nodes[k][1]] for k in self.slice(vectors) if self.nodes[k][0] == "input"}

    def slice(self, vectors):
        """Places of the instructions that these vectors depend on."""
        wanted = {element for k in vectors for element in self.vectors[k][1] if element >= 0}
        for k in range(max(wanted, default=-1), -1, -1):
            if k in wanted and self.nodes[k][0] not in ("input", "const"):
                wanted |= set(self.nodes[k][1:])
        return wanted

    def shape(self, k):
        rows, elements = self.vectors[k]
        return rows, len(elements) // rows if rows else 0


class Point:
    """The program at one point of a ring."""

    def __init__(self, certificate, ring, inputs, places=None):
        self.of, self.ring, self.inputs, self.values = certificate, ring, inputs, []
        values, call, zero = self.values, ring.call, ring.number(0)
        add, sub, mul, inverse = ring.add, ring.sub, ring.mul, ring.inverse
        square, two = getattr(ring, "square", None), ring.number(2)
        for k, (name, a, b) in enumerate(certificate.nodes):
            if places is not None and k not in places:
                value = None
            elif name == "mul":
                value = mul(values[a], values[b])
            elif name == "add":
                value = add(values[a], values[b])
            elif name == "sub":
                value = sub(values[a], values[b])
            elif name == "input":
                value = inputs[a][b]
            elif name == "const":
                value = ring.number(a)
            elif name == "sq":
                value = square(values[a]) if square else mul(values[a], values[a])
            elif name == "neg":
                value = sub(zero, values[a])
            elif name == "twice":
                value = mul(two, values[a])
            elif name == "div":
                value = mul(values[a], inverse(values[b]))
            elif name == "inv":
                value = inverse(values[a])
            elif name in ("pow", "constpow") and (n := whole_power(certificate.nodes[b])) is not None:
                value = power(ring, values[a], n)
            else:
                value = call(k, name, *((values[a], values[b]) if name in BINARY else (values[a],)))
            values.append(value)

    def vector(self, k):
        zero = self.ring.number(0)
        return [self.values[element] if element >= 0 else zero for element in self.of.vectors[k][1]]

    def matrix(self, k):
        """Rows of a matrix; a vector holds it column by column."""
        rows, columns = self.of.shape(k)
        flat = self.vector(k)
        return [[flat[i + j * rows] for j in range(columns)] for i in range(rows)]


def whole_power(node):
    value = node[1] if node[0] == "const" else None
    return int(value) if value is not None and value.denominator == 1 and abs(value) <= 2**16 else None


def power(ring, value, n):
    if n < 0:
        return power(ring, ring.inverse(value), -n)
    result = ring.number(1)
    for bit in bin(n)[2:]:
        result = ring.mul(result, result)
        result = ring.mul(result, value) if bit == "1" else result
    return result


def dot(ring, left, right):
    total = ring.number(0)
    for a, b in zip(left, right, strict=True):
        total = ring.add(total, ring.mul(a, b))
    return total


def times(ring, weight, vector):
    """W a, with W one number, a diagonal, or a matrix column by column."""
    n = len(vector)
    if len(weight) == 1:
        return [ring.mul(weight[0], x) for x in vector]
    if len(weight) == n:
        return [ring.mul(w, x) for w, x in zip(weight, vector)]
    need(len(weight) == n * n, "a weight: expected one number, a diagonal or a matrix")
    return [dot(ring, weight[i::n], vector) for i in range(n)]


def solve(ring, matrix, columns):
    """matrix^-1 columns, by elimination; `Again` if a pivot vanishes."""
    n = len(matrix)
    rows = [[*row, *more] for row, more in zip(matrix, columns, strict=True)]
    for k in range(n):
        pivot = ring.inverse(rows[k][k])
        rows[k] = [ring.mul(x, pivot) for x in rows[k]]
        for i in range(n):
            if i != k:
                factor = rows[i][k]
                rows[i] = [ring.sub(x, ring.mul(factor, y)) for x, y in zip(rows[i], rows[k])]
    return [row[n:] for row in rows]


# ---------------------------------------------------------------------------------------------------------------------
# Terms: value of each rule; in a ring of dual numbers, with its derivative

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


def spread(item, size):
    need(len(item) in (1, size), "a diagonal: expected one number, or one for each element")
    return item * size if len(item) == 1 else item


def term_value(point, term):
    """T of a term."""
    ring, part = point.ring, {name: point.vector(k) for name, k in term["parts"].items()}
    if term["rule"] == "square":
        return dot(ring, part["vector"], times(ring, part["weight"], part["vector"]))
    if term["rule"] == "gathered":
        n = len(part["vector"])
        need(len(part["memory"]) == n * n and len(part["weight"]) == 1, "an information matrix: its size")
        return ring.mul(part["weight"][0], dot(ring, part["vector"], times(ring, full(part["memory"]), part["vector"])))
    if term["rule"] == "monotone":  # sum w (a - b) (phi(a / v) - phi(b / v))
        n = len(part["first"])
        weight, scale = spread(part["weight"], n), [ring.inverse(v) for v in spread(part["scale"], n)]
        total = ring.number(0)
        for w, a, b, v in zip(weight, part["first"], part["second"], scale, strict=True):
            phi = [ring.call(None, term["phi"], ring.mul(x, v)) for x in (a, b)]
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
    return log_det(point, term)


def full(flat):
    """A matrix with one element, which `times` would read as a number, is one."""
    return flat


def log_det(point, term):
    """c (log det A - log det B + tr(A^-1 B) - n); its value is a free number, its derivative that of the formula.

    d/dt: c (tr(A^-1 A') - tr(A^-1 A' A^-1 B)) with symmetric A, constant B and constant c.
    """
    ring, base = point.ring, point.ring.base
    A, B = (point.matrix(term["parts"][name]) for name in ("matrix", "true"))
    (weight,) = point.vector(term["parts"]["weight"])
    n = len(A)
    need(all(len(row) == n for row in A) and len(B) == n, "a divergence: expected square matrices of one size")
    for row in (*B, [weight]):
        need(all(x[1] is None for x in row), "a divergence: expected a constant true value and weight")
    plain = [[x[0] for x in row] for row in A]
    rates = [[base.number(0) if x[1] is None else defined(x[1]) for x in row] for row in A]
    steps = solve(base, plain, [[*rate, *(x[0] for x in other)] for rate, other in zip(rates, B)])
    moved, ratio = [row[:n] for row in steps], [row[n:] for row in steps]
    total = base.number(0)
    for i in range(n):
        total = base.add(total, moved[i][i])
        total = base.sub(total, dot(base, moved[i], [ratio[k][i] for k in range(n)]))
    return (base.call(None, "log det", *(x for row in plain for x in row)), base.mul(weight[0], total))


def defined(derivative):
    need(derivative is not Duals.none, "a derivative of a function that is not smooth, or that this program lacks")
    return derivative


# ---------------------------------------------------------------------------------------------------------------------
# The identity


class Equalities:
    """What must vanish identically, at one point: lists of numbers, each with its name."""

    def __init__(self, certificate, ring, inputs):
        self.of, self.ring, self.inputs = certificate, ring, inputs
        self.half = ring.inverse(ring.number(2))

    def all(self):
        """Pairs (name, numbers that vanish)."""
        return [*(self.over_samples() if self.of.samples else self.flow())]

    def moving(self, rates, ring):
        """Inputs as dual numbers: the derivative of each symbol with a rate; the time has the rate 1."""
        of, plain = self.of, Point(self.of, ring, self.inputs)
        inputs = [[(x, None) for x in values] for values in self.inputs]
        for label, k in rates.items():
            place = of.labels[label]
            inputs[place] = list(zip(self.inputs[place], plain.vector(k)))
        for place, kind in enumerate(of.kinds):
            if kind == "time":
                inputs[place] = [(self.inputs[place][0], ring.number(1))]
        return inputs

    def weight(self, term, values):
        """Weight of the term's level: the symbol kappa, or 1."""
        return values[self.of.labels[term["level"]]][0] if term["level"] else self.ring.number(1)

    def flow(self):
        of, ring = self.of, self.ring
        duals = Duals(ring)
        point = self.point = Point(of, duals, self.moving(of.rates, ring))
        plain = Plain(point)
        total, storage = ring.number(0), ring.number(0)
        for term in of.terms:
            weight = self.weight(term, self.inputs)
            value, rate = term_value(point, term) if term["role"] == "stored" else (term_value(plain, term), None)
            if term["role"] == "stored":
                storage = ring.add(storage, ring.mul(weight, value))
                value = ring.mul(self.half, ring.number(0) if rate is None else defined(rate))
            signed = ring.sub if term["role"] in ("residual", "cross") else ring.add
            total = signed(total, ring.mul(weight, value))
        for item in of.projections:  # (estimate - true value)' W correction
            term = of.terms[item["term"]]
            error, weight = (plain.vector(term["parts"][name]) for name in ("vector", "weight"))
            correction = self.inputs[of.labels[item["correction"]]]
            lemma = dot(ring, times(ring, weight, error), correction)
            total = ring.sub(total, ring.mul(self.weight(term, self.inputs), lemma))
        self.storage = storage
        yield "dV/dt", [total]
        for item in of.projections:
            error = plain.vector(of.terms[item["term"]]["parts"]["vector"])
            estimate, true = self.inputs[of.labels[item["state"]]], plain.vector(item["true"])
            wrong = [ring.sub(e, ring.sub(x, t)) for e, x, t in zip(error, estimate, spread(true, len(error)), strict=True)]
            yield f"the error of {item['state']}", wrong
            rates = [x[1] for x in point.vector(item["true"])]
            yield f"the true value of {item['state']} is constant", [ring.number(0) if x is None else defined(x) for x in rates]
        for cross in of.cross:  # a = sum_j share_j v_j
            left = plain.vector(of.terms[cross["term"]]["parts"]["vector"])
            for share, k in cross["by"]:
                other = plain.vector(of.terms[k]["parts"]["vector"])
                parts = [ring.mul(x, y) for x, y in zip(spread(plain.vector(share), len(other)), other, strict=True)]
                left = [ring.sub(x, y) for x, y in zip(left, parts, strict=True)]
            yield "the vector of a cross term", left
        for term in of.terms:
            if term["rule"] == "gathered":  # dG/dt = W' diag(r) W - forgetting G
                yield from self.gathered(point, plain, term)
            if term["rule"] == "log_det":
                for name in ("matrix", "true"):
                    A = plain.matrix(term["parts"][name])
                    yield f"symmetry of {term['name']}", [ring.sub(A[i][j], A[j][i]) for i in range(len(A)) for j in range(i)]
        for item in of.masses:
            weight = plain.vector(item["weight"])
            yield "the mass matrix", [ring.sub(x, y) for x, y in zip(weight, mass_matrix(plain, item), strict=True)]

    def gathered(self, point, plain, term):
        ring, parts = self.ring, term["parts"]
        W, by = plain.matrix(parts["regressor"]), plain.vector(parts["by"])
        (forgetting,), G = plain.vector(parts["forgetting"]), point.vector(parts["memory"])
        n, by = len(plain.vector(parts["vector"])), spread(by, len(W))
        found = []
        for j in range(n):
            for i in range(n):
                made = ring.number(0)
                for row, r in zip(W, by, strict=True):
                    made = ring.add(made, ring.mul(r, ring.mul(row[i], row[j])))
                value, rate = G[i + j * n]
                rate = ring.number(0) if rate is None else defined(rate)
                found.append(ring.sub(rate, ring.sub(made, ring.mul(forgetting, value))))
        yield f"the information matrix of {term['name']}", found

    def over_samples(self):
        of, ring = self.of, self.ring
        now = self.point = Point(of, ring, self.inputs)
        inputs = list(self.inputs)
        for label, k in of.rates.items():
            inputs[of.labels[label]] = now.vector(k)
        later = Point(of, ring, inputs, of.later) if any(t["role"] == "stored" for t in of.terms) else now
        total, storage = ring.number(0), ring.number(0)
        for term in of.terms:
            value = term_value(now, term)
            if term["role"] == "stored":
                storage = ring.add(storage, value)
                value = ring.mul(self.half, ring.sub(term_value(later, term), value))
            total = (ring.sub if term["role"] == "residual" else ring.add)(total, value)
        for steps in of.steps:
            for label, values in update(now, steps).items():
                after = now.vector(of.rates[label])
                yield f"the next value of {label}", [ring.sub(x, y) for x, y in zip(after, values, strict=True)]
        self.storage = storage
        yield "V(next) - V", [total]
        for line in of.lines:
            after = now.vector(of.rates[line["state"]])
            yield f"the next value of {line['state']}", [
                ring.sub(x, y) for x, y in zip(after, shifted(now, line), strict=True)
            ]
        if of.plant:
            point = Point(of, Duals(ring), self.moving(of.plant_rates, ring))
            for item in of.plant:  # d/dt momentum + rest = 0
                momentum, rest = point.vector(item["momentum"]), now.vector(item["rest"])
                yield "a plant identity", [
                    y if x[1] is None else ring.add(defined(x[1]), y) for x, y in zip(momentum, rest, strict=True)
                ]
        for k in of.solved:
            yield "an equation that an output solves", now.vector(k)


class Plain:
    """The values of a point of dual numbers, as a point of its base ring."""

    def __init__(self, point):
        self.of, self.ring, self.values = point.of, point.ring.base, [x and x[0] for x in point.values]

    vector, matrix = Point.vector, Point.matrix


# ---------------------------------------------------------------------------------------------------------------------
# Steps of an estimate from sample to sample


def pieces(column, sizes):
    found, start = [], 0
    for size in sizes:
        found.append(column[start : start + size])
        start += size
    need(start == len(column), "the steps of an estimate: sizes of its parts")
    return found


def update(point, steps):
    """The next values of an estimate and its memory, by label.

    For each output and each of its rows (h, y), with e = y - h'theta and r = y - h'true:
    normalised     theta <- theta + D h e / n, n = floor + h' D h, D the gain. |theta - true|^2_(1/D) changes by
                   exactly -(h'(theta - true))^2 / n - floor e^2 / n^2 + r^2 / n.
    least squares  theta <- theta + P h e / n, P = (G + 1/D)^-1, n = floor + h' P h, G <- G + h h' / floor.
                   |theta - true|^2_(G + 1/D) changes by exactly -e^2 / n + r^2 / floor.
    A box with the true value inside moves theta towards it; a factor of G in [0, 1] forgets.
    """
    ring, part = point.ring, {name: point.vector(k) for name, k in steps["parts"].items()}
    sizes, squares, (floor,) = steps["sizes"], steps["rule"] == "least_squares", part["floor"]
    theta, gain = (pieces(part[name], sizes) for name in ("theta", "gain"))
    box = [pieces(part[name], sizes) for name in ("lower", "upper")] if steps["box"] else None
    rows = [(pieces(part[f"h{k}"], sizes), part[f"y{k}"]) for k in range(steps["rows"])]
    memory = pieces(part["gathered"], [n * (n + 1) // 2 for n in sizes]) if squares else [[] for _ in sizes]
    moved, kept = [], []
    for j, n in enumerate(sizes):
        now, G = theta[j], unpacked(n, memory[j]) if squares else None
        metric = [ring.inverse(x) for x in gain[j]]
        for row, measured in rows:
            h, y = row[j], measured[j]
            if squares:
                W = [[ring.add(x, metric[i]) if i == k else x for k, x in enumerate(line)] for i, line in enumerate(G)]
                direction = [line[0] for line in solve(ring, W, [[x] for x in h])]
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
        if squares:
            kept += [ring.mul(part["retention"][0], G[i][k]) for k in range(n) for i in range(k, n)]
    return {steps["estimate"]: moved, **({steps["memory"]: kept} if squares else {})}


def unpacked(n, triangle):
    """A symmetric matrix from its lower triangle, column by column."""
    matrix, k = [[None] * n for _ in range(n)], 0
    for column in range(n):
        for row in range(column, n):
            matrix[row][column] = matrix[column][row] = triangle[k]
            k += 1
    return matrix


def clipped(ring, value, low, high):
    return ring.call(None, "fmin", ring.call(None, "fmax", value, low), high)


def into_box(ring, theta, G, metric, lower, upper):
    """Projection onto the box. Least squares: onto one face after the other in the norm of G + 1/D, then by clipping,
    which sets G to zero where it changes an element."""
    n = len(theta)
    if G is None:
        return [clipped(ring, *x) for x in zip(theta, lower, upper, strict=True)], None
    W = [[ring.add(x, metric[i]) if i == k else x for k, x in enumerate(line)] for i, line in enumerate(G)]
    P = solve(ring, W, [[ring.number(int(i == k)) for k in range(n)] for i in range(n)])
    for i in range(n):
        face = clipped(ring, theta[i], lower[i], upper[i])
        factor = ring.mul(ring.sub(theta[i], face), ring.inverse(P[i][i]))
        theta = [ring.sub(x, ring.mul(P[k][i], factor)) for k, x in enumerate(theta)]
        theta[i] = face
    cut, kept = [clipped(ring, *x) for x in zip(theta, lower, upper, strict=True)], ring.number(1)
    for i in range(n - 1):
        kept = ring.mul(kept, ring.call(None, "eq", theta[i], cut[i]))
    return cut, [[ring.mul(x, kept) for x in row] for row in G]


def shifted(point, line):
    """A delay line at the next sample: the newest entry comes first, the oldest is dropped."""
    ring, of = point.ring, point.of
    newest, before = point.vector(line["newest"]), point.vector(line["before"])
    (rows, columns), (height, width) = of.shape(line["newest"]), of.shape(line["before"])
    if columns == width:
        after = [newest[r + c * rows] if r < rows else before[r - rows + c * height] for c in range(width) for r in range(height)]
    else:
        after = [*newest, *before[: height * (width - columns)]]
    if line.get("when") is None:
        return after
    (when,) = point.vector(line["when"])
    kept = ring.call(None, "not", when)
    return [
        ring.add(ring.call(None, "if_else_zero", when, new), ring.call(None, "if_else_zero", kept, old))
        for new, old in zip(after, before, strict=True)
    ]


# ---------------------------------------------------------------------------------------------------------------------
# The mass matrix of a chain of rigid bodies


def mass_matrix(point, item):
    """sum_i J_i' I_i J_i + diag(rotors), column by column, with spatial velocities of the links in their own frames.

    `joints`: kind, axis and rotation of each, exact; `translations`: of each joint in its parent, as vector; `inertia`:
    m, m c (3), I_xx, I_xy, I_yy, I_xz, I_yz, I_zz about the joint's origin, of each link; `position`: q.
    """
    ring = point.ring
    q, moves, inertia = (point.vector(item[name]) for name in ("position", "translations", "inertia"))
    n, zero, one = len(q), ring.number(0), ring.number(1)
    jacobian, found = [], [[zero] * n for _ in range(n)]  # columns (angular, linear) of the present link
    for i, joint in enumerate(item["joints"]):
        axis, R = [ring.number(rational(x)) for x in joint["axis"]], [ring.number(rational(x)) for x in joint["rotation"]]
        R, origin = [R[0:3], R[3:6], R[6:9]], moves[3 * i : 3 * i + 3]
        if joint["kind"] == "revolute":
            R = product(ring, R, turned(ring, axis, q[i]))
            new = (axis, [zero] * 3)
        else:
            shift = [ring.mul(a, q[i]) for a in axis]
            origin = [ring.add(a, b) for a, b in zip(origin, apply(ring, R, shift))]
            new = ([zero] * 3, axis)
        back = [list(row) for row in zip(*R)]
        carried = []
        for angular, linear in jacobian:  # v at the new origin is v + w x origin
            at = [ring.add(a, b) for a, b in zip(linear, across(ring, angular, origin))]
            carried.append((apply(ring, back, angular), apply(ring, back, at)))
        jacobian = [*carried, new]
        m, hx, hy, hz, xx, xy, yy, xz, yz, zz = inertia[10 * i : 10 * i + 10]
        h, I = (hx, hy, hz), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        for k, (w, v) in enumerate(jacobian):  # momentum: I w + h x v, m v + w x h
            turning = [ring.add(a, b) for a, b in zip(apply(ring, I, w), across(ring, h, v))]
            pushing = [ring.add(ring.mul(m, a), b) for a, b in zip(v, across(ring, w, h))]
            for j, (angular, linear) in enumerate(jacobian):
                energy = ring.add(dot(ring, angular, turning), dot(ring, linear, pushing))
                found[j][k] = ring.add(found[j][k], energy)
    if item.get("rotors") is not None:
        for i, rotor in enumerate(spread(point.vector(item["rotors"]), n)):
            found[i][i] = ring.add(found[i][i], rotor)
    return [found[i][j] for j in range(n) for i in range(n)]


def turned(ring, a, angle):
    """Rotation about the unit vector a: cos 1 + sin [a]x + (1 - cos) a a'."""
    c, s = (ring.call(None, name, angle) for name in ("cos", "sin"))
    rest, zero = ring.sub(ring.number(1), c), ring.number(0)
    minus = [ring.sub(zero, x) for x in a]
    skew = ((zero, minus[2], a[1]), (a[2], zero, minus[0]), (minus[1], a[0], zero))
    return [
        [ring.add(ring.add(c if i == j else zero, ring.mul(s, skew[i][j])), ring.mul(rest, ring.mul(a[i], a[j]))) for j in range(3)]
        for i in range(3)
    ]


def product(ring, A, B):
    return [[dot(ring, row, column) for column in zip(*B)] for row in A]


def apply(ring, A, x):
    return [dot(ring, row, x) for row in A]


def across(ring, a, b):
    return [ring.sub(ring.mul(a[i - 2], b[i - 1]), ring.mul(a[i - 1], b[i - 2])) for i in range(3)]


# ---------------------------------------------------------------------------------------------------------------------
# Signs, conditions and small gain, in rational intervals


class Signs:
    """Signs of vectors of parameters, for all values in the intervals of the file; of weights, with their reasons."""

    def __init__(self, certificate):
        self.of, self.ring = certificate, Intervals()
        known = {**{label: [(x, x) for x in values] for label, values in certificate.fixed.items()}, **certificate.numbers}
        self.boxes = {}
        self.known = known

    def vector(self, k, more=None):
        """Intervals of a vector's elements; None if it depends on other than these, or on a function."""
        known = {**self.known, **(more or {})}
        if not self.of.reads([k]) <= set(known):
            return None
        inputs = [known.get(label) for label in self.of.labels]
        try:
            return Point(self.of, self.ring, inputs, self.of.slice([k])).vector(k)
        except Again:
            return None

    def weight(self, term):
        """The least sign of a term's weight: "positive", "not negative" or "", and what is believed for it."""
        part, rule = term["parts"], term["rule"]
        signs = [self.sign(part["weight"], len(self.of.vectors[part["vector"]][1]) if rule == "square" else 0)]
        if signs == [""] and rule == "square":
            mass = next((item for item in self.of.masses if self.of.vectors[item["weight"]] == self.of.vectors[part["weight"]]), None)
            if mass:
                return self.mass(mass)
            if "assumed" in term:
                return "positive", f"{term['name']}: its weight is positive: {term['assumed']}"
        for name in {"monotone": ("scale",), "potential": ("width",)}.get(rule, ()):
            if self.sign(part[name]) != "positive":
                return "", ""
        if rule == "gathered":
            if self.sign(part["by"]) == "" or self.sign(part["forgetting"]) == "":
                return "", ""
            return min(signs[0], "not negative"), f"{term['name']}: its information matrix starts at zero"
        if rule == "log_det":
            A = self.vector(part["true"])
            n = self.of.shape(part["true"])[0]
            if A is None or not definite([A[i::n] for i in range(n)]):
                return "", ""
            return signs[0], f"{term['name']}: the estimate starts positive definite"
        return signs[0], ""

    def sign(self, k, size=0):
        values = self.vector(k)
        if values is None:
            return ""
        if size > 1 and len(values) == size * size:
            return "positive" if definite([values[i::size] for i in range(size)]) else ""
        least = min((x[0] for x in values), default=Fraction(1))
        return "positive" if least > 0 else "not negative" if least == 0 else ""

    def mass(self, item):
        """A mass matrix is positive definite if each link's pseudo-inertia is, and no rotor is negative."""
        if item.get("rotors") is not None and self.sign(item["rotors"]) == "":
            return "", ""
        inertia = self.vector(item["inertia"])
        if inertia is None:
            return "positive", "the load of a mass matrix is a rigid body"
        for k in range(0, len(inertia), 10):
            m, hx, hy, hz, xx, xy, yy, xz, yz, zz = inertia[k : k + 10]
            r, zero = self.ring, (Fraction(0), Fraction(0))
            half = r.mul(r.add(r.add(xx, yy), zz), (Fraction(1, 2),) * 2)
            xy, xz, yz = (r.sub(zero, x) for x in (xy, xz, yz))
            rows = [[r.sub(half, xx), xy, xz, hx], [xy, r.sub(half, yy), yz, hy], [xz, yz, r.sub(half, zz), hz], [hx, hy, hz, m]]
            if not definite(rows):
                return "", ""
        return "positive", ""


def definite(rows):
    """True if a symmetric matrix of intervals is positive definite: all pivots are positive."""
    ring, rows = Intervals, [list(row) for row in rows]
    while rows:
        pivot = rows[0][0]
        if pivot[0] <= 0:
            return False
        inverse = ring.inverse(pivot)
        rows = [
            [ring.sub(x, ring.mul(ring.mul(row[0], inverse), y)) for x, y in zip(row[1:], rows[0][1:])] for row in rows[1:]
        ]
    return True


def check_signs(of, signs):
    """Weights, projections, small gain, steps and conditions. Returns what is believed, and the strict squares."""
    believed, strict = [], set()
    for k, term in enumerate(of.terms):
        if term["role"] == "residual" or (term["role"] == "cross" and signs.sign(term["parts"]["weight"]) != ""):
            continue
        sign, reason = signs.weight(term)
        if not sign or (term["role"] == "stored" and term["rule"] != "gathered" and sign != "positive"):
            raise Refuted(f"{term['name']}: the weight of a {term['role']} term is not shown to have its sign")
        believed += [reason] * bool(reason)
        if sign == "positive" and term["rule"] != "gathered":
            strict.add(k)
    for item in of.projections:
        name, size = item["state"], len(of.vectors[item["true"]][1])
        if item["set"] != "box":
            believed.append(f"{name}: the law and the metric of its {item['set']}, and that its true value is inside")
            continue
        weight = of.vectors[of.terms[item["term"]]["parts"]["weight"]][1]
        need(of.terms[item["term"]]["rule"] == "square" and len(weight) in (1, size), f"{name}: a box needs a diagonal metric")
        ends = [signs.vector(item[end]) for end in ("lower", "true", "upper")]
        if None in (ends[0], ends[2]):
            raise Refuted(f"{name}: its box is not made of parameters")
        if ends[1] is None:
            believed.append(f"{name}: its true value is inside the box")
        elif not all(low[1] <= x[0] and x[1] <= high[0] for low, x, high in zip(*ends)):
            raise Refuted(f"{name}: its true value is not inside the box")
        signs.boxes[name] = [(low[0], high[1]) for low, high in zip(ends[0], ends[2])]
    for steps in of.steps:
        for name in ("gain", "floor"):
            if signs.sign(steps["parts"][name]) != "positive":
                raise Refuted(f"{steps['estimate']}: {name} of its steps is not shown to be positive")
        ends = [signs.vector(steps["parts"][name]) for name in ("lower", "true", "upper")] if steps["box"] else []
        if None in ends:
            believed.append(f"{steps['estimate']}: its true value is inside the box")
        elif ends and not all(low[1] <= x[0] and x[1] <= high[0] for low, x, high in zip(*ends)):
            raise Refuted(f"{steps['estimate']}: its true value is not inside the box")
        if "retention" in steps["parts"]:
            found = signs.vector(steps["parts"]["retention"])
            if found is None or found[0][0] < 0 or found[0][1] > 1:
                raise Refuted(f"{steps['estimate']}: its retention is not shown to be in [0, 1]")
    for item in of.conditions:
        if "margin" not in item or signs.sign(item["margin"]) == "":
            values = signs.vector(item["margin"]) if "margin" in item else None
            if values is not None:
                raise Refuted(f"condition {item['name']}: does not hold")
            believed.append(f"condition {item['name']}")
        elif item["strict"] and signs.sign(item["margin"]) != "positive":
            raise Refuted(f"condition {item['name']}: not positive")
    return believed, strict


def small_gain(of, signs, strict):
    """The least kappa for which the dissipation dominates the cross terms: c |sum a_j v_j|^2 <= kappa sum |v_j|^2_W_j
    if kappa >= c sum a_j^2 / W_j. None without cross terms."""
    ring, needed = Intervals, {}
    for cross in of.cross:
        (c,) = signs.vector(of.terms[cross["term"]]["parts"]["weight"]) or [None]
        used = tuple(sorted(k for _, k in cross["by"]))
        total = (Fraction(0), Fraction(0))
        for share, k in cross["by"]:
            term = of.terms[k]
            weight, a = signs.vector(term["parts"]["weight"]), signs.vector(share)
            size = len(of.vectors[term["parts"]["vector"]][1])
            if c is None or k not in strict or weight is None or a is None or term["role"] != "dissipated":
                raise Refuted(f"{of.terms[cross['term']]['name']}: no square with a positive weight dominates its cross term")
            need(term["rule"] == "square" and len(weight) in (1, size), "a dominating square: expected a diagonal weight")
            each = [ring.mul(ring.square(x), ring.inverse(w)) for x, w in zip(spread(a, size), spread(weight, size))]
            total = ring.add(total, (Fraction(0), max(x[1] for x in each)))
        need(used and len({of.terms[k]["level"] for k in used}) == 1, "a cross term: expected squares of one level")
        key = used, of.terms[used[0]]["level"]
        needed[key] = needed.get(key, Fraction(0)) + ring.mul(c, total)[1]
    sets = [set(used) for used, _ in needed]
    need(all(a is b or not a & b for a in sets for b in sets), "cross terms: expected the same dominating squares")
    if any(not level and value >= 1 for (_, level), value in needed.items()):
        raise Refuted("a cross term is not dominated")
    return max((value for (_, level), value in needed.items() if level), default=None)


# ---------------------------------------------------------------------------------------------------------------------
# Conclusions in continuous time


class Echelon:
    """Row echelon form modulo p of linear functionals, and its null space."""

    def __init__(self, p, columns):
        self.p, self.columns, self.rows = p, columns, {}

    def add(self, row):
        row = [x % self.p for x in row]
        for pivot, other in self.rows.items():
            if row[pivot]:
                row = [(x - row[pivot] * y) % self.p for x, y in zip(row, other)]
        pivot = next((k for k, x in enumerate(row) if x), None)
        if pivot is None:
            return False
        scale = pow(row[pivot], -1, self.p)
        row = [x * scale % self.p for x in row]
        for k, other in self.rows.items():
            if other[pivot]:
                self.rows[k] = [(x - other[pivot] * y) % self.p for x, y in zip(other, row)]
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
    """Bounded and vanishing signals of a claim whose V does not increase.

    A direction of the state space is open if no bounded signal determines it. With all bounded functions frozen at
    their places of the program, a signal whose value does not change along a random open direction u is bounded. A
    bounded signal that changes along u at a constant rate closes a direction.
    """

    def __init__(self, of, signs, strict):
        self.of, self.signs, self.strict = of, signs, strict
        self.rings = [Frozen(), Frozen()]
        self.rings[1].p = self.p = self.rings[0].p
        exact = signs.known
        first = [[self.rings[0].number(exact[label][i][0]) if label in exact and exact[label][i][0] == exact[label][i][1]
                  else self.rings[0].random() for i in range(of.sizes[k])] for label, k in of.labels.items()]  # fmt: skip
        other = [own if of.kinds[k] in CONSTANT_KINDS else [self.rings[0].random() for _ in own] for k, own in enumerate(first)]
        self.points, self.first = (first, other), {}
        self.states, n = {}, 0
        for label, k in of.labels.items():
            if of.kinds[k] in ("state", "time"):
                self.states[label] = range(n, n + of.sizes[k])
                n += of.sizes[k]
        self.known, self.columns = Echelon(self.p, n), n
        self.linear = []
        self.close()

    def evaluate(self, wanted, place, u=None):
        """Numbers of values ("value", k), derivatives ("rate", k) and inputs ("rest", item, j), at a point moved by u."""
        of, ring, inputs = self.of, self.rings[place], list(self.points[place])
        for label, rows in self.states.items() if u else ():
            k = of.labels[label]
            inputs[k] = [(x + step) % self.p for x, step in zip(inputs[k], u[rows.start : rows.stop])]
        if all(item[0] == "value" for item in wanted):
            point = Point(of, ring, inputs, of.slice([item[1] for item in wanted]))
            return [x for item in wanted for x in point.vector(item[1])]
        duals = Duals(ring)
        point = Point(of, duals, Equalities(of, ring, inputs).moving(of.rates, ring))
        found = []
        for kind, k, *row in wanted:
            if kind == "rest":
                item, j = self.of.linear[k], row[0]
                z = [[x[0] for x in point.vector(v)] for v in item["vectors"]]
                rest = [x[1] for x in point.vector(item["vectors"][j])]
                for rate, other in zip(item["rates"][j], z):
                    each = zip(spread([x[0] for x in point.vector(rate)], len(other)), other)
                    rest = [duals.sum(x, (-a * b) % self.p) for x, (a, b) in zip(rest, each, strict=True)]
                found += rest
            else:
                found += [x[kind == "rate"] for x in point.vector(k)]
        return [0 if x is None else x for x in found]

    def along(self, wanted, place, u):
        """Changes along u, with the bounded functions of the point itself; None where a derivative is not defined."""
        key = (tuple(wanted), place)
        if key not in self.first:
            self.first[key] = self.evaluate(wanted, place)
        moved = self.evaluate(wanted, place, u)
        none = Duals.none
        return [None if none in (x, y) else (x - y) % self.p for x, y in zip(moved, self.first[key])]

    def random_open(self):
        total = [0] * self.columns
        for _, u in self.known.null_space():
            factor = secrets.randbelow(self.p)
            total = [(x + factor * y) % self.p for x, y in zip(total, u)]
        return total

    def bounded(self, item, seen=()):
        """True if a signal, or its derivative, changes along no open direction."""
        of = self.of
        if any(self.along([item], 0, self.random_open())):
            return False
        reads = of.reads([item[1]])
        if item[0] != "value":
            reads |= of.reads([of.rates[label] for label in reads if label in of.rates])
        corrected = [p["state"] for p in of.projections if p["correction"] in reads and p["state"] not in seen]
        return None not in self.along([item], 0, self.random_open()) and all(
            self.bounded(("value", of.rates[label]), (*seen, label)) for label in corrected
        )

    def close(self):
        of = self.of
        vectors = [of.terms[k]["parts"]["matrix" if of.terms[k]["rule"] == "log_det" else "vector"]
                   for k in sorted(self.strict) if of.terms[k]["role"] == "stored"]  # fmt: skip
        for item in of.projections:
            for column in self.states[item["state"]]:
                self.known.add([int(column == k) for k in range(self.columns)])
        self.constants()
        waiting = list(range(len(of.linear)))
        while True:
            while self.grow([("value", k) for k in vectors]):
                pass
            found = next((k for k in waiting if self.follows(k)), None)
            if found is None:
                return
            waiting.remove(found)
            self.linear.append(found)
            vectors += of.linear[found]["vectors"]

    def constants(self):
        """Sums and differences of up to three states of one size whose rates cancel are constant."""
        of = self.of
        labels = [label for label in self.states if label in of.rates]
        values = [self.evaluate([("value", of.rates[label]) for label in labels], place) for place in (0, 1)]
        starts, n = {}, 0
        for label in labels:
            starts[label] = n
            n += len(self.states[label])
        groups = [(a,) for a in labels] + [(a, b) for i, a in enumerate(labels) for b in labels[:i]]
        groups += [(a, b, c) for i, a in enumerate(labels) for j, b in enumerate(labels[:i]) for c in labels[:j]]
        for group in groups:
            size = len(self.states[group[0]])
            if any(len(self.states[label]) != size for label in group):
                continue
            for pattern in range(2 ** (len(group) - 1)):
                signs = [1, *(1 - 2 * (pattern >> k & 1) for k in range(len(group) - 1))]
                for i in range(size):
                    if not any(sum(s * v[starts[x] + i] for s, x in zip(signs, group)) % self.p for v in values):
                        row = [0] * self.columns
                        for s, label in zip(signs, group):
                            row[self.states[label].start + i] = s
                        self.known.add(row)

    def grow(self, vectors):
        directions = list(self.known.null_space())
        if not vectors or not directions:
            return False
        u = self.random_open()
        pairs = list(zip(*(self.along(vectors, place, u) for place in (0, 1))))
        steady = [row for row, (a, b) in enumerate(pairs) if a and a == b]
        moved = [(free, self.along(vectors, 0, direction)) for free, direction in directions] if steady else []
        grown = False
        for row in steady:
            functional = [0] * self.columns
            for free, change in moved:
                functional[free] = change[row]
            grown |= self.known.add(functional)
        return grown

    def follows(self, k):
        item = self.of.linear[k]
        rests = [("rest", k, j) for j in range(len(item["vectors"]))]
        changes = self.along(rests, 0, self.random_open())
        return not any(changes) and None not in changes and self.stable(item) and self.corrections(item)

    def corrections(self, item):
        return all(self.bounded(("rate", z)) or True for z in item["vectors"])

    def stable(self, item):
        """True if dz/dt = A z is exponentially stable, of one or two equations for each joint, over all intervals."""
        ring, n = Intervals, len(item["vectors"])
        A = [[self.signs.vector(rate, self.signs.boxes) for rate in row] for row in item["rates"]]
        if any(entry is None for row in A for entry in row) or n > 2:
            return False
        size = max(len(entry) for row in A for entry in row)
        A = [[spread(entry, size) for entry in row] for row in A]
        if n == 1:
            return all(a[1] < 0 for a in A[0][0])
        if any(self.of.reads([rate]) & set(self.signs.boxes) for row in item["rates"] for rate in row):
            return False
        for a, b, c, d in zip(*A[0], *A[1]):
            if not (ring.add(a, d)[1] < 0 and ring.sub(ring.mul(a, d), ring.mul(b, c))[0] > 0):
                return False
        return True

    def check(self):
        """Names of the conclusions of the file that follow, and of the others."""
        of, vanish, shown, open_ = self.of, [], [], list(self.of.conclusions)
        squares = [t["parts"]["vector"] for k, t in enumerate(of.terms) if k in self.strict and t["role"] == "dissipated" and t["rule"] == "square"]
        vanish += [k for k in squares if self.bounded(("rate", k))]
        again = True
        while again:
            again = False
            for item in list(open_):
                if "vector" in item and self.holds(item, squares, vanish):
                    open_.remove(item)
                    shown.append(item)
                    again = True
                    if item["says"] == "goes to zero":
                        vanish.append(item["vector"])
        return shown, open_

    def holds(self, item, squares, vanish):
        k = item["vector"]
        if item["says"] == "is bounded":
            return self.bounded(("value", k))
        if item["says"] == "is square-integrable":
            return any(self.equal(k, other) for other in squares)
        if item["says"] != "goes to zero":
            return False
        if any(self.equal(k, other) for other in vanish) or self.made_of([("value", k)], vanish):
            return True
        if any(self.equal(k, z, "rate") for z in vanish) and self.bounded(("rate", k)):
            return True
        for place in self.linear:
            linear = self.of.linear[place]
            if any(self.equal(k, z) for z in linear["vectors"]):
                return self.made_of([("rest", place, j) for j in range(len(linear["vectors"]))], vanish)
        return any(self.seen_through(k, item["matrix"], vanish) for item in self.of.ranks)

    def sampled(self, wanted, count):
        """Numbers at random points with the file's parameters."""
        of, found = self.of, []
        for _ in range(count):
            place = Field()
            place.p = self.p
            inputs = [own if of.kinds[k] in CONSTANT_KINDS else [place.random() for _ in own] for k, own in enumerate(self.points[0])]
            keep = self.points, self.rings
            self.points, self.rings = (inputs,), (place,)
            try:
                found.append(self.evaluate(wanted, 0))
            finally:
                self.points, self.rings = keep
        return found

    def equal(self, one, other, kind="value"):
        if one == other and kind == "value":
            return True
        if len(self.of.vectors[one][1]) != len(self.of.vectors[other][1]):
            return False
        n = len(self.of.vectors[one][1])
        return all(row[:n] == row[n:] for row in self.sampled([("value", one), (kind, other)], 2))

    def made_of(self, targets, vanish):
        """True if each element of the targets is a combination, with constant coefficients, of vanishing elements."""
        parts = [("value", k) for k in dict.fromkeys(vanish)]
        width = sum(len(self.of.vectors[k][1]) for k in dict.fromkeys(vanish))
        rows = self.sampled([*targets, *parts], width + 4)
        return combined(self.p, rows, len(rows[0]) - width)

    def seen_through(self, k, matrix, vanish):
        """True if matrix' w vanishes; the matrix is believed to keep full row rank."""
        rows, columns = self.of.shape(matrix)
        size = len(self.of.vectors[k][1])
        if rows != size:
            return False
        parts = list(dict.fromkeys(vanish))
        width = sum(len(self.of.vectors[z][1]) for z in parts)
        found = self.sampled([("value", k), ("value", matrix), *(("value", z) for z in parts)], width + 4)
        made = []
        for row in found:
            w, R = row[:size], row[size : size + rows * columns]
            made.append([sum(R[i + j * rows] * w[i] for i in range(size)) % self.p for j in range(columns)] + row[size + rows * columns :])
        return combined(self.p, made, columns)


def combined(p, rows, count):
    """True if each of the first `count` columns is a combination of the others."""
    basis = Echelon(p, len(rows))
    for column in list(zip(*rows))[count:]:
        basis.add(column)
    return not any(basis.add(column) for column in list(zip(*rows))[:count])


# ---------------------------------------------------------------------------------------------------------------------


def inputs_of(certificate, number, free):
    """Inputs of the program: exact values as numbers, free symbols otherwise."""
    return [
        [number(x) for x in certificate.fixed[label]] if label in certificate.fixed else [free() for _ in range(size)]
        for label, size in zip(certificate.labels, certificate.sizes)
    ]


def check_structure(of):
    """V depends on constants and on symbols whose rate the file contains; true values and gains are constant."""
    stored = [k for term in of.terms if term["role"] == "stored" for k in term["parts"].values()]
    need(stored or of.steps, "V has no term")
    for label in of.reads(stored):
        kind = of.kind_of(label)
        need(kind in CONSTANT_KINDS or label in of.rates or (kind == "time" and not of.samples), f"V depends on {label}, which has no rate")
    for steps in of.steps:
        for name in ("true", "gain", "floor", "retention", "lower", "upper"):
            if name in steps["parts"]:
                for label in of.reads([steps["parts"][name]]):
                    need(of.kind_of(label) in CONSTANT_KINDS, f"{steps['estimate']}: {name} depends on {label}")


def identity(of):
    """log2 of the error bound, after enough points; raises `Refuted` at one where an equality does not hold."""
    ring = Degrees()
    found = Equalities(of, ring, inputs_of(of, ring.number, ring.free)).all()
    each = ring.log2_error([x for _, values in found for x in values])
    need(each < -40, f"the degree is too high: one point errs with a probability of up to 2^{each:.0f}")
    points = 0
    attempts = 0
    while points * each > WANTED:
        field = Field()
        try:
            equalities = Equalities(of, field, inputs_of(of, field.number, field.random))
            for name, values in equalities.all():
                if any(x % field.p for x in values):
                    raise Refuted(f"{name} does not hold")
            if equalities.storage % field.p == 0 and not of.steps:
                raise Refuted("V is identically zero")
        except Again:
            attempts += 1
            need(attempts < 20, "a denominator vanishes everywhere")
            continue
        points += 1
    return points * each, points


def check(data):
    """Result of the check, as JSON data; raises `Refused` or `Refuted`."""
    of = Certificate(data)
    check_structure(of)
    signs = Signs(of)
    error, points = identity(of)
    believed, strict = check_signs(of, signs)
    kappa = small_gain(of, signs, strict) if of.cross else None
    shown, others = [], of.conclusions
    if not of.samples and not any(term["role"] == "residual" for term in of.terms):
        shown, others = Conclusions(of, signs, strict).check()
    names = lambda items: [f"{item['signal']} {item['says']}" for item in items]
    return {
        "status": "re-proved", "over": data["over"], "log2_error": error, "points": points,
        "kappa": None if kappa is None else str(kappa), "only_at": sorted(of.fixed),
        "conclusions": names(shown), "believed": [*believed, *names(others)], "assumed": of.assumed,
    }  # fmt: skip


def main(arguments):
    as_json = "--json" in arguments
    paths = [x for x in arguments if x != "--json"]
    if len(paths) != 1:
        sys.stderr.write("usage: python check.py FILE [--json]\n")
        return 2
    try:
        with open(paths[0], encoding="utf-8") as file:
            result, status = check(json.load(file)), 0
    except Refuted as error:
        result, status = {"status": "refuted", "reason": str(error)}, 1
    except (Refused, OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError, Again) as error:
        result, status = {"status": "refused", "reason": f"{type(error).__name__}: {error}"}, 2
    if as_json:
        print(json.dumps(result, indent=1))
    else:
        for name, value in result.items():
            print(name + ":", *(value if isinstance(value, list) else [value]), sep="\n  " if isinstance(value, list) else " ")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
