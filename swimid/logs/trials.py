"""Trials file (``swimid-trials/1``): a list of the logs of one experiment with one robot."""

from __future__ import annotations

import fnmatch
import itertools
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from swimid.errors import InputError, UsageError, nearest, suggestion
from swimid.files import provenance, yamlio
from swimid.files.tabular import column_error, find_repeated
from swimid.logs.experiments import (
    FORMAT,
    TrialEntry,
    Trials,
    check_used,
    find_experiment,
    find_experiments,
    read_experiments,
)
from swimid.logs.log import Log
from swimid.notices import warn
from swimid.robots import file as robot_format


@dataclass(frozen=True, eq=False)
class TrialSet:
    """Trials of one experiment with one robot, from a trials file or from logs in memory.

    :func:`swimid.load` creates it.

    Attributes
    ----------
    entries : pydantic model
        Content of the trials file, an object of the class of the experiment.
    path : Path
        Path of the trials file; for trials in memory their name.
    experiment : str
        ``"falling-weight"``, ``"free-swim"``, ...
    ids : list of str
        Ids of the trials; empty for a cruise, which is one table.

    Examples
    --------
    >>> trials = TrialSet.read("sample_logs/tfish/trials.yaml")
    >>> trials.experiment, trials.ids[0], trials.entries.trials[0].drive.frequency_hz
    ('free-swim', 'f10a20', 1.0)
    """

    entries: Any
    path: Path

    def __repr__(self) -> str:
        return f"<TrialSet {self.path.name}: {self.experiment}, {len(self.ids)} trials>"

    @property
    def experiment(self) -> str:
        """Name of the experiment: ``"falling-weight"``, ``"free-swim"``, ..."""
        return str(self.entries.experiment)

    @property
    def ids(self) -> list[str]:
        """Identifiers of the trials. The list is empty for a cruise, which is one table."""
        return [trial.id for trial in getattr(self.entries, "trials", [])]

    @classmethod
    def of(
        cls,
        trials: Sequence[Mapping[str, Any]],
        *,
        experiment: str | Path | type[Trials],
        robot: str | None = None,
        name: str = "trials",
        **keys: Any,
    ) -> TrialSet:
        """Create trials from logs in memory.

        Parameters
        ----------
        trials : sequence of mappings
            One mapping per trial, with the keys of a trial in a trials file. ``log`` is a DataFrame or a
            :class:`~swimid.logs.log.Log`.
        experiment : str or class
            Name of the experiment, or an experiment of the user, as a class or as its Python file.
        robot : str, optional
            Robot, as in a trials file. The path of a robot file is relative to the working folder.
        name : str
            Name of the trials in messages.
        **keys
            Further keys of the trials file; the ``table`` of a cruise is a DataFrame or a path.

        Raises
        ------
        InputError
            A trial has a key that the experiment does not have, or its log is not a valid log.
        UsageError
            The experiment is unknown.
        """
        own = find_own_experiments(experiment)
        kind = own[0] if own else find_experiment(str(experiment))
        if kind is None:
            hint = suggestion(str(experiment), [*find_experiments()])
            raise UsageError(f"there is no experiment '{experiment}'", hint=hint)
        logs, plain = [], []
        for number, trial in enumerate(trials, start=1):
            log, entry = trial.get("log"), {"id": f"trial {number}", **trial}
            held = None
            if isinstance(log, str | Path):
                entry["log"] = str(log)
            elif log is not None:
                entry["log"] = str(entry["id"])
                held = log if isinstance(log, Log) else Log.from_frame(log, name=entry["log"])
                for group in kind.needs:
                    if not any(fnmatch.filter(held.signals, pattern) for pattern in group):
                        column = " or ".join(name for name in group if "*" not in name)
                        raise column_error(column, list(held.columns), held.path, None)
            logs.append(held)
            plain.append(entry)
        given = {"format": FORMAT, "experiment": kind.title, **keys}
        if robot is not None:
            given["robot"] = robot
        if kind.names_robot():
            if robot is None:
                raise UsageError("experiment or robot of these trials is missing: give both")
            robot_format.locate(robot)
        if plain:
            given["trials"] = plain
        table = given.get("table")
        if table is not None:
            given["table"] = str(table) if isinstance(table, str | Path) else "table"
        entries: Any = yamlio.validate(given, kind, name)
        entries._in_memory = True
        if not isinstance(table, str | Path):
            entries._held = table
        for entry, held in zip(getattr(entries, "trials", []), logs, strict=False):
            entry._held = held
        return cls(entries, Path(name))

    @classmethod
    def read(cls, path: str | Path, own: Sequence[type[Trials]] = ()) -> TrialSet:
        """Read the trials of a trials file. ``own`` are the experiments of the user.

        Raises
        ------
        InputError
            The errors of :func:`read`.
        """
        return cls(read(path, own=own), Path(path))


def find_own_experiments(source: Any) -> list[type[Trials]]:
    """Return the experiments that a user gives as a class or a Python file; none for any other name."""
    if isinstance(source, type):
        return [source]
    return read_experiments(source) if Path(source).suffix == ".py" else []


def place(source: str | Path | TrialSet) -> Path:
    """Return the path of a trials file; for trials in memory, return their name as a path.

    Messages name this path. Paths of logs and robot files are relative to its folder.
    """
    return source.path if isinstance(source, TrialSet) else Path(source)


