"""Drafts of the files of a project, made of groups of recordings that were made in the same way.

A draft contains the values that the recordings state. Every other value is ``ASK``; every command refuses a
file with ``ASK``.
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

from swimid.errors import InputError, NoTrustworthyResult
from swimid.files import yamlio
from swimid.files.templates import environment
from swimid.files.yamlio import ASK
from swimid.imports.formats import open_table
from swimid.imports.mapping import FORMAT as MAPPING
from swimid.imports.mapping import guess_mapping
from swimid.logs.experiments import FORMAT as TRIALS
from swimid.logs.experiments import Trials
from swimid.logs.units import UNITS, canonical
from swimid.notices import Progress, silent
from swimid.points.point_files import find_tracked_points
from swimid.projects.survey import SurveyedFile, several
from swimid.robots.file import list_built_in_robots
from swimid.runs.plan import folder_of, resolve
from swimid.tracking.track_setup import SetupDraft, track_setup

#: Option of a plan that names the log to which the tables of the same trial are joined.
NAMED = {"as": "log"}
#: Folder of the run of the plan, in the project.
RUN = "run"
#: Maximum number of films of a group that are searched for a second marker, if only one marker is found in
#: them.
MAX_SETUPS = 4
#: Maximum difference between the rows of a tracker's table and the frames of its film. Some containers state
#: one or two frames more than they contain (:class:`swimid.tracking.frames.Video`).
MAX_FRAME_DIFFERENCE = 2


#: Keys of the drive that a table of recordings may state.
DRIVE_KEYS = ("frequency_hz", "amplitude_deg", "bias_deg")
#: Keys of a trial that a table of recordings cannot state.
UNSTATED = {"id", "log", "drive", "coefficients"}


@dataclass
class RecordingGroup:
    """Recordings that were made in the same way.

    Attributes
    ----------
    name : str
        Name of the files that are drafted for the group.
    recordings : list of Recording
    columns : tuple of str
        Columns of the logs of the group, as far as they are known.
    steps : list of dict
        Steps of the plan that make a log of a recording; empty for recordings that are logs.
    rates_hz : dict of Path to float
        Frame rates of the films of which the recordings are tables.
    companions : list of Group
        Groups of tables of the same trials. The name of each table begins with the name of a recording of
        this group.
    fitting : list of str
        Experiments that the trials file may state.
    experiment, robot : str
        Experiment and robot of the trials file, or ``ASK``.
    """

    name: str
    recordings: list[SurveyedFile]
    columns: tuple[str, ...] = ()
    steps: list[dict[str, Any]] = field(default_factory=list)
    rates_hz: dict[Path, float] = field(default_factory=dict)
    companions: list[RecordingGroup] = field(default_factory=list)
    fitting: list[str] = field(default_factory=list)
    experiment: str = ASK
    robot: str = ASK

    @property
    def first(self) -> SurveyedFile:
        """First recording of the group, from which its files are drafted."""
        return self.recordings[0]


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
    kinds : dict of str to class
        All experiments, by name.
    experiment_file : Path or None
        Python file with experiments of the user.
    missing : list of str
        Further steps before the files can be used, besides answers to the questions: sentences with a
        command.
    inertial : list of (Path, Path, str)
        Inertial logs, each with the recording of the same trial and its mapping.
    optional : list of str
        Commands for recordings that the fits do not need.
    robot_text : str
        Robot file with links that is drafted from a file in MJCF or URDF; empty without one.
    robot_asks : list of str
        Questions that the drafted robot file asks the user.
    """

    folder: Path
    robot: str | None
    experiment: str | None
    kinds: Mapping[str, type[Trials]]
    experiment_file: Path | None = None
    groups: list[RecordingGroup] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, SetupDraft] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    inertial: list[tuple[Path, Path, str]] = field(default_factory=list)
    optional: list[str] = field(default_factory=list)
    robot_text: str = ""
    robot_asks: list[str] = field(default_factory=list)

    def relative(self, path: Path) -> str:
        """Return a path relative to the folder of the project, with slashes."""
        return relative(path, self.folder)

    def fitting(self, group: RecordingGroup) -> list[str]:
        """Return the experiments whose columns the logs of a group have; all if the columns are unknown.

        The experiments that need most columns come first.
        """
        alone = self.kinds.get(group.first.kind)
        if alone is not None:
            return [alone.title]
        known = bool(group.columns) and ASK not in group.columns
        found = {name: kind for name, kind in self.kinds.items() if kind.entry is not None}
        names = [name for name, kind in found.items() if not known or kind.has_columns(group.columns)]
        return sorted(names, key=lambda name: -len(found[name].usual))

    def all_groups(self) -> list[RecordingGroup]:
        """Return the groups, each followed by its companions."""
        return [one for group in self.groups for one in (group, *group.companions)]

    def questions(self) -> list[tuple[str, int, str]]:
        """Return file, line number and text of each line with an ``ASK``."""
        found = []
        for name, text in self.files.items():
            lines = [(name, number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
            found += [one for one in lines if re.search(rf"\b{ASK}\b", one[2].partition("#")[0])]
        return found


def groups_of(recordings: Iterable[SurveyedFile]) -> list[RecordingGroup]:
    """Return the groups of recordings that were made in the same way, films last.

    A film is not tracked again if the folder has a table of its points from another tracker.
    """
    order = ("", "log", "points", "table", "choice", "film")
    usable = [one for one in recordings if one.is_alone or one.kind in order]
    tracked, rates = _match_films(usable)
    alike: dict[Any, list[SurveyedFile]] = {}
    for one in sorted(usable, key=lambda one: order.index("" if one.is_alone else one.kind)):
        if one.path not in tracked:
            alone = one.path if one.is_alone or one.kind == "choice" else None
            alike.setdefault((one.alike, alone), []).append(one)
    groups: list[RecordingGroup] = []
    for members in alike.values():
        kind = members[0].kind
        number = sum(group.first.kind == kind for group in groups) + 1
        known = {one.path: rates[one.path] for one in members if rates.get(one.path)}
        groups.append(RecordingGroup(f"{kind}-{number}", members, rates_hz=known))
    return groups


def _match_films(recordings: list[SurveyedFile]) -> tuple[set[Path], dict[Path, float]]:
    """Return the films of which the folder has a table of tracked points, and frame rates of the tables."""
    tracked: set[Path] = set()
    rates: dict[Path, float] = {}
    films = [one for one in recordings if one.kind == "film"]
    for table in (one for one in recordings if one.kind == "points"):
        film = _namesake(table, films)
        if film is not None:
            tracked.add(film.path)
            # A table of a thinned copy of the film has another number of rows, and another rate.
            if abs(table.rows - film.rows) <= MAX_FRAME_DIFFERENCE:
                rates[table.path] = film.rate_hz
    return tracked, rates


def _namesake(table: SurveyedFile, others: Iterable[SurveyedFile]) -> SurveyedFile | None:
    """Return the recording with whose name the name of a table begins; if several, the one in its folder."""
    name, found = table.path.stem, []
    for other in others:
        stem = other.path.stem
        if name.startswith(stem) and not name[len(stem) :][:1].isdigit():
            found.append((other.path.parent == table.path.parent, len(stem), other))
    return max(found, key=lambda entry: entry[:2])[2] if found else None


def pair_groups(groups: list[RecordingGroup]) -> list[RecordingGroup]:
    """Return the groups that get a trials file; add groups of tables of the same trials as companions.

    For example, ``swim1_servo.csv`` belongs to ``swim1.mp4``. Every table of a group must have such a film,
    log or table of points.
    """
    bases = [group for group in groups if group.first.kind in ("film", "points", "log")]
    kept: list[RecordingGroup] = []
    for group in groups:
        base = _find_base(group, bases)
        if base is None:
            kept.append(group)
        else:
            base.companions.append(group)
    return kept


def _find_base(group: RecordingGroup, bases: list[RecordingGroup]) -> RecordingGroup | None:
    """Return the group of recordings of the same trials as the tables of a group; None if there is none."""
    others = [one for base in bases if base is not group for one in base.recordings]
    names = [_namesake(one, others) for one in group.recordings]
    pairs = zip(group.recordings, names, strict=True)
    suffixes = {one.path.stem.removeprefix(other.path.stem) for one, other in pairs if other is not None}
    if group.first.kind not in ("table", "log") or len(suffixes) != 1 or "" in suffixes:
        return None
    return next((base for base in bases if all(name in base.recordings for name in names)), None)


def draft(
    project: Project, groups: list[RecordingGroup], notes: list[SurveyedFile], progress: Progress = silent
) -> None:
    """Add the files for all groups to a project: setups, mappings, points, trials, plan and robot."""
    groups = project.groups = pair_groups(groups)
    for group in groups:
        DRAFTS.get(group.first.kind, _of_log)(project, group, progress)
        _add_companions(project, group, progress)
    _add_plan(project)
    logs = _logs_of(project)
    for path, base, name in project.inertial:
        words = [project.relative(path), "--map", name, "--with", logs[base], "-o", f"{path.stem}.csv"]
        project.optional.append(f"swimid track imu {shlex.join(words)}")
    for group in groups:
        _add_trials(project, group, [logs[one.path] for one in group.recordings], notes)
    _add_robot_file(project)


def _add_robot_file(project: Project) -> None:
    """Add a robot file for the groups whose robot is not known."""
    names = {name for group in project.groups if group.robot == ASK for name in group.fitting}
    forms = {project.kinds[name].robot_form for name in names} - {""}
    if forms == {"links"} and project.robot_text:
        project.files["robot.yaml"] = project.robot_text
        project.missing += project.robot_asks
    elif forms:
        columns = [name for group in project.groups for name in group.columns]
        joints = [re.fullmatch(r"(?:cmd|joint)(\d+)_rad", name) for name in columns]
        count = max((int(hit[1]) for hit in joints if hit), default=1)
        links = ["body", *(f"segment{k}" for k in range(1, count)), "tail"]
        project.files["robot.yaml"] = render_template(
            "robot.yaml", rigid="body" in forms, linked="links" in forms, links=links
        )


# ---------------------------------------------------------------- logs


def _of_film(project: Project, group: RecordingGroup, progress: Progress) -> None:
    """Add the setup of a camera, drafted from the first film in which two markers, or else one, are found."""
    name = f"{group.name}.setup.yaml"
    group.columns = ("x_m", "y_m", "yaw_rad")
    options: dict[str, Any] = {"setup": name}
    if group.first.rate_hz == 0:
        options["fps"] = ASK
    group.steps = [{"track video": options}]
    found: list[tuple[SurveyedFile, SetupDraft]] = []
    for film in group.recordings:
        try:
            made = track_setup(film.path, fps=None if film.rate_hz else 1.0, progress=progress)
        except (NoTrustworthyResult, InputError):
            continue
        found.append((film, made))
        if made.setup.tail is not None or len(found) == MAX_SETUPS:
            break
    if found:
        film, made = next((one for one in found if one[1].setup.tail is not None), found[0])
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


def _of_points(project: Project, group: RecordingGroup, progress: Progress) -> None:
    """Add a points file: places on a robot if the robot is known, and a chain otherwise."""
    name = f"{group.name}.points.yaml"
    points = list(find_tracked_points({name: np.empty(0) for name in group.first.columns}))
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
    group.steps = [{"import": options}]
    group.columns = ("x_m", "y_m", "yaw_rad", "joint1_rad")


def _of_table(project: Project, group: RecordingGroup, progress: Progress) -> None:
    """Add the drafted mapping of the tables of a group."""
    name = f"{group.name}.map.yaml"
    group.steps = [{"import": {"map": name}}]
    text = guess_mapping(group.first.path).document
    if group.first.profile:
        try:
            open_table(group.first.path)
        except InputError as error:
            if several(error):
                text += f"# join: may add columns of another topic (docs/import.md). {error.hint}\n"
    project.files[name] = text
    group.columns = tuple(re.findall(r"(?m)^ *- .*target: (\w+)", text))
    if not group.columns:
        group.columns = group.first.columns


def _of_choice(project: Project, group: RecordingGroup, progress: Progress) -> None:
    """Note that the user must choose one of several topics, tracks or sheets before a mapping is drafted."""
    name = f"{group.name}.map.yaml"
    group.steps = [{"import": {"map": name}}]
    file = shlex.quote(project.relative(group.first.path))
    project.missing.append(
        f"{name}: {group.first.path.name} {group.first.about}. "
        f"Then: swimid import {file} --guess --select NAME -o {name}"
    )


def _of_log(project: Project, group: RecordingGroup, progress: Progress) -> None:
    """Note the columns of a log, which needs no further file."""
    group.columns = group.first.columns


#: Functions that add the files for a group to a project, by the kind of the recordings in the group.
DRAFTS = {
    "film": _of_film,
    "points": _of_points,
    "table": _of_table,
    "choice": _of_choice,
}


def _add_companions(project: Project, group: RecordingGroup, progress: Progress) -> None:
    """Add the mapping that joins the tables of the same trials to the logs of a group, by their names.

    The clock of each table is aligned by a commanded joint angle and the heading. An inertial log is not
    joined, because ``track imu`` estimates the motion from it together with the log.
    """
    joined: list[str] = []
    for companion in group.companions:
        file = companion.first
        base = _namesake(file, group.recordings) or group.recordings[0]
        text = guess_mapping(file.path).document
        columns = tuple(re.findall(r"(?m)^ *- .*target: (\w+)", text))
        if {"ax_m_s2", "wx_rad_s"} <= {*columns}:
            name = f"{companion.name}.map.yaml"
            project.files[name] = text
            project.inertial.append((file.path, base.path, name))
            continue
        suffix = file.path.name.removeprefix(base.path.stem)
        place = project.relative(file.path.parent / f"{{stem}}{suffix}")
        aligned = next((name for name in columns if re.fullmatch(r"(cmd|joint)\d+_rad", name)), None)
        joined.append(f"  - file: {_flow(place)}   # {{stem}}: the name of the recording without its ending")
        if aligned and "yaw_rad" in group.columns:
            joined.append(
                f"    align: {{this: yaw_rad, that: {aligned}}}   # or offset_s under 'time:', if known"
            )
        lines = text.splitlines()
        joined += [f"    {line}" for line in lines if not line.startswith(("#", "format:", "metadata:"))]
        group.columns += columns
    if joined:
        name = f"{group.name}.map.yaml"
        head = f"# Joins the tables of the same trials to each log. Answer or delete every line with {ASK}."
        project.files[name] = "\n".join([head, f"format: {MAPPING}", "as: swimid", "join:", *joined]) + "\n"
        group.steps = [*group.steps, {"import": {"map": name, **NAMED}}]


# ---------------------------------------------------------------- plan and trials


def _add_plan(project: Project) -> None:
    """Add the plan that makes logs of all recordings that are not logs."""
    items, overrides = [], {}
    for group in project.groups:
        if not group.steps:
            continue
        (command, options), *_ = group.steps[0].items()
        items.append({"name": group.name, "files": _patterns(project, group), "steps": group.steps})
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


def _patterns(project: Project, group: RecordingGroup) -> list[str]:
    """Return the patterns of the files of a group, with one pattern for each folder inside the group."""
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
    # Plan imports with the names of the logs only, because other options name drafted files, which do not
    # exist yet.
    items: list[dict[str, Any]] = []
    for group in (one for one in project.groups if one.steps):
        options = [next(iter(step.values())) for step in group.steps]
        steps = [{"import": {key: one[key] for key in NAMED if key in one}} for one in options]
        items.append({"name": group.name, "files": _patterns(project, group), "steps": steps})
    if not items:
        return own
    content = {"format": "swimid-plan/1", "items": items}
    plan = resolve(project.folder / "plan.yaml", project.folder / RUN, content)
    made: dict[str, str] = {}
    for item in plan.items:
        log = f"{RUN}/{folder_of(Path(), item.id).as_posix()}/{item.steps[-1].outputs[0]}"
        made |= dict.fromkeys(item.files, log)
    return {path: made.get(name, name) for path, name in own.items()}


def _add_trials(project: Project, group: RecordingGroup, logs: list[str], notes: list[SurveyedFile]) -> None:
    """Add the trials file of a group. ``logs`` has the path of the log of each recording."""
    fitting, kinds = project.fitting(group), project.kinds
    group.experiment = experiment = _choose_experiment(project, group, fitting, notes)
    kind = kinds.get(experiment)
    group.fitting = fitting if kind is None else [experiment]
    robots = {one.metadata.get("robot") for one in group.recordings} - {None}
    group.robot = project.robot or (str(robots.pop()) if len(robots) == 1 else ASK)
    lines = [
        f"# Trials of {len(group.recordings)} recordings of {group.first.path.parent.name}. "
        f"Answer every {ASK}, or delete its line. All keys: swimid schema trials",
        f"format: {TRIALS}",
        f"experiment: {experiment}" + f"   # {', '.join(fitting)}" * (experiment == ASK),
        f"robot: {group.robot}"
        + f"   # {', '.join(list_built_in_robots())}, or robot.yaml" * (group.robot == ASK),
    ]
    if kind is not None and group.first.is_alone:
        table = project.relative(group.first.path)
        lines += [f"# {kind.about}", f"table: {_flow(table)}", *(f"{key}: {ASK}" for key in kind.asked)]
    else:
        lines.append("# Hold out one trial or more with 'role: validate'. Without one no fit is called good.")
        if kind is None:
            lines += [f"#   {name}: {kinds[name].about}" for name in fitting]
        lines += _trial_lines(project, group, logs, notes, kind)
    project.files[f"{group.name}.trials.yaml"] = "\n".join(lines) + "\n"


def _trial_lines(
    project: Project,
    group: RecordingGroup,
    logs: list[str],
    notes: list[SurveyedFile],
    kind: type[Trials] | None,
) -> list[str]:
    """Return the lines of a trials file with the trials of a group."""
    asked: Mapping[str, Any] = {} if kind is None else kind.asked
    entries = [{**asked, **_keys_of(one, notes, kind)} for one in group.recordings]
    lines = []
    commands = [name for name in group.columns if re.fullmatch(r"(cmd|joint)\d+_rad", name)]
    if commands and any("drive" in entry for entry in entries):
        lines.append(f"# The drive is in the logs: {', '.join(commands)}.")
        for entry in entries:
            entry.pop("drive", None)
    files = {one.path.name for group in project.all_groups() for one in group.recordings}
    lines += [*_list_unused(notes, kind, files), "trials:"]
    for log, ident, entry in zip(logs, _idents(group), entries, strict=True):
        lines.append(f"  - {_flow({'id': ident, 'log': log, **entry})}")
    return lines


def _choose_experiment(
    project: Project, group: RecordingGroup, fitting: list[str], notes: list[SurveyedFile]
) -> str:
    """Return the experiment of a group among those that its columns fit; ``ASK`` if it is not known.

    The experiment is known if the logs or the user state it, or if they state keys that only one experiment
    needs.
    """
    stated = {str(one.metadata["experiment"]) for one in group.recordings if one.metadata.get("experiment")}
    given = [*stated] * (len(stated) == 1) + [str(project.experiment)]
    if group.first.is_alone:
        given = fitting
    for name in given:
        if name in fitting:
            return name
    complete = []
    for name in fitting:
        kind = project.kinds[name]
        keys = [_keys_of(one, notes, kind).keys() for one in group.recordings]
        if kind.asked and all(kind.asked.keys() <= one for one in keys):
            complete.append(name)
    return complete[0] if len(complete) == 1 else ASK


def _idents(group: RecordingGroup) -> list[str]:
    """Return an id of a trial for each recording: the stem of its name, with its folder if stems repeat."""
    stems = [one.path.stem for one in group.recordings]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{one.path.parent.name}-{one.path.stem}" for one in group.recordings]


def _keys(kind: type[Trials] | None) -> set[str]:
    """Return the keys of a trial that a table of recordings may state, including the keys of the drive."""
    entry = kind and kind.entry
    if entry is None:
        return {"role"}
    keys = {*entry.model_fields} - UNSTATED
    return keys | set(DRIVE_KEYS if "drive" in entry.model_fields else ())


def _key_of(header: str, keys: Iterable[str]) -> tuple[str, float] | None:
    """Return the key that a column header names, and the factor from its unit to the unit of the key.

    >>> _key_of("Frequency [Hz]", ["frequency_hz"]), _key_of("pulling mass (g)", ["pulling_mass_kg"])
    (('frequency_hz', 1.0), ('pulling_mass_kg', 0.001))
    """
    name = re.sub(r"\W+", "_", header.lower()).strip("_")
    for key in keys:
        bare, _, unit = key.lower().rpartition("_")
        if name == key.lower():
            return key, 1.0
        for table in UNITS.values():
            factors = {known.lower(): factor for known, factor in table.items()}
            written = canonical(name.removeprefix(f"{bare}_")).lower()
            if bare and name.startswith(f"{bare}_") and {unit, written} <= factors.keys():
                return key, factors[written] / factors[unit]
    return None


def _list_unused(notes: list[SurveyedFile], kind: type[Trials] | None, files: set[str]) -> list[str]:
    """Return a comment line for each table of recordings that has columns which are no keys of the trials."""
    lines = []
    for table in notes:
        keys = sorted(_keys(kind))
        others = [name for name, cells in table.cells.items() if not files >= {*cells}]
        unused = [name for name in others if name != table.columns[0] and not _key_of(name, keys)]
        if unused:
            text = f"# {table.path.name}: not used: {', '.join(unused)}. Keys of a trial: {', '.join(keys)}"
            lines.append(re.sub(r"[\r\n]", " ", text))
    return lines


def _keys_of(one: SurveyedFile, notes: list[SurveyedFile], kind: type[Trials] | None) -> dict[str, Any]:
    """Return the keys of a trial that the metadata of its log, or a table of recordings, states."""
    keys = sorted(_keys(kind))
    found = {key: value for key, value in one.metadata.items() if key in keys and value is not None}
    for table in notes:
        rows = enumerate(table.cells[table.columns[0]])
        for number in [k for k, file in rows if file in (one.path.name, one.path.stem)]:
            found |= _read_row(table, number, keys)
    drive = {key: found.pop(key) for key in DRIVE_KEYS if key in found}
    return found | ({"drive": drive} if {"frequency_hz", "amplitude_deg"} <= drive.keys() else {})


def _read_row(table: SurveyedFile, number: int, keys: list[str]) -> dict[str, Any]:
    """Return the keys of a trial that a row of a table of recordings states, in the units of the keys."""
    row = {}
    for name, cells in table.cells.items():
        hit = _key_of(name, keys)
        value = None if hit is None else yamlio.parse_scalar(cells[number])
        if hit is not None and value is not None:
            key, factor = hit
            row[key] = value * factor if isinstance(value, int | float) and factor != 1 else value
    return row


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    return yamlio.dumps_flat({"value": [value]}).removeprefix("value: [").rstrip()[:-1]


def relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with slashes."""
    return Path(relpath(path, folder)).as_posix()


def render_template(template: str, **variables: Any) -> str:
    """Return the text of a template of this package with its variables filled in."""
    templates = environment("swimid.projects", keep_trailing_newline=True, autoescape=False)
    return templates.get_template(template).render(**variables)
