"""Random flows with a true V, and their simulation: an independent test of what a checker concludes from V.

V = (x_0^2 + x_1^2) / 2 falls along dx_0/dt = s x_1 - x_0, dx_1/dt = -s x_0 - x_1 for any s, which may grow; with
`damped` false, dx_1/dt = -s x_0. Further states y_k have random rates, most of them with a loss, and random signals are
functions of all states, of a given signal r and of the time t.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from types import CodeType
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from tests.framework.checker.written import File, concluded

SIGNALS: Final = 16
END: Final = 40.0
SAMPLES: Final = 200
SIGNS: Final = {"add": "+", "sub": "-", "mul": "*"}
WORDS: Final = ("is bounded", "goes to zero", "is square-integrable")

Expression = tuple[int, str]
"""Place of an expression in the file, and the same expression in Python."""


@dataclass(frozen=True)
class Flow:
    """A file, and the right side and the signals in Python, for a state X and a time t."""

    data: dict[str, Any]
    rates: CodeType
    signals: CodeType
    states: int

    def simulated(self, rng: np.random.Generator) -> Any:
        """Signals over time (samples, signals), for a random start and signal r; None if the solution ends."""
        frequency, offset = rng.uniform(0.2, 2), rng.uniform(0.1, 0.9)
        names = {"tanh": math.tanh, "sin": math.sin, "r": lambda t: offset + 0.7 * math.sin(frequency * t)}

        def right_side(t: float, X: Any) -> Any:
            ends = np.max(np.abs(X)) > 1e4
            return [math.nan] * self.states if ends else eval(self.rates, names, {"t": t, "X": X.tolist()})

        times, start = np.linspace(0, END, SAMPLES), rng.uniform(-1, 1, self.states)
        with np.errstate(all="ignore"):
            found = solve_ivp(right_side, (0, END), start, method="LSODA", t_eval=times, rtol=1e-5, atol=1e-7)
        if found.status != 0 or found.y.shape[1] < SAMPLES or not np.all(np.isfinite(found.y)):
            return None
        rows = zip(times.tolist(), found.y.T.tolist(), strict=True)
        return np.array([eval(self.signals, names, {"t": t, "X": X}) for t, X in rows])


class _Writer:
    def __init__(self, rng: random.Random) -> None:
        self.file, self.rng = File(), rng

    def expression(self, leaves: list[Expression], depth: int) -> Expression:
        rng, make = self.rng, self.file.instruction
        if depth == 0 or rng.random() < 0.25:
            return rng.choice(leaves)
        name = rng.choice(["add", "add", "sub", "mul", "tanh", "sin", "scaled"])
        place, text = self.expression(leaves, depth - 1)
        if name == "scaled":
            factor = rng.choice(["-1", "1/2", "2", "-1/3"])
            return make("mul", self.file.number(factor), place), f"({factor}) * ({text})"
        if name in ("tanh", "sin"):
            return make(name, place), f"{name}({text})"
        other, second = self.expression(leaves, depth - 1)
        return make(name, place, other), f"(({text}) {SIGNS[name]} ({second}))"


def random_flow(seed: int) -> Flow:
    """A file whose statement about V is true, with conclusions of all kinds about random signals, `s0`, `s1`, ..."""
    rng = random.Random(seed)
    writer = _Writer(rng)
    file, make, n = writer.file, writer.file.instruction, rng.randrange(2, 5)
    x = [file.symbol(f"x{k}", "state") for k in (0, 1)]
    y = [file.symbol(f"y{k}", "state") for k in range(n)]
    time, one, zero = (file.symbol("t", "time"), "t"), file.number("1"), file.number("0")
    leaves = [(place, f"X[{k}]") for k, place in enumerate(x + y)] + [(file.symbol("r", "given"), "r(t)")]
    file.data["rates"]["r"] = file.vector(file.symbol("dr", "given"))

    s, text = writer.expression([*leaves, time], 2)
    damped = rng.random() < 0.5
    moved = [make("sub", make("mul", s, x[1]), x[0]), make("sub", zero, make("mul", s, x[0]))]
    rates = [f"({text}) * X[1] - X[0]", f"-({text}) * X[0]" + " - X[1]" * damped]
    moved[1] = make("sub", moved[1], x[1]) if damped else moved[1]
    file.term("stored", file.vector(*x), file.vector(one, one))
    file.term("dissipated", file.vector(*x[: 1 + damped]), file.vector(*[one] * (1 + damped)))

    for k, place in enumerate(y):
        own, others = f"X[{k + 2}]", leaves[: 2 + k] + leaves[-1:]
        others = (leaves if rng.random() < 0.3 else others) + [time] * (rng.random() < 0.2)
        (force, text), loss = writer.expression(others, rng.randrange(3)), rng.choice(["1", "1/2", "2"])
        kind = rng.random()
        if kind < 0.65:
            force, text = make("sub", force, make("mul", file.number(loss), place)), f"{text} - ({loss}) * {own}"
        elif kind > 0.8:
            force, text = rng.choice([(one, "1.0"), (zero, "0.0")])
        moved.append(force)
        rates.append(text)
        if rng.random() < 0.8:
            item = {"vector": place, "weight": one, "loss": file.number(rng.choice(["1", "1/2", "2", "-1"]))}
            file.data["stable"].append({key: file.vector(own) for key, own in item.items()})
    for k, place in enumerate(moved):
        file.data["rates"][f"x{k}" if k < 2 else f"y{k - 2}"] = file.vector(place)

    signals = [*leaves[: n + 2], time, *zip(moved[2:], rates[2:], strict=True)]
    signals += [writer.expression([*leaves, time], rng.randrange(1, 4)) for _ in range(SIGNALS)]
    for k, (place, _) in enumerate(signals):
        vector = file.vector(place)
        for says in WORDS:
            concluded(file.data, vector, says, f"s{k}")
    codes = [compile(f"[{', '.join(texts)}]", "", "eval") for texts in (rates, [text for _, text in signals])]
    return Flow(file.data, codes[0], codes[1], n + 2)


def behaviour(values: Any) -> str:
    """What a signal over time, values (samples,), does: ``grows``, ``stays`` or ``vanishes`` (it may do so slowly)."""
    size, half = np.abs(values), SAMPLES // 2
    early, middle, late = size[:half].max(), size[SAMPLES // 3 : half].max(), size[-SAMPLES // 10 :].max()
    if late > 1.6 * early + 1e-6:
        return "grows"
    return "stays" if late > max(0.05 * size.max(), 0.85 * middle, 1e-4) else "vanishes"
