"""Quantities that follow from the parameters of a rig, and whether a body can have these parameters.

Terminal speed, period and damping ratios are derived with their errors. Added mass, drag and driving force
are compared with the largest that a body of the known size can have, by theory and tables.
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
#: A quantity as a function of the coefficients of the equation of motion; NaN where there is none.
Quantity = Callable[[Mapping[str, float]], float]


def derived(experiment: Experiment, result: FitResult) -> dict[str, Estimate]:
    """Terminal speed of each falling-weight trial; period and damping ratios of a decay.

    A decay's damping ratio is given at the largest first swing, all damping taken together, and in the
    limit of small ones, where the linear part alone is left.
    """
    first = result.trials[0]
    quantities: dict[str, Estimate | None] = {}
    if experiment.name == "falling-weight":
        for trial in result.trials:
            terminal = partial(terminal_speed, force=trial.rig.pull)
            quantities[f"terminal_speed[{trial.id}]"] = propagated(result, trial, terminal, "m/s")
    if experiment.name == "free-decay":
        quantities["natural_period_s"] = propagated(result, first, _period, "s")
        quantities["damping_ratio_linear"] = propagated(result, first, _linear_ratio, "1")
        amplitude = max(_first_amplitude(result, t) for t in result.trials)
        unit = COORDINATES[result.model.channels[0].name][0]
        quantities["first_swing"] = Estimate(value=amplitude, unit=unit, status="fixed")
        ratio = partial(_equivalent_ratio, amplitude=amplitude)
        quantities["damping_ratio_first_swing"] = propagated(result, first, ratio, "1")
    return {name: e for name, e in quantities.items() if e is not None}


def propagated(result: FitResult, trial: Trial, quantity: Quantity, unit: str) -> Estimate | None:
    """A function of a trial's coefficients with its standard error, to first order.

    Its status is that of what it depends on: ``fixed`` where that is nothing estimated, ``at-bound``
    where a bound holds a part of it, ``unidentifiable`` where its own error is above half its size.
    None where there is no such quantity.
    """

    def at(values: Array) -> float:
        return quantity(result.model.coefficients(values, trial.rig))  # type: ignore[attr-defined]

    values = result.values(trial.id)
    centre = at(values)
    if not math.isfinite(centre):
        return None
    names = [p.name for p in result.parameters]
    gradient = np.zeros(len(result.labels))
    held = False
    for j, label in enumerate(result.labels):
        name, _, owner = label.partition("[")
        if owner and owner != f"{trial.id}]":
            continue
        parameter = result.parameters[names.index(name)]
        step = 1e-4 * (result.stderr(label) or parameter.scale)
        moved = values.copy()
        moved[names.index(name)] += step if values[names.index(name)] + step <= parameter.upper else -step
        slope = (at(moved) - centre) / (moved[names.index(name)] - values[names.index(name)])
        # what vanishes at its bound is none; the others' errors were taken with it free
        vanishes = result.status[label] == "at-bound" and parameter.lower == 0.0 >= values[names.index(name)]
        if slope != 0 and result.stderr(label) is None and not vanishes:
            held = True
        gradient[j] = slope
    known = np.isfinite(np.diag(result.covariance)) & (gradient != 0)
    statuses = {result.status[label] for label, g in zip(result.labels, gradient, strict=True) if g != 0}
    if "at-bound" in statuses and (held or not known.any()):
        return Estimate(value=centre, unit=unit, status="at-bound")
    if not held and not known.any():
        return Estimate(value=centre, unit=unit, status="fixed")
    variance = float(gradient[known] @ result.covariance[np.ix_(known, known)] @ gradient[known])
    if held or not (math.isfinite(variance) and variance >= 0):
        return Estimate(value=centre, unit=unit, status="unidentifiable")
    error = math.sqrt(variance)
    vague = error > UNIDENTIFIABLE * abs(centre) and unit != "1"
    return Estimate(value=centre, stderr=error, unit=unit, status="unidentifiable" if vague else "estimated")


def possible(experiment: Experiment, result: FitResult) -> list[ev.Check]:
    """Whether a body can have the added mass and drag found, and the stated force; warns where it cannot.

    The bounds rest on what is known without the force: body mass, frontal area, size. One that the stated
    force widened would let a wrong force pass with whatever follows from it.
    """
    limits = [_most_added(experiment, result), _most_drag(experiment, result)]
    # a value that the trials do not tell is no evidence of anything impossible
    told = [limit for limit in limits if limit and result.status[limit[0]] != "unidentifiable"]
    checks = [_estimate_possible(result, *limit) for limit in told]
    return [*checks, *_force_possible(experiment), *_swing_possible(experiment)]


def _swing_possible(experiment: Experiment) -> list[ev.Check]:
    """Check that no body swings by more than half a turn in roll or pitch: beyond it, it turns over."""
    swings = [
        (float(np.nanmax(np.abs(values - np.nanmedian(values)))), trial.id)
        for trial in experiment.trials
        for name, values in trial.measured.items()
        if experiment.name == "free-decay" and name in ("roll_rad", "pitch_rad")
    ]
    if not swings:
        return []
    swing, name = max(swings)
    text = "a body that swings farther in roll or pitch turns over: are these degrees?"
    value, limit = f"{numbers.number(swing, 3, 'rad')} in {name}", f"≤ {numbers.number(math.pi, 3, 'rad')}"
    reason = f"{name} swings by {numbers.number(swing, 3, 'rad')}, which no body does"
    small = swing <= math.pi
    return [ev.check("swing possible", value, small, limit, text, otherwise="fail", reason=reason)]


#: The name of an estimate, the most it can be, of what body, and what to look at where it is more.
Limit = tuple[str, float, str, str]


def _most_drag(experiment: Experiment, result: FitResult) -> Limit | None:
    """The largest drag coefficient of any body at the speeds reached."""
    density = experiment.robot.fluid.density_kg_m3
    sized = [t for t in result.trials if t.role == "fit" and t.rig.area_factor]
    if "drag_coefficient" not in result.labels or not sized:
        return None
    numbers_reached = []
    for trial in sized:
        speed = np.abs(result.model.simulate(result.values(trial.id), trial)["u_m_s"])
        fastest = float(np.nanmax(speed, initial=0.0))
        numbers_reached.append(reynolds(fastest, 2.0 * trial.rig.area_factor / density, density))
    largest = max(numbers_reached)
    most = most_drag_coefficient(largest)
    if not math.isfinite(most):
        return None
    basis = f"a body of any shape at a Reynolds number of {numbers.number(largest, 2)}"
    return "drag_coefficient", most, basis, "forces, areas, lengths"


def _estimate_possible(result: FitResult, name: str, most: float, basis: str, inputs: str) -> ev.Check:
    """Check of an estimate against the most a body can have; warns where it is above."""
    value, error = result.value(name), result.stderr(name) or 0.0
    unit = next(p.unit for p in result.parameters if p.name == name)
    size, limit = numbers.measured(value, error or None, unit), numbers.number(most, 2, unit)
    words = name.replace("_", " ")
    return fit_common.warned_check(
        "SWM072",
        f"{words} possible",
        size,
        not value > most,
        f"≤ {limit}",
        f"look at {inputs} and their units, and at what the model lacks" if value > most else "",
        f"{words} {size} is more than {basis} can have ({limit})",
        failed=value - 1.96 * error > most,
    )


def _force_possible(experiment: Experiment) -> list[ev.Check]:
    """Whether weight or lift can be as large as the stated force that drives a body without a pulley."""
    gravity = experiment.robot.fluid.gravity_m_s2
    forces: list[tuple[float, float, str]] = []
    for trial in experiment.trials if experiment.name == "falling-weight" else []:
        rig, water = trial.rig, _most_water(experiment, trial)
        if not rig.pulley and math.isfinite(water) and rig.inertia > 0:
            forces.append((rig.pull, gravity * max(rig.inertia, water - rig.inertia), trial.id))
    if not forces:
        return []
    force, most, name = max(forces, key=lambda f: f[0] / f[1])
    size, limit = numbers.number(force, 3, "N"), numbers.number(most, 3, "N")
    text = "look at its unit and the mass; only a drive of another kind is stronger" if force > most else ""
    reason = f"the driving force of {name}, {size}, is more than a body of its mass and size weighs or lifts"
    value, passed = f"{size} in {name}", force <= most
    check = ("SWM072", "driving force possible", value, passed, f"≤ {limit}", text, reason)
    return [fit_common.warned_check(*check)]


def _most_added(experiment: Experiment, result: FitResult) -> Limit | None:
    """Largest possible added mass or inertia."""
    name = next((n for n in ("added_mass", "added_inertia") if n in result.labels), None)
    body, density = experiment.robot.body, experiment.robot.fluid.density_kg_m3
    along, inputs = result.model.channels[0].name == "x_m", "masses, forces"
    if name is None:
        return None
    if body.length_m and body.width_m and body.height_m:
        box = (body.length_m, body.width_m, body.height_m, density)
        turns = name == "added_inertia"
        most = most_added_inertia(*box) if turns else most_added_mass_in_box(*box, along=along)
        return name, most, "a body in its box", inputs
    displaced = max(_displaced(experiment, t) for t in result.trials)
    if name == "added_inertia" or displaced <= 0:
        return None
    area = max(2.0 * t.rig.area_factor / density for t in result.trials)
    most = most_added_mass(displaced, area if along and area else None, density)
    return name, most, "a body of its mass and size" if along and area else "a body of its mass", inputs


def _displaced(experiment: Experiment, trial: Trial) -> float:
    """Most water a trial's body displaces, kg, as far as its mass and size tell."""
    rig, gravity = trial.rig, experiment.robot.fluid.gravity_m_s2
    pulling = (experiment.facts.get("pulling_mass_kg") or {}).get(trial.id)
    if pulling is not None:
        return rig.inertia - pulling - experiment.robot.rig.pulley_inertia_kg
    mass = rig.inertia
    if rig.pulley:
        return mass
    # what rises is lighter than its water by its lift; but no lighter than its size allows
    return max(mass, min(mass + rig.pull / gravity, _most_water(experiment, trial)))


