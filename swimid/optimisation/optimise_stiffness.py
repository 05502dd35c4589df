"""``optimise stiffness``: the rule by which a controller sets the stiffness of a passive joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array
from swimid.notices import recorded
from swimid.optimisation import rule_evidence
from swimid.optimisation.draws import drawn
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.performance import Performance, in_parallel, points_of, study_of
from swimid.optimisation.problem import Problem
from swimid.optimisation.rule import DEGREE, FORMAT, Curve, Optimum, RuleFile, Swept, fit_curve
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results.result import FileResult
from swimid.simulation.swim_quantities import PER_BEAT, Steady

#: First and last radius of the search about the best end of a front.
RADIUS, LAST = 0.01, 5e-4
#: A stiffness lies at an end of its range within this share of the range.
BOUND_TOL = 1e-3
#: Smallest number of draws of the coefficients, and the number of runs for each draw and point.
MIN_DRAWS, DRAW_RUNS = 20, 12
#: Number of fixed stiffnesses that a sweep with the rule is compared with.
N_FIXED = 9


@dataclass(frozen=True, eq=False)
class StiffnessRule(FileResult[RuleFile]):
    """A stiffness rule, as ``optimise stiffness`` gives it.

    Attributes
    ----------
    file : RuleFile
        What :meth:`save` writes: curves, optima with their Pareto fronts, sweeps; ``.header()`` is the rule
        in C.
    """

    format = FORMAT
    file_type = RuleFile

    @property
    def stiffness_for(self) -> Callable[..., float]:
        """From frequency_hz and amplitude_deg to the stiffness (see :meth:`RuleFile.stiffness_for`)."""
        return self.file.stiffness_for

    @property
    def interval_for(self) -> Callable[..., tuple[float, float] | None]:
        """The 95 % interval of that (see :meth:`RuleFile.interval_for`)."""
        return self.file.interval_for


@takes(OptimiseStiffnessOptions)
def optimise_stiffness(
    *,
    options: OptimiseStiffnessOptions,
    output: Path | None = None,
    allow: Callable[[Path], object] = atomic.check_writable,
    progress: Progress = silent,
) -> StiffnessRule:
    """The best stiffness of a passive joint over frequency and amplitude, as a rule for a controller.

    At every frequency and amplitude NSGA-II searches the Pareto front of two objectives over the stiffness;
    the stiffness chosen on it is fitted by a quadratic function of the frequency for each amplitude.

    Parameters
    ----------
    output : path, optional
        Rule file to write; its evidence goes beside it.
    allow : callable
        Called with every file before it is written; raises where that must not be.
    progress : Progress
        Shows the points of the grid.

    Returns
    -------
    StiffnessRule
        ``.stiffness_for(frequency_hz, amplitude_deg)`` in the coefficient's unit; the file has the fronts.

    Raises
    ------
    UsageError, InputError
        For bad options and files.
    NoTrustworthyResult
        When every run breaks down or rests.

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
    with recorded(repeat=True) as notices:
        performance = Performance.of_options(options)
        problem = _problem(performance, options)
        (coefficient,), (between,) = problem.vary, problem.vary.values()
        axes = {name: [float(v) for v in np.linspace(*axis)] for name, axis in options.over.items()}
        if "amplitude_deg" not in axes:
            axes["amplitude_deg"] = [performance.drive["amplitude_deg"]]
        points = points_of({name: axes[name] for name in ("amplitude_deg", "frequency_hz")})
        problems = [replace(problem, fixed=point) for point in points]
        study = study_of(performance, options)
        for place in (output, options.header):
            if place is not None:
                allow(atomic.check_writable(place, inputs=study.inputs))
        keep = Checkpoint.beside(output, study.key)
        known = bool(options.draws and performance.applied.uncertain()[0])
        runs = len(points) * (options.population * options.generations + known * options.draws * DRAW_RUNS)
        performance.model.prepare(progress, simulated_s=runs * options.duration_s, checkpoint=keep)
        reference = float(performance.values[performance.model.index(coefficient)])

        def front(k: int) -> Array:
            return keep.kept(f"front {k}", lambda: front_at(problems[k], k, reference, options).ravel())

        fronts = [
            found.reshape(-1, 3)
            for found in in_parallel(front, range(len(points)), options.jobs, "fronts", progress)
        ]
        optima = [_optimum(one, found) for one, found in zip(problems, fronts, strict=True)]
        frequencies, amplitudes = axes["frequency_hz"], axes["amplitude_deg"]
        file = RuleFile(
            **study.said,
            coefficient=coefficient,
            unit=performance.axes[coefficient],
            between=between,
            objective=options.objective,
            objectives=tuple(quantity for _, quantity, _ in problem.goals),  # type: ignore[arg-type]
            reference=reference,
            frequency_hz=(frequencies[0], frequencies[-1]),
            amplitude_deg=(amplitudes[0], amplitudes[-1]),
            curves=[_curve(optima, amplitude) for amplitude in amplitudes],
            optima=optima,
        )
        _assess(performance, file, options.jobs or 1)
        performance.insist_motion(np.array(rule_evidence.largest_speeds(file)))
        if known:
            performance.applied.warn_without_error("the intervals")
            draws = drawn(performance.applied, options.draws, options.seed)
            file.draws, file.inside = len(draws.vectors), draws.inside

            def redone(k: int) -> Array:
                return keep.kept(f"draws {k}", lambda: _redone(problems[k], file, k, draws.vectors).ravel())

            tables = in_parallel(redone, range(len(optima)), options.jobs, "rule in draws", progress)
            _carry(file, [table.reshape(2, -1) for table in tables])
        if options.objective == "speed":
            file.sweeps = [_swept(performance, file, frequencies, a) for a in amplitudes]
    evidence = rule_evidence.evidence(file, notices, study.origin)
    file.verdict = evidence.verdict.level
    with atomic.together():
        saved = StiffnessRule.of(file, evidence).saved(output)
        if options.header is not None:
            atomic.write_text(options.header, file.header())
            saved = replace(saved, outputs=[*saved.outputs, options.header])
    keep.done()
    return saved


