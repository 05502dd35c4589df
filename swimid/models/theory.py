"""Estimates from theory and tables, to put beside measured parameters."""

from __future__ import annotations

import numpy as np

from swimid.formats.robot import Robot, Theory

#: Added-mass coefficient of a square prism moving along its length, by length over side;
#: reference volume is the prism's own (DNV-RP-C205, appendix D).
_PRISM = np.array(
    [[1.0, 0.68], [2.0, 0.36], [3.0, 0.24], [4.0, 0.19], [5.0, 0.15], [6.0, 0.13], [7.0, 0.11], [10.0, 0.08]]
)


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


def estimates(robot: Robot) -> list[Theory]:
    """What the robot file quotes, and what follows from the size of its body."""
    found = list(robot.theory)
    body = robot.body
    if body.length_m and body.width_m and body.height_m:
        value = prism_added_mass(body.length_m, body.width_m, body.height_m, robot.fluid.density_kg_m3)
        found.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return found
