"""``optimise stiffness``: the rule by which a controller sets the stiffness of a passive joint."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import genetic
from swimid.fitting.model import Array
from swimid.fitting.parallel import in_threads
from swimid.notices import recorded
from swimid.optimisation import rule_draws, rule_evidence, sweep
from swimid.optimisation.grid import points_of
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.performance import Performance, Point
from swimid.optimisation.rule import DEGREE, FORMAT, Curve, Optimum, RuleFile, Swept, fitted
from swimid.optimisation.search import Search, value_of
from swimid.optimisation.study import study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import evidence as ev
from swimid.results.result import FileResult

#: A stiffness this near to an end of its range, as a share of it, lies at the end: by NSGA-II, and where it
#: was looked at closely.
AT_BOUND, CLOSELY = 0.005, 1e-3
#: Draws by which an interval can be told.
LEAST_DRAWS = 20
#: Runs for each draw and point.
RUNS = 12
#: Fixed stiffnesses a sweep with the rule is compared with.
FIXED = 9


@dataclass(frozen=True, eq=False)
class StiffnessRule(FileResult[RuleFile]):
    """A stiffness rule, as ``optimise stiffness`` gives it.

    Attributes
    ----------
    file : RuleFile
        What :meth:`save` writes: curves, optima with their Pareto fronts, sweeps; ``.header()`` is the rule
        in C, ``.table()`` as CSV.
    """

    format = FORMAT
    file_type = RuleFile

    def stiffness_for(
        self,
        frequency_hz: float,
        amplitude_deg: float | None = None,
        *,
        outside: Literal["refuse", "hold"] = "refuse",
    ) -> float:
        """The stiffness at a frequency and an amplitude (see :meth:`RuleFile.stiffness_for`)."""
        return self.file.stiffness_for(frequency_hz, amplitude_deg, outside=outside)

    def interval_for(
        self,
        frequency_hz: float,
        amplitude_deg: float | None = None,
        *,
        outside: Literal["refuse", "hold"] = "refuse",
    ) -> tuple[float, float] | None:
        """The 95 % interval of that (see :meth:`RuleFile.interval_for`)."""
        return self.file.interval_for(frequency_hz, amplitude_deg, outside=outside)

    @classmethod
    def _told(cls, document: RuleFile, evidence: ev.Evidence | None) -> str:
        return rule_evidence.summary(document, evidence) if evidence else super()._told(document, evidence)


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
        When every run breaks down or rests, or no stiffness reaches the speed asked for.

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
        search = _search(performance, options)
        axes = {name: [float(v) for v in np.linspace(*axis)] for name, axis in options.over.items()}
        if "amplitude_deg" not in axes:
            axes["amplitude_deg"] = [performance.drive["amplitude_deg"]]
        study = study_of(performance, options)
        for place in (output, options.header, options.table):
            if place is not None:
                allow(atomic.check_writable(place, inputs=study.inputs))
        keep = Checkpoint.beside(output, study.key)
        points = [dict(p) for p in points_of({n: axes[n] for n in ("amplitude_deg", "frequency_hz")})]
        known = bool(options.draws and options.pick == "best" and performance.applied.uncertain()[0])
        runs = len(points) * (options.population * options.generations + known * options.draws * RUNS)
        performance.model.prepare(progress, simulated_s=runs * options.duration_s, checkpoint=keep)
        fronts = _fronts(search, points, keep, progress)
        chosen = np.array([search.chosen(front) for front in fronts])
        _insist(chosen, fronts, options)
        curves = _curves(points, chosen)
        low, high = search.between
        near = (CLOSELY if options.pick == "best" else AT_BOUND) * (high - low)
        optima = [
            Optimum(
                frequency_hz=point["frequency_hz"],
                amplitude_deg=point["amplitude_deg"],
                stiffness=k,
                at_bound=bool(min(k - low, high - k) < near),
                knee=float(front[genetic.knee(front[:, 1:]), 0]) if len(front) else None,
                front=front,  # type: ignore[arg-type]
            )
            for point, k, front in zip(points, chosen, fronts, strict=True)
        ]
        reached = [o.frequency_hz for o in optima if o.stiffness is not None]
        frequencies = [f for f in axes["frequency_hz"] if min(reached) <= f <= max(reached)]
        amplitudes = [curve.amplitude_deg for curve in curves]
        file = RuleFile(
            verdict="caution",
            **study.said,
            coefficient=search.coefficient,
            unit=performance.axes[search.coefficient],
            between=search.between,
            objective=options.objective,
            objectives=search.names,
            reach_speed_m_s=options.reach_speed_m_s,
            pick=options.pick,
            reference=search.reference,
            frequency_hz=(frequencies[0], frequencies[-1]),
            amplitude_deg=(amplitudes[0], amplitudes[-1]),
            curves=curves,
            optima=optima,
            provenance=study.repeatable,
        )
        _assess(search, file)
        performance.insist_motion(np.array(rule_evidence.largest_speeds(file)))
        file.least_effort = _least_effort(file)
        if known:
            performance.applied.warn_without_error("the intervals")
            rule_draws.carry(search, file, keep, progress)
        if options.objective == "speed":
            file.sweeps = [_swept(performance, file, frequencies, a) for a in amplitudes]
    origin = provenance.collect(study.inputs, settings=study.settings)
    evidence = rule_evidence.evidence(file, notices, origin)
    file.verdict = evidence.verdict.level
    written = []
    with atomic.together():
        saved = StiffnessRule.of(file, evidence).saved(output)
        for place, text in ((options.header, file.header()), (options.table, file.table())):
            if place is not None:
                atomic.write_text(place, text)
                written.append(place)
    keep.done()
    return replace(saved, outputs=[*saved.outputs, *written])


def _search(performance: Performance, options: OptimiseStiffnessOptions) -> Search:
    """What is searched, as far as the options go together."""
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
    if 0 < options.draws < LEAST_DRAWS:
        raise UsageError(f"--draws: {LEAST_DRAWS} or more, or 0 for none")
    if (options.reach_speed_m_s is not None) != (options.objective == "effort"):
        raise UsageError("--objective effort and --reach-speed-m-s belong together")
    found = performance.model.yielding()
    name = options.coefficient
    if name is None:
        if len(found) != 1:
            said = (
                f"there are {', '.join(found)}" if found else "no coefficient stands in a passive joint's law"
            )
            raise UsageError(f"which stiffness is to be found? {said}", hint="name it: --coefficient NAME")
        name = found[0]
    if name not in performance.model.coefficients:
        hint = suggestion(name, performance.model.coefficients)
        raise UsageError(f"--coefficient: there is no '{name}'", hint=hint)
    if name not in found:
        known = f"there are {', '.join(found)}" if found else "this robot has none"
        raise UsageError(f"--coefficient: {name} stands in no passive joint's law", hint=known)
    p = performance.model.parameters[performance.model.index(name)]
    low, high = options.between or (p.lower, p.upper)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise UsageError(f"{name} has no bounds", hint="give them: --between LOW,HIGH")
    performance.check({name: (low, high)}, "--between")
    return Search(performance, name, (low, high), options)


def _fronts(search: Search, points: Sequence[Point], keep: Checkpoint, progress: Progress) -> list[Array]:
    def one(k: int) -> Array:
        return keep.kept(f"front {k}", lambda: search.front(k, points[k]).ravel()).reshape(-1, 3)

    found = []
    with (
        progress("fronts", total=len(points)) as step,
        in_threads(one, range(len(points)), search.options.jobs or os.cpu_count() or 1) as results,
    ):
        for front in results:
            found.append(front)
            step()
    return found


def _insist(chosen: Array, fronts: Sequence[Array], options: OptimiseStiffnessOptions) -> None:
    """Refuse a rule that rests on too little."""
    if not any(len(front) for front in fronts):
        raise NoTrustworthyResult(
            "every simulation breaks down", hint="narrow the ranges, or take a smaller --dt"
        )
    if not np.isfinite(chosen).any():
        fastest = max(float(-front[:, 2].min()) for front in fronts if len(front))
        raise NoTrustworthyResult(
            f"no stiffness and frequency reaches {options.reach_speed_m_s:g} m/s; the fastest swims at "
            f"{fastest:.3g} m/s"
        )


def _curves(points: Sequence[Point], chosen: Array) -> list[Curve]:
    """The quadratic function of the frequency at each amplitude, by least squares."""
    places = np.array([[p["amplitude_deg"], p["frequency_hz"]] for p in points])
    curves = []
    for amplitude in np.unique(places[:, 0]):
        at = (places[:, 0] == amplitude) & np.isfinite(chosen)
        if not at.any():
            continue  # nothing reaches the speed at this amplitude
        found = fitted(places[at, 1], chosen[at])
        curves.append(
            Curve(
                amplitude_deg=float(amplitude),
                coefficients=found.coefficients,
                stderr=found.stderr,
                rms=found.rms,
            )
        )
    return curves


def _assess(search: Search, file: RuleFile) -> None:
    """Speeds and costs with the stiffness found, with the rule's and with the reference."""
    runs: list[tuple[Optimum, str, dict[str, float]]] = []
    for one in file.optima:
        point = {"frequency_hz": one.frequency_hz, "amplitude_deg": one.amplitude_deg}
        ruled = file.stiffness_for(one.frequency_hz, one.amplitude_deg, outside="hold")
        for prefix, k in (("", one.stiffness), ("rule_", ruled), ("reference_", file.reference)):
            if k is not None:
                runs.append((one, prefix, {**point, search.coefficient: k}))
    told = search.quantities([point for _, _, point in runs])
    for (one, prefix, _), q in zip(runs, told, strict=True):
        seen: dict[str, Any] = {
            f"{prefix}speed_m_s": value_of(q, "mean_speed_m_s"),
            f"{prefix}cost_of_transport_J_m": value_of(q, "cost_of_transport_J_m"),
        }
        if prefix != "rule_":
            seen[f"{prefix}turn_rate_range_rad_s"] = value_of(q, f"{search.turn}_rate_range_rad_s")
        if not prefix:
            seen["settling_time_s"] = value_of(q, "settling_time_s")
            seen["power_W"] = value_of(q, "mean_positive_power_W")
        for name, value in seen.items():
            setattr(one, name, value if math.isfinite(value) else None)


