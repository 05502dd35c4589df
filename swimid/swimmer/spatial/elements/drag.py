"""Drag along each axis of a link, at points (sea lion, Eq 2)."""

from __future__ import annotations

import numpy as np

from swimid.robots.spatial import Body, Drag
from swimid.swimmer.spatial.elements import Row, Tables, place


def add(element: Drag, body: Body, tables: Tables) -> None:
    """Add ``-rho/2 C A |v| v`` and linear drag, integrated along a row of strips by Gauss's rule."""
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
