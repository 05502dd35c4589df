"""Base class of experiments, keys that several experiments have, and the list of all experiments.

An experiment is one module of the package ``swimid.experiments``, or a Python file of a user. The module has
a class derived from :class:`Trials`. The class has the keys of the trials file as fields, and creates the
model and the trials from a trials file. The name of the module is that of the experiment, with ``_`` in place
of ``-``, so that a trials file is read without an import of the other experiments.
"""

from __future__ import annotations

import fnmatch
import functools
import importlib
import inspect
import pkgutil
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, Union, get_args

from pydantic import Discriminator, Field, PositiveFloat, PrivateAttr, Tag, model_validator

from swimid.errors import InputError, UsageError
from swimid.files import yamlio
from swimid.files.user_code import find_classes, run_file
from swimid.logs.log import Log
from swimid.results.parameters import ParameterFile
from swimid.robots import file as robot_format
from swimid.robots.file import Robot

if TYPE_CHECKING:
    from swimid.fitting.fit_common import Experiment, SimulationRun

FORMAT = "swimid-trials/1"
#: Type of a parameter file: its path, for messages, and its content.
Params = tuple[Path, ParameterFile]
#: Folder of the experiments of swimid.
FOLDER = Path(__file__).parents[1] / "experiments"


# ---------------------------------------------------------------- keys of trials


class Drive(yamlio.Document):
    """Drive of a free-swimming trial: the commanded tail beat."""

    #: Sine, or the oscillators of the tendon fish paper: Hopf, and asymmetric CPG.
    waveform: Literal["sine", "hopf", "a-cpg"] = "sine"
    frequency_hz: PositiveFloat
    amplitude_deg: Annotated[float, Field(ge=0)]
    #: Mean angle about which the joint beats, degrees.
    bias_deg: float = 0.0
    #: Difference between the durations of the two half strokes, for the waveform a-cpg.
    asymmetry: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    ramp_s: Annotated[float, Field(ge=0)] = 1.0
    #: Phase of the tail beat at time zero, degrees.
    phase_deg: float = 0.0

    @model_validator(mode="after")
    def _asymmetric(self) -> Drive:
        if self.asymmetry != 0 and self.waveform != "a-cpg":
            raise ValueError(
                f"'asymmetry' is valid only with the waveform a-cpg: omit it for {self.waveform}"
            )
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


class TrialEntry(yamlio.Document):
    """Keys that a trial of any experiment has in a trials file."""

    #: Log of the trial if the log is in memory; None if it is a file. For a log in memory, the key ``log`` is
    #: its name.
    _held: Log | None = PrivateAttr(default=None)

    #: Name of the trial; by default the name of the log file.
    id: str = ""
    #: Path of the log, relative to the trials file.
    log: str
    #: Whether the trial is fitted, or held out to validate the fit.
    role: Literal["fit", "validate"] = "fit"
    #: Start and end of the part of the log that is used, s; by default the start and the end of the log.
    start_s: float | None = None
    end_s: float | None = None

    @model_validator(mode="after")
    def _name_after_log(self) -> Self:
        if "id" not in self.model_fields_set:
            self.id = Path(self.log).name
        return self


class FreeSwimTrial(TrialEntry):
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


# ---------------------------------------------------------------- experiments


