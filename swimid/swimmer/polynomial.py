"""Polynomials in named coefficients: how the engine's tables depend on what a fit estimates.

Every entry of the tables (masses, moments, drag gains) is a polynomial in the robot's
coefficients. Built once, they are evaluated for new values by one matrix product.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.model import Array
from swimid.robots.planar import factors


class Polynomial:
    """A polynomial with numbers for factors and coefficient names for unknowns.

    Attributes
    ----------
    terms : dict of tuple of str to float
        Sorted names of a monomial's factors, and what it is multiplied by.

    >>> mass = Polynomial.of("2 * c_m")
    >>> (mass * mass + 1.0).at({"c_m": 3.0})
    37.0
    """

    __slots__ = ("terms",)

    def __init__(self, terms: dict[tuple[str, ...], float]) -> None:
        self.terms = {names: number for names, number in terms.items() if number != 0.0}

    @classmethod
    def of(cls, quantity: float | str | Polynomial | None) -> Polynomial:
        """A number, a quantity of a robot file (None counts as zero), or a polynomial."""
        if isinstance(quantity, Polynomial):
            return quantity
        number, names = factors(0.0 if quantity is None else quantity)
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

    def at(self, values: dict[str, float]) -> float:
        """Its value."""
        return float(sum(n * np.prod([values[name] for name in names]) for names, n in self.terms.items()))


class Table:
    """A table of polynomials, evaluated together.

    The width is that of a table without rows; coefficients are named in the order their values come in.
    """

    def __init__(
        self, rows: Sequence[Sequence[Polynomial | float]], columns: int, names: Sequence[str]
    ) -> None:
        self.shape = (len(rows), columns)
        entries = [Polynomial.of(entry) for row in rows for entry in row]
        monomials = sorted({m for entry in entries for m in entry.terms if m})
        self.constant = np.array([entry.terms.get((), 0.0) for entry in entries])
        # monomials of fewer factors are padded by a one behind the coefficients
        longest = max((len(m) for m in monomials), default=0)
        padded = [[names.index(name) for name in m] + [len(names)] * (longest - len(m)) for m in monomials]
        self.factors = np.array(padded, dtype=int).reshape(len(monomials), longest)
        self.gains = np.array([[entry.terms.get(m, 0.0) for m in monomials] for entry in entries]).reshape(
            len(entries), len(monomials)
        )

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Entries that are not zero whatever the coefficients, shape (rows, columns)."""
        return np.asarray(((self.constant != 0.0) | (self.gains != 0.0).any(axis=1)).reshape(self.shape))

    def __call__(self, values: Array) -> Array:
        """The table at the coefficients' values, shape (rows, columns); it may be the object's own."""
        if not len(self.factors):
            return self.constant.reshape(self.shape)
        padded = np.append(values, 1.0)
        products = padded[self.factors[:, 0]]
        for column in self.factors.T[1:]:
            products = products * padded[column]
        return np.asarray((self.constant + self.gains @ products).reshape(self.shape))
