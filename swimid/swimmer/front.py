"""Search of Pareto fronts for ``fit-graybox --method nsga2`` and ``hybrid``, and the choice of one point.

A point is a set of coefficients. The points of a front are stored in a CSV file with the columns ``index``,
``profile``, coefficients and objectives. The column of an objective is called ``KIND[PROFILE]``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from swimid.errors import InputError, Interrupted, NoTrustworthyResult, UsageError
from swimid.files import atomic
from swimid.files.atomic import Checkpoint
from swimid.fitting import fit_common, global_search, output_error
from swimid.fitting.fit_common import dtw_distance
from swimid.fitting.global_search import Front
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.output_error import FitResult, Series
from swimid.fitting.problem import Problem
from swimid.notices import Progress, show, silent, warn
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.swimmer.options import FitGrayboxOptions

if TYPE_CHECKING:
    from swimid.swimmer.fit_graybox import FitSetup

#: Kinds of distance between simulation and measurement, by the unit at the end of a channel's name. Each kind
#: has a name, and the error that counts as a distance of 1: 0.05 m, 5 degrees, 0.05 m/s and 10 degrees per
#: second.
KINDS = {
    "_m": ("position", 0.05),
    "_rad": ("orientation", math.radians(5.0)),
    "_m_s": ("speed", 0.05),
    "_rad_s": ("turning", math.radians(10.0)),
}
#: Maximum time shift between simulation and measurement, as a fraction of the record (Sakoe and Chiba 1978).
MAX_SHIFT_SHARE = 0.05
#: Rules for the choice of one point of a Pareto front, by name.
RULES = {"least-worst": global_search.least_worst, "knee": global_search.knee}
#: Titles of three fits: before the search of the front, at the chosen point, and after least squares from
#: this point.
UNTUNED, CHOSEN, AFTER = "untuned", "chosen on the front", "least squares"


def kind_of(channel: str) -> tuple[str, float]:
    """Return the kind of distance of a channel, and the error that counts as a distance of 1."""
    return next(kind for unit, kind in KINDS.items() if channel.endswith(unit))


def distance(
    measured: Mapping[str, Array],
    simulated: Mapping[str, Array],
    channels: Sequence[str],
    scales: Sequence[float],
    *,
    band: float = MAX_SHIFT_SHARE,
) -> float:
    """Return the dynamic-time-warping distance per sample between measured and simulated channels.

    All channels are warped together.

    Parameters
    ----------
    measured, simulated : mapping of channel to ndarray, shape (n,)
        Values at the same evenly spaced times. Samples that lack a measured channel are left out.
    channels : sequence of str
    scales : sequence of float
        Error of each channel that counts as 1, in the unit of the channel.
    band : float
        Maximum time shift between simulation and measurement, as a fraction of the record (Sakoe and Chiba
        1978).

    Returns
    -------
    float
        Square root of (minimum sum of squared scaled errors / n). NaN if no sample is left or the simulation
        diverged.

    >>> late = {"x_m": np.array([0.0, 0.0, 1.0, 2.0, 2.0])}
    >>> distance({"x_m": np.array([0.0, 1.0, 2.0, 2.0, 2.0])}, late, ["x_m"], [0.05], band=0.2)
    0.0
    """
    first = np.column_stack([measured[n] for n in channels])
    second = np.column_stack([simulated[n] for n in channels])
    known = np.isfinite(first).all(axis=1)
    if not known.any() or not np.isfinite(second[known]).all():
        return math.nan
    y, z = (v[known] / np.asarray(scales) for v in (first, second))
    return dtw_distance(y, z, band=max(round(band * len(y)), 1))


class Profiles:
    """Distances between simulated and measured trials, averaged over the trials of each motion profile.

    A point of the search is a vector of the free coefficients that all trials share. Per-trial parameters
    keep the start values that were estimated from the logs.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        The free parameters that all trials share are searched.
    trials : sequence of Trial
        Only trials of role ``fit`` are used.
    profiles : mapping of trial id to str
        Motion profile of each trial.
    scales : mapping of channel to float
        Errors of channels that count as 1, in place of those of :data:`KINDS`.
    jobs : int

    Attributes
    ----------
    labels : list of str, length d
        Names of the coefficients that are searched.
    lower, upper, start : ndarray, shape (d,)
    names : list of str
        Names of the profiles.
    objectives : list of (str, str)
        Profile and kind of each objective.
    columns : list of str
        Column name of each objective in a table of points.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        trials: Sequence[Trial],
        profiles: Mapping[str, str],
        *,
        scales: Mapping[str, float] | None = None,
        jobs: int = 1,
    ) -> None:
        self.problem = Problem(model, parameters, [t for t in trials if t.role == "fit"], jobs=jobs)
        self._shared = [j for j, (_, owner) in enumerate(self.problem.slots) if owner is None]
        self.labels = [self.problem.labels[j] for j in self._shared]
        low, high = self.problem.search_range()
        self.lower, self.upper = low[self._shared], high[self._shared]
        self.start = self.problem.start[self._shared]
        self._profiles = [profiles[t.id] for t in self.problem.trials]
        self.names = list(dict.fromkeys(self._profiles))
        self._scales = scales or {}
        #: Channels whose errors contribute to an objective, by objective and index of the trial.
        self._parts: dict[tuple[str, str], dict[int, list[str]]] = {}
        for name, (kind, _) in product(self.names, KINDS.values()):
            for k in self._members(name):
                channels = [c for c in self.problem.channels[k] if kind_of(c)[0] == kind]
                if channels:
                    self._parts.setdefault((name, kind), {})[k] = channels
        self.objectives = list(self._parts)
        self.columns = [f"{kind}[{profile}]" for profile, kind in self.objectives]

    def _members(self, profile: str | None) -> list[int]:
        """Return the indices of the trials of a motion profile, or of all trials if the profile is None."""
        return [k for k, own in enumerate(self._profiles) if profile in (None, own)]

    def objectives_of(self, profile: str) -> list[int]:
        """Return the indices of the objectives of a motion profile."""
        return [j for j, (name, _) in enumerate(self.objectives) if name == profile]

    def theta(self, point: Array) -> Array:
        """Return the full parameter vector at a point of the search, shape (p,).

        Per-trial parameters have their start values.
        """
        found = self.problem.start.copy()
        found[self._shared] = point
        return found

    def evaluate(self, points: Array, profile: str | None = None) -> Array:
        """Return the objectives at points of the search, for one motion profile or for all profiles.

        Parameters
        ----------
        points : ndarray, shape (n, d)
        profile : str, optional

        Returns
        -------
        ndarray, shape (n, m)
            Distances for each of m objectives, divided by the scales; NaN if a simulation diverges.
        """
        members = self._members(profile)
        runs = iter(self.problem.simulate_points([(self.theta(p), k) for p in points for k in members]))
        return np.array([self._score_trials({k: next(runs) for k in members}, profile) for _ in points])

    def score(self, series: Sequence[Series]) -> Array:
        """Return all objectives for the simulated channels of a fit, shape (m,).

        An objective is NaN if the fit lacks one of its trials.
        """
        by_trial: dict[str, dict[str, Array]] = {}
        for s in series:
            by_trial.setdefault(s.trial, {})[s.channel] = s.simulated
        known = {k: by_trial[t.id] for k, t in enumerate(self.problem.trials) if t.id in by_trial}
        return np.array(self._score_trials(known))

    def _score_trials(
        self, simulated: Mapping[int, Mapping[str, Array]], profile: str | None = None
    ) -> list[float]:
        parts = [own for (name, _), own in self._parts.items() if profile in (None, name)]
        return [float(np.mean([self._distance(k, own[k], simulated.get(k)) for k in own])) for own in parts]

    def _distance(self, k: int, channels: list[str], simulated: Mapping[str, Array] | None) -> float:
        if simulated is None:
            return math.nan
        scales = [self._scales.get(channel, kind_of(channel)[1]) for channel in channels]
        return distance(self.problem.trials[k].measured, simulated, channels, scales)


