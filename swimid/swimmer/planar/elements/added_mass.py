"""Added mass: inertia of the water a link carries along, anisotropic where its masses differ.

Counted once, in the kinetic energy (tendon fish Eq 2, dolphin Eq 3): the added-mass force of
their Eqs 6 and 7 is its derivative and must not be applied again.
"""

from __future__ import annotations

from swimid.robots.planar import AddedMass, Link
from swimid.swimmer.planar.elements import Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: AddedMass, link: Link, tables: Tables) -> None:
    """Add the element's mass at its station (default the link's centre of mass)."""
    station = link.com_m if element.at_m is None else element.at_m
    tables.add_inertia(
        link.name,
        -Polynomial.of(station),
        Polynomial.of(element.offset_m),
        Polynomial.of(element.surge_kg),
        Polynomial.of(element.sway_kg),
        Polynomial.of(element.inertia_kg_m2),
    )
