"""A constant force."""

from __future__ import annotations

from swimid.robots.spatial import Body, Force
from swimid.swimmer.spatial.elements import Row, Tables, place


def add(element: Force, body: Body, tables: Tables) -> None:
    """Add the force at its point."""
    world = 1.0 if element.frame == "world" else 0.0
    row: Row = [*place(element.at_m), *place(element.force_N), world, 0.0]
    tables.force.append((tables.index[body.name], row))
