"""Added mass along the axes of a link, and added inertia about them."""

from __future__ import annotations

from swimid.formats.multibody import AddedMass, Body
from swimid.models.multibody.elements import Tables, place
from swimid.models.multibody.inertia import diagonal


def add(element: AddedMass, body: Body, tables: Tables) -> None:
    """Add the masses at their place."""
    tables.add_inertia(
        body.name,
        diagonal(place(element.mass_kg)),
        place(element.at_m),
        diagonal(place(element.inertia_kg_m2)),
    )
