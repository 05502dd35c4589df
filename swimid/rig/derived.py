"""Quantities derived from the parameters of a rig, and tests of whether a body can have these parameters.

Terminal speed, period and damping ratios are derived with their standard errors. Added mass, drag and driving
force are compared with the largest values of any body of the known size, from theory and tables.
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

#: Length over side, and added-mass coefficient of a square prism that moves along its length, on its own
#: volume (DNV-RP-C205, appendix D).
PRISM = np.array(
    [[1.0, 0.68], [2.0, 0.36], [3.0, 0.24], [4.0, 0.19], [5.0, 0.15], [6.0, 0.13], [7.0, 0.11], [10.0, 0.08]]
)
#: Largest length of a body, in diameters of its frontal area.
MAX_SLENDERNESS = 10.0
#: Densities of fresh and salt water (kg/m3), and their kinematic viscosity at 20 degrees Celsius (m2/s).
WATER_KG_M3, WATER_VISCOSITY_M2_S = (950.0, 1050.0), 1.0e-6
#: Step of the finite differences of the delta method, in standard errors.
DELTA_STEP = 1e-4
#: Function of the coefficients of the equation of motion; NaN if it has no value.
Quantity = Callable[[Mapping[str, float]], float]


def derive(experiment: Experiment, result: FitResult) -> dict[str, Estimate]:
    """Return the terminal speed of each falling-weight trial, or period and damping ratios of a decay.

    There are two damping ratios of a decay: of all damping at the largest first swing, and of linear damping
    alone, which is the limit of small swings.
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
    """Return a function of the coefficients of a trial with its standard error, by the delta method.

    The status is ``fixed`` if the function depends on no estimated parameter, ``at-bound`` if a parameter at
    its bound takes part, and ``unidentifiable`` if the standard error is above half the value. The result is
    None if the function has no value.
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
        # a parameter that is zero at its bound needs no error: the errors of the others allow for it
        vanishes = result.status[label] == "at-bound" and parameter.lower == 0.0 >= values[k]
        if gradient[j] != 0 and error is None and not vanishes:
            unknown = True
    known = np.isfinite(np.diag(result.covariance)) & (gradient != 0)
    statuses = {result.status[label] for label, g in zip(result.labels, gradient, strict=True) if g != 0}
    if "at-bound" in statuses and (unknown or not known.any()):
        return Estimate(value=centre, unit=unit, status="at-bound")
    if not unknown and not known.any():
        return Estimate(value=centre, unit=unit, status="fixed")
    variance = float(gradient[known] @ result.covariance[np.ix_(known, known)] @ gradient[known])
    if unknown or not (math.isfinite(variance) and variance >= 0):
        return Estimate(value=centre, unit=unit, status="unidentifiable")
    estimate = Estimate(value=centre, stderr=math.sqrt(variance), unit=unit, status="estimated")
    if unit != "1" and math.sqrt(variance) > UNIDENTIFIABLE * abs(centre):
        estimate.status = "unidentifiable"
    return estimate


def _rate(c: Mapping[str, float]) -> float:
    """Return the natural frequency of small swings, rad/s; NaN without a restoring force."""
    stiffness = c["stiffness"] + c["gravity"]
    return math.sqrt(stiffness / c["inertia"]) if stiffness > 0 else math.nan


def _period(c: Mapping[str, float]) -> float:
    return 2 * math.pi / _rate(c)


def _linear_ratio(c: Mapping[str, float]) -> float:
    return c["linear"] / (2 * c["inertia"] * _rate(c))


def _equivalent_ratio(c: Mapping[str, float], amplitude: float) -> float:
    """Return the ratio of linear damping with the same loss of energy in a swing of this amplitude.

    Linear, quadratic and dry damping are linearised (Chakrabarti, "Empirical calculation of roll damping for
    ships and barges", Ocean Engineering 2001).
    """
    speed = _rate(c) * amplitude
    if not speed > 0:
        return math.nan
    whole = c["linear"] + 8.0 / (3.0 * math.pi) * c["quadratic"] * speed + 4.0 / math.pi * c["dry"] / speed
    return whole / (2.0 * c["inertia"] * _rate(c))


def _first_amplitude(result: FitResult, trial: Trial) -> float:
    """Return the largest excursion of the fitted decay from its rest position."""
    series = next(s for s in result.series if s.trial == trial.id)
    values = series.simulated[np.isfinite(series.simulated)]
    rest = result.values(trial.id)[result.model.index("rest_position")]
    return float(np.max(np.abs(values - rest), initial=0.0))


# ------------------------------------------------------------ possible bodies


def possible_checks(experiment: Experiment, result: FitResult) -> list[ev.Check]:
    """Check that a body can have the added mass, the drag and the swing, and that the force can be right.

    The limits follow from body mass, frontal area and size alone. A limit that depended on the stated force
    would let a wrong force pass.
    """
    checks = []
    for limit in (_added_mass_limit(experiment, result), _drag_limit(experiment, result)):
        if limit is not None and result.status[limit[0]] != "unidentifiable":
            checks.append(_estimate_check(result, *limit))
    if experiment.name == "free-decay":
        checks += _swing_check(experiment)
    if experiment.name == "falling-weight":
        checks += _force_check(experiment)
    return checks


#: Name of an estimate, its limit, the body that the limit is of, and the inputs to look at beyond it.
Limit = tuple[str, float, str, str]


def _drag_limit(experiment: Experiment, result: FitResult) -> Limit | None:
    """Return the largest drag coefficient of any body at the speeds reached."""
    density = experiment.robot.fluid.density_kg_m3
    sized = [t for t in result.trials if t.role == "fit" and t.rig.area_factor]
    if "drag_coefficient" not in result.labels or not sized:
        return None
    reached = []
    for trial in sized:
        speed = np.abs(result.model.simulate(result.values(trial.id), trial)["u_m_s"])
        fastest = float(np.nanmax(speed, initial=0.0))
        reached.append(reynolds(fastest, 2.0 * trial.rig.area_factor / density, density))
    most = max_drag_coefficient(max(reached))
    if not math.isfinite(most):
        return None
    basis = f"a body of any shape at a Reynolds number of {numbers.number(max(reached), 2)}"
    return "drag_coefficient", most, basis, "forces, areas, lengths"


def _added_mass_limit(experiment: Experiment, result: FitResult) -> Limit | None:
    """Return the largest possible added mass or inertia."""
    name = next((n for n in ("added_mass", "added_inertia") if n in result.labels), None)
    if name is None:
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
    """Check an estimate against its limit."""
    value, error = result.value(name), result.stderr(name) or 0.0
    unit = next(p.unit for p in result.parameters if p.name == name)
    size, limit = numbers.measured(value, error or None, unit), numbers.number(most, 2, unit)
    words, possible = name.replace("_", " "), not value > most
    return fit_common.warned_check(
        "SWM072",
        f"{words} possible",
        size,
        possible,
        f"≤ {limit}",
        f"look at {inputs} and their units, and at what the model lacks" * (not possible),
        f"{words} {size} is more than {basis} can have ({limit})",
        failed=value - 1.96 * error > most,
    )


def _swing_check(experiment: Experiment) -> list[ev.Check]:
    """Check that a decay in roll or pitch swings by less than half a turn."""
    swings = [
        (float(np.nanmax(np.abs(values - np.nanmedian(values)))), trial.id)
        for trial in experiment.trials
        for name, values in trial.measured.items()
        if name in ("roll_rad", "pitch_rad")
    ]
    if not swings:
        return []
    swing, name = max(swings)
    size, limit = numbers.number(swing, 3, "rad"), numbers.number(math.pi, 3, "rad")
    text = "a body that swings farther in roll or pitch turns over: are these degrees?"
    reason = f"{name} swings by {size}, which no body does"
    passed = swing <= math.pi
    return [
        ev.check(
            "swing possible", f"{size} in {name}", passed, f"≤ {limit}", text, otherwise="fail", reason=reason
        )
    ]


def _force_check(experiment: Experiment) -> list[ev.Check]:
    """Check that the weight or the lift of a body without a pulley can be as large as its driving force."""
    gravity = experiment.robot.fluid.gravity_m_s2
    forces: list[tuple[float, float, str]] = []
    for trial in experiment.trials:
        rig, water = trial.rig, _water_in_body(experiment, trial)
        if not rig.pulley and math.isfinite(water) and rig.inertia > 0:
            forces.append((rig.pull, gravity * max(rig.inertia, water - rig.inertia), trial.id))
    if not forces:
        return []
    force, most, name = max(forces, key=lambda f: f[0] / f[1])
    size, limit = numbers.number(force, 3, "N"), numbers.number(most, 3, "N")
    passed = force <= most
    text = "look at its unit and the mass; only a drive of another kind is stronger" * (not passed)
    reason = f"the driving force of {name}, {size}, is more than a body of its mass and size weighs or lifts"
    check = ("SWM072", "driving force possible", f"{size} in {name}", passed, f"≤ {limit}", text, reason)
    return [fit_common.warned_check(*check)]


def _max_displaced(experiment: Experiment, trial: Trial) -> float:
    """Return the largest mass of water that the body of a trial can displace, kg."""
    rig, gravity = trial.rig, experiment.robot.fluid.gravity_m_s2
    pulling = (experiment.facts.get("pulling_mass_kg") or {}).get(trial.id)
    if pulling is not None:
        return rig.inertia - pulling - experiment.robot.rig.pulley_inertia_kg
    if rig.pulley:
        return rig.inertia
    # a rising body is lighter than its water by its lift, but it displaces no more than its size allows
    return max(rig.inertia, min(rig.inertia + rig.pull / gravity, _water_in_body(experiment, trial)))


def _box(body: Body) -> tuple[float, float, float] | None:
    """Return length, width and height of a body, m."""
    if body.length_m and body.width_m and body.height_m:
        return body.length_m, body.width_m, body.height_m
    return None


def _water_in_body(experiment: Experiment, trial: Trial) -> float:
    """Return the mass of water in the largest body of the size of a trial, kg; infinite if unknown."""
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
    Tabulated coefficients of square prisms (DNV-RP-C205, appendix D) are interpolated at the length over the
    side of a square of the same frontal area. The coefficient multiplies the mass of the displaced water.

    >>> round(prism_added_mass(1.0, 1.0, 1.0, 1000.0))
    680
    """
    side = np.sqrt(width_m * height_m)
    coefficient = float(np.interp(length_m / side, PRISM[:, 0], PRISM[:, 1]))
    return coefficient * density_kg_m3 * length_m * width_m * height_m


def max_added_mass_in_box(
    length_m: float, width_m: float, height_m: float, density_kg_m3: float, *, along: bool
) -> float:
    """Return the largest added mass of a body that lies in a box, kg.

    Parameters
    ----------
    along : bool
        The body moves along its length; otherwise in any direction.

    Notes
    -----
    Water takes the motion of least energy (Kelvin), and one possible motion is that it moves with the body.
    So the added mass of a body is at most that of a larger one around it, plus all water between the two. The
    larger one is the box along its length, and in any direction the ball around the box.

    >>> max_added_mass_in_box(1.0, 1.0, 1.0, 1000.0, along=True)
    1680.0
    """
    if along:
        displaced = density_kg_m3 * length_m * width_m * height_m
        return prism_added_mass(length_m, width_m, height_m, density_kg_m3) + displaced
    diagonal = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 1.5 * density_kg_m3 * float(np.pi) / 6.0 * diagonal**3


def max_added_inertia(length_m: float, width_m: float, height_m: float, density_kg_m3: float) -> float:
    """Return the largest added moment of inertia of a body that turns about a point in its box, kg m2.

    Notes
    -----
    See :func:`max_added_mass_in_box`. The limit is the moment of inertia of a ball of water with the diagonal
    of the box as its radius.

    >>> round(max_added_inertia(1.0, 1.0, 1.0, 1000.0))
    26119
    """
    radius = float(np.sqrt(length_m**2 + width_m**2 + height_m**2))
    return 0.4 * density_kg_m3 * 4.0 / 3.0 * float(np.pi) * radius**5


def max_added_mass(displaced_kg: float, frontal_area_m2: float | None, density_kg_m3: float) -> float:
    """Return the largest added mass of a convex body that moves across its frontal area, kg.

    Parameters
    ----------
    displaced_kg : float
        Mass of the displaced water, or an upper bound of it.
    frontal_area_m2 : float or None

    Notes
    -----
    A convex body fills at least a third of the prism around it, as a pyramid does. The added mass of a prism
    along its length is at most 0.8 of the water in a cube of its frontal area (DNV-RP-C205, appendix D). See
    :func:`max_added_mass_in_box` for the rest. Without an area the limit is ten times the displaced water,
    which is more than that of a disc ten times as wide as thick.

    >>> round(max_added_mass(1.0, 0.01, 1000.0), 3)
    3.8
    """
    if frontal_area_m2 is None:
        return 10.0 * displaced_kg
    return 3.0 * displaced_kg + 0.8 * density_kg_m3 * frontal_area_m2**1.5


def max_displaced(frontal_area_m2: float, density_kg_m3: float) -> float:
    """Return the mass of water that the longest body of a frontal area displaces, kg.

    >>> round(max_displaced(np.pi / 4, 1000.0))
    7854
    """
    diameter = 2.0 * float(np.sqrt(frontal_area_m2 / np.pi))
    return density_kg_m3 * frontal_area_m2 * MAX_SLENDERNESS * diameter


def reynolds(speed_m_s: float, frontal_area_m2: float, density_kg_m3: float) -> float:
    """Return the Reynolds number with the diameter of the frontal area; NaN in a fluid that is not water.

    >>> round(reynolds(1.0, np.pi / 4, 1000.0))
    1000000
    """
    low, high = WATER_KG_M3
    if not low <= density_kg_m3 <= high:
        return float("nan")
    return speed_m_s * 2.0 * float(np.sqrt(frontal_area_m2 / np.pi)) / WATER_VISCOSITY_M2_S


def max_drag_coefficient(reynolds_number: float) -> float:
    """Return the largest drag coefficient of any body, on its frontal area; NaN without a Reynolds number.

    Notes
    -----
    Discs and plates across the flow have 1.17 to 2, an open half cylinder 2.3, and no body has 3 (Hoerner,
    Fluid-Dynamic Drag, 1965, chapter 3). In slow flow viscosity adds 24/Re to a sphere, 20.4/Re to a disc and
    64/Re to a prolate spheroid ten times as long as wide (Happel and Brenner, Low Reynolds Number
    Hydrodynamics, section 5-11).

    >>> max_drag_coefficient(1e4), max_drag_coefficient(1.0)
    (3.0072, 75.0)
    """
    return 3.0 + 72.0 / reynolds_number if reynolds_number > 0 else float("nan")


def theory_estimates(robot: Robot) -> list[Theory]:
    """Return the estimates that the robot file quotes, and the added mass of a prism of its size."""
    quoted = list(robot.theory)
    box = _box(robot.body)
    if box is not None:
        value = prism_added_mass(*box, robot.fluid.density_kg_m3)
        quoted.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return quoted
