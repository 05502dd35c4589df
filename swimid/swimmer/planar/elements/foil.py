"""Lift and drag of a fin (dolphin, Eq 9) with the polar of a flat plate."""

from __future__ import annotations

import math

from swimid.robots.planar import Foil, Link
from swimid.swimmer.planar.elements import Row, Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: Foil, link: Link, tables: Tables) -> None:
    """Add the fin's point, area, polar and chord direction."""
    chord = math.radians(element.chord_deg)
    row: Row = [
        -Polynomial.of(element.at_m),
        Polynomial.of(element.offset_m),
        0.5 * tables.density_kg_m3 * Polynomial.of(element.area_m2),
        Polynomial.of(element.lift_coefficient),
        Polynomial.of(element.drag_coefficient_0),
        Polynomial.of(element.drag_coefficient_1),
        math.cos(chord),
        math.sin(chord),
    ]
    tables.foil.append((tables.index[link.name], row))