def _problem(performance: Performance, options: OptimiseStiffnessOptions) -> Problem:
    """What is searched at every point of the grid, as far as the options go together."""
    if options.stroke is not None or performance.model.in_space:
        raise UsageError("a stiffness rule is one of a tail beat in a plane")
    if not set(options.over) <= {"frequency_hz", "amplitude_deg"} or "frequency_hz" not in options.over:
        raise UsageError("--over takes frequency_hz, and amplitude_deg where the rule depends on it")
    performance.check({name: axis[:2] for name, axis in options.over.items()}, "--over")
    performance.check_drive(options.over, "--over")
    if options.over["frequency_hz"][2] <= DEGREE or options.over.get("amplitude_deg", (0, 0, 2))[2] < 2:
        raise UsageError(
            "--over: a quadratic rule needs three frequencies or more, and two amplitudes or none"
        )
    if 0 < options.draws < MIN_DRAWS:
        raise UsageError(f"--draws: {MIN_DRAWS} or more, or 0 for none")
    name = _coefficient(performance, options)
    p = performance.model.parameters[performance.model.index(name)]
    low, high = options.between or (p.lower, p.upper)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise UsageError(f"{name} has no bounds", hint="give them: --between LOW,HIGH")
    performance.check({name: (low, high)}, "--between")
    goals, signs = {
        "speed": (("mean_surge_from_start_m_s", f"{performance.turn}_rate_range_rad_s"), (-1.0, 1.0)),
        "cost-of-transport": (("cost_of_transport_J_m", "mean_speed_m_s"), (1.0, -1.0)),
    }[options.objective]
    return Problem(performance, {name: (low, high)}, list(zip(goals, goals, signs, strict=True)), {})