def _most_water(experiment: Experiment, trial: Trial) -> float:
    """Mass of the water in the largest body of a trial's size, kg; infinite where that is not known."""
    body, density = experiment.robot.body, experiment.robot.fluid.density_kg_m3
    if body.length_m and body.width_m and body.height_m:
        return density * body.length_m * body.width_m * body.height_m
    factor = trial.rig.area_factor
    return most_displaced(2.0 * factor / density, density) if factor else math.inf


def _rate(c: Mapping[str, float]) -> float:
    """Return the natural frequency of small swings, rad/s."""
    return math.sqrt(max(c["stiffness"] + c["gravity"], 0.0) / c["inertia"])


def _period(c: Mapping[str, float]) -> float:
    return 2 * math.pi / _rate(c) if _rate(c) > 0 else math.nan


def _linear_ratio(c: Mapping[str, float]) -> float:
    return c["linear"] / (2 * c["inertia"] * _rate(c)) if _rate(c) > 0 else math.nan


def _equivalent_ratio(c: Mapping[str, float], amplitude: float) -> float:
    """Damping ratio that takes as much energy out of a swing of this amplitude as all damping together.

    Linear, quadratic and dry (equivalent linearisation; Chakrabarti, "Empirical calculation of roll damping
    for ships and barges", Ocean Engineering 2001).
    """
    rate = _rate(c)
    if rate <= 0 or amplitude <= 0:
        return math.nan
    speed = rate * amplitude
    whole = c["linear"] + 8.0 / (3.0 * math.pi) * c["quadratic"] * speed + 4.0 / math.pi * c["dry"] / speed
    return whole / (2.0 * c["inertia"] * rate)


def _first_amplitude(result: FitResult, trial: Trial) -> float:
    """Excursion from the rest position at the start of a decay, as it was fitted."""
    series = next(s for s in result.series if s.trial == trial.id)
    values = series.simulated[np.isfinite(series.simulated)]
    rest = result.values(trial.id)[result.model.index("rest_position")]
    return float(np.max(np.abs(values - rest), initial=0.0))


# ------------------------------------------------------------ theory and tables


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


def theory_estimates(robot: Robot) -> list[Theory]:
    """Return the estimates that the robot file quotes, and the added mass of a prism of its size."""
    quoted = list(robot.theory)
    body = robot.body
    if body.length_m and body.width_m and body.height_m:
        value = prism_added_mass(body.length_m, body.width_m, body.height_m, robot.fluid.density_kg_m3)
        quoted.append(
            Theory(parameter="added_mass", value=value, unit="kg", basis="square prism", source="DNV-RP-C205")
        )
    return quoted