class Trials(yamlio.Document):
    """Base class of experiments. Its fields are the keys that the trials file of every experiment has.

    A derived class states its name as the type of the field ``experiment``, which is a ``Literal``.

    Attributes
    ----------
    title : str
        Name of the experiment, such as ``"free-decay"``; empty for a base class.
    entry : class or None
        Class with the keys of one trial; None if the experiment has one table.
    about : str
        Description in words, with the keys that a trial needs.
    models : tuple of str
        Names of the models that describe the trials.
    commands : tuple of str
        Commands that fit the trials. A drafted project has the first one.
    needs : sequence of sequences of str
        Columns that every log or table needs: at least one column of each group, in which ``*`` stands for
        any text.
    usual : sequence of sequences of str
        Columns by which a log of the experiment is recognised. The default is ``needs``.
    asked : mapping
        Keys of a trial that only the user knows, with :data:`~swimid.files.yamlio.ASK` as value.
    robot_form : str
        Part of a robot file that the experiment needs: ``"body"``, ``"links"``, or ``""`` for none.
    uses : collection of str, optional
        Keys of the trials file that have an effect, as dotted paths. Any other key is an error. By default
        all keys have an effect.
    """

    _in_memory: bool = PrivateAttr(default=False)
    #: Table of all trials if the table is in memory; None if it is a file. For a table in memory, the key
    #: ``table`` is its name.
    _held: Any = PrivateAttr(default=None)
    #: Content of the trials file with its line numbers, for error messages.
    _data: Any = PrivateAttr(default=None)

    title: ClassVar[str] = ""
    entry: ClassVar[type[TrialEntry] | None] = None
    about: ClassVar[str]
    models: ClassVar[tuple[str, ...]]
    commands: ClassVar[tuple[str, ...]] = ("fit",)
    needs: ClassVar[Sequence[Sequence[str]]] = ()
    usual: ClassVar[Sequence[Sequence[str]]] = ()
    asked: ClassVar[Mapping[str, Any]] = {}
    robot_form: ClassVar[Literal["body", "links", ""]] = "body"
    uses: ClassVar[Collection[str] | None] = None

    format: Literal["swimid-trials/1"]
    experiment: str
    robot: str

    @classmethod
    def __pydantic_init_subclass__(cls, **given: Any) -> None:
        """Set the attributes that follow from the fields and from other attributes."""
        super().__pydantic_init_subclass__(**given)
        trials = cls.model_fields.get("trials")
        cls.title = str(next(iter(get_args(cls.model_fields["experiment"].annotation)), ""))
        cls.entry = trials and next(iter(get_args(trials.annotation)), None)
        cls.usual = cls.usual or cls.needs

    @classmethod
    def has_columns(cls, columns: Collection[str]) -> bool:
        """Return whether a log or a table with these columns may be one of the experiment."""
        return all(any(fnmatch.filter(columns, name) for name in group) for group in cls.usual)

    @classmethod
    def names_robot(cls) -> bool:
        """Return whether the key ``robot`` names a robot file, rather than being a mere name in reports."""
        return cls.model_fields["robot"].is_required()

    def read_robot(self, folder: Path) -> Robot:
        """Return the robot of the trials, by built-in name or by a path relative to a folder."""
        return robot_format.read(self.robot, folder)

    @abstractmethod
    def load(
        self,
        path: Path,
        *,
        command: str = "",
        params: Params | None = None,
        **options: Any,
    ) -> Experiment:
        """Read the logs, and return the model with its trials.

        Parameters
        ----------
        path : Path
            Trials file, for messages and relative paths.
        command : str
            Command that fits the trials; empty for a simulation.
        params : (Path, ParameterFile), optional
            Parameters of one of the models, with which the trials are simulated.
        **options
            Options of the command. An experiment ignores those that it does not know.

        Raises
        ------
        InputError
            If a key, the robot file or a log is wrong.
        """

    @classmethod
    def prepare_run(cls, options: Any, params: Params, time_s: Any) -> SimulationRun:
        """Return the simulation of an experiment for which no recorded trial exists.

        Parameters
        ----------
        options : SimulateOptions
        params : (Path, ParameterFile)
            Parameters of one of the models.
        time_s : ndarray, shape (n,)
            Sample times, s.

        Raises
        ------
        UsageError
            If an option is missing. By default an experiment is simulated for recorded trials only.
        """
        raise UsageError(
            f"the model '{params[1].model}' can be simulated for recorded trials only",
            hint="give them with --trials",
        )


@functools.cache
def list_experiments() -> list[str]:
    """Return the names of the experiments of swimid."""
    return [module.name.replace("_", "-") for module in pkgutil.iter_modules([str(FOLDER)])]


