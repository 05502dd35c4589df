"""What acts on a link: one module per kind of element, each adding rows to the engine's tables.

A module has ``add(element, link, tables)``; its kind's fields are in
:mod:`swimid.robots.planar`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from swimid.robots.planar import Link
from swimid.swimmer.polynomial import Polynomial

Row = list[Polynomial | float]


@dataclass
class Tables:
    """Rows being collected, as polynomials.

    Attributes
    ----------
    density_kg_m3, gravity_m_s2 : float
    index : dict of link name to int
    inertia : list of rows, one per link
        Apparent inertia over (u, v, r) at the link's origin; columns of ``engine.INERTIA``.
    drag, foil, force, wake : list of (link index, row)
        Columns of ``engine.DRAG``, ``engine.FOIL``, ``engine.FORCE``, ``engine.WAKE``.
    """

    density_kg_m3: float
    gravity_m_s2: float
    index: dict[str, int]
    inertia: list[Row]
    drag: list[tuple[int, Row]] = field(default_factory=list)
    foil: list[tuple[int, Row]] = field(default_factory=list)
    force: list[tuple[int, Row]] = field(default_factory=list)
    wake: list[tuple[int, Row]] = field(default_factory=list)

    def add_inertia(
        self,
        link: str,
        x: Polynomial,
        y: Polynomial,
        forward: Polynomial,
        port: Polynomial,
        turning: Polynomial,
    ) -> None:
        """Add a mass (which may differ by direction) at a point, and a moment of inertia about it."""
        row = self.inertia[self.index[link]]
        terms: Row = [
            forward,
            0.0,
            -(forward * y),
            port,
            port * x,
            turning + forward * y * y + port * x * x,
        ]
        self.inertia[self.index[link]] = [
            Polynomial.of(a) + Polynomial.of(b) for a, b in zip(row, terms, strict=True)
        ]


Adder = Callable[[Any, Link, Tables], None]


def adders() -> dict[str, Adder]:
    """The function that adds each kind of element."""
    from swimid.swimmer.planar.elements import (
        added_mass,
        damping,
        drag,
        foil,
        force,
        hydrostatics,
        slender_body,
        trailing_edge,
    )

    return {
        "added-mass": added_mass.add,
        "damping": damping.add,
        "drag": drag.add,
        "foil": foil.add,
        "force": force.add,
        "hydrostatics": hydrostatics.add,
        "slender-body": slender_body.add,
        "trailing-edge": trailing_edge.add,
    }
