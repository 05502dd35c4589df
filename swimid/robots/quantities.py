"""Physical quantities of a robot file: numbers, or products of numbers and named coefficients.

A gray-box fit estimates the coefficients. A :class:`Polynomial` computes with quantities while their
coefficients have no values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, PositiveFloat, model_validator

from swimid.files import yamlio

#: Pattern of the name of a coefficient in a robot file.
NAME = re.compile(r"[A-Za-z_]\w*")


def factors(quantity: float | str) -> tuple[float, tuple[str, ...]]:
    """Split a quantity of a robot file into its numeric factor and the names of its coefficients.

    Raises
    ------
    ValueError
        If a factor is neither a number nor a name.

    >>> factors("0.5 * c_f0")
    (0.5, ('c_f0',))
    """
    if not isinstance(quantity, str):
        return float(quantity), ()
    number, names = 1.0, []
    for part in quantity.split("*"):
        word = part.strip()
        if NAME.fullmatch(word):
            names.append(word)
            continue
        try:
            number *= float(word)
        except ValueError:
            raise ValueError(
                f"'{quantity}' is neither a number nor a product of numbers and coefficient names"
            ) from None
    if not math.isfinite(number):
        raise ValueError(f"'{quantity}' is not finite")
    return number, tuple(sorted(names))


def _quantity(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"'{str(value).lower()}' is not a number")
    if isinstance(value, str):
        factors(value)
    return value


#: Type of a physical quantity in a robot file: a number, or a product of numbers and named coefficients.
Quantity = Annotated[float | str, BeforeValidator(_quantity)]


class Coefficient(yamlio.Document):
    """Named coefficient of a robot file: its value, and its bounds and start value in a fit."""

    value: float
    unit: str = "1"
    bounds: tuple[float | None, float | None] = (None, None)
    #: Start value of the coefficient in a fit; the default is ``value``.
    start: float | None = None
    #: Typical size of the coefficient. Its estimate is not identifiable if the standard error exceeds half of
    #: this size and also half of the estimate.
    scale: PositiveFloat | None = None
    #: Whether a fit estimates the coefficient by default.
    free: bool = True
    #: Whether the coefficient has a separate value for each trial, such as the trim of the robot.
    per_trial: bool = False
    meaning: str = ""
    source: str = ""

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper bound of the coefficient. A bound that the file omits is infinite."""
        return yamlio.limits(self.bounds)

    @model_validator(mode="after")
    def _in_bounds(self) -> Coefficient:
        low, high = self.limits
        if not low < high:
            raise ValueError(f"the lower bound, {low:g}, must be below the upper bound, {high:g}")
        for name, value in (("value", self.value), ("start", self.start)):
            if value is not None and not low <= value <= high:
                raise ValueError(f"the {name} {value:g} lies outside the bounds, {low:g} to {high:g}")
        return self


def _check_coefficient_names(coefficients: dict[str, Coefficient]) -> dict[str, Coefficient]:
    for name in coefficients:
        if not NAME.fullmatch(name):
            raise ValueError(f"a coefficient cannot be called '{name}'; allowed are letters, digits and _")
    return coefficients


Coefficients = Annotated[dict[str, Coefficient], AfterValidator(_check_coefficient_names)]


class Polynomial:
    """Polynomial in the coefficients of a robot file.

    Attributes
    ----------
    terms : dict of tuple of str to float
        Factor of each monomial. The key of a monomial is the sorted tuple of its coefficient names.

    >>> mass = Polynomial.of("2 * c_m")
    >>> (mass * mass + 1.0).at({"c_m": 3.0})
    37.0
    """

    __slots__ = ("terms",)

    def __init__(self, terms: dict[tuple[str, ...], float]) -> None:
        self.terms = {names: number for names, number in terms.items() if number != 0.0}

    @classmethod
    def of(cls, quantity: float | str | Polynomial | None) -> Polynomial:
        """Convert a number, a quantity of a robot file (None is zero) or a polynomial to a polynomial."""
        if isinstance(quantity, Polynomial):
            return quantity
        number, names = factors(use_default(quantity, 0.0))
        return cls({names: number})

    def __add__(self, other: Polynomial | float) -> Polynomial:
        terms = dict(self.terms)
        for names, number in Polynomial.of(other).terms.items():
            terms[names] = terms.get(names, 0.0) + number
        return Polynomial(terms)

    def __mul__(self, other: Polynomial | float) -> Polynomial:
        terms: dict[tuple[str, ...], float] = {}
        for names, number in self.terms.items():
            for more, factor in Polynomial.of(other).terms.items():
                key = tuple(sorted((*names, *more)))
                terms[key] = terms.get(key, 0.0) + number * factor
        return Polynomial(terms)

    def __neg__(self) -> Polynomial:
        return self * -1.0

    def __sub__(self, other: Polynomial | float) -> Polynomial:
        return self + -Polynomial.of(other)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: float) -> Polynomial:
        return Polynomial.of(other) - self

    @property
    def names(self) -> set[str]:
        """Names of all coefficients in the polynomial."""
        return {name for factors in self.terms for name in factors}

    def at(self, values: Mapping[str, float]) -> float:
        """Return the value of the polynomial at values of the coefficients."""
        return float(sum(n * np.prod([values[name] for name in names]) for names, n in self.terms.items()))


#: Type of an entry of an input array before the coefficients have values. A string is a physical quantity as
#: a robot file states it: a number times names of coefficients.
Entry = Polynomial | float | str
#: Type of a vector with three physical quantities as components.
Vector = tuple[Quantity, Quantity, Quantity]
#: Type of a point or direction with components along the axes of a link, which are quantities or polynomials.
Components = Sequence[Entry]


def multiply_pairs(first: Components, second: Components) -> list[Polynomial]:
    """Return the products of the components of two vectors, one for each axis."""
    return [Polynomial.of(a) * Polynomial.of(b) for a, b in zip(first, second, strict=True)]


def use_default(quantity: Any, default: Any) -> Any:
    """Return an optional entry of a robot file, or the default value if the file lacks the entry."""
    if quantity is None:
        return default
    return quantity


def gauss_points(low: Any, high: Any, count: int) -> Iterator[tuple[Any, float]]:
    """Yield the points of Gauss's quadrature rule between two positions, each with its weight.

    The sum of the weights is 1.
    """
    for node, weight in zip(*np.polynomial.legendre.leggauss(count), strict=True):
        yield low + 0.5 * (high - low) * (1.0 + float(node)), 0.5 * float(weight)
