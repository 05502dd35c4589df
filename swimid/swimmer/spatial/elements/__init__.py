"""What acts on a link: one module per kind of element, each adding rows to the engine's tables.

A module has ``add(element, body, tables)``; its kind's fields are in :mod:`swimid.robots.spatial`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from swimid.robots.spatial import Body
from swimid.swimmer.polynomial import Polynomial
from swimid.swimmer.spatial import inertia

Row = list[Polynomial | float]


@dataclass
class Tables:
    """Rows being collected, as polynomials.

    Attributes
    ----------
    density_kg_m3, gravity_m_s2 : float
    index : dict of link name to int
    inertia : list of rows, one per link
        Columns of ``engine.INERTIA``.
    drag, damping, foil, force, wake : list of (link index, row)
        Columns of the engine's tables of these names.
    """

    density_kg_m3: float
    gravity_m_s2: float
    index: dict[str, int]
    inertia: list[Row]
    drag: list[tuple[int, Row]] = field(default_factory=list)
    damping: list[tuple[int, Row]] = field(default_factory=list)
    foil: list[tuple[int, Row]] = field(default_factory=list)
    force: list[tuple[int, Row]] = field(default_factory=list)
    wake: list[tuple[int, Row]] = field(default_factory=list)

    def add_inertia(
        self,
        link: str,
        mass: Sequence[Sequence[Polynomial | float]],
        at: Sequence[Polynomial | float],
        turning: Sequence[Sequence[Polynomial | float]] | None = None,
    ) -> None:
        """Add a mass (which may differ by direction) at a place, and a moment of inertia about it."""
        terms = inertia.block(mass, at, turning or inertia.diagonal((0.0, 0.0, 0.0)))
        row = self.inertia[self.index[link]]
        self.inertia[self.index[link]] = [
            Polynomial.of(a) + Polynomial.of(b) for a, b in zip(row, terms, strict=True)
        ]


def place(vector: Sequence[Any]) -> list[Polynomial]:
    """A vector of a robot file as polynomials."""
    return [Polynomial.of(v) for v in vector]


def adders() -> dict[str, Callable[[Any, Body, Tables], None]]:
    """The function that adds each kind of element."""
    from swimid.swimmer.spatial.elements import (
        added_mass,
        damping,
        drag,
        foil,
        force,
        hydrostatics,
        plate,
        spheroid,
        water,
    )

    return {
        "added-mass": added_mass.add,
        "spheroid": spheroid.add,
        "plate": plate.add,
        "drag": drag.add,
        "damping": damping.add,
        "foil": foil.add,
        "hydrostatics": hydrostatics.add,
        "water": water.add,
        "force": force.add,
    }
