"""Command ``optimise stiffness``: a rule by which a controller sets the stiffness of a passive joint.

This module has the search, the rule file (``swimid-rule/2``), and the evidence of the rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files import yamlio
from swimid.files.yamlio import Number, Rows
from swimid.fitting.model import Array
from swimid.notices import Notice, Progress, record_warnings, silent
from swimid.optimisation import study as studies
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.problem import GaitProblem
from swimid.optimisation.study import (
    BEAT,
    OptimisationStudy,
    Performance,
    StudyFile,
    in_parallel,
    points_of,
    study_of,
)
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult

#: Degree of the polynomial of the frequency that gives the stiffness at one amplitude (Algorithm 1 of
#: "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin").
CURVE_DEGREE = 2
#: Radius of the finite differences in the first step and at the end of the final search, as a fraction of the
#: stiffness range. The final search starts at the best point of a Pareto front.
SEARCH_RADIUS, MIN_RADIUS = 0.01, 5e-4
#: Maximum distance from an end of its range at which a stiffness counts as at its bound, as a fraction of the
#: range.
BOUND_TOL = 1e-3
#: Maximum relative loss of speed, or increase of the cost of transport, that is accepted if the rule is used
#: in place of the optimal stiffnesses.
MAX_LOSS = 0.02

#: Names of the quantities by which the stiffness rule is compared with the optimal stiffnesses: mean speed,
#: and cost of transport.
SPEED, COST = "mean_speed_m_s", "cost_of_transport_J_m"

Outside = Literal["refuse", "hold"]


class Curve(yamlio.Document):
    """Curve of a stiffness rule at one amplitude: ``c0 + c1 f + c2 f^2`` with the frequency f in Hz."""

    amplitude_deg: float
    coefficients: tuple[float, float, float]
    #: Root-mean-square deviation of the optimal stiffnesses from the curve, in the unit of the stiffness.
    rms: float


class Optimum(yamlio.Document):
    """Optimal stiffness of a passive joint at one frequency and amplitude of the drive."""

    frequency_hz: float
    amplitude_deg: float
    stiffness: float
    at_bound: bool = False
    #: Quantities of a simulation, in SI units, for three stiffnesses: the optimal stiffness, the stiffness of
    #: the rule, and the fixed reference stiffness.
    best: dict[str, Number] = {}
    ruled: dict[str, Number] = {}
    reference: dict[str, Number] = {}
    #: Pareto front. Each row has a stiffness and the values of two objectives, with the signs for
    #: minimisation.
    front: Rows = []


class RuleFile(StudyFile):
    """Content of a rule file: stiffness as a function of frequency and amplitude, and its optima."""

    kind: ClassVar[str] = "rule file"
    format: Literal["swimid-rule/2"] = "swimid-rule/2"
    coefficient: str
    unit: str
    between: tuple[float, float]
    objective: Literal["speed", "cost-of-transport"]
    objectives: tuple[str, str]
    #: Reference stiffness with which the rule is compared: the fixed stiffness in the parameter file or in
    #: the robot file.
    reference: float
    #: Ranges of frequency (Hz) and amplitude (deg) in which the rule is valid.
    frequency_hz: tuple[float, float]
    amplitude_deg: tuple[float, float]
    curves: list[Curve]
    optima: list[Optimum]
    #: Whether the coefficients of the model have standard errors. The rule does not take them into account.
    uncertain: bool = False
    provenance: yamlio.Provenance = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_amplitudes(self) -> RuleFile:
        amplitudes = [curve.amplitude_deg for curve in self.curves]
        if not amplitudes or amplitudes != sorted(set(amplitudes)):
            raise ValueError(f"the amplitudes of 'curves' must increase: {amplitudes}")
        return self

    def stiffness_for(
        self, frequency_hz: float, amplitude_deg: float | None = None, *, outside: Outside = "refuse"
    ) -> float:
        """Return the stiffness at a frequency and an amplitude, interpolated linearly between the curves.

        Parameters
        ----------
        frequency_hz, amplitude_deg : float
            The amplitude may be omitted if the rule has only one amplitude.
        outside : {"refuse", "hold"}
            Behaviour outside the range of the rule. "refuse" raises an error. "hold" uses the nearest end of
            the range.

        Returns
        -------
        float
            Stiffness in :attr:`unit`, within :attr:`between`.

        Raises
        ------
        UsageError
            Outside the range of the rule, unless ``outside`` is "hold".
        """
        amplitudes = [curve.amplitude_deg for curve in self.curves]
        if amplitude_deg is None:
            if len(amplitudes) > 1:
                raise UsageError("the stiffness rule depends on the amplitude: give amplitude_deg")
            amplitude_deg = amplitudes[0]
        f = _limit_to_range(frequency_hz, self.frequency_hz, "frequency_hz", outside)
        a = _limit_to_range(amplitude_deg, self.amplitude_deg, "amplitude_deg", outside)
        values = [np.polyval(curve.coefficients[::-1], f) for curve in self.curves]
        return float(np.interp(a, amplitudes, np.clip(values, *self.between)))


def _limit_to_range(value: float, ends: tuple[float, float], name: str, outside: Outside) -> float:
    low, high = ends
    slack = 1e-9 * max(abs(low), abs(high))
    if not math.isfinite(value) or (outside == "refuse" and not low - slack <= value <= high + slack):
        raise UsageError(f"{name} {value:g} is outside the range of the rule, {low:g} to {high:g}")
    return min(max(value, low), high)


def fit_curve(amplitude_deg: float, frequency_hz: Array, stiffness: Array) -> Curve:
    """Fit a quadratic function of the frequency to the stiffness at one amplitude, by least squares.

    >>> made = fit_curve(20.0, np.array([1.0, 2.0, 3.0]), np.array([3.0, 9.0, 19.0]))
    >>> bool(np.allclose(made.coefficients, [1.0, 0.0, 2.0]))
    True
    """
    found = np.polynomial.polynomial.polyfit(frequency_hz, stiffness, CURVE_DEGREE)
    residuals = stiffness - np.polynomial.polynomial.polyval(frequency_hz, found)
    rms = float(np.sqrt(np.mean(residuals**2)))
    return Curve(amplitude_deg=amplitude_deg, coefficients=tuple(found.tolist()), rms=rms)


class StiffnessRule(FileResult[RuleFile]):
    """Stiffness rule, the result of ``optimise stiffness``.

    Attributes
    ----------
    file : RuleFile
        Curves, and optima with their Pareto fronts. :meth:`save` writes this file.
    """

    file_type = RuleFile

    @property
    def stiffness_for(self) -> Callable[..., float]:
        """Function that evaluates the rule at a frequency and amplitude (:meth:`RuleFile.stiffness_for`)."""
        return self.file.stiffness_for


@takes(OptimiseStiffnessOptions)
def optimise_stiffness(
    *, options: OptimiseStiffnessOptions, output: Path | None = None, progress: Progress = silent
) -> StiffnessRule:
    """Find the best stiffness of a passive joint over frequency and amplitude, as a rule for a controller.

    NSGA-II searches the Pareto front of two objectives over the stiffness at every frequency and amplitude.
    For each amplitude, a quadratic function of the frequency is fitted to the stiffnesses that are best in
    the first objective.

    Parameters
    ----------
    output : path, optional
        Rule file to write. The evidence is written to the same folder.
    progress : Progress
        Shows the progress over the points of the grid.

    Returns
    -------
    StiffnessRule
        ``.stiffness_for(frequency_hz, amplitude_deg)`` returns the stiffness in the coefficient's unit.

    Raises
    ------
    UsageError, InputError
        If an option or a file is invalid.
    NoTrustworthyResult
        If every simulation diverges, or if the robot never moves.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Section IV.B, Algorithm 1, Eq 12, Fig 9: the rule.
    .. [2] D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu, "Performance Optimization for Bionic Robotic
       Dolphin with Active Variable Stiffness Control".
       Section 4.3: the stiffness of highest speed at a frequency.
    .. [3] Deb, Pratap, Agarwal, Meyarivan (2002), doi:10.1109/4235.996017: NSGA-II.

    Examples
    --------
    >>> rule = optimise_stiffness(
    ...     robot="dolphin", amplitude_deg=27, over={"frequency_hz": (2, 4, 3)}, duration_s=6, generations=6
    ... )
    >>> rule.stiffness_for(2.5) < rule.stiffness_for(3.5)
    True
    """
    with record_warnings(repeat=True) as notices:
        performance = Performance.of_options(options)
        problem = _problem(performance, options)
        amplitude_deg = [performance.drive.get("amplitude_deg", math.nan)]
        axes = {"amplitude_deg": amplitude_deg, "frequency_hz": []}
        axes |= {name: np.linspace(*axis).tolist() for name, axis in options.over.items()}
        study = study_of(performance, options, output)
        performance.model.prepare(progress)
        ends = {name: (axis[0], axis[-1]) for name, axis in axes.items()}
        problem.performance = performance.at_step({**ends, **problem.vary})
        file = _fit_rule(problem, axes, study, options, progress)
        _assess(problem.performance, file)
    return study.save(StiffnessRule, file, make_rule_evidence(file, notices, study.origin))


def _fit_rule(
    problem: GaitProblem,
    axes: dict[str, list[float]],
    study: OptimisationStudy,
    options: OptimiseStiffnessOptions,
    progress: Progress,
) -> RuleFile:
    """Search for the Pareto front at each grid point, and fit a curve for each amplitude."""
    performance, ((coefficient, between),) = problem.performance, problem.vary.items()
    points = points_of(axes)
    problems = [replace(problem, fixed=point) for point in points]
    reference = float(performance.values[performance.model.index(coefficient)])

    def front(k: int) -> Array:
        compute = partial(_front_at, problems[k], k, reference, options)
        return study.checkpoint.get_or_compute(f"front {k}", lambda: compute().ravel())

    fronts = in_parallel(front, len(points), options.jobs, "fronts", progress)
    optima = [_optimum(one, values.reshape(-1, 3)) for one, values in zip(problems, fronts, strict=True)]
    frequencies, amplitudes = axes["frequency_hz"], axes["amplitude_deg"]
    return RuleFile(
        **study.head,
        coefficient=coefficient,
        unit=performance.axes[coefficient],
        between=between,
        objective=options.objective,
        objectives=tuple(quantity for quantity, _ in problem.goals),  # type: ignore[arg-type]
        reference=reference,
        frequency_hz=(frequencies[0], frequencies[-1]),
        amplitude_deg=(amplitudes[0], amplitudes[-1]),
        curves=[_curve(optima, amplitude) for amplitude in amplitudes],
        optima=optima,
        uncertain=bool(performance.applied.uncertain()[0]),
    )


def _problem(performance: Performance, options: OptimiseStiffnessOptions) -> GaitProblem:
    """Return the optimisation problem that is solved at every grid point; raise an error for bad options."""
    if options.stroke is not None or performance.model.in_space:
        given = (
            "--stroke" if options.stroke is not None else f"'{performance.model.robot.name}' moves in space"
        )
        raise UsageError(f"{given}: a stiffness rule is valid only for a tail beat in a plane")
    if not set(options.over) <= {"frequency_hz", "amplitude_deg"} or "frequency_hz" not in options.over:
        raise UsageError(
            f"--over has {', '.join(options.over)}: it takes frequency_hz, and amplitude_deg if the rule "
            "depends on it"
        )
    performance.check_gaits({name: axis[:2] for name, axis in options.over.items()}, "--over")
    if options.over["frequency_hz"][2] <= CURVE_DEGREE or options.over.get("amplitude_deg", (0, 0, 2))[2] < 2:
        raise UsageError(
            "--over: a quadratic rule needs three frequencies or more, and two amplitudes or none"
        )
    name = _coefficient(performance, options)
    p = performance.model.parameters[performance.model.index(name)]
    low, high = options.between or (p.lower, p.upper)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise UsageError(f"{name} has no bounds", hint="give the bounds: --between LOW,HIGH")
    performance.check({name: (low, high)}, "--between")
    goals = [(COST, 1.0), (SPEED, -1.0)]
    if options.objective == "speed":
        goals = [("mean_surge_from_start_m_s", -1.0), (f"{performance.turn}_rate_range_rad_s", 1.0)]
    return GaitProblem(performance, {name: (low, high)}, goals, {})


def _coefficient(performance: Performance, options: OptimiseStiffnessOptions) -> str:
    """Return the name of the stiffness of the passive joint; raise an error if it is not unique."""
    found = performance.model.list_joint_coefficients()
    name = options.coefficient or "".join(found[: len(found) == 1])
    if name not in found:
        text = f"no law of a passive joint contains {name}; " * bool(name)
        raise UsageError(
            f"--coefficient: {text}the laws of passive joints contain {', '.join(found) or 'no coefficient'}",
            hint="name the stiffness: --coefficient NAME",
        )
    return name


# ------------------------------------------------------------ search


def _front_at(
    problem: GaitProblem, number: int, reference: float, options: OptimiseStiffnessOptions
) -> Array:
    """Search for the Pareto front over the stiffness at one grid point, and refine its best point.

    The best point has the minimum of the first objective. It is refined by a search with finite differences.

    Returns
    -------
    ndarray, shape (n, 3)
        Stiffness, and the two objectives with the signs for minimisation. The best point is in the first row.
    """
    ((low, high),) = problem.vary.values()
    first = np.array([(reference - low) / (high - low)])
    front = problem.front(options.population, options.generations, options.seed + number, first)
    if len(front):
        front = front[np.argsort(front[:, 1], kind="stable")]
        problem.scale = float(abs(front[0, 1]))
        refined = problem.minimise(front[:1, :1], first=SEARCH_RADIUS, last=MIN_RADIUS).points
        found = np.hstack([refined, problem.compute_objectives(problem.table(refined))])
        if found[0, 1] < front[0, 1]:
            # Remove the points that are worse than the refined point in both objectives.
            front = np.vstack([found, front[front[:, 2] < found[0, 2]]])
    front[:, 0] = low + front[:, 0] * (high - low)
    return front


def _optimum(problem: GaitProblem, front: Array) -> Optimum:
    if not len(front):
        raise NoTrustworthyResult(
            f"every simulation diverges at {problem.fixed}",
            hint="narrow the ranges, or take a smaller --dt",
        )
    ((low, high),) = problem.vary.values()
    stiffness = float(front[0, 0])
    near = min(stiffness - low, high - stiffness) < BOUND_TOL * (high - low)
    return Optimum(**problem.fixed, front=front, stiffness=stiffness, at_bound=near)  # type: ignore[arg-type]


def _curve(optima: Sequence[Optimum], amplitude: float) -> Curve:
    at = [(one.frequency_hz, one.stiffness) for one in optima if one.amplitude_deg == amplitude]
    return fit_curve(amplitude, *np.array(at).T)


def _assess(performance: Performance, file: RuleFile) -> None:
    """Simulate each grid point with the optimal, rule and reference stiffness; set quantities in ``file``."""
    gaits = []
    for one in file.optima:
        beat = {"frequency_hz": one.frequency_hz, "amplitude_deg": one.amplitude_deg}
        ruled = file.stiffness_for(**beat, outside="hold")
        gaits += [{**beat, file.coefficient: k} for k in (one.stiffness, ruled, file.reference)]
    found = performance.many(gaits)
    performance.insist(found)
    rows = [dict(zip(performance.units, row, strict=True)) for row in yamlio.plain(found, finite=True)]
    for k, one in enumerate(file.optima):
        one.best, one.ruled, one.reference = rows[3 * k : 3 * k + 3]


# ------------------------------------------------------------ evidence


def _column(file: RuleFile, way: str, name: str = SPEED) -> Array:
    return np.array([getattr(one, way)[name] for one in file.optima], dtype=float)


def _loss(file: RuleFile) -> Array:
    """Return the relative loss of speed, or increase of the cost of transport, at each grid point.

    The loss is that of the stiffness rule compared with the optimal stiffness of the grid point.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        if file.objective == "speed":
            return np.asarray(1.0 - _column(file, "ruled") / _column(file, "best"))
        return np.asarray(_column(file, "ruled", COST) / _column(file, "best", COST) - 1.0)


