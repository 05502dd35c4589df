"""Drafts of the files of a project, made of groups of recordings that were made in the same way.

A draft states what the recordings state. Everything else is ``ASK``, which every command refuses.
"""

from __future__ import annotations

import glob
import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from swimid.errors import InputError, NoTrustworthyResult
from swimid.files import yamlio
from swimid.files.yamlio import ASK
from swimid.logs.foreign import open_table
from swimid.logs.mapping import guess_mapping
from swimid.logs.point_files import tracked_points
from swimid.logs.trials import FORMAT as TRIALS
from swimid.logs.trials import FallingWeightTrial, FreeSwimTrial, Trial
from swimid.notices import Progress, silent
from swimid.projects.survey import CRUISE, Recording, several
from swimid.robots.file import built_in
from swimid.runs.plan import folder_of, resolve
from swimid.tracking.track_setup import SetupDraft, track_setup

#: Folder of the run of the plan, in the project.
RUN = "run"
#: Maximum difference between the rows of a tracker's table and the frames of its film. Some containers state
#: one or two frames more than they contain (:class:`swimid.tracking.frames.Video`).
MAX_FRAME_DIFFERENCE = 2


@dataclass(frozen=True)
class Experiment:
    """Experiment of a trials file: the columns of its logs, the keys of a trial, and the command for it."""

    command: str
    #: Description, with the keys that a trial needs.
    about: str
    #: Patterns of columns; a log must have a column for each.
    columns: tuple[str, ...]
    #: Keys of a trial that only the user knows.
    asked: Mapping[str, Any] = field(default_factory=dict)
    linked: bool = False


_DRIVE = {"drive": {"frequency_hz": ASK, "amplitude_deg": ASK}}
EXPERIMENTS = {
    "falling-weight": Experiment(
        "fit-drag",
        "a weight pulls the robot; add pulling_mass_kg to each trial",
        ("x_m",),
        {"pulling_mass_kg": ASK},
    ),
    "towed": Experiment("fit-drag", "the robot is towed by a measured force", ("force_N", "x_m|u_m_s")),
    "free-decay": Experiment(
        "fit-drag", "the robot is displaced and released", ("x_m|z_m|roll_rad|pitch_rad|yaw_rad",)
    ),
    "free-swim": Experiment(
        "fit-graybox",
        "it swims in a plane; add drive: {frequency_hz: 1, amplitude_deg: 20}, or log the joint angles",
        ("x_m", "y_m", "yaw_rad"),
        _DRIVE,
        linked=True,
    ),
    "multibody": Experiment(
        "fit-graybox",
        "any motion of a robot with links or of a vehicle",
        (r"joint\w*_rad|(x|y|z)_m|(roll|pitch|yaw)_rad",),
        linked=True,
    ),
    "arma": Experiment(
        "rwls", "a black-box model from one column to another; add input and output", (".*", ".*")
    ),
    "cruise": Experiment("fit-propulsion", "a table of cruising speeds", tuple(sorted(CRUISE))),
}


@dataclass
class Group:
    """Recordings that were made in the same way.

    Attributes
    ----------
    name : str
        Name of the files that are drafted for the group.
    recordings : list of Recording
    columns : tuple of str
        Columns of the logs of the group, as far as they are known.
    step : dict
        Step of the plan that makes a log of a recording; empty for recordings that are logs.
    rates_hz : dict of Path to float
        Frame rates of the films of which the recordings are tables.
    fitting : list of str
        Experiments that the trials file may state.
    experiment, robot : str
        Experiment and robot of the trials file, or ``ASK``.
    """

    name: str
    recordings: list[Recording]
    columns: tuple[str, ...] = ()
    step: dict[str, Any] = field(default_factory=dict)
    rates_hz: dict[Path, float] = field(default_factory=dict)
    fitting: list[str] = field(default_factory=list)
    experiment: str = ASK
    robot: str = ASK

    @property
    def first(self) -> Recording:
        """First recording of the group, from which its files are drafted."""
        return self.recordings[0]

    def experiments(self) -> list[str]:
        """Return the names of the experiments whose columns the logs have; all if columns are unknown."""
        names = [name for name in EXPERIMENTS if (name == "cruise") == (self.first.kind == "cruise")]
        if not self.columns or ASK in self.columns:
            return names
        return [
            name
            for name in names
            if all(any(re.fullmatch(p, c) for c in self.columns) for p in EXPERIMENTS[name].columns)
        ]


