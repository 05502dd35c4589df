"""Morison drag at a point or on Gauss strips (tendon fish, Eq 7)."""

from __future__ import annotations

import numpy as np

from swimid.robots.planar import Drag, Link
from swimid.swimmer.planar.elements import Row, Tables
from swimid.swimmer.polynomial import Polynomial


def add(element: Drag, link: Link, tables: Tables) -> None:
    """Add ``-rho/2 c S |v| v`` along each axis, the areas shared out by Gauss's weights."""
    half = 0.5 * tables.density_kg_m3
    gains = (
        half * Polynomial.of(element.axial_area_m2) * Polynomial.of(element.axial_coefficient),
        half * Polynomial.of(element.normal_area_m2) * Polynomial.of(element.normal_coefficient),
        Polynomial.of(element.axial_linear_N_s_m),
        Polynomial.of(element.normal_linear_N_s_m),
    )
    if element.at_m is not None:
        stations, shares = [Polynomial.of(element.at_m)], [1.0]
    else:
        low = element.from_m or 0.0
        high = link.length_m if element.to_m is None else element.to_m
        nodes, weights = np.polynomial.legendre.leggauss(element.strips)
        stations = [Polynomial.of(low + 0.5 * (high - low) * (1.0 + float(z))) for z in nodes]
        shares = [0.5 * float(w) for w in weights]
    for station, share in zip(stations, shares, strict=True):
        row: Row = [-station, Polynomial.of(element.offset_m), *(share * g for g in gains), 0.0, 0.0]
        tables.drag.append((tables.index[link.name], row))
