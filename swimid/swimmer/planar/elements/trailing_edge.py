"""Momentum shed into the wake at a trailing edge (Lighthill 1971, Proc. R. Soc. Lond. B 179:125).

With u and w the edge's velocity along its link's axis and across it, and m the added mass per length
there, the water's reaction on a slender body is

    ``[-m u w n + 1/2 m w^2 t] at the edge - d/dt integral of m w n over the body``

(n and t unit vectors across and along). The integral is the impulse of the links' lateral added mass
and acts through their kinetic energy; what is left acts here. It takes the energy 1/2 m u w^2 per time,
which the wake carries off. An edge that moves backwards (u < 0) leads and sheds nothing, a case outside
the theory: the force across is then zero, and what is left resists the motion.
"""

from __future__ import annotations

from swimid.robots.planar import Link, TrailingEdge
from swimid.swimmer.planar.elements import Row, Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: TrailingEdge, link: Link, tables: Tables) -> None:
    """Add the edge's point and half its added mass per length."""
    station = link.length_m if element.at_m is None else element.at_m
    row: Row = [
        -Polynomial.of(station),
        Polynomial.of(element.offset_m),
        0.5 * Polynomial.of(element.added_mass_kg_m),
    ]
    tables.wake.append((tables.index[link.name], row))
