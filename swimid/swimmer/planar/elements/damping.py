"""Moment against the rotation of a link."""

from __future__ import annotations

from swimid.robots.planar import Damping, Link
from swimid.swimmer.planar.elements import Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: Damping, link: Link, tables: Tables) -> None:
    """Add ``-(linear + quadratic |r|) r``."""
    turning = (Polynomial.of(element.quadratic_N_m_s2_rad2), Polynomial.of(element.linear_N_m_s_rad))
    tables.drag.append((tables.index[link.name], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *turning]))
