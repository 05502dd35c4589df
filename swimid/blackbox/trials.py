"""Trials of a black-box model from one input column to one output column."""

from __future__ import annotations

from pathlib import Path

from swimid.blackbox.model import Arma
from swimid.errors import InputError
from swimid.fitting.experiment import Experiment, read_log
from swimid.fitting.model import Trial
from swimid.logs import trials as trials_format
from swimid.logs.trials import Arma as ArmaTrials
from swimid.logs.trials import TrialSet
from swimid.results.parameters import ParameterFile

#: The keys of a trials file that are used, by experiment.
USES = {"arma": trials_format.EVERYWHERE | {"input", "output"}}


def model_of(file: ParameterFile, path: Path) -> Arma:
    """The model a parameter file holds.

    Raises
    ------
    InputError
        With the file's name, when it lacks delay, sample time or coefficients.
    """
    try:
        return Arma.from_file(file)
    except InputError as error:
        raise InputError(error.reason, file=path, column=error.column, hint=error.hint) from error


def load(source: str | Path | TrialSet, file: ParameterFile, parameters_path: Path) -> Experiment:
    """Read trials of the experiment ``arma`` for the model of a parameter file.

    Input and output are the columns the model was fitted with; a trials file that names others is refused.

    Raises
    ------
    InputError
        For anything wrong in the trials file, the parameter file or a log.
    """
    path = trials_format.place(source)
    entries = trials_format.read(source, ArmaTrials, uses=USES)
    robot = trials_format.robot_of(entries, path)
    model = model_of(file, parameters_path)
    for key, mine in (("input", None if model.sine else model.source), ("output", model.output)):
        named = getattr(entries, key)
        if mine is not None and named is not None and named != mine:
            raise InputError(
                f"these trials name the {key} '{named}', the parameters are of '{mine}'",
                file=path,
                column=key,
            )
    wanted = [model.output] if model.sine else [model.source, model.output]
    listing = [] if entries._in_memory else [path]
    trials, logs = [], []
    for entry in entries.trials:
        log = read_log(entry, path.parent, required=tuple(wanted))
        logs.append(log.source)
        trials.append(
            Trial(
                entry.id,
                entry.role,
                log.time_s,
                {model.output: log[model.output]},
                inputs={} if model.sine else {model.source: log[model.source]},
            )
        )
    return Experiment("arma", robot, model, trials, [*listing, *logs])
