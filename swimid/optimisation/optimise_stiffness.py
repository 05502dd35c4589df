"""``optimise stiffness``: the rule by which a controller sets the stiffness of a passive joint."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import genetic
from swimid.fitting.model import Array
from swimid.fitting.threads import in_threads
from swimid.notices import recorded
from swimid.optimisation import rule_evidence, sweep
from swimid.optimisation.grid import points_of
from swimid.optimisation.options import OptimiseStiffnessOptions
from swimid.optimisation.performance import TOGETHER, Performance, Point
from swimid.optimisation.rule import FORMAT, Curve, Optimum, RuleFile, Swept
from swimid.optimisation.study import study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import evidence as ev
from swimid.results.result import FileResult
from swimid.simulation.applied import Quantity

#: A stiffness this near to an end of its range, as a share of it, lies at the end.
AT_BOUND = 0.005
#: Fixed stiffnesses a sweep with the rule is compared with.
FIXED = 9
#: Coefficients of a curve.
DEGREE = 2


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

    @classmethod
    def _told(cls, document: RuleFile, evidence: ev.Evidence | None) -> str:
        return rule_evidence.summary(document, evidence) if evidence else super()._told(document, evidence)


@dataclass(frozen=True)
class Search:
    """What is searched at every point of the grid."""

    performance: Performance
    coefficient: str
    between: tuple[float, float]
    options: OptimiseStiffnessOptions

    @property
    def names(self) -> tuple[str, str]:
        """The quantities behind the two objectives."""
        if self.options.objective == "speed":
            return "mean_surge_from_start_m_s", f"{self.turn}_rate_range_rad_s"
        first = (
            "cost_of_transport_J_m"
            if self.options.objective == "cost-of-transport"
            else "mean_positive_power_W"
        )
        return first, "mean_speed_m_s"

    @property
    def turn(self) -> str:
        """What turning is called in the robot's plane."""
        return self.performance.model.pose[2].removesuffix("_rad")

    def objectives(self, point: Point, stiffness: Array) -> Array:
        """Both objectives, to be minimised, shape (n, 2); NaN where a run breaks down."""
        found = self.quantities([{**point, self.coefficient: float(k)} for k in stiffness])
        signs = (-1.0, 1.0) if self.options.objective == "speed" else (1.0, -1.0)
        return np.array([[s * _value(q, n) for s, n in zip(signs, self.names, strict=True)] for q in found])

    def quantities(self, points: Sequence[Point]) -> list[dict[str, Quantity]]:
        """What runs come to."""
        parts = [points[k : k + TOGETHER] for k in range(0, len(points), TOGETHER)]
        return [q for part in parts for q in self.performance.quantities(part)]

    def front(self, number: int, point: Point) -> Array:
        """Stiffness and objectives of the Pareto front at a point of the grid, shape (n, 3)."""
        low, high = self.between
        found = genetic.nsga2(
            lambda points: self.objectives(point, points[:, 0]),
            np.array([low]),
            np.array([high]),
            objectives=2,
            population=self.options.population,
            generations=self.options.generations,
            seed=self.options.seed + number,
            first=np.array([self.reference]),
        )
        sound = (found.objectives < genetic.BROKEN_OBJECTIVE).all(axis=1)
        return np.column_stack([found.points, found.objectives])[sound]

    @property
    def reference(self) -> float:
        """The stiffness gains are told against."""
        if self.options.reference is not None:
            return self.options.reference
        return float(self.performance.values[self.performance.model.index(self.coefficient)])

    def chosen(self, front: Array) -> float:
        """The stiffness chosen on a front; NaN where none reaches the speed asked for."""
        goal = self.options.reach_speed_m_s
        if goal is not None:
            front = front[-front[:, 2] >= goal]
        if not len(front):
            return math.nan
        at = genetic.knee(front[:, 1:]) if self.options.pick == "knee" else int(np.argmin(front[:, 1]))
        return float(front[at, 0])


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
                allow(place)
        keep = Checkpoint.beside(output, study.key)
        points = [dict(p) for p in points_of({n: axes[n] for n in ("amplitude_deg", "frequency_hz")})]
        runs = len(points) * options.population * options.generations
        performance.model.prepare(progress, simulated_s=runs * options.duration_s, checkpoint=keep)
        fronts = _fronts(search, points, keep, progress)
        chosen = np.array([search.chosen(front) for front in fronts])
        _insist(chosen, fronts, options)
        curves = _curves(points, chosen)
        low, high = search.between
        optima = [
            Optimum(
                frequency_hz=point["frequency_hz"],
                amplitude_deg=point["amplitude_deg"],
                stiffness=k,
                at_bound=bool(min(k - low, high - k) < AT_BOUND * (high - low)),
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
        if options.objective == "speed":
            file.sweeps = [_swept(performance, file, frequencies, a) for a in amplitudes]
    origin = provenance.collect(study.inputs, settings=study.settings)
    evidence = rule_evidence.evidence(file, notices, origin)
    file.verdict = evidence.verdict.level
    saved = StiffnessRule.of(file, evidence).saved(output)
    written = []
    for place, text in ((options.header, file.header()), (options.table, file.table())):
        if place is not None:
            atomic.write_text(place, text)
            written.append(place)
    keep.done()
    return replace(saved, outputs=[*saved.outputs, *written])


def _value(quantities: Mapping[str, Quantity], name: str) -> float:
    return quantities[name].value if name in quantities else math.nan


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
        f, k = places[at, 1], chosen[at]
        degree = min(DEGREE, len(f) - 1)
        if degree < 0:
            continue  # nothing reaches the speed at this amplitude
        design = np.vander(f, degree + 1, increasing=True)
        found, *_ = np.linalg.lstsq(design, k)
        left = k - design @ found
        spare = len(f) - degree - 1
        errors = None
        if spare > 0:
            inverse = np.linalg.inv(design.T @ design)
            errors = tuple(np.sqrt(np.diag(inverse) * float(left @ left) / spare).tolist())
        padded = (*found.tolist(), *[0.0] * (DEGREE - degree))
        curves.append(
            Curve(
                amplitude_deg=float(amplitude),
                coefficients=padded,
                stderr=errors if degree == DEGREE else None,
                rms=float(np.sqrt(np.mean(left**2))),
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
            f"{prefix}speed_m_s": _value(q, "mean_speed_m_s"),
            f"{prefix}cost_of_transport_J_m": _value(q, "cost_of_transport_J_m"),
        }
        if prefix != "rule_":
            seen[f"{prefix}turn_rate_range_rad_s"] = _value(q, f"{search.turn}_rate_range_rad_s")
        if not prefix:
            seen["settling_time_s"] = _value(q, "settling_time_s")
            seen["power_W"] = _value(q, "mean_positive_power_W")
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