@dataclass(frozen=True)
class FrontResult:
    """Pareto fronts of all motion profiles, and the point that was chosen from them.

    Attributes
    ----------
    profiles : Profiles
    table : DataFrame
        All points, each with the profile on whose front it lies, its coefficients, and its objectives in
        every profile.
    searches : mapping of profile to Front
        Empty if the front was read from a file.
    chosen : int
        Index of the chosen point.
    rules : mapping of str to int
        Index of the point that each rule chooses. The knee is also chosen for each profile alone.
    stages : mapping of str to FitResult
        Fits before the search, at the chosen point, and after least squares, by title. A fit is None if the
        model cannot be simulated.
    """

    profiles: Profiles
    table: pd.DataFrame
    searches: dict[str, Front]
    chosen: int
    rules: dict[str, int]
    stages: dict[str, FitResult | None] = field(default_factory=dict)

    @property
    def points(self) -> Array:
        """Coefficients of all points of the Pareto fronts, shape (n, d)."""
        return np.asarray(self.table[self.profiles.labels], dtype=float)

    @property
    def values(self) -> Array:
        """Objectives of all points of the Pareto fronts, shape (n, m)."""
        return np.asarray(self.table[self.profiles.columns], dtype=float)

    def starts(self, count: int) -> list[Array]:
        """Return starting points for least squares.

        The first is the chosen point, followed by the points that the other rules choose, and by points along
        the front.
        """
        ruled = list(dict.fromkeys([self.chosen, *self.rules.values()]))
        along = [int(k) for k in np.linspace(0, len(self.points) - 1, max(count, 1))]
        distinct = list(dict.fromkeys([*ruled, *along]))
        return [self.profiles.theta(self.points[k]) for k in distinct[: max(count, len(ruled))]]

    def save(self, output: Path, options: FitGrayboxOptions) -> list[Path]:
        """Write the front to the folder of the parameter file, and return the paths of the written files.

        The front is not written if it was read from the same file.
        """
        path = output.with_name(f"{output.stem}.front.csv")
        if options.front is not None and options.front.resolve() == path.resolve():
            return []
        atomic.write_text(path, self.table.to_csv(index=False))
        return [path]

    def add_evidence(self, evidence: ev.Evidence, result: FitResult, options: FitGrayboxOptions) -> None:
        """Add the Pareto front, the chosen point, and the errors of all fits to the evidence of the fit."""
        stages = dict(self.stages)
        if options.method == "hybrid":
            stages[AFTER] = result
        known = {title: r for title, r in stages.items() if r is not None}
        scored = {title: self.profiles.score(r.series) for title, r in known.items()}
        evidence.tables[:0] = [_stages_table(self, list(stages), known, scored)]
        evidence.figures[:0] = _figures(self, scored)
        evidence.methods[:0] = _methods(self, options)
        chosen = ", ".join(rule for rule, k in self.rules.items() if k == self.chosen) or "by index"
        evidence.facts["Front"] = f"{len(self.points)} points, {self.chosen} chosen ({chosen})"