def _least_effort(file: RuleFile) -> Optimum | None:
    """Of all frequencies and amplitudes the one that reaches the speed asked for at the least power."""
    if file.reach_speed_m_s is None:
        return None
    reached = [o for o in file.optima if o.stiffness is not None and o.power_W is not None]
    return min(reached, key=lambda o: o.power_W or math.inf, default=None)


def _swept(performance: Performance, file: RuleFile, frequencies: Sequence[float], amplitude: float) -> Swept:
    """A frequency sweep with the rule and with fixed stiffnesses over the range of what it says."""
    ruled = [file.stiffness_for(f, amplitude, outside="hold") for f in frequencies]
    fixed = sorted({float(k) for k in np.linspace(min(ruled), max(ruled), FIXED)} | {file.reference})

    def held(k: float) -> Callable[[float], float]:
        return lambda _f: k

    laws = [lambda f: file.stiffness_for(f, amplitude, outside="hold"), *(held(k) for k in fixed)]
    found = sweep.swept(performance, frequencies, amplitude, file.coefficient, laws)
    return Swept(
        amplitude_deg=amplitude,
        frequencies_hz=list(frequencies),
        rule_m_s=found.speed_m_s[0].tolist(),
        rule_m=float(found.distance_m[0]),
        fixed=fixed,
        fixed_m_s=found.speed_m_s[1:].tolist(),
        fixed_m=found.distance_m[1:].tolist(),
    )
