"""Added mass of a flat plate (sea lion, Eq 9)."""

from __future__ import annotations

import math

from swimid.robots.spatial import Body, Plate
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial.elements import Tables, place
from swimid.swimmer.spatial.inertia import along


def add(element: Plate, body: Body, tables: Tables) -> None:
    """Add ``pi rho k b c^2 / 4`` across the plate, at its place."""
    mass = 0.25 * math.pi * tables.density_kg_m3 * element.span_m * element.chord_m**2
    tables.add_inertia(body.name, along(element.normal, Polynomial.of(element.k) * mass), place(element.at_m))