def make_rule_evidence(file: RuleFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a stiffness rule, with checks, tables and figures."""
    first, second = (name.replace("_", " ") for name in file.objectives)
    facts = {
        "Stiffness": f"{file.coefficient}, {numbers.interval(*file.between, None, file.unit)}",
        "Objective": file.objective,
        "Frequency": numbers.interval(*file.frequency_hz, None, "Hz"),
        "Amplitude": numbers.interval(*file.amplitude_deg, None, "deg"),
    }
    methods = [
        f"At {len(file.optima)} points of frequency and amplitude NSGA-II (Deb et al. 2002, as implemented "
        f"in pymoo) searched the Pareto front of {first} and {second} over {file.coefficient}; each run of "
        f"{file.duration_s:g} s began at rest. A quadratic function of the frequency for each amplitude was "
        "fitted to the best values of the first objective."
    ]
    return studies.make_evidence(
        file, "optimise stiffness", answer(file), _checks(file), facts, notices, origin,
        tables=[_curve_table(file), _optima_table(file)],
        figures=[_rule_figure(file)],
        methods=methods,
    )  # fmt: skip


def _checks(file: RuleFile) -> list[ev.Check]:
    count, inside = len(file.optima), sum(not one.at_bound for one in file.optima)
    name, text = "optima within the range searched", "a better stiffness may lie beyond the range"
    fault = "had its best stiffness at the edge of the range searched"
    checks = [studies.count_check(name, inside, count, text, "point", fault)]
    worst = float(np.nanmax(_loss(file)))
    text = "the optima do not follow a quadratic function of the frequency" * (worst > MAX_LOSS)
    value, limit = f"at most {numbers.percent(worst, 2)}", f"≤ {numbers.percent(MAX_LOSS)}"
    name = "loss of the rule against its own optima"
    reason = f"the rule loses up to {numbers.percent(worst, 2)} of the objective against the optima"
    checks.append(ev.make_check(name, value, worst <= MAX_LOSS, limit, text, reason=reason))
    if file.objective == "speed":
        ruled, fixed = _column(file, "ruled"), _column(file, "reference")
        name = f"the rule is as fast as {numbers.format_number(file.reference, 3, file.unit)}"
        as_fast = int((ruled >= (1.0 - MAX_LOSS) * fixed).sum())
        text, fault = (
            "use the fixed stiffness there",
            "was slower with the rule than with the fixed stiffness",
        )
        checks.append(studies.count_check(name, as_fast, count, text, "point", fault))
        checks += studies.forwards_check([one.best["mean_surge_from_start_m_s"] for one in file.optima])
    checks.append(
        studies.steady_check(sum(one.best["settling_time_s"] is not None for one in file.optima), count)
    )
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT}
    grid = [{**drive, "frequency_hz": o.frequency_hz, "amplitude_deg": o.amplitude_deg} for o in file.optima]
    checks.append(studies.region_check(file.identified, grid))
    if not file.uncertain:
        return [*checks, studies.make_undefined_check("uncertainty of the rule")]
    name, text = (
        "uncertainty of the rule",
        "swimid optimise gait gives the interval of the stiffness of one gait",
    )
    reason = "the rule does not include the standard errors of the coefficients"
    return [*checks, ev.make_check(name, "not computed", False, text=text, reason=reason)]


def answer(file: RuleFile) -> str:
    """Return a sentence with the range of the optimal stiffnesses, and the speed if speed is the goal."""
    stiffness = [one.stiffness for one in file.optima]
    ends = (
        f"{numbers.format_number(min(stiffness), 3)} to {numbers.format_number(max(stiffness), 3, file.unit)}"
    )
    text = f"{file.coefficient} {ends} over frequency"
    if file.objective == "speed":
        speeds = [float(np.nanmax(_column(file, way))) for way in ("ruled", "reference")]
        ruled, fixed = (numbers.format_number(speed, 3, "m/s") for speed in speeds)
        reference = numbers.format_number(file.reference, 3, file.unit)
        text += f"; highest speed {ruled} against {fixed} with {reference}"
    return f"{text}."


def _curve_table(file: RuleFile) -> ev.Table:
    rows = []
    for c in file.curves:
        row: dict[str, ev.Cell] = {"amplitude": numbers.format_number(c.amplitude_deg, 3, "deg")}
        row |= {f"c{k}": numbers.format_number(value, 6) for k, value in enumerate(c.coefficients)}
        rows.append({**row, "RMS of residuals": numbers.format_number(c.rms, 2, file.unit)})
    caption = (
        f"{file.coefficient} = c0 + c1 f + c2 f², f in Hz, held within {numbers.interval(*file.between)}; "
        "linear interpolation between amplitudes."
    )
    return ev.make_table("rule", "The rule", rows, caption)


def _optima_table(file: RuleFile) -> ev.Table:
    rows: list[dict[str, ev.Cell]] = [
        {
            "frequency": numbers.format_number(o.frequency_hz, 3, "Hz"),
            "amplitude": numbers.format_number(o.amplitude_deg, 3, "deg"),
            file.coefficient: numbers.format_number(o.stiffness, 3, file.unit),
            "speed": numbers.format_number(o.best[SPEED], 3, "m/s"),
            "with the rule": numbers.format_number(o.ruled[SPEED], 3, "m/s"),
            "with the reference": numbers.format_number(o.reference[SPEED], 3, "m/s"),
            "loss of the rule": numbers.percent(float(lost), 2),
            "cost": numbers.format_number(o.best[COST], 3, "J/m"),
            "settles in": numbers.format_number(o.best["settling_time_s"], 3, "s"),
        }
        for o, lost in zip(file.optima, _loss(file), strict=True)
    ]
    reference = numbers.format_number(file.reference, 3, file.unit)
    caption = f"The reference is {reference}. A run without a settling time still gains speed at its end."
    return ev.make_table("optima", "Optima over the grid", rows, caption)


def _rule_figure(file: RuleFile) -> ev.Figure:
    traces = []
    x = np.linspace(*file.frequency_hz, 60)
    for group, c in enumerate(file.curves):
        optima = [o for o in file.optima if o.amplitude_deg == c.amplitude_deg]
        label = f"{numbers.format_number(c.amplitude_deg, 3)} deg"
        y = [file.stiffness_for(float(f), c.amplitude_deg, outside="hold") for f in x]
        traces += [
            ev.make_point_trace(
                optima, lambda o: o.frequency_hz, lambda o: o.stiffness, label=label, group=group
            ),
            ev.Trace(x=x, y=y, group=group),
        ]
    caption = "Points are the optima, curves the rule."
    y_label = f"{file.coefficient} ({numbers.unit_text(file.unit) or '1'})"
    return ev.make_figure("rule", "Stiffness rule", caption, "frequency (Hz)", y_label, traces)
