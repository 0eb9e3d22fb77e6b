"""Random changes of single entries of certificates: ``python tests/framework/checker/corruptions.py 10000``.

Every change that the checker accepts must be harmless, which is decided without the checker's rules, in floating-point
numbers: either all that the file states has the same values at random points as before (`same`), or what it states
holds there (`holds`): terms are positive, dV/dt by differences along the file's rates is the negative dissipation and
at most the residual, conditions have their signs, true values are in their boxes, and estimates follow their steps. The
other checker must come to the same outcome for every change, and to the same result. Changed texts are counted apart.
"""

from __future__ import annotations

import math
import random
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from fractions import Fraction
from functools import cache
from itertools import starmap
from pathlib import Path
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).parents[3]))

from tests.framework.checker.certificates import certificate, common, in_node, result

NAMES: Final = (
    "pendulum",
    "arm2_joint",
    "pd_torque",
    "slotine_li",
    "computed_torque",
    "lesson_q_r_is_q_d",
    "torque_direct_pi",
    "ur10_slow_repetitive",
    "theorem_1",
    "ur10_fast",
)
KINDS: Final = ("constant", "given", "state", "correction", "time", "parameter")
FUNCTIONS: Final[dict[str, Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "sin": lambda a, b: math.sin(a),
    "cos": lambda a, b: math.cos(a),
    "tanh": lambda a, b: math.tanh(a),
    "atan": lambda a, b: math.atan(a),
    "sqrt": lambda a, b: math.sqrt(abs(a)),  # arguments are assumed to be positive
    "fabs": lambda a, b: abs(a),
    "fmin": lambda a, b: min(a, b),
    "fmax": lambda a, b: max(a, b),
    "lt": lambda a, b: float(a < b),
    "floor": lambda a, b: math.floor(a),
}

TRUE: Final = "another true statement"

Path_ = tuple[Any, ...]


def leaves(item: Any, path: Path_ = ()) -> Iterator[tuple[Path_, Any]]:
    """All entries, with their paths; a list that is empty is an entry."""
    pairs = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else None
    if pairs is None or not item:
        yield path, item
    else:
        for key, value in pairs:
            yield from leaves(value, (*path, key))


def changed(value: Any, path: Path_, data: dict[str, Any], rng: random.Random) -> Any:
    """Another value of the same kind, or of another one."""
    if rng.random() < 0.03:
        return rng.choice([None, True, "1", -1, 10**9, 0.5, [], {}, [value]])
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice([value + 1, value - 1, rng.randrange(max(2, 2 * abs(value))), -value, 0])
    if isinstance(value, str):
        key = path[-1]
        choices = {
            "kind": KINDS,
            "role": ("stored", "dissipated", "residual"),
            "rule": ("square", "tanh", "atan", "potential", "projected", "ball"),
            "says": ("is bounded", "goes to zero", "is square-integrable"),
            "over": ("flow", "sample"),
        }
        if key in choices:
            return rng.choice(choices[key])
        if "operations" in path:
            return rng.choice(list(FUNCTIONS))
        if key == "position":
            return rng.choice([item["label"] for item in data["symbols"]])
        try:
            number = Fraction(value)
        except ValueError:
            return rng.choice([value + "x", value[:-1]])
        return str(rng.choice([-number, number + 1, number * 2, number / 3, Fraction(0)]))
    return rng.choice([0, None, [0]])


def corrupted(name: str, seed: int) -> tuple[dict[str, Any], Path_, Any, Any]:
    """A certificate with one entry changed, the entry's path, and its values before and after."""
    data, rng = certificate(name), random.Random(f"{name} {seed}")
    sections: dict[str, list[tuple[Path_, Any]]] = {}
    for path, value in leaves(data):
        sections.setdefault(".".join(map(str, path[: 1 + (path[0] == "program")])), []).append((path, value))
    path, value = rng.choice(sections[rng.choice(sorted(sections))])
    new = value
    while new == value and type(new) is type(value):
        new = changed(value, path, data, rng)
    item: Any = data
    for key in path[:-1]:
        item = item[key]
    item[path[-1]] = new
    return data, path, value, new


# ---- What a file states, in floating-point numbers -------------------------------------------------------------------


class Numbers:
    """Values of a file's vectors at a point."""

    def __init__(self, data: dict[str, Any], symbols: dict[str, list[float]]) -> None:
        program, values = data["program"], list[float]()
        own = [symbols[item["label"]] for item in data["symbols"]]
        constants = [float(Fraction(x)) for x in program["constants"]]
        for code, a, b in zip(program["code"], program["a"], program["b"], strict=True):
            name = program["operations"][code]
            if name in ("const", "input"):
                values.append(constants[a] if name == "const" else own[a][b])
            else:
                values.append(FUNCTIONS[name](values[a], values[b]))
        self.vectors = [[values[k] if k >= 0 else 0.0 for k in places] for places in data["vectors"]]
        self.samples = data["over"] == "sample"

    def term(self, term: dict[str, Any]) -> float:
        """T of a term, written again."""
        part = {key: self.vectors[k] for key, k in term["parts"].items()}
        w, a = part["weight"], part["vector"]
        n = len(a)
        if term["rule"] == "square" and len(w) == n * n and n > 1:
            return sum(a[i] * w[i + n * k] * a[k] for i in range(n) for k in range(n))
        if term["rule"] == "square":
            return sum(x * y * y for x, y in zip(w, a, strict=True))
        if term["rule"] == "projected":
            rows = zip(w, a, part["correction"], part["true"], strict=True)
            return sum(-x * (y + c * self.samples - true) * c for x, y, c, true in rows)
        if term["rule"] == "potential":
            pairs = zip(w, a, part["scale"], strict=True)
            return sum(2 * x * v * v * (math.sqrt(1 + (y / v) ** 2) - 1) for x, y, v in pairs)
        phi, rows = FUNCTIONS[term["rule"]], zip(w, a, part["other"], part["scale"], strict=True)
        return sum(x * (y - z) * (phi(y / v, 0) - phi(z / v, 0)) for x, y, z, v in rows)


def point(data: dict[str, Any], rng: random.Random) -> dict[str, list[float]]:
    """Random values of all symbols, with the file's parameters, and without corrections of projections."""
    found = dict[str, list[float]]()
    for item in data["symbols"]:
        own = [rng.uniform(-1.3, 1.3) for _ in range(item["size"])]
        if item["numbers"] is not None:
            ends = [(float(Fraction(low)), float(Fraction(high))) for low, high in item["numbers"]]
            own = [low * (1 - (s := rng.random())) + high * s for low, high in ends]
        elif item["kind"] == "correction":
            own = [0.0] * item["size"]
        found[item["label"]] = own
    return found


def boxed(data: dict[str, Any], symbols: dict[str, list[float]], rng: random.Random) -> dict[str, list[float]]:
    """The point with projected states inside their boxes."""
    at, program = Numbers(data, symbols), data["program"]
    found = {label: [*own] for label, own in symbols.items()}
    for term in data["terms"]:
        if term["rule"] == "projected" and not at.samples:
            part = term["parts"]
            ends = zip(
                data["vectors"][part["vector"]], at.vectors[part["lower"]], at.vectors[part["upper"]], strict=True
            )
            for k, low, high in ends:
                label = data["symbols"][program["a"][k]]["label"]
                found[label][program["b"][k]] = rng.uniform(max(low, min(-1.3, high - 1)), min(high, max(1.3, low + 1)))
    return found


def stated(data: dict[str, Any], symbols: dict[str, list[float]]) -> list[float]:
    """Numbers of which the file's statement consists: terms, rates and all vectors that its statements name."""
    at, found = Numbers(data, symbols), list[float]()
    for term in data["terms"]:
        found += [at.term(term), float(hash(term["role"])), float(bool(term["assumed"]))]
    for label, k in sorted(data["rates"].items()):
        found += [float(hash(label)), *at.vectors[k]]
    for key in ("robots", "stable", "ranks", "conditions", "conclusions"):
        for path, value in leaves(data.get(key, [])):
            found += at.vectors[value] if type(value) is int else [float(hash(str((path, value))))]
    return found


def same(data: dict[str, Any], original: dict[str, Any]) -> bool:
    """True if a file states the same as the original at random points: kinds, numbers and all values are the same."""
    keys = ("format", "version", "over", "symbols")
    if any(data[key] != original[key] for key in keys):
        return False
    rng = random.Random(1)
    for _ in range(3):
        symbols = point(original, rng)
        symbols |= {k: [rng.uniform(-1, 1) for _ in x] for k, x in symbols.items() if k.endswith(", correction")}
        try:
            one, other = stated(data, symbols), stated(original, symbols)
        except (ArithmeticError, ValueError):
            return False  # outside of the domain of a function
        if len(one) != len(other) or not all(
            math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-9) for a, b in zip(one, other, strict=True)
        ):
            return False
    return True


