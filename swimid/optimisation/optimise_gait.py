"""``optimise gait``: the best gait within limits, how sure it is, and a robust one beside it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import genetic
from swimid.fitting.model import Array
from swimid.notices import recorded
from swimid.optimisation import controller, fins, gait_evidence
from swimid.optimisation.controller import SpeedController
from swimid.optimisation.descent import KEPT_TO, PENALTY, STEPS, WORST, descend, merit
from swimid.optimisation.draws import drawn
from swimid.optimisation.fins import FinChoice
from swimid.optimisation.gait_file import FORMAT, Gait, GaitFile, Limit, Search, Varied
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.optimisation.performance import Performance
from swimid.optimisation.study import Study, study_of
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.propulsion.model import RecoilModel
from swimid.results import evidence as ev
from swimid.results.result import FileResult
from swimid.simulation import catalogue

#: A search has reached the best of all within this share of it.
REACHED = 1e-3
#: A gait this near to an end of its range, as a share of it, lies there; a quantity this near to its limit
#: is held back by it.
AT_BOUND, HELD = 0.005, 0.01
#: Radius from which searches in draws begin: near the optimum of the estimates.
NEAR = 0.05
#: Steps of the searches in draws, and of the robust one.
DRAW_STEPS, ROBUST_STEPS = 14, 10
#: The same of the last look at the optimum.
FINE, FINE_STEPS = 0.02, 12
#: Resamples of the draws by which two gaits are told apart.
BOOTSTRAP = 400


@dataclass(frozen=True, eq=False)
class BestGait(FileResult[GaitFile]):
    """The best gait, as ``optimise gait`` gives it.

    Attributes
    ----------
    at : dict of str to float
        The best gait: what was varied.
    file : GaitFile
        What :meth:`save` writes; it also has intervals, the robust gait and the searches.
    """

    format = FORMAT
    file_type = GaitFile

    @property
    def at(self) -> dict[str, float]:
        """What was varied, at the best gait."""
        return dict(self.file.optimum.at)

    @classmethod
    def _told(cls, document: GaitFile, evidence: ev.Evidence | None) -> str:
        return gait_evidence.summary(document, evidence) if evidence else super()._told(document, evidence)


@dataclass
class Problem:
    """What is minimised over the unit cube of what is varied; every run is kept.

    Attributes
    ----------
    goals : list of (name, quantity, sign)
        What is minimised is the sign times the quantity.
    limits : dict of str to Limit
    scale : float
        A typical size of the first goal.
    """

    performance: Performance
    vary: Mapping[str, tuple[float, float]]
    goals: Sequence[tuple[str, str, float]]
    limits: Mapping[str, Limit]
    checkpoint: Checkpoint
    jobs: int
    efficiency: float = 1.0
    scale: float = 1.0
    calls: int = field(default=0, init=False)

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lower and upper ends of what is varied."""
        low, high = np.array(list(self.vary.values()), dtype=float).T
        return low, high

    def at(self, x: Array) -> dict[str, float]:
        """The gait at a point of the cube."""
        low, high = self.ends
        return dict(zip(self.vary, (low + x * (high - low)).tolist(), strict=True))

    def table(self, points: Array, values: Sequence[Array] | None = None) -> Array:
        """The quantities at points of the cube, shape (n, quantities)."""
        gaits = [self.at(x) for x in points]
        self.calls += 1
        width = len(self.performance.units)
        found = self.checkpoint.kept(
            f"runs {self.calls}",
            lambda: self.performance.many(gaits, values, jobs=self.jobs).ravel(),
        )
        return found.reshape(-1, width)

    def quantity(self, table: Array, name: str) -> Array:
        """A quantity of runs, shape (n,): also what a limit is about."""
        units = list(self.performance.units)
        if name == "battery_power_W":
            return table[:, units.index("mean_positive_power_W")] / self.efficiency
        if name == "basin_m":
            body = self.performance.model.body
            assert body is not None
            return table[:, units.index("path_extent_m")] + body.length(self.performance.values)
        return table[:, units.index(name)]

    def wanted(self, table: Array) -> Array:
        """The goals as they are minimised, shape (n, goals)."""
        return np.column_stack([s * _turn(self.quantity(table, q), q) for _, q, s in self.goals])

    def passed(self, table: Array) -> Array:
        """By how much each limit is passed, over its own size, shape (n, limits); negative where kept to."""
        found = [np.empty((len(table), 0))]
        for limit in self.limits.values():
            value = self.quantity(table, limit.quantity)[:, None]
            if limit.at_most is not None:
                found.append(value / limit.at_most - 1.0)
            if limit.at_least is not None:
                found.append(1.0 - value / limit.at_least)
        return np.hstack(found)

    def keeps(self, table: Array) -> NDArray[np.bool_]:
        """Whether runs keep to the limits, shape (n,)."""
        return np.asarray((self.passed(table) <= KEPT_TO).all(axis=1))

    def parts(self, points: Array, values: Sequence[Array] | None = None) -> Array:
        """The first goal and what passing each limit costs, shape (n, 1 + limits)."""
        return self.parts_of(self.table(points, values))

    def parts_of(self, table: Array) -> Array:
        """The same of runs that were made."""
        return np.hstack([self.wanted(table)[:, :1], PENALTY * self.scale * self.passed(table)])

    def cost(self, points: Array) -> Array:
        """The goals with what passing limits costs, shape (n, goals)."""
        table = self.table(points)
        passed = np.maximum(self.passed(table), 0.0).sum(axis=1)
        return self.wanted(table) + PENALTY * self.scale * passed[:, None]


