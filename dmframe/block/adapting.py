"""Base class of adaptive blocks: a block states the gradient law; the options of `dmframe.block.adaptation` extend it.

A block declares its estimates and the error that drives them, and states the direction in which the error moves each
estimate. The framework derives the states, the parameters of the options, the rates, the initial values and the terms
of the certificate.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, Final, final

import casadi as ca
from pydantic.fields import FieldInfo

from dmframe.block.adaptation import Estimate, Fit, Terms, adaptation
from dmframe.block.base import AbstractBlock, Equations, Signals, owner_of, with_estimates
from dmframe.block.certificate import SX, Certificate, TrueValue
from dmframe.block.linalg import metric, times
from dmframe.block.names import type_name
from dmframe.block.naming import named, reading
from dmframe.block.numberless import without_numbers
from dmframe.block.parameter import Around, Ball, Box, Diagonal, Interval, Positive, Scalar
from dmframe.block.port import ANY, Adapted, State
from dmframe.common.errors import BlockError, MissingError, ValueFault, nearest, raise_all
from dmframe.common.names import latex_name
from dmframe.common.units import rate_over

FITTED: Final = ("R", "forgetting")
"""The parameters of a fit. A block with a fit declares them itself, since R has the size of its prediction error."""


class AdaptingBlock(AbstractBlock):
    """The base class of every adaptive block.

    `equations` and `certificate` state the gradient law without the terms of the estimates. The rate of an estimate is
    its gain times its `direction`. Its square is added to the certificate, which gives the true values by
    ``estimates={...}``. `driven_by` names the input or output that drives the estimates, and with it the size and unit
    of the error; a block without it accepts no leak and no dead zone.
    """

    driven_by: ClassVar[str] = ""
    ignores_at_source: ClassVar[bool] = False
    """True if the block outputs the error after the dead zone (`driven`), so that every block that reads it stops
    adapting inside the dead zone. The block's certificate then states the dissipation itself, without a residual.
    """

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Create the states of the estimates and the parameters of the options."""
        from dmframe.block.contract import malformed  # avoids a circular import

        raise_all([BlockError(f"{cls.__name__}: {text}") for text in malformed(cls)])
        for name in _options(cls).keys() & inspect.get_annotations(cls):
            raise BlockError(f"{cls.__name__}: declares the parameter {name}, which the framework adds; remove it")
        before = () if "states" in vars(cls) else [state for base in cls.__mro__[1:] for state in _made(base)]
        cls.states = (*(state for state in cls.states if state not in before), *_made(cls))
        fields = cls.model_fields
        given = {name: fields.pop(name) for name in FITTED if name in fields}
        fields |= {name: FieldInfo.from_annotated_attribute(*made) for name, made in _options(cls).items()} | given
        cls.model_rebuild(force=True, raise_errors=False)
        super().__pydantic_init_subclass__(**kwargs)

    def error(self, u: Signals, x: Signals, p: Signals) -> SX | None:
        """The error that drives the adaptation, before any dead zone; None for the signal that `driven_by` names."""
        del u, x, p
        return None

    def direction(self, u: Signals, x: Signals, p: Signals, error: SX, /) -> Mapping[str, SX]:
        """Direction in which the error moves each estimate; with a dead zone it has to be linear in the error.

        The rate of an estimate is its gain times this direction, minus the leaks.
        """
        del u, x, p, error
        return {}

    def nominal(self, u: Signals, p: Signals) -> Mapping[str, SX]:
        """Initial values of estimates that no parameter sets; the other estimates start at zero."""
        del p
        return {item.name: getattr(u, item.nominal) for item in self.estimates if item.nominal}

    def fits(self, u: Signals, x: Signals, p: Signals) -> Mapping[str, Fit]:
        """Prediction errors that drive estimates in addition to the error; called if the parameter R is given."""
        del u, x, p
        return {}

    def driven(self, error: SX, p: Signals) -> SX:
        """The error after the dead zone."""
        return adaptation(p).drive(error)

    @final
    def composed_equations(self, u: Signals, x: Signals, p: Signals) -> Equations:
        """The block's equations with the rates of the estimates."""
        return without_numbers(self, owner_of(u))._with_rates(u, x, p)

    def _with_rates(self, u: Signals, x: Signals, p: Signals) -> Equations:
        stated = self.equations(u, x, p)
        if not isinstance(stated, Equations):
            return stated
        law, error = adaptation(p), self._error(u, x, p, stated)
        directions = self.direction(u, x, p, law.drive(error))
        _hold("direction() moves", directions, self.estimates, owner_of(u))
        for name in directions.keys() & stated.rates.keys():
            raise BlockError(
                f"{owner_of(u)}: equations() state the rate of {name}, which direction() determines; remove it"
            )
        fits, nominal, rates = self._fits(u, x, p), self._nominal(u, p), dict(stated.rates)
        for item in self.estimates:
            if item.name in directions:
                gain, direction, fit = getattr(p, item.gain), directions[item.name], fits.get(item.name)
                moved = fit.gained(gain, direction - fit.gradient) if fit else times(gain, direction)
                rates[item.name] = law.rate(moved, getattr(x, item.name), _start(item.name, nominal, p), error)
                rates |= fit.rates(item.memory) if fit else {}
        return replace(stated, rates=rates)

    @final
    def composed_start(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        """The block's initial values with those of the estimates."""
        return without_numbers(self, owner_of(u))._with_nominal(u, p, truth)

    def _with_nominal(self, u: Signals, p: Signals, truth: Signals) -> Mapping[str, SX]:
        starts = self.start(u, p, truth)
        for item in self.estimates:
            if item.name in starts:
                raise BlockError(
                    f"{owner_of(u)}: start() sets the initial value of {item.name}, which a leak does not use; "
                    "set it in nominal()"
                )
        return {**starts, **self._nominal(u, p)}

    @final
    def composed_certificate(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        """The block's certificate with the squares of the estimates and the dissipation and residual of the options."""
        return without_numbers(self, owner_of(u))._with_terms(u, x, p, truth)

    def _with_terms(self, u: Signals, x: Signals, p: Signals, truth: Signals) -> Certificate | None:
        plain = self.certificate(u, x, p, truth)
        if not isinstance(plain, Certificate):
            return plain
        present = [item for item in self.estimates if item.name in x]
        _hold("certificate() gives the true value of", plain.estimates, present, owner_of(u))
        law, fits, nominal, added = adaptation(p), self._fits(u, x, p), self._nominal(u, p), Terms()
        weighed, estimates = dict[str, TrueValue](), list[Estimate]()
        for name, true in ((item.name, plain.estimates[item.name]) for item in present):
            weighed[name] = self._weighed(name, true, p)
            estimates.append(Estimate(getattr(x, name), true.value, _start(name, nominal, p), weighed[name].weight))
            added += fits[name].terms(estimates[-1], true.weight) if name in fits else Terms()
        if not law.plain:
            error = self._error(u, x, p, self.equations(u, x, p))
            added += law.terms(estimates, error)
            if law.width is not None and not self.ignores_at_source:
                added += law.idle(error, self._effect(u, x, p, error, plain.estimates))
        whole = with_estimates(replace(plain, estimates=weighed), x)
        return replace(whole, **{role: getattr(whole, role) + terms for role, terms in vars(added).items()})

    def _error(self, u: Signals, x: Signals, p: Signals, stated: Equations) -> SX:
        """The error that drives the adaptation; zero for a block without `driven_by`."""
        starts = self.error(u, x, p)
        if starts is not None:
            return starts
        if self.driven_by in stated.outputs:
            return named(self.driven_by, stated.outputs[self.driven_by])
        return getattr(u, self.driven_by) if self.driven_by else ca.DM(0)

    def _nominal(self, u: Signals, p: Signals) -> Mapping[str, SX]:
        """The values of `nominal`, checked against the block's estimates."""
        return _known("nominal()", self.nominal(u, p), self.estimates, owner_of(u))

    def _fits(self, u: Signals, x: Signals, p: Signals) -> dict[str, Fit]:
        """The fits chosen by the parameters."""
        if type(self).fits is AdaptingBlock.fits or not any(name in p for name in FITTED):
            return {}
        if "R" not in p:
            raise MissingError(f"{type_name(type(self))}: forgetting requires R, the weight of the prediction error")
        fits = dict(_known("fits()", self.fits(u, x, p), self.estimates, owner_of(u)))
        for item in self.estimates if "forgetting" in p else ():
            for name in ("leak", "error_leak", f"{item.name}_box", f"{item.name}_ball"):
                if name in p:
                    raise ValueFault(
                        f"{type_name(type(self))}: {name} cannot be combined with forgetting: it projects in the "
                        f"metric of {item.gain}, and with forgetting V has the metric of P"
                    )
            if item.name in fits and not item.memory:
                raise MissingError(
                    f"{type_name(type(self))}: forgetting requires an information matrix of {item.name}; declare it, "
                    f"Adapted({item.name!r}, ..., memory={'G_' + item.name!r})"
                )
            if item.name in fits:
                fits[item.name] = replace(fits[item.name], forgetting=p.forgetting, state=getattr(x, item.memory))
        return fits

    def _weighed(self, name: str, true: TrueValue, p: Signals) -> TrueValue:
        """The true value with its complete weight in V, which contains the inverse of the gain."""
        gain, weight = next(getattr(p, item.gain) for item in self.estimates if item.name == name), true.weight
        if isinstance(weight, int) and weight == 1:
            return replace(true, weight=metric(gain))
        return replace(true, weight=weight / gain if gain.is_column() else weight * metric(gain))

    def _effect(self, u: Signals, x: Signals, p: Signals, error: SX, stated: Mapping[str, TrueValue]) -> SX:
        """Effect of the estimation errors on the loop, b of s'b: the transposed direction applied to them."""
        s = type(error).sym("s", *error.shape)
        with reading(None):  # a name would replace an expression in s
            directions = self.direction(u, x, p, s)
        effect = sum(
            ca.jtimes(-direction, s, stated[name].weight * (getattr(x, name) - stated[name].value), True)
            for name, direction in directions.items()
        )
        if ca.depends_on(effect, s):
            raise BlockError(
                f"{owner_of(u)}: direction() is not linear in {self.driven_by}, so that the residual of a dead zone is "
                "unknown; make it linear, or remove dead_zone"
            )
        return effect


def _made(block: type) -> list[State]:
    """The states of a class's own estimates, or of those that it inherits."""
    return [state for item in getattr(block, "estimates", ()) for state in item.states]


def _options(block: type[AdaptingBlock]) -> dict[str, tuple[Any, Any]]:
    """The parameters that the options add to an adaptive block: annotations and fields by name."""
    found = dict[str, tuple[Any, Any]]()
    for item in block.estimates:
        found |= {f"{item.name}_box": (Box, Interval(item.shape, item.unit))} if item.box else {}
        found |= {f"{item.name}_ball": (Ball, Around(item.shape, item.unit))} if item.ball else {}
    error = next((port for port in (*block.inputs, *block.outputs) if port.name == block.driven_by), None)
    if error is None:
        return found
    unit = "" if error.unit == ANY else error.unit
    return found | {
        "leak": (Scalar | None, Positive("", "1/s", default=None)),
        "error_leak": (Scalar | None, Positive("", "" if error.unit == ANY else rate_over(unit), default=None)),
        "dead_zone": (Diagonal | None, Positive(error.shape, unit, default=None)),
    }


def option_descriptions(block: type[AbstractBlock]) -> dict[str, str]:
    """Description of each of these parameters, as marked text."""
    if not issubclass(block, AdaptingBlock):
        return {}
    sets = {
        "box": "Interval onto which the estimate is projected.",
        "ball": "Instead of the box, the ball onto which it is projected; with a list for the radius, an ellipsoid.",
    }
    error = f"${latex_name(block.driven_by)}$"
    robust = (
        "Robust adaptation laws, each off by default: decay towards the initial value; the same, proportional to "
        f"{error}; no adaptation while {error} is below this width. See `dmframe.block.adaptation`."
    )
    return {name: sets.get(name.rpartition("_")[2], robust) for name in _options(block)}


def _known(method: str, starts: Mapping[str, Any], estimates: Iterable[Adapted], owner: str) -> Mapping[str, Any]:
    """The mapping that a method returned, checked against the estimates that the block declares."""
    if not isinstance(starts, Mapping):
        raise BlockError(f"{owner}: expected {method} to return values by estimate, found {type(starts).__name__}")
    known = [item.name for item in estimates]
    for name in starts:
        if name not in known:
            raise BlockError(
                f"{owner}: {method} returns {name}, which is not one of its estimates; {nearest(name, known)}"
            )
    return starts


def _hold(what: str, starts: Mapping[str, Any], estimates: Iterable[Adapted], owner: str) -> None:
    """Check that a method returns a value for each estimate that the block declares, and for no other name."""
    known, names = {item.name: item for item in estimates}, list(starts) if isinstance(starts, Mapping) else None
    if names is None:
        raise BlockError(f"{owner}: {what} {type(starts).__name__}; expected values by estimate")
    for name in names:
        if name not in known:
            raise BlockError(f"{owner}: {what} {name}, which is not one of its estimates; {nearest(name, known)}")
    for name, item in known.items():
        if name not in names and not item.optional:
            raise BlockError(f"{owner}: {what} {', '.join(names) or 'nothing'}, and omits the estimate {name}")


def _start(name: str, nominal: Mapping[str, SX], p: Signals) -> SX:
    """Initial value of an estimate."""
    key = f"{name}_0"
    return getattr(p, key) if key in p else nominal.get(name, 0)
