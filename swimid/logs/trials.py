"""Trials file (``swimid-trials/1``): a list of the logs of one experiment with one robot."""

from __future__ import annotations

import fnmatch
import itertools
import math
import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args

from pydantic import Discriminator, Field, PositiveFloat, PrivateAttr, Tag, model_validator

from swimid.errors import InputError, UsageError, nearest, suggestion
from swimid.files import provenance, yamlio
from swimid.files.tabular import missing_column, repeated
from swimid.logs.log import Log
from swimid.notices import warn
from swimid.robots import file as robot_format

FORMAT = "swimid-trials/1"


class Drive(yamlio.Document):
    """Drive of a free-swimming trial: the commanded tail beat."""

    waveform: Literal["sine", "hopf", "a-cpg"] = "sine"
    frequency_hz: PositiveFloat
    amplitude_deg: Annotated[float, Field(ge=0)]
    bias_deg: float = 0.0
    asymmetry: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    ramp_s: Annotated[float, Field(ge=0)] = 1.0
    #: Phase of the tail beat at time zero, degrees.
    phase_deg: float = 0.0

    @model_validator(mode="after")
    def _asymmetric(self) -> Drive:
        if self.asymmetry != 0 and self.waveform != "a-cpg":
            raise ValueError(f"'asymmetry' belongs to the waveform a-cpg; a {self.waveform} has none")
        return self


class StrokeDrive(yamlio.Document):
    """Drive of a trial by a stroke of the robot file. Such a stroke moves several joints at once."""

    stroke: str
    #: Frequency of the stroke, Hz; by default the one in the robot file.
    frequency_hz: PositiveFloat | None = None
    #: Factor by which the joint angles of the stroke in the robot file are multiplied.
    scale: Annotated[float, Field(ge=0)] = 1.0
    ramp_s: Annotated[float, Field(ge=0)] = 0.0
    #: Number of stroke cycles after which the joints rest; by default the stroke does not end.
    cycles: PositiveFloat | None = None
    phase_deg: float = 0.0


def _kind_of_drive(value: Any) -> str:
    named = "stroke" in value if isinstance(value, dict) else isinstance(value, StrokeDrive)
    return "stroke" if named else "beat"


class Trial(yamlio.Document):
    """Keys that a trial of any experiment has in a trials file."""

    #: Log of the trial if the log is in memory; None if it is a file. For a log in memory, the key ``log`` is
    #: its name.
    _held: Log | None = PrivateAttr(default=None)

    id: str = ""
    log: str
    role: Literal["fit", "validate"] = "fit"
    #: Start and end of the part of the log that is used, s; by default the start and the end of the log.
    start_s: float | None = None
    end_s: float | None = None

    @model_validator(mode="after")
    def _name_after_log(self) -> Self:
        if "id" not in self.model_fields_set:
            self.id = Path(self.log).name
        return self


class RigTrial(Trial):
    """Keys of a trial on a single-degree-of-freedom rig. Their values replace those of the robot file."""

    inertial_mass_kg: PositiveFloat | None = None
    frontal_area_m2: PositiveFloat | None = None
    fluid_density_kg_m3: PositiveFloat | None = None


class FallingWeightTrial(RigTrial):
    """Keys of a trial of a body that a falling weight pulls over a pulley, or that a known force drives."""

    pulling_mass_kg: PositiveFloat | None = None
    driving_force_N: float | None = None

    @model_validator(mode="after")
    def _one_drive(self) -> FallingWeightTrial:
        if (self.pulling_mass_kg is None) == (self.driving_force_N is None):
            raise ValueError("give either 'pulling_mass_kg' or 'driving_force_N'")
        return self


class FreeSwimTrial(Trial):
    """Keys of a free-swimming trial. Without ``drive``, the joint columns of the log are the input."""

    drive: (
        Annotated[
            Annotated[Drive, Tag("beat")] | Annotated[StrokeDrive, Tag("stroke")],
            Discriminator(_kind_of_drive),
        ]
        | None
    ) = None
    #: Coefficients of the model, by name, whose values in this trial differ from the robot file, such as the
    #: stiffness of a spring.
    coefficients: dict[str, float] = {}
    #: Initial state of the robot at the first sample of the trial: at rest, estimated from the log, or in
    #: steady swimming under the drive.
    start_state: Literal["auto", "rest", "estimate", "steady"] = "auto"


class Trials(yamlio.Document):
    """Keys that a trials file has for every kind of experiment."""

    _in_memory: bool = PrivateAttr(default=False)
    #: Columns that a log needs: at least one column of each group, in which ``*`` stands for any text.
    needs: ClassVar[Sequence[Sequence[str]]] = ()

    format: Literal["swimid-trials/1"]
    robot: str


