"""Added mass of a prolate spheroid (sea lion, Eqs 3 to 8)."""

from __future__ import annotations

import math

from swimid.robots.spatial import Body, Spheroid
from swimid.swimmer.spatial.elements import Tables, place
from swimid.swimmer.spatial.inertia import diagonal


def coefficients(semi_major: float, semi_minor: float) -> tuple[float, float, float]:
    """Lamb's coefficients k1 (along the axis), k2 (across) and k' (turning about a cross axis).

    Returns
    -------
    k1, k2 : float
        Shares of the displaced mass, ``alpha_0 / (2 - alpha_0)`` and ``beta_0 / (2 - beta_0)``; the paper's
        Eq 7 writes a_0 (the semi-major axis' letter) for alpha_0.
    k : float
        Share of the displaced water's moment of inertia (Lamb 1932, section 115), with a, b for the two,
        ``e^4 (b - a) / ((2 - e^2) (2 e^2 - (2 - e^2) (b - a)))``.

    >>> [round(k, 3) for k in coefficients(6.0, 1.0)]
    [0.045, 0.917, 0.762]
    """
    e = math.sqrt(1.0 - (semi_minor / semi_major) ** 2)
    log = math.log((1.0 + e) / (1.0 - e))
    alpha = 2.0 * (1.0 - e * e) / e**3 * (0.5 * log - e)
    beta = 1.0 / (e * e) - (1.0 - e * e) / (2.0 * e**3) * log
    off = 2.0 - e * e
    turning = e**4 * (beta - alpha) / (off * (2.0 * e * e - off * (beta - alpha)))
    return alpha / (2.0 - alpha), beta / (2.0 - beta), turning


def add(element: Spheroid, body: Body, tables: Tables) -> None:
    """Add the water a spheroid moves, at its middle."""
    a, b = element.semi_major_m, element.semi_minor_m
    displaced = 4.0 / 3.0 * math.pi * tables.density_kg_m3 * a * b * b
    k1, k2, turning = coefficients(a, b)
    masses = [f * (k * displaced) for f, k in zip(place(element.factors), (k1, k2, k2), strict=True)]
    inertia = turning * displaced * (a * a + b * b) / 5.0 if element.turning else 0.0
    # turning about z moves water sideways, about y up and down: the factors go with it
    _, sideways, upwards = place(element.factors)
    about = (0.0, upwards * inertia, sideways * inertia)
    tables.add_inertia(body.name, diagonal(masses), place(element.at_m), diagonal(about))
