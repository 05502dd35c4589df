"""Lift and drag of a fin with the polar of a flat plate."""

from __future__ import annotations

import numpy as np

from swimid.robots.spatial import Body, Foil
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial.elements import Row, Tables, place


def add(element: Foil, body: Body, tables: Tables) -> None:
    """Add the fin's point, area, polar and directions."""
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