def _coefficient(performance: Performance, options: OptimiseStiffnessOptions) -> str:
    """The coefficient that is the stiffness."""
    name, found = options.coefficient, performance.model.yielding()
    if name is None and len(found) == 1:
        return found[0]
    if name is None:
        known = ", ".join(found) or "no coefficient"
        raise UsageError(
            f"which stiffness is to be found? in passive joints' laws stands {known}",
            hint="name it: --coefficient NAME",
        )
    if name not in found:
        raise UsageError(
            f"--coefficient: {name} stands in no passive joint's law", hint=suggestion(name, found)
        )
    return name


# ------------------------------------------------------------ the optima


def front_at(problem: Problem, number: int, reference: float, options: OptimiseStiffnessOptions) -> Array:
    """Search the Pareto front at a point of the grid, its best end by differences.

    Returns
    -------
    ndarray, shape (n, 3)
        Stiffness and both objectives, as they are minimised; the best in the first objective first.
    """
    ((low, high),) = problem.vary.values()
    first = np.array([(reference - low) / (high - low)])
    front = problem.front(options.population, options.generations, options.seed + number, first=first)
    if len(front):
        front = front[np.argsort(front[:, 1], kind="stable")]
        problem.scale = float(abs(front[0, 1]))
        closer = problem.minimise(front[:1, :1], first=RADIUS, last=LAST).points
        found = np.hstack([closer, problem.wanted(problem.table(closer))])
        if found[0, 1] < front[0, 1]:
            # points that are worse in both objectives leave the front
            front = np.vstack([found, front[front[:, 2] < found[0, 2]]])
    front[:, 0] = low + front[:, 0] * (high - low)
    return front


def _optimum(problem: Problem, front: Array) -> Optimum:
    if not len(front):
        raise NoTrustworthyResult(
            f"every simulation breaks down at {problem.fixed}",
            hint="narrow the ranges, or take a smaller --dt",
        )
    ((low, high),) = problem.vary.values()
    stiffness = float(front[0, 0])
    near = min(stiffness - low, high - stiffness) < BOUND_TOL * (high - low)
    return Optimum(**problem.fixed, front=front, stiffness=stiffness, at_bound=near)  # type: ignore[arg-type]


def _curve(optima: Sequence[Optimum], amplitude: float) -> Curve:
    """The quadratic function of the frequency at an amplitude."""
    at = [(one.frequency_hz, one.stiffness) for one in optima if one.amplitude_deg == amplitude]
    return fit_curve(amplitude, *np.array(at).T)


def _assess(performance: Performance, file: RuleFile, jobs: int) -> None:
    """Speeds and costs with the stiffness found, with the rule's and with the reference."""
    gaits, owners = [], []
    for one in file.optima:
        ruled = file.stiffness_for(one.frequency_hz, one.amplitude_deg, outside="hold")
        for prefix, k in (("", one.stiffness), ("rule_", ruled), ("reference_", file.reference)):
            beat = {"frequency_hz": one.frequency_hz, "amplitude_deg": one.amplitude_deg}
            gaits.append({**beat, file.coefficient: k})
            owners.append((one, prefix))
    told = {
        "speed_m_s": "mean_speed_m_s",
        "cost_of_transport_J_m": "cost_of_transport_J_m",
        "turn_rate_range_rad_s": f"{performance.turn}_rate_range_rad_s",
        "settling_time_s": "settling_time_s",
    }
    units = list(performance.units)
    for (one, prefix), row in zip(owners, performance.many(gaits, jobs=jobs), strict=True):
        for name, quantity in told.items():
            value = float(row[units.index(quantity)])
            if prefix + name in Optimum.model_fields and math.isfinite(value):
                setattr(one, prefix + name, value)


# ------------------------------------------------------------ how sure they are


