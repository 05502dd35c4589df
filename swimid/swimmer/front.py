"""``fit-graybox --method nsga2`` and ``hybrid``: the search for a front, the choice on it, what it shows.

The points of a front are a CSV: ``index``, ``profile``, coefficients, objectives. An objective's column is
called ``KIND[PROFILE]``; nothing else in the header has brackets.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from swimid.errors import InputError, Interrupted, NoTrustworthyResult, UsageError
from swimid.files import atomic
from swimid.files import checkpoint as checkpoint_format
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import fit_common, global_search, output_error
from swimid.fitting.experiment import Experiment
from swimid.fitting.global_search import Front
from swimid.fitting.metrics import FitResult, Series, dtw_distance
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem
from swimid.notices import warn
from swimid.progress import Progress, show, silent
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.swimmer.options import FitGrayboxOptions

#: Which channels make up a distance together.
KINDS: dict[str, tuple[str, ...]] = {
    "position": ("x_m", "y_m", "z_m"),
    "orientation": ("roll_rad", "pitch_rad", "yaw_rad"),
    "speed": ("u_m_s", "v_m_s", "w_m_s"),
    "turning": ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s"),
}
#: What an error counts as one in each: m, rad (5 degrees), m/s, rad/s (10 degrees a second).
SCALES = {
    "position": 0.05,
    "orientation": math.radians(5.0),
    "speed": 0.05,
    "turning": math.radians(10.0),
}
#: The unit of each.
UNITS = {"position": "m", "orientation": "rad", "speed": "m/s", "turning": "rad/s"}
#: By this share of the record the two may be shifted at most.
BAND = 0.05


def kind_of(channel: str) -> str:
    """The distance a channel is part of; a joint's angle counts as orientation, its rate as turning."""
    for kind, names in KINDS.items():
        if channel in names:
            return kind
    return "turning" if channel.endswith("_rate_rad_s") else "orientation"


def distance(
    measured: Mapping[str, Array],
    simulated: Mapping[str, Array],
    channels: Sequence[str],
    scales: Sequence[float],
    *,
    band: float = BAND,
) -> float:
    """Dynamic-time-warping distance per sample of several channels warped as one.

    Parameters
    ----------
    measured, simulated : mapping of channel to ndarray, shape (n,)
        On one clock of even steps. Samples that are not measured in every channel are left out.
    scales : sequence of float
        What an error of each channel counts as one, in the channel's unit.
    band : float
        By what share of the record the two may be shifted at most (Sakoe and Chiba 1978).

    Returns
    -------
    float
        Root of the least sum of squares over n; NaN where nothing is left or the simulation broke down.

    >>> late = {"x_m": np.array([0.0, 0.0, 1.0, 2.0, 2.0])}
    >>> distance({"x_m": np.array([0.0, 1.0, 2.0, 2.0, 2.0])}, late, ["x_m"], [0.05], band=0.2)
    0.0
    """
    first = np.column_stack([measured[n] for n in channels])
    second = np.column_stack([simulated[n] for n in channels])
    there = np.isfinite(first).all(axis=1)
    if not there.any() or not np.isfinite(second[there]).all():
        return math.nan
    y, z = (v[there] / np.asarray(scales) for v in (first, second))
    return dtw_distance(y, z, band=max(round(band * len(y)), 1))


