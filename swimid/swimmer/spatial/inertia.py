"""Apparent inertias as blocks of polynomials: masses that differ by direction, at a place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting.model import Array
from swimid.swimmer.polynomial import Polynomial

Quantity = Polynomial | float
#: Rows and columns of the entries a symmetric block is stored by.
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def block(
    mass: Sequence[Sequence[Quantity]], at: Sequence[Quantity], turning: Sequence[Sequence[Quantity]]
) -> list[Quantity]:
    """The stored entries (:data:`swimid.swimmer.spatial.engine.INERTIA`) of a mass at a place.

    A, ``B = -M S`` and ``D = J - S M S`` with ``S`` the lever's cross product: the velocity of the place (m)
    is ``v - S w``. The mass is symmetric, 3 by 3, momentum of the place for its velocity, kg; turning is
    inertia about that place, kg m2.
    """
    m = np.array([[Polynomial.of(e) for e in row] for row in mass])
    x, y, z = (Polynomial.of(a) for a in at)
    none = Polynomial.of(0.0)
    lever = np.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    ms = m @ lever
    sms = lever @ ms
    a = [m[r, c] for r, c in UPPER]
    d = [Polynomial.of(turning[r][c]) - sms[r, c] for r, c in UPPER]
    return [*a, *(-ms).ravel(), *d]


def diagonal(values: Sequence[Quantity]) -> list[list[Quantity]]:
    """A matrix of these values on its diagonal."""
    return [[values[r] if r == c else 0.0 for c in range(3)] for r in range(3)]


def along(direction: Sequence[float], size: Quantity) -> list[list[Quantity]]:
    """A mass that only motion along a unit direction feels."""
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    return [[Polynomial.of(size) * float(unit[r] * unit[c]) for c in range(3)] for r in range(3)]


def full(row: Array) -> Array:
    """The 6 by 6 matrix of a stored row of numbers, shape (6, 6)."""
    a, b, d = (np.zeros((3, 3)) for _ in range(3))
    for n, (r, c) in enumerate(UPPER):
        a[r, c] = a[c, r] = row[n]
        d[r, c] = d[c, r] = row[15 + n]
    b[:] = np.asarray(row[6:15]).reshape(3, 3)
    return np.block([[a, b], [b.T, d]])
