"""Quantities derived from the parameters of a rig, and tests whether these parameters are possible.

Terminal speed, period and damping ratios are derived with their standard errors. Added mass, drag and driving
force are compared with the largest values that any body of the known size can have, from theory and tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from swimid.fitting import fit_common
from swimid.fitting.covariance import UNIDENTIFIABLE
from swimid.fitting.experiment import Experiment
from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array, Trial
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate
from swimid.rig.model import COORDINATES, terminal_speed
from swimid.robots.file import Body, Robot, Theory

#: Added-mass coefficients of square prisms that move along their length (DNV-RP-C205, appendix D). Each row
#: has the ratio of length to side, and the added mass divided by the mass of the displaced water.
PRISM = np.array(
    [[1.0, 0.68], [2.0, 0.36], [3.0, 0.24], [4.0, 0.19], [5.0, 0.15], [6.0, 0.13], [7.0, 0.11], [10.0, 0.08]]
)
#: Maximum length of a body, in diameters of a circle with the frontal area of the body.
MAX_SLENDERNESS = 10.0
#: Minimum and maximum density of water (fresh to salt, kg/m3), and kinematic viscosity of water at 20 degrees
#: Celsius (m2/s).
WATER_KG_M3, WATER_VISCOSITY_M2_S = (950.0, 1050.0), 1.0e-6
#: Step of the finite differences of the delta method, in standard errors of the parameter.
DELTA_STEP = 1e-4
#: Function of the coefficients of the equation of motion; NaN if the quantity does not exist.
Quantity = Callable[[Mapping[str, float]], float]


def derive(experiment: Experiment, result: FitResult) -> dict[str, Estimate]:
    """Return the terminal speed of each falling-weight trial, or the period and damping ratios of a decay.

    A decay has two damping ratios. One includes all damping, at the amplitude of the largest first swing. The
    other includes linear damping only, and is the limit for small swings.
    """
    first = result.trials[0]
    quantities: dict[str, Estimate | None] = {}
    if experiment.name == "falling-weight":
        for trial in result.trials:
            terminal = partial(terminal_speed, force=trial.rig.pull)
            quantities[f"terminal_speed[{trial.id}]"] = propagate(result, trial, terminal, "m/s")
    if experiment.name == "free-decay":
        amplitude = max(_first_amplitude(result, t) for t in result.trials)
        unit = COORDINATES[result.model.channels[0].name][0]
        ratio = partial(_equivalent_ratio, amplitude=amplitude)
        quantities["natural_period_s"] = propagate(result, first, _period, "s")
        quantities["damping_ratio_linear"] = propagate(result, first, _linear_ratio, "1")
        quantities["first_swing"] = Estimate(value=amplitude, unit=unit, status="fixed")
        quantities["damping_ratio_first_swing"] = propagate(result, first, ratio, "1")
    return {name: e for name, e in quantities.items() if e is not None}


def propagate(result: FitResult, trial: Trial, quantity: Quantity, unit: str) -> Estimate | None:
    """Return the value and the standard error of a function of a trial's coefficients (delta method).

    The status is ``fixed`` if the function depends on no estimated parameter, and ``at-bound`` if it depends
    on a parameter at its bound. It is ``unidentifiable`` if the standard error is above half the value. The
    result is None if the function has no finite value.
    """

    def at(values: Array) -> float:
        return quantity(result.model.coefficients(values, trial.rig))  # type: ignore[attr-defined]

    values = result.values(trial.id)
    centre = at(values)
    if not math.isfinite(centre):
        return None
    names = [p.name for p in result.parameters]
    gradient = np.zeros(len(result.labels))
    unknown = False
    for j, label in enumerate(result.labels):
        name, _, owner = label.partition("[")
        if owner and owner != f"{trial.id}]":
            continue
        k = names.index(name)
        parameter, error = result.parameters[k], result.stderr(label)
        step = DELTA_STEP * (error or parameter.scale)
        moved = values.copy()
        moved[k] += step
        if moved[k] > parameter.upper:
            moved[k] = values[k] - step
        gradient[j] = (at(moved) - centre) / (moved[k] - values[k])
        # the value 0 at a lower bound of 0 needs no error: the errors of the other parameters allow for it
        vanishes = result.status[label] == "at-bound" and parameter.lower == 0.0 >= values[k]
        if gradient[j] != 0 and error is None and not vanishes:
            unknown = True
    known = np.isfinite(np.diag(result.covariance)) & (gradient != 0)
    statuses = {result.status[label] for label, g in zip(result.labels, gradient, strict=True) if g != 0}
    variance = float(gradient[known] @ result.covariance[np.ix_(known, known)] @ gradient[known])
    estimate = Estimate(value=centre, unit=unit, status="fixed")
    if unknown or not (math.isfinite(variance) and variance >= 0):
        estimate.status = "unidentifiable"
    elif known.any():
        estimate.status, estimate.stderr = "estimated", math.sqrt(variance)
    if estimate.stderr is None and "at-bound" in statuses:
        estimate.status = "at-bound"
    elif unit != "1" and (estimate.stderr or 0.0) > UNIDENTIFIABLE * abs(centre):
        estimate.status = "unidentifiable"
    return estimate


def _rate(c: Mapping[str, float]) -> float:
    """Return the natural angular frequency of small swings, rad/s; NaN without a restoring force."""
    stiffness = c["stiffness"] + c["gravity"]
    return math.sqrt(stiffness / c["inertia"]) if stiffness > 0 else math.nan


def _period(c: Mapping[str, float]) -> float:
    return 2 * math.pi / _rate(c)


def _linear_ratio(c: Mapping[str, float]) -> float:
    return c["linear"] / (2 * c["inertia"] * _rate(c))


def _equivalent_ratio(c: Mapping[str, float], amplitude: float) -> float:
    """Return the damping ratio with which linear damping alone would lose the same energy in a swing.

    Linear, quadratic and dry damping are linearised at the given amplitude (Chakrabarti, "Empirical
    calculation of roll damping for ships and barges", Ocean Engineering 2001).
    """
    speed = _rate(c) * amplitude
    if not speed > 0:
        return math.nan
    whole = c["linear"] + 8.0 / (3.0 * math.pi) * c["quadratic"] * speed + 4.0 / math.pi * c["dry"] / speed
    return whole / (2.0 * c["inertia"] * _rate(c))


def _first_amplitude(result: FitResult, trial: Trial) -> float:
    """Return the maximum displacement of the fitted decay from its rest position."""
    series = next(s for s in result.series if s.trial == trial.id)
    values = series.simulated[np.isfinite(series.simulated)]
    rest = result.values(trial.id)[result.model.index("rest_position")]
    return float(np.max(np.abs(values - rest), initial=0.0))


# ------------------------------------------------------------ possible bodies


def possible_checks(experiment: Experiment, result: FitResult) -> list[ev.Check]:
    """Check that added mass, drag, swing and driving force are physically possible.

    The limits follow from body mass, frontal area and size only. If a limit depended on the stated force, a
    wrong force could pass the check.
    """
    limits = [_added_mass_limit(experiment, result), _drag_limit(experiment, result)]
    checks = [_estimate_check(result, *limit) for limit in limits if limit is not None]
    coordinate = result.model.channels[0].name
    if coordinate in ("roll_rad", "pitch_rad"):
        checks.append(_swing_check(experiment, coordinate))
    if experiment.name == "falling-weight":
        checks += _force_check(experiment)
    return checks


#: Name of an estimate, its maximum, the body that has this maximum, and the inputs to check if it is
#: exceeded.
Limit = tuple[str, float, str, str]


def _drag_limit(experiment: Experiment, result: FitResult) -> Limit | None:
    """Return the limit of the drag coefficient: the maximum of all body shapes at the simulated speeds."""
    density = experiment.robot.fluid.density_kg_m3
    sized = [t for t in result.trials if t.role == "fit" and t.rig.area_factor]
    if result.status.get("drag_coefficient", "unidentifiable") == "unidentifiable" or not sized:
        return None
    speeds = [result.model.simulate(result.values(t.id), t)["u_m_s"] for t in sized]
    reached = [
        reynolds(float(np.nanmax(np.abs(u), initial=0.0)), 2.0 * t.rig.area_factor / density, density)
        for u, t in zip(speeds, sized, strict=True)
    ]
    most = max_drag_coefficient(max(reached))
    if not math.isfinite(most):
        return None
    basis = f"a body of any shape at a Reynolds number of {numbers.number(max(reached), 2)}"
    return "drag_coefficient", most, basis, "forces, areas, lengths"


def _added_mass_limit(experiment: Experiment, result: FitResult) -> Limit | None:
    """Return the limit of the added mass or of the added moment of inertia."""
    name = next((n for n in ("added_mass", "added_inertia") if n in result.labels), None)
    if name is None or result.status[name] == "unidentifiable":
        return None
    density, inputs = experiment.robot.fluid.density_kg_m3, "masses, forces"
    along = result.model.channels[0].name == "x_m"
    box = _box(experiment.robot.body)
    if box is not None:
        most = max_added_mass_in_box(*box, density, along=along)
        if name == "added_inertia":
            most = max_added_inertia(*box, density)
        return name, most, "a body in its box", inputs
    displaced = max(_max_displaced(experiment, t) for t in result.trials)
    if name == "added_inertia" or displaced <= 0:
        return None
    area = max(2.0 * t.rig.area_factor / density for t in result.trials)
    if along and area:
        return name, max_added_mass(displaced, area, density), "a body of its mass and size", inputs
    return name, max_added_mass(displaced, None, density), "a body of its mass", inputs


def _estimate_check(result: FitResult, name: str, most: float, basis: str, inputs: str) -> ev.Check:
    """Check that an estimate is not above its limit."""
    value, error = result.value(name), result.stderr(name) or 0.0
    unit = next(p.unit for p in result.parameters if p.name == name)
    size, limit = numbers.measured(value, error or None, unit), numbers.number(most, 2, unit)
    words, text = name.replace("_", " "), f"look at {inputs} and their units, and at what the model lacks"
    reason = f"{words} {size} is more than {basis} can have ({limit})"
    check = ("SWM072", f"{words} possible", size, not value > most, f"≤ {limit}", text, reason)
    return fit_common.warned_check(*check, failed=value - 1.96 * error > most)


def _swing_check(experiment: Experiment, name: str) -> ev.Check:
    """Check that the angle of a decay in roll or pitch stays within half a revolution of its median."""
    swings = []
    for trial in experiment.trials:
        values = trial.measured[name]
        swings.append((float(np.nanmax(np.abs(values - np.nanmedian(values)))), trial.id))
    size, limit = f"{numbers.number(max(swings)[0], 3, 'rad')} in {max(swings)[1]}", f"≤ {math.pi:.3g} rad"
    text = "a body that swings farther in roll or pitch turns over: are these degrees?"
    reason = f"the body swings by {size}, which no body does"
    check = ("SWM072", "swing possible", size, max(swings)[0] <= math.pi, limit, text, reason)
    return fit_common.warned_check(*check, failed=True)


def _force_check(experiment: Experiment) -> list[ev.Check]:
    """Check that the driving force of a body without a pulley is at most its weight or net buoyancy."""
    gravity = experiment.robot.fluid.gravity_m_s2
    forces: list[tuple[float, float, str]] = []
    for trial in experiment.trials:
        rig, water = trial.rig, _water_in_body(experiment, trial)
        if not rig.pulley and math.isfinite(water) and rig.inertia > 0:
            forces.append((rig.pull, gravity * max(rig.inertia, water - rig.inertia), trial.id))
    if not forces:
        return []
    force, most, name = max(forces, key=lambda f: f[0] / f[1])
    size, limit = f"{numbers.number(force, 3, 'N')} in {name}", f"≤ {numbers.number(most, 3, 'N')}"
    text = "look at its unit and the mass; only a drive of another kind is stronger"
    reason = f"the driving force of {size} is more than a body of its mass and size weighs or lifts"
    check = ("SWM072", "driving force possible", size, force <= most, limit, text, reason)
    return [fit_common.warned_check(*check)]


def _max_displaced(experiment: Experiment, trial: Trial) -> float:
    """Return the maximum mass of water that the body of a trial can displace, kg."""
    rig, gravity = trial.rig, experiment.robot.fluid.gravity_m_s2
    pulling = (experiment.facts.get("pulling_mass_kg") or {}).get(trial.id)
    if pulling is not None:
        return rig.inertia - pulling - experiment.robot.rig.pulley_inertia_kg
    if rig.pulley:
        return rig.inertia
    # a rising body displaces more than its own mass, by its net buoyancy, but not more than its size allows
    return max(rig.inertia, min(rig.inertia + rig.pull / gravity, _water_in_body(experiment, trial)))


def _box(body: Body) -> tuple[float, float, float] | None:
    """Return the length, width and height of a body, m; None if one is unknown."""
    if body.length_m and body.width_m and body.height_m:
        return body.length_m, body.width_m, body.height_m
    return None


def _water_in_body(experiment: Experiment, trial: Trial) -> float:
    """Return the mass of water in the largest body of the known size, kg; infinite if the size is unknown."""
    box, density = _box(experiment.robot.body), experiment.robot.fluid.density_kg_m3
    if box is not None:
        return density * math.prod(box)
    if not trial.rig.area_factor:
        return math.inf
    return max_displaced(2.0 * trial.rig.area_factor / density, density)


# ------------------------------------------------------------ theory and tables


def prism_added_mass(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Return the added mass of a box that moves along its length, kg.

    Notes
    -----
    Tabulated coefficients of square prisms (DNV-RP-C205, appendix D) are interpolated at the length of the
    box divided by the side of a square with the same frontal area. The coefficient multiplies the mass of the
    displaced water.

    >>> round(prism_added_mass(1.0, 1.0, 1.0, 1000.0))
    680
    """
    side = np.sqrt(width_m * height_m)
    coefficient = float(np.interp(length_m / side, PRISM[:, 0], PRISM[:, 1]))
    return coefficient * density_kg_m3 * length_m * width_m * height_m


def max_added_mass_in_box(
    length_m: float, width_m: float, height_m: float, density_kg_m3: float, *, along: bool
) -> float:
    """Return the maximum added mass of a body that fits into a box, kg.

    Parameters
    ----------
    along : bool
        Whether the body moves along its length. Otherwise it may move in any direction.

    Notes
    -----
    The flow around a moving body has the minimum kinetic energy of all possible flows (Kelvin). In one
    possible flow the surrounding water moves with the body. The added mass of a body is therefore at most the
    added mass of a larger body around it, plus all water between the two bodies. For motion along the length
    the larger body is the box. For motion in any direction it is the sphere around the box.

    >>> max_added_mass_in_box(1.0, 1.0, 1.0, 1000.0, along=True)
    1680.0
    """
    if along:
        displaced = density_kg_m3 * length_m * width_m * height_m
        return prism_added_mass(length_m, width_m, height_m, density_kg_m3) + displaced
    diagonal = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 1.5 * density_kg_m3 * float(np.pi) / 6.0 * diagonal**3


def max_added_inertia(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Return the maximum added moment of inertia of a body that rotates about a point in its box, kg m2.

    Notes
    -----
    The limit is derived as in :func:`max_added_mass_in_box`. It is the moment of inertia of a sphere of water
    whose radius is the diagonal of the box.

    >>> round(max_added_inertia(1.0, 1.0, 1.0, 1000.0))
    26119
    """
    radius = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 0.4 * density_kg_m3 * 4.0 / 3.0 * float(np.pi) * radius**5


def max_added_mass(displaced_kg: float, frontal_area_m2: float | None, density_kg_m3: float) -> float:
    """Return the maximum added mass of a convex body that moves perpendicular to its frontal area, kg.

    Parameters
    ----------
    displaced_kg : float
        Mass of the displaced water, or an upper bound of this mass.
    frontal_area_m2 : float or None

    Notes
    -----
    A convex body fills at least a third of the prism around it, as a pyramid does. The added mass of a prism
    along its length is at most 0.8 of the mass of water in a cube of the same frontal area (DNV-RP-C205,
    appendix D). The rest follows as in :func:`max_added_mass_in_box`. Without a frontal area the limit is ten
    times the displaced water. This is more than the added mass of a disc that is ten times as wide as thick.

    >>> round(max_added_mass(1.0, 0.01, 1000.0), 3)
    3.8
    """
    if frontal_area_m2 is None:
        return 10.0 * displaced_kg
    return 3.0 * displaced_kg + 0.8 * density_kg_m3 * frontal_area_m2**1.5


def max_displaced(frontal_area_m2: float, density_kg_m3: float) -> float:
    """Return the mass of water that the longest possible body with a frontal area displaces, kg.

    >>> round(max_displaced(np.pi / 4, 1000.0))
    7854
    """
    diameter = 2.0 * float(np.sqrt(frontal_area_m2 / np.pi))
    return density_kg_m3 * frontal_area_m2 * MAX_SLENDERNESS * diameter


def reynolds(speed_m_s: float, frontal_area_m2: float, density_kg_m3: float) -> float:
    """Return the Reynolds number with the diameter of the frontal area; NaN if the fluid is not water.

    >>> round(reynolds(1.0, np.pi / 4, 1000.0))
    1000000
    """
    low, high = WATER_KG_M3
    if not low <= density_kg_m3 <= high:
        return float("nan")
    return speed_m_s * 2.0 * float(np.sqrt(frontal_area_m2 / np.pi)) / WATER_VISCOSITY_M2_S


def max_drag_coefficient(reynolds_number: float) -> float:
    """Return the maximum drag coefficient of any body, based on its frontal area.

    The result is NaN if the Reynolds number is not positive.

    Notes
    -----
    Discs and plates across the flow have drag coefficients of 1.17 to 2, an open half cylinder has 2.3, and
    no body has 3 (Hoerner, Fluid-Dynamic Drag, 1965, chapter 3). In slow flow viscosity adds 24/Re for a
    sphere, 20.4/Re for a disc and 64/Re for a prolate spheroid that is ten times as long as wide (Happel and
    Brenner, Low Reynolds Number Hydrodynamics, section 5-11).

    >>> max_drag_coefficient(1e4), max_drag_coefficient(1.0)
    (3.0072, 75.0)
    """
    return 3.0 + 72.0 / reynolds_number if reynolds_number > 0 else float("nan")


def theory_estimates(robot: Robot) -> list[Theory]:
    """Return the theoretical estimates of the robot file, and the added mass of a prism of its size."""
    quoted = list(robot.theory)
    box = _box(robot.body)
    if box is not None:
        value = prism_added_mass(*box, robot.fluid.density_kg_m3)
        quoted.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return quoted