@dataclass
class Project:
    """Files of a project, before they are written.

    Attributes
    ----------
    folder : Path
        Folder of the project. Paths in the files are relative to it.
    files : dict of str to str
        Text of each file, by name.
    pictures : dict of str to SetupDraft
        Drafts of setups, by the name of the setup file. Each writes a picture beside its file.
    missing : list of str
        What must be done before the files can be used, besides the answers: sentences with a command.
    """

    folder: Path
    robot: str | None
    experiment: str | None
    groups: list[Group] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, SetupDraft] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)

    def relative(self, path: Path) -> str:
        """Return a path relative to the folder of the project, with slashes."""
        return relative(path, self.folder)

    def questions(self) -> list[tuple[str, int, str]]:
        """Return file, line number and text of each line with an ``ASK``."""
        return [
            (name, number, line.strip())
            for name, text in self.files.items()
            for number, line in enumerate(text.splitlines(), 1)
            if re.search(rf"\b{ASK}\b", line.partition("#")[0])
        ]


def groups_of(recordings: Iterable[Recording]) -> list[Group]:
    """Return the groups of recordings that were made in the same way, films last.

    A film of which a tracker's table is there is not tracked again.
    """
    found: dict[Any, list[Recording]] = {}
    order = ("cruise", "log", "points", "table", "choice", "film")
    usable = [one for one in recordings if one.kind in order]
    rates: dict[Path, float] = {}
    tracked: set[Path] = set()
    films = [one for one in usable if one.kind == "film"]
    for one in (one for one in usable if one.kind == "points"):
        film = _film_of(one, films)
        if film is not None:
            tracked.add(film.path)
            # A table of a thinned copy of the film has another number of rows, and another rate.
            if abs(one.rows - film.rows) <= MAX_FRAME_DIFFERENCE:
                rates[one.path] = film.rate_hz
    for one in sorted(usable, key=lambda one: order.index(one.kind)):
        if one.path not in tracked:
            alone = one.path if one.kind in ("cruise", "choice") else None
            found.setdefault((one.alike, alone), []).append(one)
    groups: list[Group] = []
    for members in found.values():
        kind = members[0].kind
        number = sum(group.first.kind == kind for group in groups) + 1
        known = {one.path: rates[one.path] for one in members if rates.get(one.path)}
        groups.append(Group(f"{kind}-{number}", members, rates_hz=known))
    return groups


def _film_of(table: Recording, films: Iterable[Recording]) -> Recording | None:
    """Return the film with whose name a tracker's table begins, from the same folder if there are several."""
    name, found = table.path.stem, []
    for film in films:
        stem = film.path.stem
        if name.startswith(stem) and not name[len(stem) :][:1].isdigit():
            found.append((film.path.parent == table.path.parent, len(stem), film))
    return max(found, key=lambda entry: entry[:2])[2] if found else None


def draft(project: Project, groups: list[Group], notes: list[Recording], progress: Progress = silent) -> None:
    """Add the files for all groups to a project: setups, mappings, points, trials, plan and robot."""
    project.groups = groups
    for group in groups:
        DRAFTS[group.first.kind](project, group, progress)
    _add_plan(project)
    logs = _logs_of(project)
    for group in groups:
        _add_trials(project, group, [logs[one.path] for one in group.recordings], notes)
    fitting = {name for group in groups if group.robot == ASK for name in group.fitting} - {"arma"}
    if fitting:
        linked = [EXPERIMENTS[name].linked for name in fitting]
        project.files["robot.yaml"] = rendered("robot.yaml", rigid=not all(linked), linked=any(linked))


# ---------------------------------------------------------------- logs


def _of_film(project: Project, group: Group, progress: Progress) -> None:
    """Add the setup of a camera, drafted from the first film in which markers are found."""
    name = f"{group.name}.setup.yaml"
    group.columns = ("x_m", "y_m", "yaw_rad")
    options: dict[str, Any] = {"setup": name}
    if group.first.rate_hz == 0:
        options["fps"] = ASK
    group.step = {"track video": options}
    for film in group.recordings:
        try:
            made = track_setup(film.path, fps=None if film.rate_hz else 1.0, progress=progress)
        except (NoTrustworthyResult, InputError):
            continue
        project.pictures[name] = made
        if made.setup.tail is None:
            group.columns = ("x_m", "y_m")
            project.missing.append(
                f"{name}: one marker was found, so that the logs have no heading. A fit of free swimming "
                "needs a second marker behind it"
            )
        pick = f"swimid track setup {shlex.quote(project.relative(film.path))} --pick -o {name} --force"
        text = made.document.replace(
            "# scale: {metres_per_pixel: 0.0015}",
            f"scale: {{metres_per_pixel: {ASK}}}   # or pick it in the browser: {pick}",
        )
        if made.setup.tail is not None:
            place = "of the marker, m: forward of the reference point of the robot, and to port"
            text = re.sub(r"(?m)^  number: .*$", rf"\g<0>\n  at_m: [{ASK}, {ASK}]   # {place}", text)
        project.files[name] = re.sub(r"(?m)^frame_rate_hz: 1\.0\n", "", text)
        return
    file = shlex.quote(project.relative(group.first.path))
    project.missing.append(
        f"{name}: no marker was found in {group.first.path.name}. "
        f"Pick the markers: swimid track setup {file} --pick -o {name}"
    )