def fit_front(
    posed: FitSetup, checkpoint: Checkpoint, progress: Progress = silent
) -> tuple[FrontResult, FitResult]:
    """Search or read the Pareto fronts, choose a point, and return the fronts and the fit at this point.

    Parameters
    ----------
    posed : FitSetup
        Trials, model and parameters.
    checkpoint : Checkpoint
        Stores the generations, so that an interrupted search can be resumed.
    progress : Progress

    Raises
    ------
    InputError, UsageError
        For a front file that does not belong to these trials, and for a chosen point that is not on the
        front.
    NoTrustworthyResult
        If the search is interrupted, or if every simulation diverges.
    """
    profiles, options = posed.profiles, posed.options
    searches: dict[str, Front] = {}
    if options.front is None:
        searches = _search(profiles, options, checkpoint, progress)
        table = _join_fronts(profiles, searches)
    else:
        table = read(options.front, profiles)
    values = np.asarray(table[profiles.columns], dtype=float)
    rules = {name: rule(values) for name, rule in RULES.items()}
    if len(profiles.names) > 1:
        for name in profiles.names:
            rules[f"knee of {name}"] = global_search.knee(values[:, profiles.objectives_of(name)])
    found = FrontResult(profiles, table, searches, _choose_point(options.pick, rules, len(table)), rules)

    def at(point: Array) -> FitResult:
        theta, trials = profiles.theta(point), posed.experiment.trials
        return output_error.evaluate_fit(
            posed.model, trials, theta, parameters=posed.parameters, jobs=options.jobs
        )

    message = f"point {found.chosen} of the front; standard errors are local to it"
    result = replace(at(found.points[found.chosen]), message=message)
    stages: dict[str, FitResult | None] = {UNTUNED: None}
    with suppress(NoTrustworthyResult):
        stages[UNTUNED] = output_error.with_held_out(at(profiles.start))
    stages[CHOSEN] = output_error.with_held_out(result)
    return replace(found, stages=stages), result


