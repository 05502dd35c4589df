"""Added mass along the axes of a link, and added inertia about them."""

from __future__ import annotations

from swimid.robots.spatial import AddedMass, Body
from swimid.swimmer.spatial.elements import Tables, place
from swimid.swimmer.spatial.inertia import diagonal


def add(element: AddedMass, body: Body, tables: Tables) -> None:
    """Add the masses at their place."""
    tables.add_inertia(
        body.name,
        diagonal(place(element.mass_kg)),
        place(element.at_m),
        diagonal(place(element.inertia_kg_m2)),
    )