def holds(data: dict[str, Any], found: dict[str, Any]) -> str:
    """What a file states, and that does not hold at random points; empty if all holds."""
    rng, points = random.Random(2), 0
    for _ in range(30):
        symbols = point(data, rng)
        try:
            symbols = boxed(data, symbols, rng)
            fault = _fault(data, found, symbols, Numbers(data, symbols))
        except (ArithmeticError, ValueError):
            continue  # a point outside of the domain of a function
        if fault:
            return fault
        points += 1
        if points == 4:
            return ""
    return "no point where all functions have values"


def _fault(data: dict[str, Any], found: dict[str, Any], symbols: dict[str, list[float]], at: Numbers) -> str:
    for term in data["terms"]:
        if term["role"] in ("stored", "dissipated") and at.term(term) < -1e-9:
            return f"{term['name']} is negative"
    for item in data["conditions"]:
        decided = item["margin"] is not None and f"condition: {item['name']}" not in found["assumed"]
        if decided and min(at.vectors[item["margin"]]) < 0:
            return f"condition {item['name']}"
    for item in data["terms"]:
        if item["rule"] == "projected":
            low, true, high = (at.vectors[item["parts"][key]] for key in ("lower", "true", "upper"))
            known = f"{item['name']}: its true value is inside its box" not in found["assumed"]
            for a, x, b in zip(low, true, high, strict=True):
                if a > b or (known and not a - 1e-12 <= x <= b + 1e-12):
                    return f"the box of {item['name']}"
    return _decrease(data, symbols, at) if data["over"] == "flow" else _change(data, symbols, at)