def _search(
    profiles: Profiles,
    options: FitGrayboxOptions,
    checkpoint: Checkpoint,
    progress: Progress,
) -> dict[str, Front]:
    """Search the Pareto front of each motion profile by NSGA-II."""
    searches: dict[str, Front] = {}
    total = options.generations * len(profiles.names)
    done: list[str] = []
    try:
        with progress("generations", total=total) as step:

            def advance(name: str) -> None:
                done.append(name)
                step()
                show(step, name)

            for number, name in enumerate(profiles.names):
                searches[name] = global_search.nsga2(
                    partial(profiles.evaluate, profile=name),
                    profiles.lower,
                    profiles.upper,
                    objectives=len(profiles.objectives_of(name)),
                    population=options.population,
                    generations=options.generations,
                    seed=options.seed + number,
                    first=profiles.start,
                    checkpoint=checkpoint,
                    name=name,
                    advance=partial(advance, name),
                )
    except KeyboardInterrupt:
        kept, hint = "nothing was written", "give an output with -o, so that the search can be continued"
        if checkpoint.path:
            kept, hint = f"they are kept in {checkpoint.path}", "run the same command to continue"
        raise Interrupted(
            f"interrupted after {len(done)} of {total} generations; {kept}", hint=hint
        ) from None
    return searches


def _join_fronts(profiles: Profiles, searches: Mapping[str, Front]) -> pd.DataFrame:
    """Return the points of all Pareto fronts with their objectives in every motion profile.

    Points at which a simulation diverges are left out.
    """
    points = np.concatenate([f.points for f in searches.values()])
    owners = [name for name, f in searches.items() for _ in f.points]
    values = np.nan_to_num(profiles.evaluate(points), nan=global_search.BROKEN_OBJECTIVE)
    sound = np.asarray((values < global_search.BROKEN_OBJECTIVE).all(axis=1))
    if not sound.any():
        raise NoTrustworthyResult(
            "the simulation diverges at every point of the front",
            hint="check units and trial settings, or narrow the bounds",
        )
    if not sound.all():
        text = f"{int((~sound).sum())} points of the front are left out, because their simulation diverges"
        warn("SWM027", f"{text} in another motion profile: narrow the bounds")
    table = pd.DataFrame(np.hstack([points, values]), columns=[*profiles.labels, *profiles.columns])
    table.insert(0, "profile", owners)
    return _number_points(table[sound])


