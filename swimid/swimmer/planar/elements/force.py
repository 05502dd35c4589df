"""A constant force at a point of a link."""

from __future__ import annotations

from swimid.robots.planar import Force, Link
from swimid.swimmer.planar.elements import Row, Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: Force, link: Link, tables: Tables) -> None:
    """Add the force, fixed to the link or to the world."""
    row: Row = [
        -Polynomial.of(element.at_m),
        Polynomial.of(element.offset_m),
        Polynomial.of(element.forward_N),
        Polynomial.of(element.port_N),
        1.0 if element.frame == "world" else 0.0,
    ]
    tables.force.append((tables.index[link.name], row))