def _turn(found: Array, quantity: str) -> Array:
    """Turning counts either way round."""
    return np.abs(found) if quantity.startswith("mean_") and quantity.endswith("_rate_rad_s") else found


@takes(OptimiseGaitOptions)
def optimise_gait(
    *, options: OptimiseGaitOptions, output: Path | None = None, progress: Progress = silent
) -> BestGait | FinChoice | SpeedController:
    """The best gait of a robot within limits, with the uncertainty of its coefficients.

    A gradient search from several starts and NSGA-II both look for it; the one that needs fewer runs to come
    within 0.1 % of the best is kept, and named. With a parameter file that has standard errors the search is
    repeated in draws of the coefficients: they say where the best gait may lie, and how much the one that was
    found loses. The robust gait loses least on the average of the worst tenth of draws.

    Parameters
    ----------
    output : path, optional
        Gait file to write; its evidence goes beside it.
    progress : Progress
        Shows the searches.

    Returns
    -------
    BestGait, FinChoice or SpeedController
        Of a robot with links ``.at`` is the gait; the file has intervals, the robust gait, and the front of
        two goals. Of a recoil law the fin, frequency and amplitude that reach a speed at the least power; of
        a discrete-time model a table from steps to speeds and a PI controller.

    Raises
    ------
    UsageError, InputError
        For bad options and files.
    NoTrustworthyResult
        When every run breaks down, or no gait keeps to the limits.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Section IV: gait and stiffness.
    .. [2] Deb, Pratap, Agarwal, Meyarivan (2002), doi:10.1109/4235.996017: NSGA-II.
    .. [3] Rockafellar, Uryasev (2000), doi:10.21314/JOR.2000.038: the average of the worst share of outcomes.

    Examples
    --------
    >>> found = optimise_gait(
    ...     robot="dolphin", amplitude_deg=27, frequency_hz=3, vary={"K_s": (0.1, 2.0)}, duration_s=6
    ... )
    >>> 0.3 < found.at["K_s"] < 0.9
    True
    """
    if options.params is not None:
        given = catalogue.read_parameters(options.params)
        if given.model == RecoilModel.name:
            return fins.choose(given, options, output)
        if given.model == "arma":
            return controller.design(given, options, output)
    with recorded(repeat=True) as notices:
        performance = Performance.of_options(options)
        study = study_of(performance, options)
        if output is not None:
            atomic.check_writable(output, inputs=study.inputs)
        keep = Checkpoint.beside(output, study.key)
        problem = _problem(performance, options, keep)
        known = bool(performance.applied.uncertain()[0])
        performance.model.prepare(progress, simulated_s=_simulated_s(options, known), checkpoint=keep)
        found = _one if len(options.goals) == 1 else _front
        file = found(problem, options, study, progress)
        if known:
            performance.applied.warn_without_error("the intervals")
            sure = _uncertain if len(options.goals) == 1 else _front_in_draws
            sure(problem, file, options, progress)
    origin = provenance.collect(study.inputs, settings=study.settings)
    evidence = gait_evidence.evidence(file, notices, origin)
    file.verdict = evidence.verdict.level
    saved = BestGait.of(file, evidence).saved(output)
    keep.done()
    return saved


