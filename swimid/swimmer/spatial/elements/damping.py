"""Moments against rotation."""

from __future__ import annotations

from swimid.robots.spatial import Body, Damping
from swimid.swimmer.spatial.elements import Row, Tables, place


def add(element: Damping, body: Body, tables: Tables) -> None:
    """Add quadratic and linear moments about the link's axes."""
    row: Row = [*place(element.quadratic_N_m_s2_rad2), *place(element.linear_N_m_s_rad)]
    tables.damping.append((tables.index[body.name], row))