def _moved(data: dict[str, Any], symbols: dict[str, list[float]], at: Numbers, h: float) -> dict[str, list[float]]:
    found = dict(symbols)
    for label, k in data["rates"].items():
        found[label] = [x + h * rate for x, rate in zip(symbols[label], at.vectors[k], strict=True)]
    found |= {x["label"]: [symbols[x["label"]][0] + h] for x in data["symbols"] if x["kind"] == "time"}
    return found


def _decrease(data: dict[str, Any], symbols: dict[str, list[float]], at: Numbers) -> str:
    """V is positive, and dV/dt, by differences, is at most the residual; without corrections of projections."""

    def V(h: float) -> float:
        moved = Numbers(data, _moved(data, symbols, at, h))
        return sum(moved.term(x) for x in data["terms"] if x["role"] == "stored") / 2

    rate, h = math.inf, 1e-2
    size = sum(abs(at.term(x)) for x in data["terms"])
    for _ in range(5):  # the differences of a smooth V converge
        h, before = h / 8, rate
        rate = (8 * (V(h) - V(-h)) - (V(2 * h) - V(-2 * h))) / (12 * h)
        if abs(rate - before) < 1e-5 * (size + abs(rate)):
            break
    lost = sum(at.term(x) for x in data["terms"] if x["role"] == "dissipated")
    gained = sum(at.term(x) for x in data["terms"] if x["role"] == "residual")
    if abs(rate + lost - gained) > 1e-3 * (size + abs(rate)) + 1e-6:
        return f"dV/dt: {rate} is not {gained - lost}"
    return "V increases" if rate > gained + 1e-3 * (size + abs(rate)) + 1e-6 else ""