# ------------------------------------------------------------ what is asked


def _simulated_s(options: OptimiseGaitOptions, uncertain: bool) -> float:
    runs = options.population * options.generations + options.starts * STEPS * 2 * len(options.vary)
    if uncertain and len(options.goals) == 2:
        runs += options.draws * options.population
    elif uncertain:
        runs += options.draws * (DRAW_STEPS + ROBUST_STEPS) * (2 * len(options.vary) + 1)
    return runs * options.duration_s


def _problem(performance: Performance, options: OptimiseGaitOptions, keep: Checkpoint) -> Problem:
    """The problem the options describe."""
    if not options.vary:
        raise UsageError("say what may be varied: --vary NAME=LOW,HIGH")
    performance.check(options.vary, "--vary")
    performance.check_drive(options.vary, "--vary")
    if len(options.goals) > 2 or len(set(options.goals)) < len(options.goals):
        raise UsageError("--goal: one, or two that differ")
    turn = performance.model.pose[2].removesuffix("_rad") if not performance.model.in_space else "yaw"
    quantities = {
        "speed": ("mean_speed_m_s", -1.0),
        "radius": ("turning_radius_m", 1.0),
        "turn-rate": (f"mean_{turn}_rate_rad_s", -1.0),
        "cost-of-transport": ("cost_of_transport_J_m", 1.0),
        "power": ("mean_positive_power_W", 1.0),
    }
    goals = [(goal, *quantities[goal]) for goal in options.goals]
    for goal, quantity, _ in goals:
        if quantity not in performance.units:
            raise UsageError(f"--goal {goal} is not for this robot: it has {', '.join(performance.units)}")
    if options.goals == ("power",) and options.reach_speed_m_s is None:
        raise UsageError("the least power is that of no motion", hint="give the speed: --reach-speed-m-s")
    problem = Problem(
        performance,
        options.vary,
        goals,
        _limits(performance, options),
        keep,
        options.jobs or os.cpu_count() or 1,
        options.efficiency,
    )
    for name, limit in problem.limits.items():
        if limit.quantity not in (*performance.units, "battery_power_W", "basin_m"):
            raise UsageError(f"--limit {name} is not for this robot")
    return problem


def _limits(performance: Performance, options: OptimiseGaitOptions) -> dict[str, Limit]:
    known = {
        "torque_N_m": ("peak_torque_N_m", 1.0, "N m"),
        "joint_rate_deg_s": ("peak_joint_rate_rad_s", math.pi / 180.0, "rad/s"),
        "battery_W": ("battery_power_W", 1.0, "W"),
        "tank_m": ("basin_m", 1.0, "m"),
    }
    found = {}
    for name, value in options.limits.items():
        if name not in known:
            raise UsageError(
                f"--limit: there is no '{name}'", hint=suggestion(name, list(known), "there are")
            )
        if not value > 0:
            raise UsageError(f"--limit {name}: {value:g} is not above zero")
        if name == "tank_m" and performance.model.body is None:
            raise UsageError("--limit tank_m is for robots in a plane")
        quantity, factor, unit = known[name]
        found[name] = Limit(quantity=quantity, at_most=factor * value, unit=unit)
    if options.reach_speed_m_s is not None:
        speed = options.reach_speed_m_s
        found["reach_speed_m_s"] = Limit(quantity="mean_speed_m_s", at_least=speed, unit="m/s")
    return found