class Profiles:
    """Distances of the simulated trials from the measured ones, a mean for each motion profile.

    A point of the search holds the shared coefficients; what belongs to single trials stays where their logs
    put it.

    Parameters
    ----------
    parameters : sequence of Parameter
        Those that are free and shared are searched.
    trials : sequence of Trial
        Those of role ``fit`` count.
    profiles : mapping of trial id to str
        The motion profile of each.
    scales : mapping of channel to float
        What an error of a channel counts as one, other than :data:`SCALES`.
    band : float
        By what share of a record the two may be shifted.

    Attributes
    ----------
    labels : list of str, length d
        The coefficients searched.
    lower, upper, start : ndarray, shape (d,)
    names : list of str
        Of the profiles.
    objectives : list of (str, str)
        Profile and kind of each objective.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        trials: Sequence[Trial],
        profiles: Mapping[str, str],
        *,
        scales: Mapping[str, float] | None = None,
        band: float = BAND,
        jobs: int = 1,
    ) -> None:
        self.problem = Problem(model, parameters, [t for t in trials if t.role == "fit"], jobs=jobs)
        self.band = band
        self._shared = [j for j, (_, owner) in enumerate(self.problem.slots) if owner is None]
        self.labels = [self.problem.labels[j] for j in self._shared]
        low, high = self.problem.search_range()
        self.lower, self.upper = low[self._shared], high[self._shared]
        self.start = self.problem.start[self._shared]
        of = [profiles[t.id] for t in self.problem.trials]
        self.names = list(dict.fromkeys(of))
        self._members = {name: [k for k, p in enumerate(of) if p == name] for name in self.names}
        self._groups = [self._grouped(k, scales or {}) for k in range(len(of))]
        self.objectives = [
            (name, kind)
            for name in self.names
            for kind in KINDS
            if any(kind in self._groups[k] for k in self._members[name])
        ]

    def _grouped(self, k: int, scales: Mapping[str, float]) -> dict[str, tuple[list[str], list[float]]]:
        """Channels of a trial and their scales, by kind."""
        found: dict[str, tuple[list[str], list[float]]] = {}
        for channel in self.problem.channels[k]:
            kind = kind_of(channel)
            names, sizes = found.setdefault(kind, ([], []))
            names.append(channel)
            sizes.append(scales.get(channel, SCALES[kind]))
        return found

    def of(self, profile: str) -> list[int]:
        """Places of a profile's objectives."""
        return [j for j, (name, _) in enumerate(self.objectives) if name == profile]

    @property
    def columns(self) -> list[str]:
        """Columns of the objectives in a table."""
        return [f"{kind}[{profile}]" for profile, kind in self.objectives]

    @property
    def kinds(self) -> list[str]:
        """Kinds of distance, each once."""
        return list(dict.fromkeys(kind for _, kind in self.objectives))

    def theta(self, point: Array) -> Array:
        """A point with the numbers of single trials, shape (p,)."""
        found = self.problem.start.copy()
        found[self._shared] = point
        return found

    def evaluate(self, points: Array, profile: str | None = None) -> Array:
        """Objectives, shape (n, m), of points, shape (n, d), all or those of one profile.

        In units of the scales; NaN where a simulation breaks down.
        """
        members = [k for name in self.names if profile in (None, name) for k in self._members[name]]
        thetas = [self.theta(p) for p in points]
        runs = iter(self.problem.simulated([(theta, k) for theta in thetas for k in members]))
        return np.array([self._scored({k: next(runs) for k in members}, profile) for _ in points])

    def scored(self, series: Sequence[Series]) -> Array:
        """All objectives of a fit's series, shape (m,); NaN where a trial is not among them."""
        by_trial: dict[str, dict[str, Array]] = {}
        for s in series:
            by_trial.setdefault(s.trial, {})[s.channel] = s.simulated
        known = {k: by_trial[t.id] for k, t in enumerate(self.problem.trials) if t.id in by_trial}
        return np.array(self._scored(known, None))

    def _scored(self, simulated: Mapping[int, Mapping[str, Array]], profile: str | None) -> list[float]:
        found = []
        for name, kind in self.objectives:
            if profile in (None, name):
                parts = [self._distance(k, kind, simulated) for k in self._members[name]]
                found.append(float(np.mean([p for p in parts if p is not None])))
        return found

    def _distance(self, k: int, kind: str, simulated: Mapping[int, Mapping[str, Array]]) -> float | None:
        """One trial's distance; None where it does not measure this."""
        if kind not in self._groups[k]:
            return None
        if k not in simulated:
            return math.nan
        channels, scales = self._groups[k][kind]
        measured = self.problem.trials[k].measured
        return distance(measured, simulated[k], channels, scales, band=self.band)


