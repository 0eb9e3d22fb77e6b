"""Functions of `arithmetic.h` in WebAssembly: the same operations, bit-identical to C without fused multiply-add."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dmframe.codegen.wasm_binary import F64, RETURN, Function, Number, called, number

_SHIFT: Final = 1.5 * 2.0**52
"""Adding it rounds a number to an integer, which is then in the last bits."""

_hex = float.fromhex


def _sincos() -> Function:
    f, x = Function([F64], [F64, F64]), Number((0,))
    with f.when((abs(x) < 1e5).empty()):
        f.write(called("env.sin", x), called("env.cos", x), RETURN)
    turns = f.keep(x * 0.63661977236758134308 + _SHIFT)
    n = f.keep(turns - _SHIFT)
    near = (x - n * _hex("0x1.921fb54400000p+0")) - n * _hex("0x1.0b4611a600000p-34")
    r = f.keep(near - n * _hex("0x1.3198a2e037073p-69"))
    y = f.keep(r * r)
    y2 = f.keep(y * y)
    y4 = f.keep(y2 * y2)
    s = f.keep(
        r
        + r
        * y
        * (
            (-1.0 / 6 + y * (1.0 / 120))
            + y2 * (-1.0 / 5040 + y * (1.0 / 362880))
            + y4 * ((-1.0 / 39916800 + y * (1.0 / 6227020800.0)) - y2 * (1.0 / 1307674368000.0))
        )
    )
    c = f.keep(
        (1 - 0.5 * y)
        + y2
        * (
            (1.0 / 24 - y * (1.0 / 720))
            + y2 * (1.0 / 40320 - y * (1.0 / 3628800))
            + y4 * ((1.0 / 479001600 - y * (1.0 / 87178291200.0)) + y2 * (1.0 / 20922789888000.0))
        )
    )
    quarter = turns.low_bits()
    a, b = f.keep((quarter & 1).choose(c, s)), f.keep((quarter & 1).choose(s, c))
    f.write((quarter & 2).choose(-a, a), ((quarter + 1) & 2).choose(-b, b))
    return f


def _tanh() -> Function:
    f, x = Function([F64], [F64]), Number((0,))
    a = abs(x)
    y = f.keep((a > 20.0).choose(number(40), 2 * a))
    steps = f.keep(y * 1.44269504088896340736 + _SHIFT)
    n = f.keep(steps - _SHIFT)
    r = f.keep((y - n * _hex("0x1.62e42fefa3800p-1")) - n * _hex("0x1.ef35793c76730p-45"))
    scale = f.keep(steps.power_of_two())
    r2 = f.keep(r * r)
    r4 = f.keep(r2 * r2)
    r8 = f.keep(r4 * r4)
    q = r + r2 * (
        ((0.5 + r * (1.0 / 6)) + r2 * (1.0 / 24 + r * (1.0 / 120)))
        + r4 * ((1.0 / 720 + r * (1.0 / 5040)) + r2 * (1.0 / 40320 + r * (1.0 / 362880)))
        + r8 * ((1.0 / 3628800 + r * (1.0 / 39916800)) + r2 * (1.0 / 479001600 + r * (1.0 / 6227020800.0)))
    )
    e = f.keep(scale * q + (scale - 1.0))
    f.write((e / (e + 2.0)).copysign(x))
    return f


def _of_two(value: Callable[[Number, Number], Number]) -> Function:
    f = Function([F64, F64], [F64])
    f.write(value(Number((0,)), Number((1,))))
    return f


def _sign() -> Function:
    f, x = Function([F64], [F64]), Number((0,))
    f.write((x > 0.0).choose(number(1), (x < 0.0).choose(number(-1), x)))
    return f


ARITHMETIC: Final[Mapping[str, Function]] = {
    "sincos": _sincos(),
    "tanh": _tanh(),
    "sign": _sign(),
    "fmin": _of_two(lambda x, y: ((x < y) | y.differs(y)).choose(x, y)),
    "fmax": _of_two(lambda x, y: ((x > y) | y.differs(y)).choose(x, y)),
}
"""Functions by name; ``sincos`` returns two numbers."""