# ------------------------------------------------------------ searches


def _candidates(options: OptimiseGaitOptions) -> int:
    """Points the starts are chosen from: four of each, in a whole power of two as the sequence asks."""
    return int(2 ** math.ceil(math.log2(4 * options.starts)))


def _begun(problem: Problem, options: OptimiseGaitOptions) -> Array:
    """Starts of the gradient search: the best of a Sobol sequence in the cube; sets the goal's size."""
    from scipy.stats import qmc

    width = len(problem.vary)
    points = qmc.Sobol(width, seed=options.seed).random(_candidates(options))
    table = problem.table(points)
    problem.performance.insist(table)
    wanted = problem.wanted(table)[:, 0]
    problem.scale = float(np.nanmedian(np.abs(wanted))) if np.isfinite(wanted).any() else 1.0
    return points[np.argsort(merit(problem.parts_of(table)), kind="stable")[: options.starts]]


def _genetic(problem: Problem, options: OptimiseGaitOptions, progress: Progress) -> genetic.Front:
    """NSGA-II over the cube, for all goals."""
    with progress("NSGA-II", total=options.generations) as step:
        return genetic.nsga2(
            problem.cost,
            np.zeros(len(problem.vary)),
            np.ones(len(problem.vary)),
            objectives=len(problem.goals),
            population=options.population,
            generations=options.generations,
            seed=options.seed,
            advance=step,
        )


def _file(problem: Problem, study: Study, **found: Any) -> GaitFile:
    """The gait file of what was found."""
    return GaitFile(
        verdict="caution",
        **study.said,
        vary={
            name: Varied(unit=problem.performance.axes[name], low=low, high=high)
            for name, (low, high) in problem.vary.items()
        },
        goals={goal: (q, problem.performance.units[q]) for goal, q, _ in problem.goals},
        limits=dict(problem.limits),
        provenance=study.repeatable,
        **found,
    )


def _one(problem: Problem, options: OptimiseGaitOptions, study: Study, progress: Progress) -> GaitFile:
    """The best gait for one goal."""
    starts = _begun(problem, options)
    before = _candidates(options)
    with progress("gradient search", total=STEPS) as step:
        smooth = descend(lambda x, _owner: problem.parts(x), starts, advance=step)
    genes = _genetic(problem, options, progress)
    found = {
        "gradient": (smooth.points[smooth.best], [(before + n, v) for n, v in smooth.history]),
        "nsga2": (
            genes.points[0],
            [(options.population * (k + 1), float(v[0])) for k, v in enumerate(genes.history)],
        ),
    }
    best = min(history[-1][1] for _, history in found.values())
    searches = []
    for method, (_, history) in found.items():
        reached = [n for n, v in history if v <= best + REACHED * abs(best)]
        searches.append(
            Search(
                method=method,  # type: ignore[arg-type]
                value=problem.goals[0][2] * history[-1][1],
                runs=history[-1][0],
                reached_after=reached[0] if reached else None,
            )
        )
    kept = min(searches, key=lambda s: math.inf if s.reached_after is None else s.reached_after).method
    # what is kept is looked at closely once more, from where both ended
    ends = np.array([found[method][0] for method in found])
    point = descend(lambda x, _owner: problem.parts(x), ends, first=FINE, steps=FINE_STEPS)
    optimum = _gait(problem, point.points[point.best])
    return _file(problem, study, searches=searches, kept=kept, optimum=optimum)


def _front(problem: Problem, options: OptimiseGaitOptions, study: Study, progress: Progress) -> GaitFile:
    """The Pareto front of two goals, and the point on it that is nearest to the best of both."""
    _begun(problem, options)
    found = _genetic(problem, options, progress)
    table = problem.table(found.points)
    keeps = problem.keeps(table) & (found.objectives < genetic.BROKEN_OBJECTIVE).all(axis=1)
    if not keeps.any():
        raise NoTrustworthyResult("no gait keeps to the limits", hint="widen what is varied, or the limits")
    points, values = found.points[keeps], problem.wanted(table)[keeps]
    signs = np.array([sign for _, _, sign in problem.goals])
    gaits = np.array([list(problem.at(x).values()) for x in points])
    return _file(
        problem,
        study,
        searches=[Search(method="nsga2", runs=found.evaluations)],
        kept="nsga2",
        optimum=_gait(problem, points[genetic.knee(values)]),
        front=np.column_stack([gaits, values * signs]),
    )