#: How a point of the front is chosen, and what the rule is called.
RULES = {"least-worst": global_search.least_worst, "knee": global_search.knee}
#: Titles of the stages.
UNTUNED, CHOSEN, AFTER = "untuned", "chosen on the front", "least squares"


@dataclass(frozen=True)
class Found:
    """A front and the point chosen on it."""

    profiles: Profiles
    #: All points, each with the profile on whose front it lies and its objectives in every profile.
    table: pd.DataFrame
    #: Dict of profile to Front: empty where the front was read from a file.
    searches: dict[str, Front]
    chosen: int
    #: What every rule would choose; the knee of a single profile's objectives as well.
    rules: dict[str, int]
    #: Fits before the search and at the chosen point; None where the model cannot be simulated.
    stages: dict[str, FitResult | None] = field(default_factory=dict)

    @property
    def points(self) -> Array:
        """The coefficients of all points, shape (n, d)."""
        return np.asarray(self.table[self.profiles.labels], dtype=float)

    @property
    def values(self) -> Array:
        """Their objectives, shape (n, m)."""
        return np.asarray(self.table[self.profiles.columns], dtype=float)

    @property
    def point(self) -> Array:
        """The coefficients chosen, shape (d,)."""
        return self.points[self.chosen]

    def begins(self, count: int) -> list[Array]:
        """Where least squares starts: at the chosen point, those of the other rules, then along the front."""
        ruled = list(dict.fromkeys([self.chosen, *self.rules.values()]))
        along = [int(k) for k in np.linspace(0, len(self.points) - 1, max(count, 1))]
        distinct = list(dict.fromkeys([*ruled, *along]))
        return [self.profiles.theta(self.points[k]) for k in distinct[: max(count, len(ruled))]]


def kept(output: Path | None, belongs_to: Any, options: FitGrayboxOptions) -> Checkpoint:
    """What an earlier search left beside the output; raises where there is none although the user insists."""
    if options.resume and output is None:
        raise UsageError("--resume needs -o: an unfinished search is kept beside the output")
    before = output is not None and checkpoint_format.place(output).is_file()
    keep = Checkpoint.beside(output, belongs_to, anew=options.resume is False)
    if options.resume and not keep.begun:
        keep.done()
        raise UsageError(
            f"no unfinished search belongs to {output}"
            + (": the one beside it has other inputs or options" if before else ""),
            hint="leave out --resume to begin one",
        )
    return keep


def fit(
    experiment: Experiment,
    model: Model,
    parameters: tuple[Parameter, ...],
    options: FitGrayboxOptions,
    checkpoint: Checkpoint,
    progress: Progress,
) -> tuple[Found, FitResult]:
    """Search the fronts, choose a point, and return both with the model's fit there."""
    known = experiment.facts["profiles"]
    profiles = Profiles(
        model,
        parameters,
        experiment.trials,
        known if options.per_profile else dict.fromkeys(known, "all trials"),
        scales=options.scales,
        band=options.band,
        jobs=options.jobs or os.cpu_count() or 1,
    )
    found = search(profiles, options, checkpoint=checkpoint, progress=progress)

    def at(point: Array) -> FitResult:
        theta = profiles.theta(point)
        return output_error.at(model, experiment.trials, theta, parameters=parameters, jobs=options.jobs)

    message = f"point {found.chosen} of the front; standard errors are local to it"
    result = replace(at(found.point), message=message)
    stages: dict[str, FitResult | None] = {UNTUNED: None}
    with suppress(NoTrustworthyResult):
        stages[UNTUNED] = output_error.with_held_out(at(profiles.start))
    stages[CHOSEN] = output_error.with_held_out(result)
    return replace(found, stages=stages), result


