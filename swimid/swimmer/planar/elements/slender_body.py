"""Strips over a link whose cross-section varies along it (dolphin, Eqs 4, 7 and 8)."""

from __future__ import annotations

import math

import numpy as np

from swimid.robots.planar import Link, SlenderBody
from swimid.swimmer.planar.elements import Row, Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: SlenderBody, link: Link, tables: Tables) -> None:
    """Add added mass ``c_m rho pi h^2 / 4`` and drag ``rho/2 (c_f p, c_d h) |v| v`` per length."""
    at = np.array([s.station_m for s in element.sections])
    heights = np.array([s.height_m for s in element.sections])
    girths = np.array([s.perimeter_m for s in element.sections])
    low, high = float(at[0]), float(at[-1])
    nodes, weights = np.polynomial.legendre.leggauss(element.strips)
    stations = low + 0.5 * (high - low) * (1.0 + nodes)
    for station, width in zip(stations, 0.5 * (high - low) * weights, strict=True):
        height, girth = float(np.interp(station, at, heights)), float(np.interp(station, at, girths))
        mass = Polynomial.of(element.added_mass_coefficient) * (
            0.25 * tables.density_kg_m3 * math.pi * height**2 * float(width)
        )
        forward = mass if element.added_mass_direction == "both" else Polynomial.of(0.0)
        zero = Polynomial.of(0.0)
        tables.add_inertia(link.name, Polynomial.of(-float(station)), zero, forward, mass, zero)
        half = 0.5 * tables.density_kg_m3 * float(width)
        row: Row = [
            -float(station),
            0.0,
            half * girth * Polynomial.of(element.friction_coefficient),
            half * height * Polynomial.of(element.drag_coefficient),
            0.0,
            0.0,
            0.0,
            0.0,
        ]
        tables.drag.append((tables.index[link.name], row))