def _gait(problem: Problem, x: Array) -> Gait:
    """A point of the cube as a gait, with what the robot comes to there."""
    table = problem.table(x[None])
    if not problem.keeps(table).all():
        raise NoTrustworthyResult("no gait keeps to the limits", hint="widen what is varied, or the limits")
    if not np.isfinite(problem.wanted(table)).all():
        raise NoTrustworthyResult("the goal has no value anywhere: a robot that does not turn has no radius")
    at = problem.at(x)
    held = []
    for name, limit in problem.limits.items():
        size = limit.at_most if limit.at_most is not None else limit.at_least
        assert size is not None
        if abs(float(problem.quantity(table, limit.quantity)[0]) / size - 1.0) < HELD:
            held.append(name)
    return Gait(
        at=at,
        at_bound=[n for n, v in zip(at, x, strict=True) if min(v, 1.0 - v) < AT_BOUND],
        held_by=held,
        goals={goal: float(problem.quantity(table, q)[0]) for goal, q, _ in problem.goals},
        quantities={name: float(v) for name, v in zip(problem.performance.units, table[0], strict=True)},
    )


# ------------------------------------------------------------ how sure it is


def _draw(problem: Problem, file: GaitFile, options: OptimiseGaitOptions) -> list[Array]:
    """Draws of the coefficients; the file says how many."""
    draws = drawn(problem.performance.applied, options.draws, options.seed)
    file.draws, file.refused = len(draws.vectors), draws.refused
    file.inside = draws.inside if draws.inside < file.draws else None
    return draws.vectors


def _front_in_draws(
    problem: Problem, file: GaitFile, options: OptimiseGaitOptions, progress: Progress
) -> None:
    """What the gaits of a front come to in draws of the coefficients, and which of them is told there.

    The front itself is that of the estimates.
    """
    vectors = _draw(problem, file, options)
    low, high = problem.ends
    width = len(problem.vary)
    gaits = np.array(file.front, dtype=float)[:, :width]
    signs = np.array([sign for _, _, sign in problem.goals])
    values = np.empty((len(gaits), len(vectors), len(signs)))
    keeps = np.empty(values.shape[:2], dtype=bool)
    with progress("front in draws", total=len(gaits)) as step:
        for k, x in enumerate((gaits - low) / (high - low)):
            table = problem.table(np.tile(x, (len(vectors), 1)), vectors)
            values[k], keeps[k] = problem.wanted(table), problem.keeps(table)
            step()
    ends = np.nanquantile(values * signs, [0.025, 0.975], axis=1, method="weibull")
    file.front_ci95 = np.moveaxis(ends, 0, -1).reshape(len(gaits), -1).tolist()
    told = int(np.argmin(np.abs(gaits - np.array(list(file.optimum.at.values()))).sum(axis=1)))
    file.optimum.goals_ci95 = {
        goal: (float(a), float(b)) for (goal, _, _), a, b in zip(problem.goals, *ends[:, told], strict=True)
    }
    if problem.limits:
        file.optimum.kept_in_draws = float(keeps[told].mean())
    nearest = []
    for k in range(len(vectors)):
        sound = np.flatnonzero(keeps[:, k] & np.isfinite(values[:, k]).all(axis=1))
        if len(sound):
            nearest.append(gaits[sound[genetic.knee(values[sound, k])]])
    if nearest:
        file.drawn = np.array(nearest).tolist()
        ends = np.quantile(nearest, [0.025, 0.975], axis=0, method="weibull")
        file.optimum.at_ci95 = {
            name: (float(a), float(b)) for name, a, b in zip(problem.vary, *ends, strict=True)
        }


