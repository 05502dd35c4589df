"""Command ``swimid init``: drafts of the files of a project, from a folder of recordings."""

from __future__ import annotations

import shlex
from collections import Counter
from pathlib import Path
from typing import Any

from swimid.errors import InputError, UsageError, suggestion
from swimid.files import atomic
from swimid.files.yamlio import ASK
from swimid.logs.experiments import find_experiments
from swimid.logs.trials import find_own_experiments
from swimid.notices import Progress, silent
from swimid.options import takes
from swimid.projects import drafts
from swimid.projects.drafts import RUN, Project
from swimid.projects.options import InitOptions
from swimid.projects.robot import find_robot
from swimid.projects.survey import SurveyedFile, survey
from swimid.results.evidence import Table
from swimid.results.result import Result, table_text
from swimid.robots import file as robot_format

#: Maximum number of questions and of files that the terminal shows. The README of the project lists all of
#: them.
MAX_LISTED_ENTRIES = 12
#: Maximum number of questions of one file that the terminal shows one by one.
MAX_LINES = 4


class Drafted(Result):
    """Result of ``init``: recordings that were found, questions to the user, and next commands.

    Attributes
    ----------
    document : Project
        Text of each drafted file.
    """

    def next_command(self, file: str | Path, folder: Path = Path()) -> str:
        """Return the first command of the project."""
        return str(self.data["next"])