def search(
    profiles: Profiles, options: FitGrayboxOptions, *, checkpoint: Checkpoint, progress: Progress = silent
) -> Found:
    """Search the fronts, or read them, and choose a point.

    Raises
    ------
    InputError, UsageError
        For a front file that does not belong to these trials, a choice the front does not have.
    NoTrustworthyResult
        When it is interrupted, or every simulation breaks down.
    """
    if options.front is not None:
        table, searches = read(options.front, profiles), {}
    else:
        searches = _searched(profiles, options, checkpoint, progress)
        table = _joined(profiles, searches)
    found = Found(profiles, table, searches, 0, {})
    rules = {name: rule(found.values) for name, rule in RULES.items()}
    if len(profiles.names) > 1:
        for name in profiles.names:
            rules[f"knee of {name}"] = global_search.knee(found.values[:, profiles.of(name)])
    return replace(found, chosen=_chosen(options.pick, rules, len(table)), rules=rules)


def _searched(
    profiles: Profiles, options: FitGrayboxOptions, checkpoint: Checkpoint, progress: Progress
) -> dict[str, Front]:
    searches: dict[str, Front] = {}
    total = options.generations * len(profiles.names)
    done = 0
    try:
        with progress("generations", total=total) as step:
            for number, name in enumerate(profiles.names):

                def advance(name: str = name) -> None:
                    nonlocal done
                    done += 1
                    step()
                    show(step, name)

                searches[name] = global_search.nsga2(
                    lambda points, name=name: profiles.evaluate(points, name),  # type: ignore[misc]
                    profiles.lower,
                    profiles.upper,
                    objectives=len(profiles.of(name)),
                    population=options.population,
                    generations=options.generations,
                    crossover=options.crossover,
                    seed=options.seed + number,
                    first=profiles.start,
                    checkpoint=checkpoint,
                    name=name,
                    advance=advance,
                )
    except KeyboardInterrupt:
        kept = f"{checkpoint.path} keeps them" if checkpoint.path else "nothing was written"
        raise Interrupted(
            f"interrupted after {done} of {total} generations; {kept}",
            hint="the same command goes on from there" if checkpoint.path else "with -o it can be taken up",
        ) from None
    return searches


def _joined(profiles: Profiles, searches: Mapping[str, Front]) -> pd.DataFrame:
    """The points of all fronts with their objectives in every profile; those that break down left out."""
    points = np.concatenate([f.points for f in searches.values()])
    owners = [name for name, f in searches.items() for _ in f.points]
    values = np.nan_to_num(profiles.evaluate(points), nan=global_search.BROKEN_OBJECTIVE)
    sound = np.asarray((values < global_search.BROKEN_OBJECTIVE).all(axis=1))
    if not sound.any():
        raise NoTrustworthyResult(
            "the simulation breaks down at every point of the front",
            hint="check units and trial settings, or narrow the bounds",
        )
    if not sound.all():
        warn("SWM027", f"{int((~sound).sum())} points of the front break down in another motion profile")
    table = pd.DataFrame(np.hstack([points, values]), columns=[*profiles.labels, *profiles.columns])
    table.insert(0, "profile", owners)
    return _numbered(table[sound])


def _numbered(table: pd.DataFrame) -> pd.DataFrame:
    """Points with their index as the first column."""
    return table.assign(index=np.arange(len(table)))[["index", *table.columns.drop("index", errors="ignore")]]