def _change(data: dict[str, Any], symbols: dict[str, list[float]], at: Numbers) -> str:
    """V(next) - V is minus what is dissipated, plus the residual, and projections are those onto their boxes."""
    after = Numbers(data, symbols | {label: at.vectors[k] for label, k in data["rates"].items()})
    total, size = 0.0, 0.0
    for item in data["terms"]:
        value = at.term(item)
        stored = item["role"] == "stored"
        total += (after.term(item) - value) / 2 if stored else value if item["role"] == "dissipated" else -value
        size += abs(value)
        if item["rule"] == "projected":
            part = {key: at.vectors[k] for key, k in item["parts"].items()}
            rows = zip(part["vector"], part["correction"], part["lower"], part["upper"], strict=True)
            if not all(math.isclose(z + c, min(max(z, a), b), rel_tol=1e-6, abs_tol=1e-9) for z, c, a, b in rows):
                return f"the projection of {item['name']}"
    return "" if abs(total) <= 1e-6 * size + 1e-9 else f"V(next) - V differs by {total}"


@cache
def accepted(name: str) -> dict[str, Any]:
    """Result of the original file."""
    return result(certificate(name))


def judged(tasks: Sequence[tuple[str, int]]) -> list[tuple[str, str]]:
    """Outcomes of changed files, by name and seed, and what was changed."""
    found = list(starmap(_judged, tasks))
    outcomes = list[tuple[str, str]]()
    others = in_node([data for _, _, data, _ in found])
    for (outcome, where, _, own), other in zip(found, others, strict=True):
        agreed = (own["status"], common(own)) == (other["status"], common(other))
        outcomes.append((outcome, where) if agreed else ("FALSE", f"{where}: {own}; the other checker: {other}"))
    return outcomes


def _judged(name: str, seed: int) -> tuple[str, str, dict[str, Any], dict[str, Any]]:
    """Outcome of a changed file without the other checker, what was changed, the file and its result."""
    data, path, before, after = corrupted(name, seed)
    where, original = f"{name}, seed {seed}: {path}: {before!r} -> {after!r}", certificate(name)
    found = result(data)
    if found["status"] != "re-proved":
        return found["status"], where, data, found
    if path[0] in ("about", "assumed") or path[-1] in ("name", "signal", "assumed", "says"):
        shown = {**found, "log2_error": 0, "points": 0} != {**accepted(name), "log2_error": 0, "points": 0}
        if path[-1] != "says":
            hidden = not shown and (path[0] == "assumed" or (path[-1] == "assumed" and before is not None))
            return ("FALSE" if hidden else "a text, which the result shows" if shown else "a text"), where, data, found
    try:
        if same(data, original):
            return "an equal function", where, data, found
        fault = holds(data, found)
    except (LookupError, TypeError) as error:
        fault = f"not judged: {type(error).__name__}: {error}"
    if fault:
        return "FALSE", f"{where}: {fault}", data, found
    return TRUE, where, data, found


def main(count: int, processes: int = 2, names: Sequence[str] = NAMES) -> int:
    """Judge this many changes; print the counts, and what is false."""
    large = count // 25  # of each of the last two, which take five times as long
    tasks = [(name, seed) for name in names[-2:] for seed in range(large)]
    tasks += [(names[k % (len(names) - 2)], k // (len(names) - 2)) for k in range(count - len(tasks))]
    random.Random(0).shuffle(tasks)
    counts = Counter[str]()
    chunks = [tasks[k : k + 25] for k in range(0, count, 25)]
    with ProcessPoolExecutor(processes) as pool:
        for k, found in enumerate(pool.map(judged, chunks)):
            counts.update(outcome for outcome, _ in found)
            sys.stdout.writelines(f"FALSE: {where}\n" for outcome, where in found if outcome == "FALSE")
            if k % 20 == 19:
                sys.stdout.write(f"{counts.total()}: {dict(counts.most_common())}\n")
                sys.stdout.flush()
    sys.stdout.writelines(f"{number:6d}  {outcome}\n" for outcome, number in counts.most_common())
    return int(counts["FALSE"] > 0)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:] or [1000])))