def _uncertain(problem: Problem, file: GaitFile, options: OptimiseGaitOptions, progress: Progress) -> None:
    """Intervals from draws of the coefficients, and the robust gait."""
    vectors = _draw(problem, file, options)
    low, high = problem.ends
    nominal = (np.array(list(file.optimum.at.values())) - low) / (high - low)
    with progress("gaits of draws", total=DRAW_STEPS) as step:
        best = descend(
            lambda x, owner: problem.parts(x, [vectors[k] for k in owner]),
            np.tile(nominal, (len(vectors), 1)),
            first=NEAR,
            steps=DRAW_STEPS,
            advance=step,
        )
    file.drawn = (low + best.points * (high - low)).tolist()
    ends = np.quantile(best.points, [0.025, 0.975], axis=0, method="weibull")
    file.optimum.at_ci95 = {
        name: (float(a), float(b))
        for name, a, b in zip(problem.vary, *(low + e * (high - low) for e in ends), strict=True)
    }
    # the robust gait is chosen with one half of the draws, and tried with the other
    robust = _robust(problem, vectors[::2], best.points[::2], best.values[::2], nominal, progress)
    goal, quantity, _ = problem.goals[0]
    gaits = [file.optimum, _gait_or_none(problem, robust)]
    told = [problem.table(np.tile(x, (len(vectors), 1)), vectors) for x in (nominal, robust)]
    costs = [merit(problem.parts_of(table)) for table in told]
    least = np.minimum(best.values, np.minimum(*costs))
    losses = [(cost - least)[1::2] for cost in costs]
    if not _loses_less(losses[1], losses[0], options.seed):
        # no other gait can be told from the best one by what it loses
        gaits[1], told[1], losses[1] = file.optimum.model_copy(update={"at_ci95": {}}), told[0], losses[0]
    for gait, table, lost in zip(gaits, told, losses, strict=True):
        if gait is not None:
            values = _turn(problem.quantity(table, quantity), quantity)
            ci95 = np.nanquantile(values, [0.025, 0.975], method="weibull")
            gait.goals_ci95 = {goal: (float(ci95[0]), float(ci95[1]))}
            gait.loss_90 = float(np.quantile(lost, 1.0 - WORST))
            gait.loss_worst_tenth = worst_tenth(lost)
            if problem.limits:
                gait.kept_in_draws = float(problem.keeps(table[1::2]).mean())
    file.robust = gaits[1]


def worst_tenth(lost: Array) -> float:
    """Average of the worst tenth of losses.

    >>> worst_tenth(np.arange(20.0))
    18.5
    """
    count = max(round(WORST * len(lost)), 1)
    return float(np.sort(lost)[-count:].mean())


def _loses_less(one: Array, other: Array, seed: int) -> bool:
    """Whether one gait loses less than another in the worst tenth of the same draws, nine times in ten.

    By the bootstrap over the draws.
    """
    rng = np.random.default_rng(seed)
    picked = rng.integers(0, len(one), (BOOTSTRAP, len(one)))
    gained = [worst_tenth(other[k]) - worst_tenth(one[k]) for k in picked]
    return bool(np.quantile(gained, WORST) > 0)


def _robust(
    problem: Problem,
    vectors: Sequence[Array],
    points: Array,
    values: Array,
    nominal: Array,
    progress: Progress,
) -> Array:
    """The point that loses least in the worst tenth of draws, whose best points and values are given."""

    def losses(x: Array, _owner: NDArray[np.int64]) -> Array:
        many = np.repeat(x, len(vectors), axis=0)
        cost = merit(problem.parts(many, list(vectors) * len(x))).reshape(len(x), -1)
        return np.array([[worst_tenth(row)] for row in cost - values])

    starts = np.array([nominal, np.median(points, axis=0)])
    with progress("robust gait", total=ROBUST_STEPS) as step:
        found = descend(losses, starts, first=NEAR, last=0.005, steps=ROBUST_STEPS, advance=step)
    return found.points[found.best]


def _gait_or_none(problem: Problem, x: Array) -> Gait | None:
    try:
        return _gait(problem, x)
    except NoTrustworthyResult:
        return None