def read(path: Path, profiles: Profiles) -> pd.DataFrame:
    """Read the points of a front of these trials: their profile, coefficients and objectives.

    Raises
    ------
    InputError
        For a file that is no front, or the front of other coefficients, profiles or channels.
    """
    try:
        table = pd.read_csv(path, dtype={"profile": str})
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=path) from error
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"is no table: {error}", file=path) from error
    names = [str(column) for column in table.columns]
    scored = [name for name in names if name.endswith("]")]
    points = [name for name in names[2:] if name not in scored]
    if names[:2] != ["index", "profile"] or not scored or not points or table.empty:
        raise InputError(
            "holds no front: its columns are index, profile, coefficients, and objectives such as "
            "position[characteristic]",
            file=path,
            hint="give the .front.csv that an earlier --method nsga2 or hybrid wrote",
        )
    if sorted(points) != sorted(profiles.labels):
        raise InputError(
            f"is a front of {', '.join(points)}, and these are estimated: {', '.join(profiles.labels)}",
            file=path,
            hint="give the same --fix, --free and --share as when it was made",
        )
    if sorted(scored) != sorted(profiles.columns):
        raise InputError(
            "is a front of other motion profiles or channels than these trials have",
            file=path,
            hint="give the trials file and --channels it was made with",
        )
    for column in [*points, *scored]:
        bad = np.flatnonzero(~np.isfinite(pd.to_numeric(table[column], errors="coerce").to_numpy()))
        if len(bad):
            raise InputError("holds no number", file=path, line=int(bad[0]) + 2, column=column)
    return _numbered(table[["profile", *profiles.labels, *profiles.columns]])


def _chosen(pick: str, rules: Mapping[str, int], count: int) -> int:
    if pick in rules:
        return rules[pick]
    if not pick.isdigit():
        raise UsageError(
            f"--pick takes {', '.join(RULES)} or the index of a point of the front, not '{pick}'"
        )
    if int(pick) >= count:
        raise UsageError(f"the front has {count} points, from 0 to {count - 1}: there is no {pick}")
    return int(pick)


def save(output: Path, found: Found, options: FitGrayboxOptions) -> list[Path]:
    """Write the front beside the parameter file, whole or not at all; not where it was read from there."""
    path = output.with_name(f"{output.stem}.front.csv")
    if options.front is not None and options.front.resolve() == path.resolve():
        return []
    atomic.write_text(path, found.table.to_csv(index=False))
    return [path]


# ---------------------------------------------------------------- what it shows


def show_in(evidence: ev.Evidence, found: Found, result: FitResult, options: FitGrayboxOptions) -> None:
    """Add the front, the choice on it and what the search gained to the evidence of a fit."""
    stages = found.stages if options.method == "nsga2" else {**found.stages, AFTER: result}
    evidence.tables[:0] = [_stages_table(found, stages), _choices_table(found)]
    evidence.figures[:0] = _figures(found, stages)
    evidence.methods[:0] = _methods(found, options)
    chosen = ", ".join(rule for rule, k in found.rules.items() if k == found.chosen) or "by index"
    evidence.facts["Front"] = f"{len(found.points)} points, {found.chosen} chosen ({chosen})"


def _stages_table(found: Found, stages: Mapping[str, FitResult | None]) -> ev.Table:
    """List objectives and errors before the search, at the chosen point and after least squares."""
    scored = [None if r is None else found.profiles.scored(r.series) for r in stages.values()]
    rows: list[list[Any]] = [
        [f"DTW distance, {kind}", profile, *(None if s is None else float(s[j]) for s in scored)]
        for j, (profile, kind) in enumerate(found.profiles.objectives)
    ]
    units = {c.name: c.unit for r in stages.values() if r is not None for c in r.model.channels}
    for role, title in (("fit", "fitted trials"), ("validate", "held-out trials")):
        errors = [{} if r is None else fit_common.scores(r, role) for r in stages.values()]
        for channel in dict.fromkeys(c for e in errors for c in e):
            known = [e.get(channel) for e in errors]
            shown = [numbers.number(e.rmse, 3, units[channel]) if e else "" for e in known]
            rows.append([f"RMSE, {channel}", title, *shown])
    return ev.Table(
        id="stages",
        title="Errors before and after the search",
        columns=["quantity", "of", *stages],
        rows=rows,
        caption="DTW distances are per sample, over the scale of the channel, averaged over trials.",
    )


