"""``optimise stiffness``: the rule by which a controller sets the stiffness of a passive joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.model import Array
from swimid.logs.kinematics import PER_CYCLE
from swimid.notices import Notice, recorded
from swimid.optimisation import study as studies
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.performance import BEAT, Performance, points_of
from swimid.optimisation.problem import Problem, drawn
from swimid.optimisation.rule import DEGREE, Curve, Optimum, RuleFile, Swept, fit_curve
from swimid.optimisation.study import in_parallel, study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.result import FileResult
from swimid.simulation.swim_quantities import SwimRun

#: First and last radius of the search about the best end of a front.
RADIUS, LAST = 0.01, 5e-4
#: A stiffness lies at an end of its range within this share of the range.
BOUND_TOL = 1e-3
#: Smallest number of draws of the coefficients, and the number of runs for each draw and point.
MIN_DRAWS, DRAW_RUNS = 20, 12


@dataclass(frozen=True, eq=False)
class StiffnessRule(FileResult[RuleFile]):
    """A stiffness rule, as ``optimise stiffness`` gives it.

    Attributes
    ----------
    file : RuleFile
        What :meth:`save` writes: curves, optima with their Pareto fronts, sweeps; ``.header()`` is the rule
        in C.
    """

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
        performance.insist_motion(np.array(largest_speeds(file)))
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
    evidence = evidence_of(file, notices, study.origin)
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
        run = SwimRun.driven(model, f"sweep {number} {point!r}", swim, frequency, duration_s)
        for values, k in zip(states, stiffness[:, number], strict=True):
            values[model.index(coefficient)] = k
        columns = model.simulate_many([(values, run.trial) for values in states])
        paths = np.array([[column[name][::PER_CYCLE] for name in model.pose[:2]] for column in columns])
        ways += np.hypot(*np.diff(paths, axis=2).transpose(1, 0, 2)).sum(axis=1)
        for values, seen in zip(states, columns, strict=True):
            for name, value in model.final_state(seen).items():
                values[model.index(name)] = value
        model.forget([run.trial])
    return ways


def _swept(performance: Performance, file: RuleFile, frequencies: Sequence[float], amplitude: float) -> Swept:
    """A frequency sweep with the rule and with fixed stiffnesses over the range of what it says."""
    ruled = [file.stiffness_for(f, amplitude, outside="hold") for f in frequencies]
    fixed = sorted({*np.linspace(min(ruled), max(ruled), 9).tolist(), file.reference})
    stiffness = np.vstack([ruled, np.tile(np.array(fixed)[:, None], len(ruled))])
    ways = sweep(performance, frequencies, amplitude, file.coefficient, stiffness).tolist()
    return Swept(amplitude_deg=amplitude, rule_m=ways[0], fixed=fixed, fixed_m=ways[1:])


#: Largest loss of speed, or rise of cost, of the rule against its own optima.
MAX_LOSS = 0.02


def evidence_of(file: RuleFile, notices: Sequence[Notice], origin: dict[str, Any]) -> ev.Evidence:
    """Return the evidence of a rule."""
    first, second = (name.replace("_", " ") for name in file.objectives)
    return studies.evidence(
        file,
        "optimise stiffness",
        answer(file),
        _checks(file),
        {
            "Stiffness": f"{file.coefficient}, {numbers.interval(*file.between, None, file.unit)}",
            "Objective": file.objective,
            "Frequency": numbers.interval(*file.frequency_hz, None, "Hz"),
            "Amplitude": numbers.interval(*file.amplitude_deg, None, "deg"),
        },
        notices,
        origin,
        tables=[_curves(file), _optima(file)],
        figures=[_rule(file), _speeds(file)],
        methods=[
            f"At {len(file.optima)} points of frequency and amplitude the Pareto front of {first} and "
            f"{second} over {file.coefficient} was searched by NSGA-II (Deb et al. 2002, as implemented in "
            f"pymoo); each run of {file.duration_s:g} s began at rest. The best values of the first were "
            "fitted by a quadratic function of the frequency for each amplitude. Intervals, where known, are "
            f"percentiles of the same over {file.draws} draws of the coefficients from their covariance."
        ],
    )


# ------------------------------------------------------------ what it comes to


def _column(file: RuleFile, name: str) -> Array:
    """A number of every optimum, NaN where there is none."""
    return np.array([getattr(one, name) for one in file.optima], dtype=float)


def loss(file: RuleFile) -> Array:
    """Return what the rule loses against its own optima: a share of speed, or of cost where that counts."""
    with np.errstate(invalid="ignore", divide="ignore"):
        if file.objective == "speed":
            return np.asarray(1.0 - _column(file, "rule_speed_m_s") / _column(file, "speed_m_s"))
        own, ruled = (_column(file, f"{p}cost_of_transport_J_m") for p in ("", "rule_"))
        return np.asarray(ruled / own - 1.0)


def largest_speeds(file: RuleFile) -> tuple[float, float]:
    """Return the highest speed with the rule and with the reference, m/s (tendon fish, section V.C)."""
    ruled, fixed = (np.nanmax(_column(file, f"{p}_speed_m_s")) for p in ("rule", "reference"))
    return float(ruled), float(fixed)


def _checks(file: RuleFile) -> list[ev.Check]:
    count, inside = len(file.optima), sum(not one.at_bound for one in file.optima)
    text = "" if inside == count else "the rest lie at an end: a better stiffness may lie beyond it"
    name = "optima within the range searched"
    checks = [ev.check(name, f"{inside} of {count}", inside == count, "all", text)]
    worst = float(np.nanmax(loss(file)))
    name, text = "what the rule loses against its own optima", "the optima are no quadratic function there"
    checks.append(_at_most(name, worst, text))
    if file.objective == "speed":
        surge = [-min(row[1] for row in o.front if row[1] is not None) for o in file.optima]
        checks += studies.forwards_check(surge)
    checks.append(studies.steady_check(sum(one.settling_time_s is not None for one in file.optima), count))
    drive = {name: float(value) for name, value in file.drive.items() if name in BEAT}
    grid = [{**drive, "frequency_hz": o.frequency_hz, "amplitude_deg": o.amplitude_deg} for o in file.optima]
    checks.append(studies.region_check(file.identified, grid))
    if file.inside is None:
        checks.append(studies.unknown_check("uncertainty of the rule"))
    else:
        worst = max(one.loss_90 or 0.0 for one in file.optima)
        text = "the best stiffness depends on what the fit left open: see its intervals"
        name = "what the rule loses in nine of ten draws of the coefficients"
        checks += [studies.draws_check(file.inside), _at_most(name, worst, text)]
    if file.sweeps:
        won = sum(s.rule_m >= max(s.fixed_m) for s in file.sweeps)
        name = "a frequency sweep with the rule is faster than with any fixed stiffness"
        value = f"at {won} of {len(file.sweeps)} amplitudes"
        checks.append(ev.check(name, value, won == len(file.sweeps), "all"))
    return checks


def _at_most(name: str, worst: float, text: str) -> ev.Check:
    """Check that a loss is small everywhere."""
    sound = worst <= MAX_LOSS
    value, limit = f"at most {numbers.percent(worst, 2)}", f"≤ {numbers.percent(MAX_LOSS)}"
    return ev.check(name, value, sound, limit, "" if sound else text)


def _signed(value: float, digits: int = 4) -> str:
    return f"{'−' if value < 0 else '+'} {numbers.number(abs(value), digits)}"


def answer(file: RuleFile) -> str:
    """Return what the rule says and gains as a sentence."""
    stiffness, f = _column(file, "stiffness"), _column(file, "frequency_hz")
    low, high = float(stiffness.min()), float(stiffness.max())
    trend = "over"
    if high > low and np.corrcoef(f, stiffness)[0, 1] > 0.3:
        trend = "rising with"
    text = f"{file.coefficient} {numbers.number(low, 3)} to {numbers.number(high, 3, file.unit)}, "
    text += f"{trend} frequency"
    if file.objective == "speed":
        ruled, fixed = largest_speeds(file)
        text += (
            f"; highest speed {numbers.number(ruled, 3, 'm/s')} against {numbers.number(fixed, 3, 'm/s')} "
            f"with {numbers.number(file.reference, 3, file.unit)} ({_signed(100 * (ruled / fixed - 1), 3)} %)"
        )
    return f"{text}."


# ------------------------------------------------------------ tables


def _curves(file: RuleFile) -> ev.Table:
    rows = []
    for c in file.curves:
        named = zip(("c0", "c1", "c2"), c.coefficients, c.stderr or (None, None, None), strict=True)
        row: dict[str, blocks.Cell] = {"amplitude": numbers.number(c.amplitude_deg, 3, "deg")}
        row |= {name: numbers.measured(value, error) for name, value, error in named}
        row["rms left"] = numbers.number(c.rms, 2, file.unit)
        rows.append(row)
    caption = (
        f"{file.coefficient} = c0 + c1 f + c2 f², f in Hz, held within {numbers.interval(*file.between)}; "
        "between amplitudes by straight lines."
    )
    return blocks.table("rule", "The rule", rows, caption)


def _optima(file: RuleFile) -> ev.Table:
    rows = []
    for o, lost in zip(file.optima, loss(file), strict=True):
        row: dict[str, blocks.Cell] = {
            "frequency": numbers.number(o.frequency_hz, 3, "Hz"),
            "amplitude": numbers.number(o.amplitude_deg, 3, "deg"),
            file.coefficient: numbers.number(o.stiffness, 3, file.unit),
            "95 %": numbers.interval(*o.stiffness_ci95),
            "speed": numbers.number(o.speed_m_s, 3, "m/s"),
            "with the rule": numbers.number(o.rule_speed_m_s, 3, "m/s"),
            "with the reference": numbers.number(o.reference_speed_m_s, 3, "m/s"),
            "loss of the rule": numbers.percent(float(lost), 2),
            "cost": numbers.number(o.cost_of_transport_J_m, 3, "J/m"),
            "settles in": numbers.number(o.settling_time_s, 3, "s"),
        }
        rows.append(row)
    reference = numbers.number(file.reference, 3, file.unit)
    caption = f"The reference is {reference}; without a settling time the robot still gains speed at the end."
    return blocks.table("optima", "Optima over the grid", rows, caption)


# ------------------------------------------------------------ figures


def _rule(file: RuleFile) -> ev.Figure:
    traces = []
    x = np.linspace(*file.frequency_hz, 60)
    for group, c in enumerate(file.curves):
        optima = [o for o in file.optima if o.amplitude_deg == c.amplitude_deg]
        label = f"{numbers.number(c.amplitude_deg, 3)} deg"
        traces += [
            blocks.points(optima, lambda o: o.frequency_hz, lambda o: o.stiffness, label=label, group=group),
            _curve_trace(file, c, x, group),
        ]
    caption = "Points are the stiffness found, curves the rule, bands its 95 % interval over draws."
    y_label = f"{file.coefficient} ({numbers.unit_text(file.unit) or '1'})"
    return blocks.figure("rule", "Stiffness rule", caption, "frequency (Hz)", y_label, traces)


def _curve_trace(file: RuleFile, curve: Curve, x: Array, group: int) -> ev.Trace:
    """The rule at an amplitude, with its band where that is known."""
    y = [file.stiffness_for(float(f), curve.amplitude_deg, outside="hold") for f in x]
    trace = ev.Trace(x=x, y=y, group=group)
    if file.draws:
        ends = [file.interval_for(float(f), curve.amplitude_deg, outside="hold") for f in x]
        trace.lower, trace.upper = np.array(ends, dtype=float).T.tolist()
    return trace


def _speeds(file: RuleFile) -> ev.Figure:
    panels = []
    for c in file.curves[:6]:
        optima = [o for o in file.optima if o.amplitude_deg == c.amplitude_deg]
        x, fixed = [o.frequency_hz for o in optima], numbers.number(file.reference, 3, file.unit)
        traces = [
            ev.Trace(x=x, y=[o.rule_speed_m_s for o in optima], label="rule"),
            ev.Trace(x=x, y=[o.reference_speed_m_s for o in optima], style="dashed", label=fixed),
        ]
        title = f"{c.amplitude_deg:g} deg"
        panels.append(blocks.panel("frequency (Hz)", "mean speed (m/s)", traces, title=title))
    caption = f"Each point is a run of {file.duration_s:g} s from rest (tendon fish, Fig 11)."
    title = "Speed with the rule and with a fixed stiffness"
    return blocks.panels("speeds", title, caption, panels, columns=2)
