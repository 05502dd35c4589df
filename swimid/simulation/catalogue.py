"""Any trials file with any parameter file: the experiment, the values of each trial, their covariance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swimid.blackbox import trials as arma
from swimid.errors import InputError, UsageError, suggestion
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Array, Model
from swimid.logs import trials as trials_format
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.propulsion import trials as propulsion
from swimid.propulsion.model import RecoilModel, SurgeModel
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Estimate, Fit, ParameterFile
from swimid.rig import trials as rig
from swimid.robots import file as robot_format
from swimid.swimmer import trials as swimmer

#: Derivatives are taken over this share of a standard error, and of a parameter's size at most.
STEP, SMALLEST = 0.05, 1e-3


@dataclass(frozen=True)
class Quantity:
    """A number computed from a simulation.

    Attributes
    ----------
    value : float
    unit : str
    stderr : float or None
        From the parameters' covariance; None where no uncertainty is known.
    """

    value: float
    unit: str
    stderr: float | None = None


@dataclass
class Applied:
    """Parameter values for a model, with what is known of their uncertainty.

    Attributes
    ----------
    model : Model
    file : ParameterFile or None
        None for the values of a robot file.
    path : Path or None
        Of ``file``.
    chosen : dict of str to float
        Values set by the user; they are exact and win over the file's.
    """

    model: Model
    file: ParameterFile | None = None
    path: Path | None = None
    chosen: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [p.name for p in self.model.parameters]
        #: What a robot file says of its coefficients; a fit starts elsewhere.
        self.stated = self.model.stated()
        #: The file's estimates by parameter, or ``name[trial]``.
        self.known = {} if self.file is None else self.file.parameters
        for name, value in self.chosen.items():
            if name not in names:
                hint = suggestion(name, names)
                raise UsageError(f"there is no parameter '{name}'", hint=hint)
            p = self.model.parameters[names.index(name)]
            if not p.lower <= value <= p.upper:
                warn("SWM053", f"{name} = {value:g} lies outside its bounds, {p.lower:g} to {p.upper:g}")
        if self.file is not None:
            self._check(names)
            self._warn_doubtful(self.file.fit)

    def _check(self, names: list[str]) -> None:
        """Refuse a file of another robot: parameters too many, or too few."""
        known = {label.split("[")[0] for label in self.known}
        strange = sorted(known - set(names))
        missing = [
            p.name
            for p in self.model.parameters
            if p.free and not p.per_trial and p.name not in known and p.name not in self.chosen
        ]
        for wrong, text in (
            (strange, "the model of this robot has no such parameter"),
            (missing, "this parameter is missing"),
        ):
            if wrong:
                raise InputError(
                    text,
                    file=self.path,
                    column=f"parameters.{wrong[0]}",
                    hint=f"are these the parameters of another robot? This one has: {', '.join(names)}",
                )

    def _warn_doubtful(self, fit: Fit | None) -> None:
        """Tell which values the fit that wrote them does not vouch for."""
        name = self.path.name if self.path else "the parameter file"
        if fit is not None and not fit.converged:
            warn(
                "SWM062", f"{name}: the fit did not converge; these are the values at which its search ended"
            )
        unknown = [n for n, e in self.known.items() if e.status == "unidentifiable" and n not in self.chosen]
        if unknown:
            warn(
                "SWM062",
                f"{name}: not identifiable from the trials of the fit: {', '.join(unknown)}; what depends on "
                "them alone is not known",
            )

    def values(self, trial: str | None = None) -> Array:
        """Full parameter vector, shape (len(model.parameters),).

        Parameters
        ----------
        trial : str, optional
            Whose own values to take; without it, and for a trial the file does not know, per-trial
            parameters have their neutral start value.
        """
        return np.array([self._value(p.name, p.start, p.per_trial, trial) for p in self.model.parameters])

    def _value(self, name: str, start: float, per_trial: bool, trial: str | None) -> float:
        if name in self.chosen:
            return float(self.chosen[name])
        label = f"{name}[{trial}]" if per_trial else name
        return self.known[label].value if label in self.known else self.stated.get(name, start)

    def fitted_per_trial(self) -> set[str]:
        """Names of parameters the file holds for some trial."""
        return {n.split("[")[0] for n in self.known if "[" in n}

    def noise(self) -> dict[str, float]:
        """Standard deviation of the noise of each channel the parameters were fitted to."""
        fit = self.file.fit if self.file is not None else None
        return {
            name: float(known["value_sd"])
            for name, known in (fit.noise if fit is not None else {}).items()
            if isinstance(known, dict) and known.get("value_sd")
        }

    # -------------------------------------------------------- uncertainty

    def _carried(self) -> dict[str, Estimate]:
        """What the file says of the shared parameters, but for those set by the user."""
        names = [p.name for p in self.model.parameters]
        return {n: self.known[n] for n in names if n in self.known and n not in self.chosen}

    def uncertain(self) -> tuple[list[str], Array]:
        """Shared parameters with a standard error, and their covariance."""
        if self.file is None:
            return [], np.empty((0, 0))
        errors = {n: e.stderr for n, e in self._carried().items() if e.stderr and math.isfinite(e.stderr)}
        names, sd = list(errors), np.array(list(errors.values()), dtype=float)
        groups = self.file.settings.get("shared", {})
        owner = {member: group for group, members in groups.items() for member in members}
        labels = [owner.get(name, name) for name in names]
        stated = self.file.correlation
        listed = stated.names if stated else []
        correlation = np.eye(len(names))
        for i, first in enumerate(labels):
            for j, second in enumerate(labels):
                if first == second:
                    correlation[i, j] = 1.0
                elif stated and first in listed and second in listed:
                    correlation[i, j] = stated.matrix[listed.index(first)][listed.index(second)]
        return names, correlation * np.outer(sd, sd)

    def warn_without_error(self, where: str) -> None:
        """Name the shared parameters that were not identified and have no standard error to carry along."""
        lost = [
            name
            for name, e in self._carried().items()
            if e.status in ("unidentifiable", "at-bound") and not e.stderr
        ]
        if lost:
            warn(
                "SWM055",
                f"{', '.join(lost)} {'has' if len(lost) == 1 else 'have'} no standard error in the parameter "
                f"file: what is not known of them is not in {where}",
            )

    def with_errors(
        self, values: Array, compute: Callable[[Array], Mapping[str, Quantity]]
    ) -> dict[str, Quantity]:
        """Quantities with standard errors, by the delta method from the parameters' covariance.

        Parameters
        ----------
        values : ndarray, shape (len(model.parameters),)
        compute : callable
            From a parameter vector to quantities by name.
        """
        sides = [tuple(compute(end) for end in ends) for ends in self.neighbours(values)]
        return self.carried(values, compute(values), sides)

    def neighbours(self, values: Array) -> list[tuple[Array, Array]]:
        """Parameter vectors to either side of each uncertain parameter, for central differences."""
        names, covariance = self.uncertain()
        found = []
        for k, name in enumerate(names):
            index = self.model.index(name)
            p = self.model.parameters[index]
            size = max(abs(values[index]), p.scale)
            step = min(STEP * math.sqrt(covariance[k, k]), SMALLEST * size)
            low, high = np.clip([values[index] - step, values[index] + step], p.lower, p.upper)
            found.append((_with(values, index, float(low)), _with(values, index, float(high))))
        return found

    def carried(
        self,
        values: Array,
        centre: Mapping[str, Quantity],
        sides: Sequence[tuple[Mapping[str, Quantity], ...]],
    ) -> dict[str, Quantity]:
        """Quantities with standard errors from those at the :meth:`neighbours`.

        There is none where a neighbour lacks the quantity: its run breaks down, or never settles.
        """
        names, covariance = self.uncertain()
        if not names:
            return dict(centre)
        slopes = np.zeros((len(centre), len(names)))
        lost = {key for pair in sides for end in pair for key in centre if key not in end}
        ends = self.neighbours(values)
        for k, ((before, after), (low, high)) in enumerate(zip(sides, ends, strict=True)):
            index = self.model.index(names[k])
            width = float(high[index] - low[index])
            for row, key in enumerate(centre):
                if key in before and key in after and width > 0:
                    slopes[row, k] = (after[key].value - before[key].value) / width
        result = {}
        for (key, quantity), slope in zip(centre.items(), slopes, strict=True):
            variance = float(slope @ covariance @ slope)
            known = key not in lost and math.isfinite(variance)
            result[key] = replace(quantity, stderr=math.sqrt(max(variance, 0.0)) if known else None)
        return result


def _with(values: Array, index: int, value: float) -> Array:
    moved = values.copy()
    moved[index] = value
    return moved


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


def is_possible(model: Model, values: Array) -> bool:
    """Return whether the coefficients make masses that a body has."""
    try:
        if model.swimmer is not None:
            model.swimmer.check(values)
    except InputError:
        return False
    return True
