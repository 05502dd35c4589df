"""Water inside a hull."""

from __future__ import annotations

from swimid.robots.spatial import Body, Water
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial.elements import Row, Tables, place
from swimid.swimmer.spatial.inertia import diagonal


def add(element: Water, body: Body, tables: Tables) -> None:
    """Add its inertia; in a hull open to the water its weight and the buoyancy of its space balance."""
    mass = tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    about = [mass * float(k) ** 2 for k in element.gyration_m]
    tables.add_inertia(body.name, diagonal((mass, mass, mass)), place(element.at_m), diagonal(about))
    if element.weighs:
        row: Row = [*place(element.at_m), 0.0, 0.0, -tables.gravity_m_s2 * mass, 1.0, 0.0]
        tables.force.append((tables.index[body.name], row))
