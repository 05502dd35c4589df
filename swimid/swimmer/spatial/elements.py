"""Elements that act on a link of a robot in space: each adds rows to the engine's tables.

Their fields are in :mod:`swimid.robots.spatial`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from swimid.fitting.model import Array
from swimid.robots.spatial import (
    AddedMass,
    Body,
    Damping,
    Drag,
    Foil,
    Force,
    Hydrostatics,
    Plate,
    Spheroid,
    Water,
)
from swimid.swimmer.planar import elements as planar
from swimid.swimmer.polynomial import Polynomial

Quantity = Polynomial | float
Row = list[Quantity]


@dataclass
class Tables(planar.Tables):
    """Rows being collected, as polynomials.

    The tables of a planar robot, with ``damping``: (link index, row) in columns of ``engine.DAMPING``.
    """

    damping: list[tuple[int, Row]] = field(default_factory=list)

    def add_mass(
        self,
        link: str,
        mass: Sequence[Sequence[Quantity]],
        at: Sequence[Quantity],
        turning: Sequence[Sequence[Quantity]] | None = None,
    ) -> None:
        """Add a mass (which may differ by direction) at a place, and a moment of inertia about it."""
        self.add_to(link, block(mass, at, turning or diagonal((0.0, 0.0, 0.0))))


def place(vector: Sequence[Any]) -> list[Polynomial]:
    """A vector of a robot file as polynomials."""
    return [Polynomial.of(v) for v in vector]


#: Rows and columns of the entries a symmetric block is stored by.
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def block(
    mass: Sequence[Sequence[Quantity]],
    at: Sequence[Quantity],
    turning: Sequence[Sequence[Quantity]],
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


def _added_mass(element: AddedMass, body: Body, tables: Tables) -> None:
    """Added mass along the axes of a link, and added inertia about them. Add the masses at their place."""
    tables.add_mass(
        body.name,
        diagonal(place(element.mass_kg)),
        place(element.at_m),
        diagonal(place(element.inertia_kg_m2)),
    )


def spheroid_coefficients(semi_major: float, semi_minor: float) -> tuple[float, float, float]:
    """Lamb's coefficients k1 (along the axis), k2 (across) and k' (turning about a cross axis).

    Returns
    -------
    k1, k2 : float
        Shares of the displaced mass, ``alpha_0 / (2 - alpha_0)`` and ``beta_0 / (2 - beta_0)``; the paper's
        Eq 7 writes a_0 (the semi-major axis' letter) for alpha_0.
    k : float
        Share of the displaced water's moment of inertia (Lamb 1932, section 115), with a, b for the two,
        ``e^4 (b - a) / ((2 - e^2) (2 e^2 - (2 - e^2) (b - a)))``.

    >>> [round(k, 3) for k in spheroid_coefficients(6.0, 1.0)]
    [0.045, 0.917, 0.762]
    """
    e = math.sqrt(1.0 - (semi_minor / semi_major) ** 2)
    log = math.log((1.0 + e) / (1.0 - e))
    alpha = 2.0 * (1.0 - e * e) / e**3 * (0.5 * log - e)
    beta = 1.0 / (e * e) - (1.0 - e * e) / (2.0 * e**3) * log
    off = 2.0 - e * e
    turning = e**4 * (beta - alpha) / (off * (2.0 * e * e - off * (beta - alpha)))
    return alpha / (2.0 - alpha), beta / (2.0 - beta), turning


def _spheroid(element: Spheroid, body: Body, tables: Tables) -> None:
    """Added mass of a prolate spheroid (sea lion, Eqs 3 to 8).

    Add the water a spheroid moves, at its middle.
    """
    a, b = element.semi_major_m, element.semi_minor_m
    displaced = 4.0 / 3.0 * math.pi * tables.density_kg_m3 * a * b * b
    k1, k2, turning = spheroid_coefficients(a, b)
    masses = [f * (k * displaced) for f, k in zip(place(element.factors), (k1, k2, k2), strict=True)]
    inertia = turning * displaced * (a * a + b * b) / 5.0 if element.turning else 0.0
    # turning about z moves water sideways, about y up and down: the factors go with it
    _, sideways, upwards = place(element.factors)
    about = (0.0, upwards * inertia, sideways * inertia)
    tables.add_mass(body.name, diagonal(masses), place(element.at_m), diagonal(about))


def _plate(element: Plate, body: Body, tables: Tables) -> None:
    """Added mass of a flat plate (sea lion, Eq 9).

    Add ``pi rho k b c^2 / 4`` across the plate, at its place.
    """
    mass = 0.25 * math.pi * tables.density_kg_m3 * element.span_m * element.chord_m**2
    tables.add_mass(body.name, along(element.normal, Polynomial.of(element.k) * mass), place(element.at_m))


def _drag(element: Drag, body: Body, tables: Tables) -> None:
    """Add ``-rho/2 C A |v| v`` and linear drag, integrated along a row of strips by Gauss's rule.

    Drag along each axis of a link, at points (sea lion, Eq 2).
    """
    half = 0.5 * tables.density_kg_m3
    quadratic = [
        half * a * c for a, c in zip(place(element.area_m2), place(element.coefficient), strict=True)
    ]
    linear = place(element.linear_N_s_m)
    near = place(element.at_m)
    far = near if element.to_m is None else place(element.to_m)
    for point, weight in zip(*np.polynomial.legendre.leggauss(element.strips), strict=True):
        along, share = 0.5 * (1.0 + float(point)), 0.5 * float(weight)
        at = [
            a if element.to_m is None else (1.0 - along) * a + along * b
            for a, b in zip(near, far, strict=True)
        ]
        row: Row = [
            *at, *(share * q for q in quadratic), *(share * g for g in linear), element.half_height_m or 0.0
        ]  # fmt: skip
        tables.drag.append((tables.index[body.name], row))


def _damping(element: Damping, body: Body, tables: Tables) -> None:
    """Add quadratic and linear moments about the link's axes.

    Moments against rotation.
    """
    row: Row = [*place(element.quadratic_N_m_s2_rad2), *place(element.linear_N_m_s_rad)]
    tables.damping.append((tables.index[body.name], row))


def _foil(element: Foil, body: Body, tables: Tables) -> None:
    """Add the fin's point, area, polar and directions.

    Lift and drag of a fin with the polar of a flat plate.
    """
    chord, normal = (
        [float(c) for c in np.asarray(d) / np.linalg.norm(d)] for d in (element.chord, element.normal)
    )
    row: Row = [
        *place(element.at_m),
        0.5 * tables.density_kg_m3 * Polynomial.of(element.area_m2),
        Polynomial.of(element.lift_coefficient),
        Polynomial.of(element.drag_coefficient_0),
        Polynomial.of(element.drag_coefficient_1),
        *chord,
        *normal,
        element.half_height_m or 0.0,
    ]
    tables.foil.append((tables.index[body.name], row))


def _hydrostatics(element: Hydrostatics, body: Body, tables: Tables) -> None:
    """Add the weight at the centre of mass, and buoyancy where the element says.

    Weight and buoyancy of a link.
    """
    index, gravity = tables.index[body.name], tables.gravity_m_s2
    weight = -gravity * Polynomial.of(body.mass_kg)
    tables.force.append((index, [*place(body.com_m), 0.0, 0.0, weight, 1.0, 0.0]))
    lift = gravity * tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        at = place(body.com_m if element.buoyancy_at_m is None else element.buoyancy_at_m)
        tables.force.append((index, [*at, 0.0, 0.0, lift, 1.0, element.half_height_m or 0.0]))


def _water(element: Water, body: Body, tables: Tables) -> None:
    """Add its inertia; in a hull open to the water its weight and the buoyancy of its space balance.

    Water inside a hull.
    """
    mass = tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    about = [mass * float(k) ** 2 for k in element.gyration_m]
    tables.add_mass(body.name, diagonal((mass, mass, mass)), place(element.at_m), diagonal(about))
    if element.weighs:
        row: Row = [*place(element.at_m), 0.0, 0.0, -tables.gravity_m_s2 * mass, 1.0, 0.0]
        tables.force.append((tables.index[body.name], row))


def _force(element: Force, body: Body, tables: Tables) -> None:
    """Add the force at its point.

    A constant force.
    """
    world = 1.0 if element.frame == "world" else 0.0
    row: Row = [*place(element.at_m), *place(element.force_N), world, 0.0]
    tables.force.append((tables.index[body.name], row))


#: Function that adds the rows of an element to the tables, by its kind.
ADDERS: dict[str, Callable[[Any, Any, Tables], None]] = {
    "added-mass": _added_mass,
    "spheroid": _spheroid,
    "plate": _plate,
    "drag": _drag,
    "damping": _damping,
    "foil": _foil,
    "hydrostatics": _hydrostatics,
    "water": _water,
    "force": _force,
}