def _redone(problem: Problem, file: RuleFile, number: int, vectors: Sequence[Array]) -> Array:
    """An optimum in draws of the coefficients.

    Returns
    -------
    ndarray, shape (2, draws)
        The stiffness, and the relative loss of the rule against it.
    """
    one, (name,) = file.optima[number], problem.vary
    ruled = file.stiffness_for(one.frequency_hz, one.amplitude_deg, outside="hold")
    best = problem.minimise_in_draws(vectors, problem.place({name: one.stiffness}))
    _, cost = problem.costs(problem.place({name: ruled}), vectors)
    stiffness = [problem.at(x)[name] for x in best.points]
    return np.array([stiffness, (cost - best.values) / np.abs(best.values)])


def _carry(file: RuleFile, tables: Sequence[Array]) -> None:
    """Carry optima in draws of the coefficients into the intervals, losses and curves of a rule."""
    for one, (stiffness, lost) in zip(file.optima, tables, strict=True):
        low, high = np.quantile(stiffness, [0.025, 0.975], method="weibull")
        one.stiffness_ci95 = (float(low), float(high))
        one.loss_90 = max(float(np.quantile(lost, 0.9, method="higher")), 0.0)
    for curve in file.curves:
        at = [k for k, one in enumerate(file.optima) if one.amplitude_deg == curve.amplitude_deg]
        f = np.array([file.optima[k].frequency_hz for k in at])
        for column in np.array([tables[k][0] for k in at]).T:
            curve.drawn.append([*fit_curve(curve.amplitude_deg, f, column).coefficients])


# ------------------------------------------------------------ a frequency sweep in one run


def sweep(
    performance: Performance,
    frequencies_hz: Sequence[float],
    amplitude_deg: float,
    coefficient: str,
    stiffness: Array,
) -> Array:
    """Swim through frequencies without a stop, each for the performance's duration.

    Parameters
    ----------
    stiffness : ndarray, shape (runs, frequencies)

    Returns
    -------
    ndarray, shape (runs,)
        Way made in all, m.

    Notes
    -----
    A step lasts whole beats and begins with the motion the last one ended with; the drive goes on at the same
    phase.
    """
    model = performance.model
    states = [performance.values.copy() for _ in stiffness]
    ways = np.zeros(len(stiffness))
    for number, frequency in enumerate(frequencies_hz):
        point = {"frequency_hz": frequency, "amplitude_deg": amplitude_deg}
        ramp_s = 0.0 if number else performance.ramp_s
        swim, _ = replace(performance, ramp_s=ramp_s).swim(point)
        duration_s = math.ceil(performance.duration_s * frequency - 1e-9) / frequency
        run = Steady.driven(model, f"sweep {number} {point!r}", swim, frequency, duration_s)
        for values, k in zip(states, stiffness[:, number], strict=True):
            values[model.index(coefficient)] = k
        columns = model.simulate_many([(values, run.trial) for values in states])
        paths = np.array([[column[name][::PER_BEAT] for name in model.pose[:2]] for column in columns])
        ways += np.hypot(*np.diff(paths, axis=2).transpose(1, 0, 2)).sum(axis=1)
        for values, seen in zip(states, columns, strict=True):
            for name, value in model.final_state(seen).items():
                values[model.index(name)] = value
        model.forget([run.trial])
    return ways


def _swept(performance: Performance, file: RuleFile, frequencies: Sequence[float], amplitude: float) -> Swept:
    """A frequency sweep with the rule and with fixed stiffnesses over the range of what it says."""
    ruled = [file.stiffness_for(f, amplitude, outside="hold") for f in frequencies]
    fixed = sorted({*np.linspace(min(ruled), max(ruled), N_FIXED).tolist(), file.reference})
    stiffness = np.vstack([ruled, np.tile(np.array(fixed)[:, None], len(ruled))])
    ways = sweep(performance, frequencies, amplitude, file.coefficient, stiffness).tolist()
    return Swept(amplitude_deg=amplitude, rule_m=ways[0], fixed=fixed, fixed_m=ways[1:])