def _of_points(project: Project, group: Group, progress: Progress) -> None:
    """Add a points file: places on a robot if the robot is known, and a chain otherwise."""
    name = f"{group.name}.points.yaml"
    points = list(tracked_points({name: np.empty(0) for name in group.first.columns}))
    options: dict[str, Any] = {"points": name}
    lines = [
        f"# Points of {group.first.path.name}. Answer every {ASK}. All keys: swimid schema points",
        "format: swimid-points/1",
    ]
    if project.robot is not None:
        options["robot"] = project.robot
        lines += ["points:   # from the front end of the link: x forward, y to port, m", *(
            f"  {point}: {{link: {ASK}, at_m: [{ASK}, 0]}}" for point in points
        )]  # fmt: skip
    else:
        listed = ", ".join(points)
        lines.append(f"chain: [{ASK}]   # the points along the body, from front to rear, of: {listed}")
    lines.append(
        "# default scale: from the lengths of the links\n# scale: {metres_per_pixel: 0.0005}"
        if project.robot is not None
        else f"scale: {{metres_per_pixel: {ASK}}}   # or {{between: [a, b], distance_m: 0.1}}"
    )
    if not group.first.has_times and set(group.rates_hz) != {one.path for one in group.recordings}:
        options["rate-hz"] = ASK
    project.files[name] = "\n".join(lines) + "\n"
    group.step = {"import": options}
    group.columns = ("x_m", "y_m", "yaw_rad", "joint1_rad")


def _of_table(project: Project, group: Group, progress: Progress) -> None:
    """Add a mapping of a table."""
    name = f"{group.name}.map.yaml"
    group.step = {"import": {"map": name}}
    text = guess_mapping(group.first.path).document
    if group.first.profile:
        try:
            open_table(group.first.path)
        except InputError as error:
            if several(error):
                text += f"# join: may add columns of another topic (docs/mapping.md). {error.hint}\n"
    project.files[name] = text
    group.columns = tuple(re.findall(r"(?m)^ *- .*target: (\w+)", text))
    if not group.columns:
        group.columns = group.first.columns


def _of_choice(project: Project, group: Group, progress: Progress) -> None:
    """Note that the user must choose one of several topics, tracks or sheets before a mapping is drafted."""
    name = f"{group.name}.map.yaml"
    group.step = {"import": {"map": name}}
    file = shlex.quote(project.relative(group.first.path))
    project.missing.append(
        f"{name}: {group.first.path.name} {group.first.about}. "
        f"Then: swimid import {file} --guess --select NAME -o {name}"
    )


def _of_log(project: Project, group: Group, progress: Progress) -> None:
    """Note the columns of a log, which needs no further file."""
    group.columns = group.first.columns


#: Function that adds the files for a group, by the kind of its recordings.
DRAFTS = {
    "film": _of_film,
    "points": _of_points,
    "table": _of_table,
    "choice": _of_choice,
    "log": _of_log,
    "cruise": _of_log,
}


# ---------------------------------------------------------------- plan and trials


def _add_plan(project: Project) -> None:
    """Add the plan that makes logs of all recordings that are not logs."""
    items, overrides = [], {}
    for group in project.groups:
        if not group.step:
            continue
        (command, options), *_ = group.step.items()
        items.append({"name": group.name, "files": _patterns(project, group), "steps": [{command: options}]})
        if "rate-hz" not in options:
            for path, rate in group.rates_hz.items():
                overrides[project.relative(path)] = {command: {"rate-hz": rate}}
    if not items:
        return
    plan: dict[str, Any] = {"format": "swimid-plan/1", "items": items}
    if overrides:
        plan["overrides"] = overrides
    head = f"# Makes a log of each recording: swimid batch plan.yaml -o {RUN}. A step is a command.\n"
    project.files["plan.yaml"] = head + yamlio.dumps(plan)


def _patterns(project: Project, group: Group) -> list[str]:
    """Return the patterns of the files of a group: one for a folder all of whose files belong to it."""
    members = {one.path for one in group.recordings}
    patterns: dict[str, None] = {}
    for path in sorted(members):
        alike = sorted(path.parent.glob(f"*{path.suffix}"))
        pattern = glob.escape(project.relative(path)) + "/" * path.is_dir()
        if path.is_file() and len(alike) > 2 and members >= {*alike}:
            pattern = f"{glob.escape(project.relative(path.parent))}/*{path.suffix}"
        patterns[pattern] = None
    return list(patterns)


