"""``fit-graybox --method nsga2`` and ``hybrid``: the search for a front, the choice on it, what it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, Interrupted, NoTrustworthyResult, UsageError
from swimid.files import checkpoint as checkpoint_format
from swimid.files.checkpoint import Checkpoint
from swimid.fitting import fit_common, genetic, warping
from swimid.fitting.fit_result import FitResult
from swimid.fitting.genetic import Front
from swimid.fitting.model import Array
from swimid.notices import warn
from swimid.progress import Progress, show, silent
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.swimmer import front_table as front_format
from swimid.swimmer.front_table import FrontFile
from swimid.swimmer.options import FitGrayboxOptions
from swimid.swimmer.profiles import Profiles

#: How a point of the front is chosen, and what the rule is called.
RULES = {"least-worst": genetic.least_worst, "knee": genetic.knee}
#: Titles of the stages.
UNTUNED, CHOSEN, AFTER = "untuned", "chosen on the front", "least squares"
#: One profile for all trials.
OVERALL = "all trials"


@dataclass(frozen=True)
class Found:
    """A front and the point chosen on it.

    Attributes
    ----------
    profiles : Profiles
    file : FrontFile
        All points, each with its objectives in every profile.
    searches : dict of profile to Front
        Empty where the front was read from a file.
    chosen : int
    rules : dict of str to int
        What every rule would choose; the knee of a single profile's objectives as well.
    """

    profiles: Profiles
    file: FrontFile
    searches: dict[str, Front]
    chosen: int
    rules: dict[str, int]

    @property
    def point(self) -> Array:
        """The coefficients chosen, shape (d,)."""
        return np.asarray(self.file.points[self.chosen])

    def begins(self, count: int) -> list[Array]:
        """Where least squares starts: at the chosen point, those of the other rules, then along the front."""
        order = [self.chosen, *self.rules.values()]
        order += [int(k) for k in np.linspace(0, len(self.file.points) - 1, max(count, 1))]
        distinct = list(dict.fromkeys(order))
        wanted = max(count, len(dict.fromkeys([self.chosen, *self.rules.values()])))
        return [self.profiles.theta(self.file.points[k]) for k in distinct[:wanted]]


def profiled(known: Mapping[str, str], options: FitGrayboxOptions) -> dict[str, str]:
    """The motion profile of each trial."""
    return dict(known) if options.per_profile else dict.fromkeys(known, OVERALL)


def kept(output: Path | None, belongs_to: Any, options: FitGrayboxOptions) -> Checkpoint:
    """What an earlier search left beside the output.

    Raises
    ------
    UsageError
        When there is nothing to go on with although the user insists.
    """
    if options.resume and output is None:
        raise UsageError("--resume needs -o: an unfinished search is kept beside the output")
    if options.resume is False and output is not None:
        checkpoint_format.place(output).unlink(missing_ok=True)
    before = output is not None and checkpoint_format.place(output).is_file()
    keep = Checkpoint.beside(output, belongs_to)
    if options.resume and not keep.begun:
        keep.done()
        raise UsageError(
            f"no unfinished search belongs to {output}"
            + (": the one beside it has other inputs or options" if before else ""),
            hint="leave out --resume to begin one",
        )
    return keep


def search(
    profiles: Profiles, options: FitGrayboxOptions, *, checkpoint: Checkpoint, progress: Progress = silent
) -> Found:
    """Search the fronts, or read them, and choose a point.

    Raises
    ------
    InputError
        For a front file that does not belong to these trials.
    UsageError
        For a choice the front does not have.
    NoTrustworthyResult
        When it is interrupted, or every simulation breaks down.
    """
    if options.front is not None:
        file, searches = _read(options.front, profiles), {}
    else:
        searches = _searched(profiles, options, checkpoint, progress)
        file = _joined(profiles, searches)
    rules = {name: rule(file.values) for name, rule in RULES.items()}
    if len(profiles.names) > 1:
        for name in profiles.names:
            own = [j for j, (profile, _) in enumerate(profiles.objectives) if profile == name]
            rules[f"knee of {name}"] = genetic.knee(file.values[:, own])
    return Found(profiles, file, searches, _chosen(options.pick, rules, len(file.points)), rules)


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

                searches[name] = genetic.nsga2(
                    lambda points, name=name: profiles.evaluate(points, name),  # type: ignore[misc]
                    profiles.lower,
                    profiles.upper,
                    objectives=sum(profile == name for profile, _ in profiles.objectives),
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


def _joined(profiles: Profiles, searches: Mapping[str, Front]) -> FrontFile:
    """The points of all fronts with their objectives in every profile; those that break down left out."""
    points = np.concatenate([f.points for f in searches.values()])
    owners = [name for name, f in searches.items() for _ in f.points]
    values = np.nan_to_num(profiles.evaluate(points), nan=genetic.BROKEN)
    sound = np.asarray((values < genetic.BROKEN).all(axis=1))
    if not sound.any():
        raise NoTrustworthyResult(
            "the simulation breaks down at every point of the front",
            hint="check units and trial settings, or narrow the bounds",
        )
    if not sound.all():
        warn("SWM027", f"{int((~sound).sum())} points of the front break down in another motion profile")
    return FrontFile(
        profiles.labels,
        profiles.objectives,
        [o for o, good in zip(owners, sound, strict=True) if good],
        points[sound],
        values[sound],
    )


def _read(path: Path, profiles: Profiles) -> FrontFile:
    file = front_format.read(path)
    if sorted(file.coefficients) != sorted(profiles.labels):
        raise InputError(
            f"is a front of {', '.join(file.coefficients)}, and these are estimated: "
            f"{', '.join(profiles.labels)}",
            file=path,
            hint="give the same --fix, --free and --share as when it was made",
        )
    if sorted(file.objectives) != sorted(profiles.objectives):
        raise InputError(
            "is a front of other motion profiles or channels than these trials have",
            file=path,
            hint="give the trials file and --channels it was made with",
        )
    column = [file.coefficients.index(label) for label in profiles.labels]
    scored = [file.objectives.index(o) for o in profiles.objectives]
    return FrontFile(
        profiles.labels,
        profiles.objectives,
        file.profiles,
        file.points[:, column],
        file.values[:, scored],
    )


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
    """Write the front beside the parameter file, unless it was read from there."""
    path = front_format.beside(output)
    if options.front is not None and options.front.resolve() == path.resolve():
        return []
    front_format.write(path, found.file)
    return [path]


# ---------------------------------------------------------------- what it shows


def stages_table(found: Found, stages: Mapping[str, FitResult | None]) -> ev.Table:
    """Objectives and errors before the search, at the chosen point and after least squares."""
    scored = {
        title: None if result is None else found.profiles.scored(result.series)
        for title, result in stages.items()
    }
    rows: list[list[Any]] = []
    for j, (profile, kind) in enumerate(found.profiles.objectives):
        row: list[Any] = [f"DTW distance, {kind}", profile]
        row += ["" if s is None else numbers.number(float(s[j]), 3) for s in scored.values()]
        rows.append(row)
    for role, title in (("fit", "fitted trials"), ("validate", "held-out trials")):
        errors = [{} if r is None else fit_common.scores(r, role) for r in stages.values()]
        for channel in dict.fromkeys(c for e in errors for c in e):
            row = [f"RMSE, {channel}", title]
            row += [
                numbers.number(e[channel]["rmse"], 3, e[channel]["unit"]) if channel in e else ""
                for e in errors
            ]
            rows.append(row)
    return ev.Table(
        id="stages",
        title="What the search gained",
        columns=["quantity", "of", *stages],
        rows=rows,
        caption="DTW distances are per sample, over the scale of the channel ("
        + ", ".join(_scale_text(kind) for kind in dict.fromkeys(k for _, k in found.profiles.objectives))
        + " unless told otherwise); their mean over the trials of a profile.",
    )


def _scale_text(kind: str) -> str:
    size = warping.SCALES[kind]
    if warping.UNITS[kind].startswith("rad"):
        return f"{kind} {np.degrees(size):.3g} {warping.UNITS[kind].replace('rad', 'deg')}"
    return f"{kind} {size:g} {warping.UNITS[kind]}"


def choices_table(found: Found) -> ev.Table:
    """What every rule chooses, and how far the coefficients range over the front."""
    rows: list[list[Any]] = []
    picks = {**found.rules}
    if found.chosen not in picks.values():
        picks = {"by index": found.chosen, **picks}
    for j, label in enumerate(found.profiles.labels):
        column = found.file.points[:, j]
        searched = numbers.interval(float(found.profiles.lower[j]), float(found.profiles.upper[j]), None)
        spread = numbers.interval(float(column.min()), float(column.max()), None)
        rows.append([label, searched, spread, *(numbers.number(float(column[k]), 4) for k in picks.values())])
    rows.append(["index", "", f"0 to {len(found.file.points) - 1}", *picks.values()])
    return ev.Table(
        id="front-choices",
        title="Choices on the front",
        columns=["coefficient", "searched", "over the front", *picks],
        rows=rows,
        caption="least-worst: the largest objective, each over the least on the front, is smallest. knee: "
        "nearest to the best of every objective. Any other point is chosen with --front FILE --pick INDEX.",
    )


def figures(found: Found, stages: Mapping[str, FitResult | None]) -> list[ev.Figure]:
    """The front of every profile, and how it was approached."""
    panels = []
    ends = {t: found.profiles.scored(r.series) for t, r in stages.items() if r is not None}
    for name in found.profiles.names:
        own = [j for j, (profile, _) in enumerate(found.profiles.objectives) if profile == name]
        if len(own) < 2:
            continue
        first, second = own[:2]
        here = np.array([p == name for p in found.file.profiles])
        clouds = [("its front", here, 0)]
        if not here.all():
            clouds.append(("fronts of the other profiles", ~here, 1))
        traces = [
            ev.Trace(x=found.file.values[m, first], y=found.file.values[m, second], style="points",
                     label=label, group=group)
            for label, m, group in clouds if m.any()
        ]  # fmt: skip
        for group, (title, values) in enumerate(ends.items(), start=2):
            label = f"chosen ({found.chosen})" if title == CHOSEN else title
            traces.append(
                ev.Trace(x=values[[first]], y=values[[second]], style="points", label=label, group=group)
            )
        kinds = [found.profiles.objectives[j][1] for j in (first, second)]
        panels.append(
            ev.Panel(
                x_label=f"{kinds[0]} distance",
                y_label=f"{kinds[1]} distance",
                title=name,
                traces=traces,
                x_scale="log",
                y_scale="log",
            )
        )
    drawn = []
    if panels:
        drawn.append(
            ev.Figure(
                id="front",
                title="Pareto fronts",
                caption="Each point is a set of coefficients; no point of a profile's own front is better "
                "than another one of it in both distances. A model that explains all profiles with one set "
                "has points of all fronts close together at the lower left.",
                columns=2,
                panels=panels,
            )
        )
    if found.searches:
        drawn.append(_history(found))
    return drawn


def _history(found: Found) -> ev.Figure:
    panels = []
    for name, front in found.searches.items():
        kinds = [kind for profile, kind in found.profiles.objectives if profile == name]
        generation = np.arange(1, len(front.history) + 1)
        traces = [
            ev.Trace(x=generation, y=front.history[:, j], label=kind, group=j) for j, kind in enumerate(kinds)
        ]
        panels.append(
            ev.Panel(x_label="generation", y_label="least distance", title=name, traces=traces, y_scale="log")
        )
    return ev.Figure(
        id="generations",
        title="The search, generation by generation",
        caption="Least distance of each kind in the population. A search that is done has been level for a "
        "while.",
        columns=2,
        panels=panels,
    )


def methods(found: Found, options: FitGrayboxOptions) -> list[str]:
    """How it was done, in sentences."""
    said = []
    if found.searches:
        evaluations = sum(f.evaluations for f in found.searches.values())
        of = (
            f"for each of {len(found.searches)} motion profiles ({', '.join(found.searches)})"
            if len(found.searches) > 1
            else "over all fitted trials"
        )
        kinds = dict.fromkeys(kind for _, kind in found.profiles.objectives)
        said.append(
            f"A Pareto front of {len(found.profiles.labels)} coefficients was searched {of} by NSGA-II "
            f"(Deb et al. 2002; pymoo), population {options.population}, {options.generations} generations, "
            f"crossover {options.crossover:g}, seed {options.seed}: {evaluations} points in all. "
            f"Objectives are dynamic-time-warping distances ({', '.join(kinds)}), "
            f"time stretched by at most {100 * options.band:g} % of the record (Sakoe and Chiba 1978; "
            "dtaidistance)."
        )
    rule = next((r for r, k in found.rules.items() if k == found.chosen), "")
    by = f"by the rule {options.pick}" if options.pick in found.rules else "by hand"
    said.append(
        f"Point {found.chosen} of {len(found.file.points)} was chosen {by}"
        + (f" (it is also that of the rule {rule})" if by == "by hand" and rule else "")
        + "."
    )
    if options.method == "nsga2":
        said.append(
            "Standard errors are those of the model made linear at that point, what it misses counted as "
            "noise; the point is no least-squares optimum (--method hybrid goes on to one)."
        )
    else:
        said.append("Least squares started there and at the points of the other rules.")
    return said


def summary(found: Found, options: FitGrayboxOptions, saved: Sequence[Path]) -> list[str]:
    """The choice, for the terminal."""
    where = next((f" in {p}" for p in saved if p.name.endswith(".front.csv")), "")
    names = ", ".join(f"{rule} {k}" for rule, k in found.rules.items())
    return [f"  front: {len(found.file.points)} points{where}; chosen {found.chosen} ({names})"]
