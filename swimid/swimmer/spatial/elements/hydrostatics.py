"""Weight and buoyancy of a link."""

from __future__ import annotations

from swimid.robots.spatial import Body, Hydrostatics
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial.elements import Tables, place


def add(element: Hydrostatics, body: Body, tables: Tables) -> None:
    """Add the weight at the centre of mass, and buoyancy where the element says."""
    index, gravity = tables.index[body.name], tables.gravity_m_s2
    weight = -gravity * Polynomial.of(body.mass_kg)
    tables.force.append((index, [*place(body.com_m), 0.0, 0.0, weight, 1.0, 0.0]))
    lift = gravity * tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        at = place(body.com_m if element.buoyancy_at_m is None else element.buoyancy_at_m)
        tables.force.append((index, [*at, 0.0, 0.0, lift, 1.0, element.half_height_m or 0.0]))