def read(source: str | Path | TrialSet, command: str = "", own: Sequence[type[Trials]] = ()) -> Any:
    """Return the content of a trials file or of trials in memory, an object of the class of the experiment.

    Parameters
    ----------
    source : path or TrialSet
    command : str
        Command that fits the trials. By default any experiment is read.
    own : sequence of classes
        Experiments of the user.

    Raises
    ------
    InputError
        The file is not YAML, has unknown or unused keys, has an experiment that is unknown or that the
        command does not fit, or has two trials with the same id; or the same samples of a log are both fitted
        and held out.
    """
    path = place(source)
    held: Any = None
    data: Any = {}
    if isinstance(source, TrialSet):
        own = [*own, type(source.entries)]
        held = source.entries if source.entries._in_memory else None
    if held is not None:
        data = {"experiment": held.experiment}
    else:
        data = yamlio.of_format(path, FORMAT, "trials file")
    kind = find_experiment(str(data.get("experiment")), own)
    if kind is None or (command and command not in kind.commands):
        names = [*find_experiments(own, command)]
        commands: Sequence[str] = ()
        if kind is not None:
            commands = kind.commands
        raise _not_allowed(data, path, names, command, commands)
    trials: Any = held or yamlio.validate(data, kind, path)
    trials._data = data
    if kind.names_robot():
        line = yamlio.line_of(data, ["robot"])
        robot_format.locate(trials.robot, path.parent, {"file": path, "line": line, "column": "robot"})
    if kind.uses is not None:
        check_used(trials, path, kind.uses)
    listed: list[TrialEntry] = getattr(trials, "trials", [])
    ids = [trial.id for trial in listed]
    twice = find_repeated(ids)
    if twice is not None:
        index = ids.index(twice, ids.index(twice) + 1)
        text = f"two trials have the id '{twice}'"
        raise InputError(text, file=path, line=yamlio.line_of(data, ["trials", index]), column="id")
    for same in same_recordings([(trial, path.parent / trial.log) for trial in listed]):
        for first, second in itertools.combinations(same, 2):
            line = yamlio.line_of(data, ["trials", second])
            check_apart(listed[first], listed[second], path, line)
    return trials


def _not_allowed(
    data: Any, path: Path, names: list[str], command: str, commands: Sequence[str]
) -> InputError:
    """Return the error for a trials file whose experiment is missing, or is not in ``names``.

    ``commands`` are the commands that fit the experiment of the file. ``command`` is the requested command,
    which does not fit it.
    """
    hint, what = None, "is missing"
    if "experiment" in data:
        experiment = str(data["experiment"])
        what = f"'{experiment}' is not allowed"
        if commands:
            hint = f"the command is: {' or '.join(f'swimid {name}' for name in commands)}"
        elif close := nearest(experiment, names):
            hint = f"did you mean '{close}'?"
        elif not command or command == "fit":
            hint = "give the Python file of an experiment of your own with --experiment"
    line = yamlio.line_of(data, ["experiment"])
    text = f"{what}; allowed here: {', '.join(names) or 'those of --experiment'}"
    return InputError(text, file=path, line=line, column="experiment", hint=hint)


def same_recordings(trials: Sequence[tuple[TrialEntry, Path]]) -> list[list[int]]:
    """Return, for each log that several trials use, the indices of these trials.

    ``trials`` has each trial with the path of its log. Logs with the same content, in files or in memory,
    count as one log.
    """
    groups: dict[Any, list[int]] = {}
    for index, (trial, path) in enumerate(trials):
        key: Any = os.path.normpath(path)
        if trial._held is not None:
            key = ("in memory", trial._held.digest())
        groups.setdefault(key, []).append(index)
    files = {key: Path(key) for key in groups if isinstance(key, str) and Path(key).is_file()}
    sizes = Counter(path.stat().st_size for path in files.values())
    for key, path in files.items():
        if sizes[path.stat().st_size] > 1:
            groups.setdefault(("in files", provenance.sha256(path)), []).extend(groups.pop(key))
    return [sorted(group) for group in groups.values() if len(group) > 1]


def check_apart(one: TrialEntry, other: TrialEntry, file: Path, line: int | None = None) -> None:
    """Raise an error if one trial fits samples that another one holds out; warn if both fit the same samples.

    Two adjacent trials of a log may have one sample in common.

    Parameters
    ----------
    one, other : TrialEntry
        Two trials that use parts of the same log.
    file, line
        Path of the trials file and line number, for the message.

    Raises
    ------
    InputError
    """
    low = max((t.start_s for t in (one, other) if t.start_s is not None), default=-math.inf)
    high = min((t.end_s for t in (one, other) if t.end_s is not None), default=math.inf)
    if low >= high:
        return
    ends = [f" {word} {end:g} s" for word, end in (("from", low), ("to", high)) if math.isfinite(end)]
    text = f"the trials '{one.id}' and '{other.id}' are of the same log and share its rows{''.join(ends)}"
    if one.role != other.role:
        hint = "separate the trials with start_s and end_s, or hold out another log"
        raise InputError(f"{text}: held-out rows must not be fitted", file=file, line=line, hint=hint)
    if one.role == "fit":
        text += ", which count twice, so that standard errors are too small"
        warn("SWM074", f"{file.name}: {text}: separate the trials with start_s and end_s")