class FallingWeight(Trials):
    """Trials file of a falling-weight experiment."""

    needs = (("x_m",),)
    experiment: Literal["falling-weight"]
    trials: Annotated[list[FallingWeightTrial], Field(min_length=1)]


class Towed(Trials):
    """Trials file of an experiment with a measured force on the towed robot."""

    needs = (("force_N",), ("x_m", "u_m_s"))
    experiment: Literal["towed"]
    trials: Annotated[list[RigTrial], Field(min_length=1)]


class FreeDecay(Trials):
    """Trials file of a free-decay experiment: the robot is displaced and released."""

    needs = (("x_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"),)
    experiment: Literal["free-decay"]
    trials: Annotated[list[RigTrial], Field(min_length=1)]


class Cruise(Trials):
    """Trials file of a cruise experiment, which names a table of cruising speeds."""

    #: Table of cruising speeds if it is in memory; None if it is a file. For a table in memory, the key
    #: ``table`` is its name.
    _held: Any = PrivateAttr(default=None)

    experiment: Literal["cruise"]
    table: str
    drag: str | None = None


class FreeSwim(Trials):
    """Trials file of a free-swimming experiment."""

    needs = (("x_m", "*_m", "*_rad", "*_s", "*_N"),)
    experiment: Literal["free-swim"]
    trials: Annotated[list[FreeSwimTrial], Field(min_length=1)]


class Multibody(Trials):
    """Trials file for a robot of rigid links. The logs have joint angles, a pose, or both."""

    experiment: Literal["multibody"]
    trials: Annotated[list[FreeSwimTrial], Field(min_length=1)]


class Arma(Trials):
    """Trials file for a black-box model from one input column to one output column of the logs."""

    experiment: Literal["arma"]
    input: str | None = None
    output: str | None = None
    trials: Annotated[list[Trial], Field(min_length=1)]


EXPERIMENTS: dict[str, type[Trials]] = {
    get_args(kind.model_fields["experiment"].annotation)[0]: kind
    for kind in (FallingWeight, Towed, FreeDecay, Cruise, FreeSwim, Multibody, Arma)
}
T = TypeVar("T", bound=Trials)
#: Type of the trials file of any experiment, from which the JSON Schema is made.
AnyTrials = Annotated[
    FallingWeight | Towed | FreeDecay | Cruise | FreeSwim | Multibody | Arma,
    Field(discriminator="experiment"),
]

#: Keys of a trials file, as dotted paths, that every function that computes with trials uses.
EVERYWHERE = frozenset(
    {"format", "experiment", "robot", "trials"}
    | {f"trials.{key}" for key in ("id", "log", "role", "start_s", "end_s")}
)


@dataclass(frozen=True, eq=False)
class TrialSet:
    """Trials of one experiment with one robot, from a trials file or from logs in memory.

    :func:`swimid.load` creates it.

    Attributes
    ----------
    entries : pydantic model
        Content of the trials file, an object of one of the classes in :data:`EXPERIMENTS`.
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
        experiment: str,
        robot: str,
        name: str = "trials",
        **keys: Any,
    ) -> TrialSet:
        """Create trials from logs in memory.

        Parameters
        ----------
        trials : sequence of mappings
            One mapping per trial, with the keys of a trial in a trials file. ``log`` is a DataFrame or a
            :class:`~swimid.logs.log.Log`.
        experiment, robot : str
            Experiment and robot, as in a trials file. The path of a robot file is relative to the working
            folder.
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
        if experiment not in EXPERIMENTS:
            hint = suggestion(experiment, list(EXPERIMENTS))
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
                for group in EXPERIMENTS[experiment].needs:
                    if not any(fnmatch.filter(held.signals, pattern) for pattern in group):
                        column = " or ".join(name for name in group if "*" not in name)
                        raise missing_column(column, list(held.columns), held.path, None)
            logs.append(held)
            plain.append(entry)
        robot_format.locate(robot)
        given = {"format": FORMAT, "experiment": experiment, "robot": robot, **keys}
        if plain:
            given["trials"] = plain
        table = given.get("table")
        if table is not None:
            given["table"] = str(table) if isinstance(table, str | Path) else "table"
        entries: Any = yamlio.validate(given, EXPERIMENTS[experiment], name)
        entries._in_memory = True
        if experiment == "cruise" and not isinstance(table, str | Path):
            entries._held = table
        for entry, held in zip(getattr(entries, "trials", []), logs, strict=False):
            entry._held = held
        return cls(entries, Path(name))

    @classmethod
    def read(cls, path: str | Path) -> TrialSet:
        """Read the trials of a trials file.

        Raises
        ------
        InputError
            The errors of :func:`read`.
        """
        return cls(read(path), Path(path))


