"""Weight and buoyancy of a link in the vertical plane."""

from __future__ import annotations

from swimid.robots.planar import Hydrostatics, Link
from swimid.swimmer.planar.elements import Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: Hydrostatics, link: Link, tables: Tables) -> None:
    """Add the link's weight at its centre of mass, and buoyancy where the element says."""
    index, gravity = tables.index[link.name], tables.gravity_m_s2
    weight = -gravity * Polynomial.of(link.mass_kg)
    at = (-Polynomial.of(link.com_m), Polynomial.of(link.com_offset_m))
    tables.force.append((index, [*at, 0.0, weight, 1.0]))
    lift = gravity * tables.density_kg_m3 * Polynomial.of(element.volume_m3)
    if lift.terms:
        station = link.com_m if element.buoyancy_at_m is None else element.buoyancy_at_m
        where = (-Polynomial.of(station), Polynomial.of(element.buoyancy_offset_m))
        tables.force.append((index, [*where, 0.0, lift, 1.0]))
