"""The boxfish paper's own method for the falling-weight rig: speeds at two displacements.

Eqs 13-19: at a fixed displacement the squared speed is linear in the pulling mass; the slopes
at two displacements give ``a1`` (Eq 18, Eq 19 where the second is twice the first), hence drag
coefficient and added mass; slope and intercept give the pulley friction (Eq 17).

The method treats the moving mass as the same for all pulling weights. How much that biases it
is found by running it on noise-free data computed at its own answer, and is reported and
included in its stated error; the output-error fit has no such step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from swimid.errors import NoTrustworthyResult
from swimid.fitting.model import Array
from swimid.rig.equation import falling_weight_closed_form

#: What the method gives: 1, kg, N.
NAMES = ("drag_coefficient", "added_mass", "pulley_friction")


@dataclass(frozen=True)
class Drop:
    """One falling-weight trial for this method, since release and without missing samples."""

    pulling_mass_kg: float
    time_s: Array
    displacement_m: Array


@dataclass(frozen=True)
class TwoPointResult:
    """What the method gives.

    Attributes
    ----------
    values, stderr, bias : dict of name to float
        Of :data:`NAMES`; the standard error is of chance and bias together. The bias is what the method gives
        on perfect data of its own answer, minus that answer.
    points_m : tuple of float
        The two displacements.
    pulling_mass_kg : ndarray, shape (k,)
    speed_squared, speed_squared_sd : ndarray, shape (2, k), m2/s2
    slopes, intercepts : ndarray, shape (2,)
        Of squared speed against pulling mass: alpha and beta of Eq 13.
    """

    values: dict[str, float]
    stderr: dict[str, float]
    bias: dict[str, float]
    points_m: tuple[float, float]
    pulling_mass_kg: Array
    speed_squared: Array
    speed_squared_sd: Array
    slopes: Array
    intercepts: Array

    @property
    def answers(self) -> bool:
        """Whether the speeds lie on rising lines, so that there are errors."""
        return all(map(math.isfinite, self.stderr.values()))


def speed_at(
    time_s: Array, displacement_m: Array, point_m: float, half_width_m: float
) -> tuple[float, float]:
    """Speed at a displacement by a straight-line fit around it, and its standard error.

    Raises
    ------
    NoTrustworthyResult
        When fewer than three samples lie around the point.
    """
    near = np.abs(displacement_m - point_m) <= half_width_m
    if near.sum() < 3:
        raise NoTrustworthyResult(
            f"only {int(near.sum())} samples lie within {half_width_m:.3g} m of the displacement "
            f"{point_m:.3g} m",
            hint="choose --points inside the measured displacement, or use the default method",
        )
    t, x = time_s[near], displacement_m[near]
    if len(t) > 4:
        # A quadratic keeps the curvature out of the error estimate; its slope at the middle is the line's.
        residual = x - np.polyval(np.polyfit(t - t.mean(), x, 2), t - t.mean())
        spread = math.sqrt(float(residual @ residual) / max(len(t) - 3, 1))
    else:
        spread = 0.0
    centred = t - t.mean()
    slope = float(centred @ x) / float(centred @ centred)
    return slope, spread / math.sqrt(float(centred @ centred))


def two_point(
    drops: Sequence[Drop],
    *,
    mass_kg: float,
    frontal_area_m2: float,
    density_kg_m3: float,
    gravity_m_s2: float,
    points_m: tuple[float, float] | None = None,
) -> TwoPointResult:
    """Drag coefficient, added mass and pulley friction from speeds at two displacements.

    Parameters
    ----------
    drops : sequence of Drop
        At least three different pulling masses.
    mass_kg : float
        Inertia of body and pulley.
    points_m : (x1, x2), optional
        Default a quarter and a half of the displacement all drops reached. The paper took
        0.293 and 0.584 m. Each speed is fitted over a stretch of a sixth of x1 to either side.

    Raises
    ------
    NoTrustworthyResult
        Too few drops, points outside the data, or speeds that fit no drag at all.
    """
    masses = np.array([d.pulling_mass_kg for d in drops])
    if len(np.unique(masses)) < 3:
        raise NoTrustworthyResult("the two-point method needs at least three different pulling masses")
    reach = min(float(d.displacement_m.max()) for d in drops)
    points = points_m or (0.255 * reach, 0.51 * reach)
    if not 0 < points[0] < points[1]:
        raise NoTrustworthyResult(f"the two displacements must rise from zero: {points[0]:g} {points[1]:g}")
    width = points[0] / 6

    def speeds(displacements: Sequence[Array]) -> tuple[Array, Array]:
        """Speed at the points and its standard error, each shape (2, k)."""
        pairs = list(zip(drops, displacements, strict=True))
        fits = np.array([[speed_at(d.time_s, x, point, width) for d, x in pairs] for point in points])
        return fits[:, :, 0], fits[:, :, 1]

    def solve(squared: Array) -> tuple[Array, Array, Array]:
        slopes, intercepts = np.array([np.polyfit(masses, v, 1) for v in squared]).T
        a1 = _a1(slopes[0] / slopes[1], points)
        # tanh^2 phi(x) = 1 - exp(-2 a1 x), from Eq 14
        saturation = -np.expm1(-2 * a1 * np.array(points))
        drag = float(np.mean(2 * gravity_m_s2 * saturation / (density_kg_m3 * frontal_area_m2 * slopes)))
        moving = mass_kg + float(masses.mean())
        added = density_kg_m3 * drag * frontal_area_m2 / (2 * a1) - moving
        friction = float(np.mean(-gravity_m_s2 * intercepts / slopes))
        return np.array([drag, added, friction]), slopes, intercepts

    measured, measured_sd = speeds([d.displacement_m for d in drops])
    squared, squared_sd = measured**2, 2 * np.abs(measured) * measured_sd
    answer, slopes, intercepts = solve(squared)

    # from the scatter of the squared speeds about their lines
    scatter = squared - (slopes[:, None] * masses + intercepts[:, None])
    pooled = math.sqrt(float(np.sum(scatter**2)) / max(2 * len(masses) - 4, 1))
    spread = np.maximum(squared_sd, pooled)
    variance = np.zeros(3)
    for at in np.ndindex(squared.shape):
        moved = squared.copy()
        moved[at] += spread[at]
        try:
            variance += (solve(moved)[0] - answer) ** 2
        except NoTrustworthyResult:
            variance = np.full(3, np.inf)
            break

    drag, added, friction = answer
    area_factor = 0.5 * density_kg_m3 * frontal_area_m2 * drag
    perfect = [
        falling_weight_closed_form(
            d.time_s, 0.0, mass_kg + added + weight, area_factor, weight * gravity_m_s2 - friction
        )[0]
        for d, weight in zip(drops, masses, strict=True)
    ]
    bias = solve(speeds(perfect)[0] ** 2)[0] - answer

    def named(values: Array) -> dict[str, float]:
        return dict(zip(NAMES, map(float, values), strict=True))

    return TwoPointResult(
        values=named(answer),
        stderr=named(np.sqrt(np.sqrt(variance) ** 2 + bias**2)),
        bias=named(bias),
        points_m=(float(points[0]), float(points[1])),
        pulling_mass_kg=masses,
        speed_squared=squared,
        speed_squared_sd=squared_sd,
        slopes=slopes,
        intercepts=intercepts,
    )


def _a1(ratio: float, points: tuple[float, float]) -> float:
    """Solve Eq 18 for a1; Eq 19 where the second displacement is twice the first."""
    x1, x2 = points
    if not x1 / x2 < ratio < 1:
        raise NoTrustworthyResult(
            f"the squared speeds at {x1:.3g} m and {x2:.3g} m have the ratio {ratio:.3f}; "
            f"drag needs one between {x1 / x2:.3f} and 1",
            hint="choose other --points, or use the default method",
        )
    if abs(x2 - 2 * x1) < 1e-9 * x1:
        return -math.log(1 / ratio - 1) / (2 * x1)

    def mismatch(a1: float) -> float:
        return math.expm1(-2 * a1 * x1) / math.expm1(-2 * a1 * x2) - ratio

    return float(optimize.brentq(mismatch, 1e-9 / x1, 50 / x1))
