"""Names that a block's author gives to parts of a law, and operations that print as one sign.

A law is printed from the very methods that run: they are called a second time, with one symbol for each port, state,
parameter and truth. `named` and `operation` say what this second reading shows; in a run both do nothing of their own.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from keyword import iskeyword
from typing import Any, Final, final

import casadi as ca

from dmframe.errors import DmframeError
from dmframe.names import distinct, look_alikes, unicode_name

Expression = Any
"""A CasADi expression (SX, MX or DM) or a number; the library is untyped."""


@final
class NamingError(DmframeError):
    """A name that cannot stand for the expression that it is given."""


@final
@dataclass(eq=False)
class Naming:
    """What a block names while it is read.

    Parameters
    ----------
    make
        Makes a symbol of a name and a shape.
    taken
        What each name that is taken already is: ``{"sigma": "an input"}``.
    definitions
        Symbol and expression of each name, in the order in which they were given.
    again
        The same for a name that was given again, with an expression that looks different: it has to be equal.
    """

    make: Callable[[str, tuple[int, int]], Expression]
    taken: dict[str, str]
    definitions: dict[str, tuple[Expression, Expression]] = field(default_factory=dict)
    again: list[tuple[str, Expression]] = field(default_factory=list)

    def define(self, name: str, expression: Expression) -> Expression:
        """The symbol of a name. Raises `NamingError`."""
        if not name.isidentifier() or iskeyword(name):
            raise NamingError(f"expected a name such as K_star, found {name!r}")
        if name in self.taken:
            raise NamingError(f"the name {name} is taken, by {self.taken[name]} of the block; choose another")
        if strange := look_alikes(name):
            raise NamingError(
                f"the name {name!a} holds {strange!a}, no Latin and no known Greek letter; choose another"
            )
        for other in (*self.taken, *self.definitions):
            if other != name and distinct([other, name]):
                raise NamingError(f"the names {other} and {name} both print as {unicode_name(name)}; choose another")
        if name not in self.definitions:
            self.definitions[name] = (self.make(name, expression_of(expression).shape), expression)
            return self.definitions[name][0]
        symbol, known = self.definitions[name]
        if expression_of(expression).shape != symbol.shape:
            raise NamingError(f"{name} is named twice, with different shapes: {_size(symbol)} and {_size(expression)}")
        if not same(known, expression):
            self.again.append((name, expression))
        return symbol


_DEEP: Final = 1000
"""How far two expressions are compared, node by node, before they count as different."""


def same(first: Expression, second: Expression) -> bool:
    """True for two expressions that are built alike; equal ones that are built differently are not."""
    one, other = expression_of(first), expression_of(second)
    return type(one) is type(other) and bool(ca.is_equal(one, other, _DEEP))


def _size(value: Expression) -> str:
    rows, columns = expression_of(value).shape
    return f"{rows} x {columns}"


def expression_of(value: Expression) -> Expression:
    """A number as an expression; an expression as it is."""
    return value if isinstance(value, ca.SX | ca.MX | ca.DM) else ca.DM(value)


_reading: ContextVar[Naming | None] = ContextVar("naming", default=None)


@contextmanager
def reading(naming: Naming | None) -> Iterator[None]:
    """Within, `named` gives names; with None it gives none."""
    token = _reading.set(naming)
    try:
        yield
    finally:
        _reading.reset(token)


def named(name: str, expression: Expression) -> Expression:
    """The expression, which is printed by this name, beside a line that says what the name stands for.

    Parameters
    ----------
    name
        As of a port: ``"K_star"``. It must not be the name of a port, state, parameter or truth of the block, and one
        name stands for one expression.
    expression
        What it stands for.
    """
    naming = _reading.get()
    return expression if naming is None else naming.define(name, expression)


@final
@dataclass(frozen=True)
class Operation:
    """A function that prints as one sign: `sign` says how (see `dmframe.formula.read`), or is the function's name.

    `given` are the names of a robot's arguments; `said` is what it is, in words, after the names of its arguments.
    `function` is what an `operation` runs, by which a sign of its own is found: another may have the same name.
    """

    sign: str
    given: tuple[str, ...] = ()
    said: tuple[tuple[str, ...], str] | None = None
    function: Callable[..., Any] | None = None


_operations: Final[dict[str, Operation]] = {}


@functools.cache
def said_of(function: Callable[..., Any]) -> tuple[tuple[str, ...], str]:
    """The arguments of a function that it needs, and the first line of its docstring."""
    parameters = [item for item in inspect.signature(function).parameters.values() if item.default is item.empty]
    text = (inspect.getdoc(function) or "").partition("\n")[0]
    return tuple(item.name for item in parameters if item.name != "self"), text


def operation_of(function: Any) -> Operation | None:
    """What a called CasADi function is, if it is an operation."""
    return _operations.get(function.name())


def register(name: str, operation: Operation) -> None:
    """Say how calls of a CasADi function of this name print."""
    _operations[name] = operation


def call(function: Any, arguments: Collection[Expression]) -> Expression:
    """Call a CasADi function of one output; with MX it stays one node."""
    return function.call(list(arguments), False, True)[0]


RESERVED: Final = frozenset(
    "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp log log10 log1p expm1 sqrt abs fabs sgn sign min "
    "max fmin fmax atan2 floor ceil mod fmod pow erf sum vec hadamard diag diagonal norm dot cross det inv trace "
    "transpose derivative solve solve_spd clip beyond and or not if else "
    "f J R_tool J_turn Y_k W_k Y_inertia Y_momentum Y_kinetic Y_gravity Y_d M C g g_full phi I d".split()
)
"""Names under which formulas print functions of the framework, of the robot and of mathematics."""


def _check_name(function: Callable[..., Any]) -> None:
    """Raise `NamingError` for a name that is none, or that prints as something else."""
    name = function.__name__
    if not name.isidentifier() or iskeyword(name) or look_alikes(name):
        raise NamingError(f"expected a function with a name such as saturated, found {name!a}, which would be printed")
    if name in RESERVED:
        raise NamingError(f"the name {name} prints as another function; rename the operation")


def operation(function: Callable[..., Expression]) -> Callable[..., Expression]:
    """Make a function of expressions one that prints as one sign: ``norm(a)``, not the root of a sum of squares.

    All its arguments are expressions or numbers, given by position. In a run it is just called. The first line of its
    docstring stands beside the law. Raises `NamingError` for a name that prints as something else.
    """
    if (function.__module__ or "").partition(".")[0] != "dmframe":  # it has none in a text that is run
        _check_name(function)
    name = f"{function.__module__}.{function.__qualname__}".replace(".", "_").replace("<locals>", "")

    @functools.cache
    def node(*shapes: tuple[int, int]) -> Any:
        symbols = [ca.SX.sym(f"a{place}", *shape) for place, shape in enumerate(shapes)]
        # numbered, since functions of other files may have the same name
        sizes = "_".join([*(f"{rows}x{columns}" for rows, columns in shapes), str(len(_operations))])
        # CasADi's names hold letters, digits and single underscores only
        label = "_".join(part for part in f"{name}_{sizes}".split("_") if part)
        register(label, Operation(function.__name__, said=said_of(function), function=function))
        return ca.Function(label, symbols, [ca.densify(function(*symbols))])

    @functools.wraps(function)
    def wrapped(*arguments: Expression) -> Expression:
        if not any(isinstance(argument, ca.MX) for argument in arguments):
            return function(*arguments)
        given = [expression_of(argument) for argument in arguments]
        return call(node(*(argument.shape for argument in given)), [as_mx(argument) for argument in given])

    return wrapped


def derivative(expression: Expression, by: Expression) -> Expression:
    """The Jacobian of a column by symbols; it prints as a sign of its own, named parts as their names."""
    naming = _reading.get()
    meant = expression
    for symbol, meaning in reversed(naming.definitions.values()) if naming is not None else ():
        meant = ca.substitute([meant], [symbol], [as_mx(meaning) if isinstance(meant, ca.MX) else ca.SX(meaning)])[0]
    jacobian = ca.densify(ca.jacobian(meant, by))
    if not isinstance(jacobian, ca.MX):
        return jacobian
    arguments = [expression, by, jacobian]
    symbols = [ca.MX.sym(f"a{place}", *item.shape) for place, item in enumerate(arguments)]
    label = "derivative_" + "_".join(f"{rows}x{columns}" for rows, columns in (item.shape for item in arguments))
    register(label, Operation("derivative"))
    return call(ca.Function(label, symbols, [symbols[2]], {"never_inline": True}), arguments)


def as_mx(value: Expression) -> Expression:
    """An expression as MX; a constant SX too, which cannot be mixed with MX otherwise."""
    if isinstance(value, ca.SX):
        return ca.MX(ca.DM(value))
    return value if isinstance(value, ca.MX) else ca.MX(expression_of(value))
