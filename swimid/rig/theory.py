"""Estimates from theory and tables, to put beside measured parameters."""

from __future__ import annotations

import numpy as np

from swimid.robots.file import Robot, Theory

#: Added-mass coefficient of a square prism moving along its length, by length over side;
#: reference volume is the prism's own (DNV-RP-C205, appendix D).
_PRISM = np.array(
    [[1.0, 0.68], [2.0, 0.36], [3.0, 0.24], [4.0, 0.19], [5.0, 0.15], [6.0, 0.13], [7.0, 0.11], [10.0, 0.08]]
)

#: A body is no more than so many times as long as its frontal area is wide.
SLENDER = 10.0
#: Densities of fresh and salt water, and their kinematic viscosity at 20 degrees.
WATER_KG_M3, WATER_VISCOSITY_M2_S = (950.0, 1050.0), 1.0e-6


def prism_added_mass(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Added mass of a box moving along its length, kg.

    Notes
    -----
    Tabulated coefficients of square prisms (DNV-RP-C205, appendix D), interpolated at length
    over the side of a square of the same frontal area, times the mass of the displaced water.

    >>> round(prism_added_mass(1.0, 1.0, 1.0, 1000.0))
    680
    """
    side = np.sqrt(width_m * height_m)
    coefficient = float(np.interp(length_m / side, _PRISM[:, 0], _PRISM[:, 1]))
    return coefficient * density_kg_m3 * length_m * width_m * height_m


def most_added_mass_in_box(
    length_m: float, width_m: float, height_m: float, density_kg_m3: float, *, along: bool
) -> float:
    """Largest added mass of a body that lies in a box, kg.

    Parameters
    ----------
    along : bool
        The body moves along its length; else any way.

    Notes
    -----
    Water that moves with a body as if it belonged to it is a possible motion, and the water takes the one
    of least energy (Kelvin). So a body has no more added mass than one around it has, with all water between
    them: the box along its length, the ball around the box any way, with half its water as added mass.

    >>> most_added_mass_in_box(1.0, 1.0, 1.0, 1000.0, along=True)
    1680.0
    """
    if along:
        displaced = density_kg_m3 * length_m * width_m * height_m
        return prism_added_mass(length_m, width_m, height_m, density_kg_m3) + displaced
    diagonal = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 1.5 * density_kg_m3 * float(np.pi) / 6.0 * diagonal**3


def most_added_inertia(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Largest added moment of inertia of a body that lies in a box and turns about a point in it, kg m2.

    Notes
    -----
    As :func:`most_added_mass_in_box`: that of a ball of water that turns with it, as large as the box from
    any point in it.

    >>> round(most_added_inertia(1.0, 1.0, 1.0, 1000.0))
    26119
    """
    radius = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 0.4 * density_kg_m3 * 4.0 / 3.0 * float(np.pi) * radius**5


def most_added_mass(displaced_kg: float, frontal_area_m2: float | None, density_kg_m3: float) -> float:
    """Largest added mass of a convex body that moves across its frontal area, kg.

    Parameters
    ----------
    displaced_kg : float
        Mass of the displaced water, or more.
    frontal_area_m2 : float or None

    Notes
    -----
    A convex body fills at least a third of the prism around it (a pyramid does), whose added mass along its
    length is at most 0.8 of the water in a cube of its frontal area (DNV-RP-C205, appendix D, for all
    lengths); the rest as in :func:`most_added_mass_in_box`. Where the area is not known: ten times the
    displaced water, which a disc ten times as wide as thick does not reach.

    >>> round(most_added_mass(1.0, 0.01, 1000.0), 3)
    3.8
    """
    if frontal_area_m2 is None:
        return 10.0 * displaced_kg
    return 3.0 * displaced_kg + 0.8 * density_kg_m3 * frontal_area_m2**1.5


def most_displaced(frontal_area_m2: float, density_kg_m3: float) -> float:
    """Mass of the water that a body displaces which is :data:`SLENDER` times as long as wide, kg.

    >>> round(most_displaced(np.pi / 4, 1000.0))
    7854
    """
    diameter = 2.0 * float(np.sqrt(frontal_area_m2 / np.pi))
    return density_kg_m3 * frontal_area_m2 * SLENDER * diameter


def reynolds(speed_m_s: float, frontal_area_m2: float, density_kg_m3: float) -> float:
    """Reynolds number with the diameter of the frontal area; NaN in a fluid that is not water.

    >>> round(reynolds(1.0, np.pi / 4, 1000.0))
    1000000
    """
    low, high = WATER_KG_M3
    if not low <= density_kg_m3 <= high:
        return float("nan")
    return speed_m_s * 2.0 * float(np.sqrt(frontal_area_m2 / np.pi)) / WATER_VISCOSITY_M2_S


def most_drag_coefficient(reynolds_number: float) -> float:
    """Largest drag coefficient of any body, on its frontal area; NaN where the Reynolds number is.

    Notes
    -----
    Hoerner, Fluid-Dynamic Drag (1965), chapter 3: discs and plates across the flow have 1.17 to 2, an open
    half cylinder 2.3, nothing has 3. In slow flow viscosity adds 24/Re to a sphere, 20.4/Re to a disc and
    64/Re to a body ten times as long as wide (a prolate spheroid along its axis; Happel and Brenner, Low
    Reynolds Number Hydrodynamics, section 5-11).

    >>> most_drag_coefficient(1e4), most_drag_coefficient(1.0)
    (3.0072, 75.0)
    """
    return 3.0 + 72.0 / reynolds_number if reynolds_number > 0 else float("nan")


def estimates(robot: Robot) -> list[Theory]:
    """What the robot file quotes, and what follows from the size of its body."""
    quoted = list(robot.theory)
    body = robot.body
    if body.length_m and body.width_m and body.height_m:
        value = prism_added_mass(body.length_m, body.width_m, body.height_m, robot.fluid.density_kg_m3)
        quoted.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return quoted