@takes(InitOptions)
def init(
    folder: str | Path,
    *,
    options: InitOptions,
    output: str | Path | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Drafted:
    """Examine a folder of recordings, and draft the files that are needed to work with them.

    Parameters
    ----------
    folder : path
        Folder of films, logs and tables, with its subfolders.
    output : path, optional
        Folder of the project. Without it, nothing is written.
    force : bool
        Whether the folder of the project may have content. Files of the same names are replaced.
    progress : Progress
        Progress over the files of the folder and the films.

    Returns
    -------
    Result
        ``.document.files`` has the text of each file, ``.data`` the recordings, questions and commands.

    Raises
    ------
    InputError
        The folder does not exist or is empty, or the robot does not exist.
    UsageError
        The folder of the project has content, or there is no such experiment.

    Examples
    --------
    >>> found = init("sample_logs/rig", robot="boxfish", experiment="falling-weight")
    >>> sorted(found.document.files)
    ['README.md', 'log-1.trials.yaml']
    """
    source = Path(folder)
    target = Path() if output is None else Path(output)
    if output is not None:
        atomic.check_empty(target, force=force)
    project = _start_project(target, options)
    recordings = survey(source, project.kinds, target if output else None, progress)
    if project.robot is None:
        _add_robot(project, source)
    written: list[Path] = []
    with atomic.write_together():
        if output is not None:
            # Make the folder first, because the paths in the plan are relative to it. It is removed again
            # after an error.
            atomic.make_folder(target)
        data = _draft_files(project, source, recordings, progress)
        if output is not None:
            written = _write(project)
            data["next"] = f"cd {shlex.quote(str(target))}"
    return Drafted("init", _describe_project(project, data), data, written, document=project)


def _start_project(folder: Path, options: InitOptions) -> Project:
    """Return a project without files, with the robot and the experiment that the user states."""
    robot = options.robot
    if robot is not None:
        place = robot_format.locate(robot)
        if robot not in robot_format.list_built_in_robots():
            robot = drafts.relative(place, folder)
    own = find_own_experiments(options.experiment or "")
    kinds, experiment = find_experiments(own), options.experiment
    if own:
        experiment = own[0].title
    if experiment not in (None, *kinds):
        raise UsageError(f"there is no experiment '{experiment}'", hint=suggestion(str(experiment), [*kinds]))
    file = Path(str(options.experiment)) if own else None
    return Project(folder, robot, experiment, kinds, experiment_file=file)


def _add_robot(project: Project, source: Path) -> None:
    """Take the robot from a file in MJCF or URDF in the folder, if there is one and MuJoCo is installed."""
    try:
        found = find_robot(source)
    except (InputError, UsageError) as error:
        project.missing.append(f"robot.yaml is not drafted from the robot's model: {error}")
        return
    if found is not None:
        path, project.robot_text, asks = found
        words = f"robot.yaml is drafted from {path.name}"
        project.robot_asks = [f"{words}: {ask}" for ask in asks] or [f"{words}: check it"]


def _draft_files(
    project: Project, source: Path, recordings: list[SurveyedFile], progress: Progress
) -> dict[str, Any]:
    """Add all files to a project; return recordings, questions and commands as plain data."""
    notes = [one for one in recordings if one.kind == "notes"]
    drafts.draft(project, drafts.groups_of(recordings), notes, progress)
    shown = project.all_groups()
    grouped = {one.path for group in shown for one in group.recordings}
    commands, questions = _commands(project), project.questions()
    others = [one for one in recordings if one.path not in grouped]
    project.files["README.md"] = drafts.render_template(
        "README.md", folder=source.resolve().name, groups=shown, others=others,
        missing=project.missing, questions=questions, commands=commands,
    )  # fmt: skip
    return {
        "recordings": [{"file": str(one.path), "kind": one.kind, "content": one.about} for one in recordings],
        "others": [f"{one.path.name}: {one.about}" for one in others],
        "files": list(project.files),
        "questions": [{"file": name, "line": line, "text": text} for name, line, text in questions],
        "missing": project.missing,
        "commands": commands,
        "next": f"swimid init {shlex.quote(str(source))} -o project",
    }


def _write(project: Project) -> list[Path]:
    """Write all files of a project, and return their paths."""
    written: list[Path] = []
    for name, text in project.files.items():
        path = project.folder / name
        if name in project.pictures:
            # The draft of a setup writes the picture of its markers, too.
            written += project.pictures[name].save(path).outputs
        atomic.write_text(path, text)
        written.append(path)
    return list(dict.fromkeys(written))


def _commands(project: Project) -> list[str]:
    """Return the commands of a project in the order in which they are typed."""
    commands = []
    if "plan.yaml" in project.files:
        commands.append(f"swimid batch plan.yaml -o {RUN}")
    for group in project.groups:
        trials = f"{group.name}.trials.yaml"
        if group.experiment == ASK:
            fits = dict.fromkeys(project.kinds[name].commands[0] for name in group.fitting)
            commands.append(f"# state the experiment in {trials}, then take its command: {', '.join(fits)}")
        fit, own = project.kinds[group.fitting[0]].commands[0], ""
        if project.experiment_file is not None and group.experiment == project.experiment:
            own = f" --experiment {shlex.quote(project.relative(project.experiment_file))}"
        model, results = f"{group.name}.yaml", f"{group.name}.yaml {group.name}.comparison.yaml"
        commands += [
            f"swimid {fit} {trials}{own} -o {model}",
            f"swimid compare {trials}{own} --params {model} -o {group.name}.comparison.yaml",
            f"swimid report {results} -o {group.name}.html",
        ]
    if project.optional:
        commands += ["# inertial logs, one by one: motion between the pictures", *project.optional]
    return commands


def _describe_project(project: Project, data: dict[str, Any]) -> str:
    """Return the text that the command prints: groups, other files, and open questions."""
    rows = [
        [group.name, str(len(group.recordings)), group.first.path.name, group.first.about]
        for group in project.all_groups()
    ]
    columns = ["recordings", "number", "first", "content"]
    lines = [table_text(Table(id="found", title="Found", columns=columns, rows=rows))]
    asked, by_file = list(data["missing"]), Counter(one["file"] for one in data["questions"])
    for name, count in by_file.items():
        first = next(one for one in data["questions"] if one["file"] == name)
        if name == "robot.yaml":
            asked.append(f"{name}: {count} lines, for a robot that is not built in")
        elif count > MAX_LINES:
            asked.append(f"{name}: {count} lines, from line {first['line']} on: {first['text']}")
        else:
            lines_of = [one for one in data["questions"] if one["file"] == name]
            asked += [f"{name}, line {one['line']}: {one['text']}" for one in lines_of]
    for title, entries in (("Other files", data["others"]), ("To answer", asked)):
        if entries:
            lines += [
                "",
                f"{title} ({len(entries)}):",
                *(f"  {entry}" for entry in entries[:MAX_LISTED_ENTRIES]),
            ]
        if len(entries) > MAX_LISTED_ENTRIES:
            lines.append(f"  and {len(entries) - MAX_LISTED_ENTRIES} more in README.md")
    return "\n".join(lines)
