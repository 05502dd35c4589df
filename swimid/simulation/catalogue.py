"""Any trials file, with any parameter file, as one experiment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from swimid.blackbox import trials as arma
from swimid.errors import InputError, UsageError
from swimid.fitting.experiment import Experiment
from swimid.logs import trials as trials_format
from swimid.logs.trials import TrialSet
from swimid.propulsion import trials as propulsion
from swimid.propulsion.model import RecoilModel, SurgeModel
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile
from swimid.rig import trials as rig
from swimid.robots import file as robot_format
from swimid.simulation.applied import Applied
from swimid.swimmer import trials as swimmer

#: Experiments whose trials tell each model's parameters.
EXPERIMENTS = {
    "multilink": ("free-swim", "multibody"),
    "multibody": ("free-swim", "multibody"),
    "falling-weight": ("falling-weight",),
    "towed": ("towed",),
    "free-decay": ("free-decay",),
    RecoilModel.name: ("cruise",),
    SurgeModel.name: ("free-swim",),
    "arma": ("arma",),
}


class Loaded(NamedTuple):
    """An experiment and the parameters to simulate it with."""

    experiment: Experiment
    applied: Applied


def read_parameters(source: parameters_format.Source) -> ParameterFile:
    """Parameters of any model that can be simulated.

    Raises
    ------
    InputError
        When it is none, or of a model that is not known.
    """
    return parameters_format.read(source, model=tuple(EXPERIMENTS))


def load(trials: str | Path | TrialSet, options: Any) -> Loaded:
    """A trials file of any experiment as the model of a parameter file, and its values.

    Parameters
    ----------
    trials : path or TrialSet
    options : Options
        Of a verb: ``params`` (a parameter file, or None for the values of the robot file, else the model's
        start values), ``robot`` (accept the parameters for it although the file names another one),
        ``readings`` (over those of the parameter file), ``dt`` (integration step of a robot with links, s),
        and where the verb has it ``chosen`` (values that win over the file's) and ``start_state``.

    Raises
    ------
    InputError
        For anything wrong in one of the files: another experiment than the parameters' model
        describes, another robot, missing columns.
    """
    parameters, chosen = options.params, dict(getattr(options, "chosen", {}))
    readings, max_step = dict(options.readings), options.dt
    if parameters is None:
        experiment = _of_trials(trials, readings, max_step)
        return Loaded(experiment, Applied(experiment.model, chosen=chosen))
    trials_path, path = trials_format.place(trials), parameters_format.place(parameters)
    file = read_parameters(parameters)
    entries: Any = trials_format.read(trials)
    if entries.experiment not in EXPERIMENTS[file.model]:
        raise InputError(
            f"holds trials of the experiment '{entries.experiment}'; parameters of the model "
            f"'{file.model}' describe: {', '.join(EXPERIMENTS[file.model])}",
            file=trials_path,
            column="experiment",
        )
    if options.robot is None:
        _check_robot(entries.robot, trials_path, file, path)
    if file.model in ("multilink", "multibody"):
        readings = {**file.settings.get("readings", {}), **readings}
        start = getattr(options, "start_state", "auto")
        if start == "auto":
            start = file.settings.get("start_state", "auto")
        experiment = swimmer.load(trials, readings=readings, start_state=start, max_step=max_step)
    elif file.model in ("falling-weight", "towed", "free-decay"):
        experiment = _rig(trials, file)
    elif file.model == "arma":
        experiment = arma.load(trials, file, path)
    else:
        experiment = _propulsion(trials, file, path)
    experiment = replace(experiment, inputs=[*experiment.inputs, parameters_format.origin(parameters)])
    return Loaded(experiment, Applied(experiment.model, file, path, chosen))


def _of_trials(trials: str | Path | TrialSet, readings: dict[str, str], max_step: float) -> Experiment:
    """The model that a trials file and its robot suggest: of links where the robot has any."""
    entries: Any = trials_format.read(trials)
    if entries.experiment == "arma":
        raise UsageError(
            "a black-box model has no values but those of a fit: give them with --params",
            hint="swimid rwls makes them",
        )
    robot = trials_format.robot_of(entries, trials_format.place(trials))
    if entries.experiment == "multibody" or (
        entries.experiment == "free-swim" and (robot.multilink is not None or robot.multibody is not None)
    ):
        return swimmer.load(trials, readings=readings, max_step=max_step)
    if entries.experiment in ("cruise", "free-swim"):
        return propulsion.load(trials)
    return rig.load(trials)


def robot_of_parameters(file: ParameterFile, path: Path, robot: str | None = None) -> tuple[str, Path | None]:
    """Name or file of the robot a parameter file is of, and the folder that is relative to.

    Raises
    ------
    InputError
        When neither the file nor the user names one.
    """
    if robot is not None:
        return robot, None
    if file.robot is None:
        raise InputError("this key is missing", file=path, column="robot", hint="give the robot: --robot")
    return file.robot, path.parent


def _check_robot(name: str, trials_path: Path, file: ParameterFile, path: Path) -> None:
    """Refuse the parameters of one robot for the trials of another."""
    mine = robot_format.read(name, trials_path.parent).name
    if file.robot is None or file.robot in (mine, name):
        return
    try:
        theirs = robot_format.read(file.robot, path.parent).name
    except InputError:
        theirs = Path(file.robot).stem
    if theirs != mine:
        raise InputError(
            f"these are the parameters of the robot '{theirs}'; the trials in {trials_path.name} are of "
            f"'{mine}'",
            file=path,
            column="robot",
        )


def _rig(trials: str | Path | TrialSet, file: ParameterFile) -> Experiment:
    coordinate = None
    if file.model == "free-decay" and file.fit is not None and len(file.fit.channels) == 1:
        coordinate = next(iter(file.fit.channels))
    experiment = rig.load(trials, coordinate=coordinate)
    rounding = file.settings.get("encoder_rounding")
    if rounding in experiment.variants:
        experiment = replace(experiment, trials=experiment.variants[str(rounding)])
    return experiment


def drag_file(file: ParameterFile, path: Path) -> Path | ParameterFile:
    """The drag parameters that the parameters of the recoil law were estimated with.

    Raises
    ------
    InputError
        When it is not there: neither where the fit named it nor beside the parameter file.
    """
    if file._drag is not None:
        return file._drag
    named = file.settings.get("drag_file")
    if named is None:
        raise InputError("this key is missing", file=path, column="settings.drag_file")
    # as the fit named it, relative to where it ran; else beside the parameter file
    places = [path.parent / Path(str(named)).name, path.parent / str(named), Path(str(named))]
    place = next((p for p in places if p.is_file()), None)
    if place is None:
        raise InputError(
            f"the drag file {named} it was made with is not there",
            file=path,
            column="settings.drag_file",
            hint="put it beside this file",
        )
    return place


def set_references(model: SurgeModel, file: ParameterFile, path: Path) -> None:
    """Give a surge model the amplitude and frequency its parameters refer to."""
    for key in ("reference_amplitude_rad", "reference_frequency_hz"):
        if key not in file.settings:
            raise InputError("this key is missing", file=path, column=f"settings.{key}")
        setattr(model, key, float(file.settings[key]))


def _propulsion(trials: str | Path | TrialSet, file: ParameterFile, path: Path) -> Experiment:
    if file.model == RecoilModel.name:
        # a file that does not say which drag it goes with takes the trials file's
        named = file.settings.get("drag_file") is not None
        return propulsion.load(trials, drag=drag_file(file, path) if named else None)
    experiment = propulsion.load(trials)
    assert isinstance(experiment.model, SurgeModel)
    set_references(experiment.model, file, path)
    for key in ("waveform", "asymmetry"):
        fitted, here = file.settings.get(key), experiment.facts[key]
        if fitted is not None and fitted != here:
            raise InputError(
                f"these trials were driven with the {key} {here}, those of the parameters with {fitted}: "
                "each has a thrust of its own",
                file=trials_format.place(trials),
                column=f"drive.{key}",
            )
    return experiment