def _number_points(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of points with a new first column, which is the index of each point."""
    found = table.reset_index(drop=True)
    found.insert(0, "index", found.index.to_numpy())
    return found


def read(path: Path, profiles: Profiles) -> pd.DataFrame:
    """Read a Pareto front from a file: motion profile, coefficients and objectives of each point.

    Raises
    ------
    InputError
        For a file that is not a front, or a front with other coefficients, profiles or channels.
    """
    try:
        table = pd.read_csv(path, dtype={"profile": str})
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=path, hint="check the path") from error
    except (ValueError, UnicodeDecodeError) as error:
        hint = "give the .front.csv of an earlier fit"
        raise InputError(f"is no table: {error}", file=path, hint=hint) from error
    expected = [*profiles.labels, *profiles.columns]
    others = {str(column) for column in table.columns} ^ {"index", "profile", *expected}
    if others or table.empty:
        raise InputError(
            f"is not a front of this fit: the front or the fit lacks {', '.join(sorted(others)) or 'points'}",
            file=path,
            hint="give the .front.csv of an earlier --method nsga2 or hybrid with the same trials, "
            "--channels, --fix, --free and --share",
        )
    for column in expected:
        bad = np.flatnonzero(~np.isfinite(pd.to_numeric(table[column], errors="coerce").to_numpy()))
        if len(bad):
            text = f"'{table[column].iloc[bad[0]]}' is not a finite number"
            raise InputError(text, file=path, line=int(bad[0]) + 2, column=column)
    return _number_points(table[["profile", *expected]])


def _choose_point(pick: str, rules: Mapping[str, int], count: int) -> int:
    """Return the index of the point of the Pareto front that the selection rule or the user chooses."""
    if pick in rules:
        return rules[pick]
    if not pick.isdigit():
        raise UsageError(
            f"--pick takes {', '.join(RULES)} or the index of a point of the front, not '{pick}'"
        )
    if int(pick) >= count:
        raise UsageError(f"--pick {pick}: the points of the front have the indices 0 to {count - 1}")
    return int(pick)


# ---------------------------------------------------------------- evidence


def _stages_table(
    found: FrontResult, titles: list[str], known: Mapping[str, FitResult], scored: Mapping[str, Array]
) -> ev.Table:
    """Return a table of objectives and errors of the fits.

    The fits are those before the search, at the chosen point, and after least squares.
    """
    rows: list[list[Any]] = []
    for j, (profile, kind) in enumerate(found.profiles.objectives):
        row = [float(scored[title][j]) if title in scored else None for title in titles]
        rows.append([f"DTW distance, {kind}", profile, *row])
    for role, name in (("fit", "fitted trials"), ("validate", "held-out trials")):
        errors = {title: fit_common.compute_scores(r, role) for title, r in known.items()}
        units = {c.name: c.unit for r in known.values() for c in r.model.channels}
        for channel in dict.fromkeys(c for own in errors.values() for c in own):
            shown = {t: numbers.format_number(e[channel].rmse, 3, units[channel]) for t, e in errors.items()}
            rows.append([f"RMSE, {channel}", name, *(shown.get(title, "") for title in titles)])
    return ev.Table(
        id="stages",
        title="Errors before and after the search",
        columns=["quantity", "of", *titles],
        rows=rows,
        caption="DTW distances are per sample, over the scale of the channel, averaged over trials.",
    )


def _figures(found: FrontResult, ends: Mapping[str, Array]) -> list[ev.Figure]:
    """Plot the Pareto front of each motion profile, with the points of the fits."""
    profiles = found.profiles
    fronts = []
    for name in profiles.names:
        objectives = profiles.objectives_of(name)
        own = np.asarray(found.table["profile"] == name)
        axes = objectives[:2]
        clouds = [("its front", found.values[own]), ("fronts of the other profiles", found.values[~own])]
        clouds += [(f"chosen ({found.chosen})" if t == CHOSEN else t, v[None]) for t, v in ends.items()]
        traces = [
            ev.Trace(x=v[:, axes[0]], y=v[:, axes[-1]], style="points", label=label, group=k)
            for k, (label, v) in enumerate(clouds)
            if len(v)
        ]
        if len(axes) > 1:
            x, y = (f"{profiles.objectives[j][1]} distance" for j in axes)
            fronts.append(
                ev.Panel(x_label=x, y_label=y, title=name, traces=traces, x_scale="log", y_scale="log")
            )
    caption = (
        "Each point is a set of coefficients. One set can explain all profiles if the points of all fronts "
        "lie close together at the lower left."
    )
    return [ev.Figure(id="front", title="Pareto fronts", caption=caption, panels=fronts)] * bool(fronts)


def _methods(found: FrontResult, options: FitGrayboxOptions) -> list[str]:
    """Return sentences for a methods section that describe the search of the Pareto fronts."""
    said = []
    if found.searches:
        evaluations = sum(f.evaluations for f in found.searches.values())
        scope = f"for each motion profile ({', '.join(found.searches)})"
        kinds = ", ".join(dict.fromkeys(kind for _, kind in found.profiles.objectives))
        said.append(
            f"A Pareto front of {len(found.profiles.labels)} coefficients was searched {scope} by NSGA-II "
            f"(Deb et al. 2002; pymoo), population {options.population}, {options.generations} generations, "
            f"crossover {global_search.CROSSOVER:g}, seed {options.seed}: {evaluations} points in all. "
            f"Objectives are dynamic-time-warping distances ({kinds}), "
            f"time stretched by at most {100 * MAX_SHIFT_SHARE:g} % of the record (Sakoe and Chiba 1978)."
        )
    by = f"by the rule {options.pick}" if options.pick in found.rules else "by its index"
    said.append(f"Point {found.chosen} of {len(found.points)} was chosen {by}.")
    if options.method == "nsga2":
        said.append(
            "Standard errors are those of the linearised model at that point, its error counted as noise; "
            "the point is no least-squares optimum."
        )
    else:
        said.append("Least squares started there and at the points of the other rules.")
    return said