def find_experiment(name: str, own: Sequence[type[Trials]] = ()) -> type[Trials] | None:
    """Return the experiment with a given name; None if no experiment has this name.

    Parameters
    ----------
    name : str
    own : sequence of classes
        Experiments of the user.
    """
    for kind in own:
        if kind.title == name:
            return kind
    if name not in list_experiments():
        return None
    module = importlib.import_module(f"swimid.experiments.{name.replace('-', '_')}")
    found: type[Trials] = find_classes(module, Trials)[0]
    return found


def find_experiments(own: Sequence[type[Trials]] = (), command: str = "") -> dict[str, type[Trials]]:
    """Return the experiments by name: all of them, or only those that ``command`` can fit."""
    names = dict.fromkeys([*list_experiments(), *(kind.title for kind in own)])
    found = {name: kind for name in names if (kind := find_experiment(name, own)) is not None}
    return {name: kind for name, kind in found.items() if not command or command in kind.commands}


def read_experiments(*paths: str | Path) -> list[type[Trials]]:
    """Return the experiments that Python files define.

    Parameters
    ----------
    *paths : path
        Python files, which are run. Their classes that are derived from :class:`Trials` are the experiments.

    Raises
    ------
    InputError
        If a file cannot be run or defines no experiment, or if an experiment is incomplete or has the name of
        another one. The error states file and line.
    """
    found: dict[str, type[Trials]] = {}
    for path in map(Path, paths):
        kinds = find_classes(run_file(path, "experiments"), Trials)
        if not kinds:
            hint = "derive a class from swimid.logs.experiments.Trials"
            raise InputError("defines no experiment", file=path, hint=hint)
        for kind in kinds:
            lacking = [name for name in ("about", "models") if not hasattr(kind, name)]
            lacking += [f"{name}()" for name in sorted(kind.__abstractmethods__)]
            faults = {
                "needs a field 'experiment' with its name as a Literal": not kind.title,
                f"lacks {', '.join(lacking)}": lacking,
                f"has a name that is used already: '{kind.title}'": kind.title
                in {*list_experiments(), *found},
            }
            for problem in (problem for problem, fault in faults.items() if fault):
                line = inspect.getsourcelines(kind)[1]
                raise InputError(f"the experiment {kind.__name__} {problem}", file=path, line=line)
            found[kind.title] = kind
    return list(found.values())


def make_schema() -> Any:
    """Return the union of the types of all trials files, from which the JSON Schema is made."""
    kinds = tuple(find_experiments().values())
    return Annotated[Union[kinds], Field(discriminator="experiment")]  # noqa: UP007 - made of a tuple


# ---------------------------------------------------------------- check for keys without effect

#: Keys of a trials file, as dotted paths, that have an effect in every command and function on trials.
EVERYWHERE = frozenset(
    {"format", "experiment", "robot", "trials"}
    | {f"trials.{key}" for key in ("id", "log", "role", "start_s", "end_s")}
)


def list_given(document: yamlio.Document, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted path and the value of each key of a document whose value is not the default."""
    for name in type(document).model_fields:
        value = getattr(document, name)
        if name not in document.model_fields_set or value == type(document).model_fields[name].default:
            continue
        yield prefix + name, value
        parts = value if isinstance(value, list) else [value]
        for part in parts:
            if isinstance(part, yamlio.Document):
                yield from list_given(part, f"{prefix}{name}.")


def check_used(trials: Trials, path: Path, uses: Collection[str]) -> None:
    """Raise an error if a trials file has a key that has no effect on the present computation.

    Parameters
    ----------
    uses : collection of str
        Keys that have an effect, as dotted paths.

    Raises
    ------
    InputError
    """
    data = trials._data
    unused = [key for key, _ in list_given(trials) if key not in uses]
    if not unused:
        return
    key = unused[0].removeprefix("trials.")
    for index, trial in enumerate(getattr(trials, "trials", [])):
        if key in dict(list_given(trial)):
            where, line = f"the trial '{trial.id}' sets", yamlio.line_of(data, ["trials", index])
            break
    else:
        where, line = "sets", yamlio.line_of(data, [key])
    hint = "omit this key, or choose another experiment"
    text = f"{where} '{key}', which has no effect here"
    raise InputError(text, file=path, line=line, column=key, hint=hint)