def _logs_of(project: Project) -> dict[Path, str]:
    """Return the path of the log of each recording, relative to the project."""
    own = {one.path: project.relative(one.path) for group in project.groups for one in group.recordings}
    # Names of outputs do not depend on the command that makes a log, and no drafted file exists yet.
    items = [
        {"name": one.name, "files": _patterns(project, one), "steps": ["import"]}
        for one in project.groups
        if one.step
    ]
    if not items:
        return own
    content = {"format": "swimid-plan/1", "items": items}
    plan = resolve(project.folder / "plan.yaml", project.folder / RUN, content)
    made = {
        file: f"{RUN}/{folder_of(Path(), item.id).as_posix()}/{item.steps[0].outputs[0]}"
        for item in plan.items
        for file in item.files
    }
    return {path: made.get(name, name) for path, name in own.items()}


def _add_trials(project: Project, group: Group, logs: list[str], notes: list[Recording]) -> None:
    """Add the trials file of a group, whose recordings have these logs."""
    fitting = group.experiments()
    metadata = [one.metadata for one in group.recordings]
    stated = {one.get("experiment") for one in metadata} - {None}
    experiment = ASK
    if len(stated) == 1 and stated <= {*fitting}:
        experiment = str(stated.pop())
    elif project.experiment in fitting:
        experiment = str(project.experiment)
    elif fitting == ["cruise"]:
        experiment = "cruise"
    group.fitting = fitting if experiment == ASK else [experiment]
    group.experiment = experiment
    robots = {one.get("robot") for one in metadata} - {None}
    robot = project.robot or (str(robots.pop()) if len(robots) == 1 else ASK)
    group.robot = robot
    lines = [
        f"# Trials of {len(group.recordings)} recordings of {group.first.path.parent.name}. "
        f"Answer every {ASK}, or delete its line. All keys: swimid schema trials",
        f"format: {TRIALS}",
        f"experiment: {experiment}" + f"   # {', '.join(fitting)}" * (experiment == ASK),
        f"robot: {robot}" + f"   # {', '.join(built_in())}, or robot.yaml" * (robot == ASK),
    ]
    if group.first.kind == "cruise":
        table = project.relative(group.first.path)
        lines += [f"table: {_flow(table)}", f"drag: {ASK}   # result of fit-drag for this robot"]
    else:
        lines += [
            "# Hold out at least one trial with 'role: validate'. Without one no fit is called good.",
            "trials:",
        ]
        asked = EXPERIMENTS[experiment].asked if experiment != ASK else {}
        if experiment == ASK:
            lines[-1:] = [f"#   {name}: {EXPERIMENTS[name].about}" for name in fitting] + ["trials:"]
        for one, log, ident in zip(group.recordings, logs, _idents(group), strict=True):
            entry = {"id": ident, "log": log, **asked, **_keys_of(one, notes, experiment)}
            lines.append(f"  - {_flow(entry)}")
    project.files[f"{group.name}.trials.yaml"] = "\n".join(lines) + "\n"


def _idents(group: Group) -> list[str]:
    """Return an id of a trial for each recording: the stem of its name, with its folder if stems repeat."""
    stems = [one.path.stem for one in group.recordings]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{one.path.parent.name}-{one.path.stem}" for one in group.recordings]


def _keys_of(one: Recording, notes: list[Recording], experiment: str) -> dict[str, Any]:
    """Return the keys of a trial that the metadata of its log, or a table of recordings, states."""
    rows: list[Mapping[str, Any]] = [one.metadata]
    for table in notes:
        for number, name in enumerate(table.cells[table.columns[0]]):
            if name in (one.path.name, one.path.stem):
                rows.append({key: yamlio.parse_scalar(cells[number]) for key, cells in table.cells.items()})
    trials: dict[str, type[Trial]] = {"falling-weight": FallingWeightTrial, "free-swim": FreeSwimTrial}
    trial = trials.get(experiment)
    keys = {"role", *(trial.model_fields if trial else ())} - {"id", "log", "drive", "coefficients"}
    found: dict[str, Any] = {}
    drive: dict[str, Any] = {}
    for row in rows:
        found |= {key: value for key, value in row.items() if key in keys and value is not None}
        if trial is FreeSwimTrial:
            drive |= {key: row[key] for key in ("frequency_hz", "amplitude_deg", "bias_deg") if key in row}
    if {"frequency_hz", "amplitude_deg"} <= drive.keys():
        found["drive"] = drive
    return found


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    return yamlio.dumps_flat({"value": [value]}).removeprefix("value: [").rstrip()[:-1]


def relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with slashes."""
    return Path(relpath(path, folder)).as_posix()


def rendered(template: str, **variables: Any) -> str:
    """Return the text of a template of this package with its variables filled in."""
    environment = Environment(
        loader=PackageLoader("swimid.projects"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    return environment.get_template(template).render(**variables)
