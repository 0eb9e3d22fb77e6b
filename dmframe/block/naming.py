"""Names of sub-expressions of a law, and operations that are printed as one symbol.

A law is printed from the methods that run: they are evaluated once more, with one symbol for each port, state,
parameter and true parameter. `named` and `operation` define the result of that evaluation, and have no effect in a run.
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

from dmframe.common.errors import DmframeError
from dmframe.common.names import distinct, look_alikes, unicode_name

Expression = Any
"""A CasADi expression (SX, MX or DM) or a number; the library is untyped."""


@final
class NamingError(DmframeError):
    """A name that an expression cannot have."""


@final
@dataclass(eq=False)
class Naming:
    """Names that a block defines while it is printed.

    Parameters
    ----------
    make
        Creates a symbol from a name and a shape.
    taken
        Names in use, and their kinds: ``{"sigma": "an input"}``.
    definitions
        Symbol and expression of each name, in the order of their definition.
    again
        Repeated definitions with an expression of another form, which must be equal.
    """

    make: Callable[[str, tuple[int, int]], Expression]
    taken: dict[str, str]
    definitions: dict[str, tuple[Expression, Expression]] = field(default_factory=dict)
    again: list[tuple[str, Expression]] = field(default_factory=list)

    def define(self, name: str, expression: Expression) -> Expression:
        """Define a name, and return its symbol. Raises `NamingError`."""
        if not name.isidentifier() or iskeyword(name):
            raise NamingError(f"expected a name such as K_star, found {name!r}")
        if name in self.taken:
            raise NamingError(f"the name {name} is taken, by {self.taken[name]} of the block; choose another")
        if strange := look_alikes(name):
            raise NamingError(
                f"the name {name!a} has {strange!a}, which is neither a Latin nor a known Greek letter; choose another"
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
"""Depth up to which two expressions are compared node by node."""


def same(first: Expression, second: Expression) -> bool:
    """True for two expressions of the same structure."""
    one, other = expression_of(first), expression_of(second)
    return type(one) is type(other) and bool(ca.is_equal(one, other, _DEEP))


def _size(value: Expression) -> str:
    rows, columns = expression_of(value).shape
    return f"{rows} x {columns}"


def expression_of(value: Expression) -> Expression:
    """Convert a number to an expression."""
    return value if isinstance(value, ca.SX | ca.MX | ca.DM) else ca.DM(value)


_reading: ContextVar[Naming | None] = ContextVar("naming", default=None)


@contextmanager
def reading(naming: Naming | None) -> Iterator[None]:
    """Context in which `named` defines names in `naming`; none with None."""
    token = _reading.set(naming)
    try:
        yield
    finally:
        _reading.reset(token)


def named(name: str, expression: Expression) -> Expression:
    """Give an expression a name, by which it is printed, with its definition in a separate line.

    Parameters
    ----------
    name
        Name as of a port: ``"K_star"``. It must differ from the block's ports, states, parameters and true parameters,
        and be unique for an expression.
    expression
        Expression to name.
    """
    naming = _reading.get()
    return expression if naming is None else naming.define(name, expression)


@final
@dataclass(frozen=True)
class Operation:
    """A function printed as one symbol: `sign` is its notation (see `dmframe.formula.read`), or the function's name.

    `given` are the names of a robot's arguments; `description` contains the argument names and the description.
    `function` is the function of an `operation`, which identifies it, since another may have the same name.
    """

    sign: str
    given: tuple[str, ...] = ()
    description: tuple[tuple[str, ...], str] | None = None
    function: Callable[..., Any] | None = None


_operations: Final[dict[str, Operation]] = {}


@functools.cache
def description_of(function: Callable[..., Any]) -> tuple[tuple[str, ...], str]:
    """Required arguments of a function, and the first line of its docstring."""
    parameters = [item for item in inspect.signature(function).parameters.values() if item.default is item.empty]
    text = (inspect.getdoc(function) or "").partition("\n")[0]
    return tuple(item.name for item in parameters if item.name != "self"), text


def operation_of(function: Any) -> Operation | None:
    """Operation of a CasADi function; None if it is not an operation."""
    return _operations.get(function.name())


def register(name: str, operation: Operation) -> None:
    """Register the operation of CasADi functions of this name."""
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
"""Names of functions of mathematics, of the framework and of the robot in printed formulas."""


def _check_name(function: Callable[..., Any]) -> None:
    """Raise `NamingError` for an invalid name, or one that prints as another function."""
    name = function.__name__
    if not name.isidentifier() or iskeyword(name) or look_alikes(name):
        raise NamingError(f"expected a function with a name such as saturated, found {name!a} for the printed law")
    if name in RESERVED:
        raise NamingError(f"the name {name} prints as another function; rename the operation")


def operation(function: Callable[..., Expression]) -> Callable[..., Expression]:
    """Decorate a function of expressions so that it is printed as one symbol: ``norm(a)`` instead of its formula.

    All its arguments are expressions or numbers, given by position. In a run it is called directly. The first line of
    its docstring is printed next to the law. Raises `NamingError` for a name that prints as another function.
    """
    if (function.__module__ or "").partition(".")[0] != "dmframe":  # None in an executed text
        _check_name(function)
    name = f"{function.__module__}.{function.__qualname__}".replace(".", "_").replace("<locals>", "")

    @functools.cache
    def node(*patterns: tuple[int, ...]) -> Any:
        given = [ca.Sparsity.compressed(pattern) for pattern in patterns]  # an identity matrix keeps its zeros
        symbols = [ca.SX.sym(f"a{place}", pattern) for place, pattern in enumerate(given)]
        # numbered, since functions of other files may have the same name
        sizes = "_".join([*(f"{rows}x{columns}" for rows, columns in (x.shape for x in given)), str(len(_operations))])
        # CasADi's names have only letters, digits and single underscores
        label = "_".join(part for part in f"{name}_{sizes}".split("_") if part)
        register(label, Operation(function.__name__, description=description_of(function), function=function))
        return ca.Function(label, symbols, [ca.densify(function(*symbols))])

    @functools.wraps(function)
    def wrapped(*arguments: Expression) -> Expression:
        if not any(isinstance(argument, ca.MX) for argument in arguments):
            return function(*arguments)
        given = [expression_of(argument) for argument in arguments]
        return call(node(*(tuple(item.sparsity().compress()) for item in given)), [as_mx(item) for item in given])

    return wrapped


def derivative(expression: Expression, by: Expression) -> Expression:
    """Jacobian of a column with respect to symbols, printed as one symbol; named sub-expressions print as names."""
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
    """Convert an expression to MX, also a constant SX, which cannot be mixed with MX."""
    if isinstance(value, ca.SX):
        return ca.MX(ca.DM(value))
    return value if isinstance(value, ca.MX) else ca.MX(expression_of(value))