def _choices_table(found: Found) -> ev.Table:
    """List the point that every rule chooses, and the range of each coefficient over the front."""
    picks = {**found.rules}
    if found.chosen not in picks.values():
        picks = {"by index": found.chosen, **picks}
    rows: list[list[Any]] = []
    for j, label in enumerate(found.profiles.labels):
        column = found.points[:, j]
        searched = numbers.interval(float(found.profiles.lower[j]), float(found.profiles.upper[j]), None)
        spread = numbers.interval(float(column.min()), float(column.max()), None)
        rows.append([label, searched, spread, *(float(column[k]) for k in picks.values())])
    rows.append(["index", "", f"0 to {len(found.points) - 1}", *picks.values()])
    return ev.Table(
        id="front-choices",
        title="Choices on the front",
        columns=["coefficient", "searched", "over the front", *picks],
        rows=rows,
        caption="least-worst: the largest objective, each over the least on the front, is smallest. knee: "
        "nearest to the best of every objective. Any other point is chosen with --front FILE --pick INDEX.",
        folded=True,
    )


def _figures(found: Found, stages: Mapping[str, FitResult | None]) -> list[ev.Figure]:
    """Draw the front of every profile, and the search by generations."""
    ends = {t: found.profiles.scored(r.series) for t, r in stages.items() if r is not None}
    shown = [name for name in found.profiles.names if len(found.profiles.of(name)) > 1]
    drawn = [
        ev.Figure(
            id="front",
            title="Pareto fronts",
            caption="Each point is a set of coefficients. One set can explain all profiles where the points "
            "of all fronts lie close together at the lower left.",
            columns=2,
            panels=[_front_panel(found, name, ends) for name in shown],
        ),
        ev.Figure(
            id="generations",
            title="Search by generations",
            caption="Least distance of each kind in the population.",
            columns=2,
            panels=[_history_panel(found, name) for name in found.searches],
        ),
    ]
    return [figure for figure in drawn if figure.panels]


def _front_panel(found: Found, name: str, ends: Mapping[str, Array]) -> ev.Panel:
    """The first two objectives of a profile: all points, and what the stages came to."""
    axes = found.profiles.of(name)[:2]
    here = np.asarray(found.table["profile"] == name)
    clouds = [("its front", here), ("fronts of the other profiles", ~here)]
    drawn = [(label, found.values[m][:, axes], k) for k, (label, m) in enumerate(clouds) if m.any()]
    for group, (title, values) in enumerate(ends.items(), start=2):
        label = f"chosen ({found.chosen})" if title == CHOSEN else title
        drawn.append((label, values[None, axes], group))
    x_label, y_label = (f"{found.profiles.objectives[j][1]} distance" for j in axes)
    return ev.Panel(
        x_label=x_label,
        y_label=y_label,
        title=name,
        traces=[ev.Trace(x=v[:, 0], y=v[:, 1], style="points", label=n, group=g) for n, v, g in drawn],
        x_scale="log",
        y_scale="log",
    )


def _history_panel(found: Found, name: str) -> ev.Panel:
    history = found.searches[name].history
    generation = np.arange(1, len(history) + 1)
    kinds = [found.profiles.objectives[j][1] for j in found.profiles.of(name)]
    traces = [ev.Trace(x=generation, y=history[:, j], label=kind, group=j) for j, kind in enumerate(kinds)]
    return ev.Panel(x_label="generation", y_label="least distance", title=name, traces=traces, y_scale="log")


def _methods(found: Found, options: FitGrayboxOptions) -> list[str]:
    """Describe the search in sentences for a methods section."""
    said = []
    if found.searches:
        evaluations = sum(f.evaluations for f in found.searches.values())
        of = "over all fitted trials"
        if len(found.searches) > 1:
            of = f"for each of {len(found.searches)} motion profiles ({', '.join(found.searches)})"
        said.append(
            f"A Pareto front of {len(found.profiles.labels)} coefficients was searched {of} by NSGA-II "
            f"(Deb et al. 2002; pymoo), population {options.population}, {options.generations} generations, "
            f"crossover {options.crossover:g}, seed {options.seed}: {evaluations} points in all. "
            f"Objectives are dynamic-time-warping distances ({', '.join(found.profiles.kinds)}), "
            f"time stretched by at most {100 * options.band:g} % of the record (Sakoe and Chiba 1978)."
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