def place(source: str | Path | TrialSet) -> Path:
    """Return the path of a trials file; for trials in memory, return their name as a path.

    Messages name this path. Paths of logs and robot files are relative to its folder.
    """
    return source.path if isinstance(source, TrialSet) else Path(source)


def read(
    source: str | Path | TrialSet, *experiments: type[T], uses: Mapping[str, Collection[str]] | None = None
) -> T:
    """Return the content of a trials file or of trials in memory, if it is of one of the given experiments.

    Parameters
    ----------
    source : path or TrialSet
    uses : mapping, optional
        Keys that the caller uses, by experiment (``trials.drive.ramp_s``). Any other key in the file is an
        error. Every caller that computes with the trials passes this argument.

    Raises
    ------
    InputError
        The file is not YAML, has unknown or unused keys, has another experiment, or has two trials with the
        same id; or rows of a log are both fitted and held out.
    """
    path = place(source)
    held: Any = None
    if isinstance(source, TrialSet) and source.entries._in_memory:
        held = source.entries
        data: Any = {"experiment": held.experiment}
    else:
        data = yamlio.of_format(path, FORMAT, "trials file")
    names = [name for name, kind in EXPERIMENTS.items() if not experiments or kind in experiments]
    experiment = data.get("experiment")
    if experiment not in names:
        close, hint, what = nearest(str(experiment), names), None, "is missing"
        if "experiment" in data:
            what = f"'{experiment}' is not allowed"
        if close:
            hint = f"did you mean '{close}'?"
        text, line = f"{what}; here: {', '.join(names)}", yamlio.line_of(data, ["experiment"])
        raise InputError(text, file=path, line=line, column="experiment", hint=hint)
    trials: Any = held or yamlio.validate(data, EXPERIMENTS[experiment], path)
    line = yamlio.line_of(data, ["robot"])
    robot_format.locate(trials.robot, path.parent, {"file": path, "line": line, "column": "robot"})
    if uses is not None:
        _refuse_unused(trials, path, uses[experiment], data)
    listed: list[Trial] = getattr(trials, "trials", [])
    ids = [trial.id for trial in listed]
    twice = repeated(ids)
    if twice is not None:
        index = ids.index(twice, ids.index(twice) + 1)
        text = f"two trials have the id '{twice}'"
        raise InputError(text, file=path, line=yamlio.line_of(data, ["trials", index]), column="id")
    for same in same_recordings([(trial, path.parent / trial.log) for trial in listed]):
        for first, second in itertools.combinations(same, 2):
            line = yamlio.line_of(data, ["trials", second])
            check_apart(listed[first], listed[second], path, line)
    return trials


def same_recordings(trials: Sequence[tuple[Trial, Path]]) -> list[list[int]]:
    """Return the indices of the trials of each log, in a file or in memory, that several trials use.

    ``trials`` has each trial with the path of its log. Logs with the same content are one log.
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


def given(document: yamlio.Document, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted path and the value of each key of a document whose value is not the default."""
    for name in type(document).model_fields:
        value = getattr(document, name)
        if name not in document.model_fields_set or value == type(document).model_fields[name].default:
            continue
        yield prefix + name, value
        parts = value if isinstance(value, list) else [value]
        for part in parts:
            if isinstance(part, yamlio.Document):
                yield from given(part, f"{prefix}{name}.")


def _refuse_unused(trials: Trials, path: Path, uses: Collection[str], data: Any) -> None:
    unused = [key for key, _ in given(trials) if key not in uses]
    if not unused:
        return
    key = unused[0].removeprefix("trials.")
    for index, trial in enumerate(getattr(trials, "trials", [])):
        if key in dict(given(trial)):
            where, line = f"the trial '{trial.id}' sets", yamlio.line_of(data, ["trials", index])
            break
    else:
        where, line = "sets", yamlio.line_of(data, [key])
    hint = "leave it out if it does not matter, else this is not the fit for these trials"
    text = f"{where} '{key}', which has no effect here"
    raise InputError(text, file=path, line=line, column=key, hint=hint)


def check_apart(one: Trial, other: Trial, file: Path, line: int | None = None) -> None:
    """Raise an error if a trial fits rows of a log that another one holds out; warn if both fit them.

    Two adjacent trials may have one row in common.

    Parameters
    ----------
    one, other : Trial
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
        hint = "part them with start_s and end_s, or hold out another log"
        raise InputError(f"{text}: what is held out must not be fitted", file=file, line=line, hint=hint)
    if one.role == "fit":
        warn("SWM074", f"{file.name}: {text}, which count twice: standard errors are too small")


def robot_of(trials: Trials, path: Path) -> robot_format.Robot:
    """Return the robot that a trials file names, by built-in name or by a path relative to the file."""
    return robot_format.read(trials.robot, path.parent)
