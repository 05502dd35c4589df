"""Manoeuvres of a ship by the MMG standard method, in the axes and the dimensionless form of its source.

The source is Yasukawa and Yoshimura 2015, J. Mar. Sci. Technol. 20:37-52: x forward, y to starboard, drift
angle, advance ratio. SciPy integrates. Nothing of swimid is used. The log has y to port.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ship:
    """KVLCC2 as a model of 7 m (Tables 1 to 4 of the source)."""

    rho: float = 1000.0
    length: float = 7.0
    draft: float = 0.46
    mass: float = 3270.0
    ahead_of_midship: float = 0.2436
    inertia: float = 10014.375
    added: tuple[float, float, float] = (0.022, 0.223, 0.011)
    resistance: float = 0.022
    surge: tuple[float, ...] = (-0.040, 0.002, 0.011, 0.771)
    sway: tuple[float, ...] = (-0.315, 0.083, -1.607, 0.379, -0.391, 0.008)
    yaw: tuple[float, ...] = (-0.137, -0.049, -0.030, -0.294, 0.055, -0.013)
    diameter: float = 0.204
    open_water: tuple[float, float, float] = (0.3242, -0.2209, -0.1490)
    wake: float = 0.40
    #: C_1, and C_2 for a negative and a positive drift angle of the propeller.
    wake_change: tuple[float, float, float] = (2.0, 1.1, 1.6)
    propeller: float = -3.386
    deduction: float = 0.22
    rudder_area: float = 0.0539
    rudder_lift: float = 2.747
    #: The rudder is as high as the share 0.591 that the example file states for the propeller's diameter.
    rudder_height: float = 0.204 / 0.591
    ratio: float = 1.09
    gain: float = 0.5
    straightening: tuple[float, float] = (0.395, 0.640)
    inflow: float = -0.710
    steering: float = 0.387
    hull: tuple[float, float] = (0.312, -0.464)


def forces(ship: Ship, u: float, v: float, r: float, rudder: float, rate: float) -> Array:
    """Return surge force, sway force and yaw moment about midship: hull, propeller, rudder."""
    speed = np.hypot(u, v)
    beta, turn = np.arctan2(-v, u), r * ship.length / speed
    lateral = v / speed
    x, y, n = ship.surge, ship.sway, ship.yaw
    scale = 0.5 * ship.rho * ship.length * ship.draft * speed**2
    hull_x = (
        -ship.resistance * (u / speed) ** 2
        + x[0] * lateral**2
        + x[1] * lateral * turn
        + x[2] * turn**2
        + x[3] * lateral**4
    )
    products = np.array([lateral, turn, lateral**3, lateral**2 * turn, lateral * turn**2, turn**3])
    hull = np.array([hull_x, y @ products, ship.length * (n @ products)]) * scale
    # the sine of the drift angle of the propeller, with its own speed
    aside = -(v + ship.propeller * r) / np.hypot(u, v + ship.propeller * r)
    decay, growth = ship.wake_change[0], ship.wake_change[1 + int(aside > 0.0)]
    inflow = u * (1.0 - ship.wake) * (1.0 + (1.0 - np.exp(-decay * abs(aside))) * (growth - 1.0))
    advance = inflow / (rate * ship.diameter)
    thrust_coefficient = np.polyval(ship.open_water[::-1], advance)
    thrust = ship.rho * rate**2 * ship.diameter**4 * thrust_coefficient
    covered = ship.diameter / ship.rudder_height
    # the source's effective inflow angle holds for small drift angles, whose sine is -v / U
    rudder_angle = np.sin(beta) - ship.inflow * turn
    across = speed * ship.straightening[int(rudder_angle > 0.0)] * rudder_angle
    faster = 1.0 + ship.gain * (np.sqrt(1.0 + 8.0 * thrust_coefficient / (np.pi * advance**2)) - 1.0)
    along = ship.ratio * inflow * np.sqrt(covered * faster**2 + 1.0 - covered)
    attack = rudder - np.arctan2(across, along)
    normal = 0.5 * ship.rho * ship.rudder_area * (along**2 + across**2) * ship.rudder_lift * np.sin(attack)
    share, place = ship.hull
    steered = -normal * np.array(
        [
            (1.0 - ship.steering) * np.sin(rudder),
            (1.0 + share) * np.cos(rudder),
            (-0.5 * ship.length + share * place * ship.length) * np.cos(rudder),
        ]
    )
    return np.asarray(hull + steered + [(1.0 - ship.deduction) * thrust, 0.0, 0.0])


def simulate(
    ship: Ship,
    time_s: Array,
    rudder: Callable[[float], float],
    rate: Callable[[float], float],
    start: tuple[float, float, float] = (1.1, 0.0, 0.0),
) -> dict[str, Array]:
    """Return the columns of a log at midship, with y to port, for a rudder angle (rad) and a rate (1/s)."""
    unit = 0.5 * ship.rho * ship.length**2 * ship.draft
    m_x, m_y = (share * unit for share in ship.added[:2])
    j_z, x_g, m = ship.added[2] * unit * ship.length**2, ship.ahead_of_midship, ship.mass
    turned_inertia = ship.inertia + x_g**2 * m

    def slope(now: float, state: Array) -> list[float]:
        _, _, heading, u, v, r = state
        force_x, force_y, moment = forces(ship, u, v, r, rudder(now), rate(now))
        du = (force_x + (m + m_y) * v * r + x_g * m * r**2) / (m + m_x)
        matrix = np.array([[m + m_y, x_g * m], [x_g * m, turned_inertia + j_z]])
        dv, dr = np.linalg.solve(matrix, [force_y - (m + m_x) * u * r, moment - x_g * m * u * r])
        c, s = np.cos(heading), np.sin(heading)
        return [u * c - v * s, u * s + v * c, r, du, dv, dr]

    begin = [0.0, 0.0, 0.0, *start]
    found = solve_ivp(
        slope, (time_s[0], time_s[-1]), begin, "DOP853", time_s, rtol=1e-10, atol=1e-10, max_step=0.1
    ).y
    signs = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])[:, None]
    names = ("x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s")
    return {"t_s": time_s, **dict(zip(names, signs * found, strict=True))}
