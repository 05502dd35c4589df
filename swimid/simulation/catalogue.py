"""Combination of trials with a parameter file: parameters of each trial, and their covariance."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from swimid.effects import catalogue as effect_catalogue
from swimid.effects.base import Effect
from swimid.errors import InputError, NoTrustworthyResult, UsageError, suggestion
from swimid.fitting.fit_common import Experiment, load_experiment
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.logs.experiments import Trials, find_experiments, read_experiments
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Estimate, Fit, ParameterFile
from swimid.robots import file as robot_format

#: Step of a finite difference as a fraction of the standard error of the parameter, and maximum step as a
#: fraction of the larger of the absolute value and the typical scale of the parameter.
STEP_SHARE, MAX_STEP_SHARE = 0.05, 1e-3
#: Largest relative change of a quantity that counts as a rounding error in a finite difference.
COVARIANCE_RTOL = 1e-12


@dataclass(frozen=True)
class Quantity:
    """Value that is computed from a simulation, with its unit and its standard error.

    Attributes
    ----------
    value : float
    unit : str
    stderr : float or None
        Standard error from the covariance of the parameters; None if it is unknown.
    """

    value: float
    unit: str
    stderr: float | None = None


#: Type of a function from parameter vectors to quantities, shape (vectors, quantities). An undefined quantity
#: is NaN.
Compute = Callable[[Sequence[Array]], Array]


@dataclass
class Applied:
    """Model with the parameter values to simulate and their uncertainty.

    Attributes
    ----------
    model : Model
        Model with the effects that the parameter file names.
    file : ParameterFile or None
        Parameter file; None if the values come from the robot file.
    path : Path or None
        Path of ``file``.
    chosen : dict of str to float
        Parameter values set by the user. They replace the values of the file and have no uncertainty.
    trials : sequence of Trial
        Trials of the model, from which the effects of the file take the scales of their parameters.
    own_effects : sequence of path
        Python files with effects of the user, which the parameter file may name.
    stated : dict of str to float
        Values of the coefficients that the robot file states. They may differ from the start values of a fit.
    known : dict of str to Estimate
        Estimates of the file by parameter name, and by ``name[trial]`` for a parameter of one trial.
    """

    model: Model
    file: ParameterFile | None = None
    path: Path | None = None
    chosen: Mapping[str, float] = field(default_factory=dict)
    trials: Sequence[Trial] = ()
    own_effects: Sequence[Path] = ()

    def __post_init__(self) -> None:
        if self.file is not None and self.file.effects:
            self.model = with_effects(self.model, self.file, self.path, self.trials, self.own_effects)
        names = [p.name for p in self.model.parameters]
        self.stated = self.model.get_file_values()
        self.known = {} if self.file is None else self.file.parameters
        for name, value in self.chosen.items():
            if name not in names:
                raise UsageError(
                    f"the model has no parameter '{name}'", hint=suggestion(name, names, "it has")
                )
            p = self.model.parameters[names.index(name)]
            if not p.lower <= value <= p.upper:
                warn("SWM053", f"{name} = {value:g} lies outside its bounds, {p.lower:g} to {p.upper:g}")
        if self.file is not None:
            self._check(names)
            self._warn_doubtful(self.file.fit)

    def _check(self, names: list[str]) -> None:
        """Refuse a parameter file whose parameters differ from those of the model.

        Such a file may belong to another robot.

        Raises
        ------
        InputError
            If a parameter is missing or does not exist in the model.
        """
        known = {label.split("[")[0] for label in self.known}
        needed = [p.name for p in self.model.parameters if p.free and not p.per_trial]
        strange = sorted(known - set(names))
        missing = [name for name in needed if name not in known and name not in self.chosen]
        if not strange and not missing:
            return
        text = "the model of this robot has no such parameter" if strange else "this parameter is missing"
        raise InputError(
            text,
            file=self.path,
            column=f"parameters.{(strange or missing)[0]}",
            hint=f"are these the parameters of another robot? This one has: {', '.join(names)}",
        )

    def _warn_doubtful(self, fit: Fit | None) -> None:
        """Warn if the fit of the parameters did not converge, or if parameters are not identifiable."""
        name = self.path.name if self.path else "the parameter file"
        if fit is not None and not fit.converged:
            warn(
                "SWM062", f"{name}: the fit did not converge; these are the values at which its search ended"
            )
        unknown = [n for n, e in self.known.items() if e.status == "unidentifiable" and n not in self.chosen]
        if unknown:
            warn(
                "SWM062",
                f"{name}: not identifiable from the trials of the fit: {', '.join(unknown)}; outputs that "
                "depend on these parameters alone are not determined",
            )

    def at_step(self, model: Model) -> Self:
        """Return the same parameters with ``model``, which has another integration step."""
        other = copy.copy(self)
        other.model = model
        return other

    def values(self, trial: Trial | None = None) -> Array:
        """Return the parameter vector of a trial, shape (len(model.parameters),).

        Parameters
        ----------
        trial : Trial, optional
            Trial whose per-trial parameters are used. Without a trial, or if the file does not have this
            trial, per-trial parameters have their neutral start values.
        """
        owner = self.owner(trial)
        return np.array([self._value(p, owner) for p in self.model.parameters])

    def owner(self, trial: Trial | None) -> str | None:
        """Return the id of the fitted trial that has the samples of ``trial``; None if no fitted trial has.

        A trial is not identified by its name, because a log of another day may have the same name. Only if
        the parameter file does not come from a fit, trials are matched by name.
        """
        if trial is None or self.file is None:
            return None
        if self.file.fit is None:
            return trial.id
        known = self.file.fit.samples_sha256
        if known.get(trial.id) == trial.digest:
            return trial.id
        return next((name for name, digest in known.items() if digest == trial.digest), None)

    def _value(self, p: Parameter, trial: str | None) -> float:
        if p.name in self.chosen:
            return float(self.chosen[p.name])
        label = f"{p.name}[{trial}]" if p.per_trial else p.name
        if label in self.known:
            return self.known[label].value
        return self.stated.get(p.name, p.start)

    def list_per_trial(self) -> set[str]:
        """Return the names of the parameters that have a value for each trial in the parameter file."""
        return {n.split("[")[0] for n in self.known if "[" in n}

    def noise(self) -> dict[str, float]:
        """Return the standard deviation of the noise of each fitted channel, by the name of the channel."""
        if self.file is None or self.file.fit is None:
            return {}
        known = {name: noise for name, noise in self.file.fit.noise.items() if isinstance(noise, dict)}
        return {name: float(noise["value_sd"]) for name, noise in known.items() if noise.get("value_sd")}

    # -------------------------------------------------------- uncertainty

    def _estimates(self) -> dict[str, Estimate]:
        """Return the estimates of the shared parameters, except the parameters that the user sets."""
        names = [p.name for p in self.model.parameters]
        return {n: self.known[n] for n in names if n in self.known and n not in self.chosen}

    def uncertain(self) -> tuple[list[str], Array]:
        """Return the shared parameters that have a standard error, and their covariance."""
        if self.file is None:
            return [], np.empty((0, 0))
        errors = {n: e.stderr for n, e in self._estimates().items() if e.stderr and math.isfinite(e.stderr)}
        names, sd = list(errors), np.array(list(errors.values()), dtype=float)
        groups = self.file.settings.get("shared", {})
        owner = {member: group for group, members in groups.items() for member in members}
        labels = np.array([owner.get(name, name) for name in names])
        # parameters of one group have one estimate, so they are fully correlated
        correlation = (labels[:, None] == labels).astype(float)
        stated = self.file.correlation
        if stated is not None:
            at = {name: k for k, name in enumerate(stated.names)}
            rows = [k for k, label in enumerate(labels) if label in at]
            places = [at[labels[k]] for k in rows]
            listed = np.array(stated.matrix)[np.ix_(places, places)]
            same = labels[rows][:, None] == labels[rows]
            correlation[np.ix_(rows, rows)] = np.where(same, 1.0, listed)
        return names, correlation * np.outer(sd, sd)

    def warn_without_error(self, where: str) -> None:
        """Warn of shared parameters that were not identified and have no standard error."""
        doubtful = ("unidentifiable", "at-bound")
        lost = [n for n, e in self._estimates().items() if e.status in doubtful and not e.stderr]
        if lost:
            names = ", ".join(lost)
            text = f"the parameter file has no standard error of {names}: their uncertainty is not in {where}"
            warn("SWM055", text)

    def with_errors(self, values: Array, compute: Compute) -> tuple[Array, Array]:
        """Return quantities of a simulation and their standard errors, shape (quantities,) each.

        The standard errors are computed from the covariance of the parameters by the delta method.

        Parameters
        ----------
        values : ndarray, shape (len(model.parameters),)
        compute : callable
            Function from parameter vectors to quantities.

        Notes
        -----
        Derivatives are central differences. A standard error is NaN if no parameter has one, or if the
        quantity is undefined for one of the displaced parameter vectors, because the simulation diverges
        or never becomes steady. A change of the quantity within :data:`COVARIANCE_RTOL` counts as zero.
        """
        names, covariance = self.uncertain()
        vectors, widths = [values], []
        for name, sd in zip(names, np.sqrt(np.diag(covariance)), strict=True):
            index = self.model.index(name)
            p = self.model.parameters[index]
            step = min(STEP_SHARE * sd, MAX_STEP_SHARE * max(abs(values[index]), p.scale))
            ends = np.clip([values[index] - step, values[index] + step], p.lower, p.upper)
            for end in ends:
                moved = values.copy()
                moved[index] = end
                vectors.append(moved)
            widths.append(float(ends[1] - ends[0]))
        table = compute(vectors)
        if not names:
            return table[0], np.full(table.shape[1], np.nan)
        width = np.array(widths)[:, None]
        change = table[2::2] - table[1::2]
        change[np.abs(change) < COVARIANCE_RTOL * np.abs(table[0])] = 0.0
        slopes = np.where(width > 0, change / np.maximum(width, 1e-300), 0.0)
        return table[0], np.sqrt(np.maximum(np.sum(slopes * (covariance @ slopes), axis=0), 0.0))


def with_effects(
    model: Model,
    file: ParameterFile,
    path: Path | None,
    trials: Sequence[Trial],
    own_effects: Sequence[Path] = (),
) -> Model:
    """Return a model with the effects of a parameter file, at the parameter values of the file.

    Raises
    ------
    InputError
        If an effect is unknown, if no variant of the effect has the parameters of the file, or if the file
        lacks constants of the effect that can be computed only from measured trials.
    """
    own = [e for place in own_effects for e in effect_catalogue.from_file(place)]
    acting = []
    for effect in load_effects(file, path, own):
        form = form_of(effect, file, path, model, trials)
        name = effect.name
        sizes = [n for n, v in effect_catalogue.constants(form).items() if isinstance(v, float)]
        lacking = [n for n in sizes if n not in constants_of(file, name)]
        if lacking and not any(trial.measured for trial in trials):
            raise InputError(
                f"the effect '{name}' needs {', '.join(lacking)} from the diagnosed trials",
                file=path,
                column=f"settings.effects.{name}",
            )
        acting.append(form)
    affected = model.with_effects(acting, trials)
    count = len(model.parameters)
    affected.parameters = (
        *model.parameters,
        *(
            replace(p, start=file.parameters[p.name].value, lower=lower, upper=upper)
            for p in affected.parameters[count:]
            for lower, upper in [file.parameters[p.name].limits]
        ),
    )
    return affected


def load_effects(file: ParameterFile, path: Path | None, own: Sequence[Effect] = ()) -> list[Effect]:
    """Return the effects that a parameter file names, in the order in which they act.

    Parameters
    ----------
    own : sequence of Effect
        Effects of the user, which the file may name.

    Raises
    ------
    InputError
        If there is no such effect.
    """
    known = {e.name: e for e in (*effect_catalogue.list_effects(), *own)}
    for name in file.effects:
        if name not in known:
            hint = suggestion(name, list(known))
            raise InputError(f"there is no effect '{name}'", file=path, column="effects", hint=hint)
    return [known[name] for name in file.effects]


def constants_of(file: ParameterFile, name: str) -> dict[str, Any]:
    """Return the constants of an effect that a parameter file contains."""
    return dict((file.settings.get("effects") or {}).get(name, {}))


def form_of(
    effect: Effect, file: ParameterFile, path: Path | None, model: Model, trials: Sequence[Trial]
) -> Effect:
    """Return the variant (form) of an effect that has the parameters and constants in a parameter file.

    Raises
    ------
    InputError
        If no variant of the effect has these parameters in the model, or if the file names the effect twice.
    """
    name = effect.name
    names = list(file.of_effect(name))
    form = effect_catalogue.restore_form(effect, names, constants_of(file, name), model, trials)
    if form is None or file.effects.count(name) > 1:
        hint = "name each effect once, and give all of its parameters as 'effect/parameter'"
        first = next(iter(effect_catalogue.forms(effect, model, trials)), None)
        if first is not None:
            hint += f": {', '.join(f'{name}/{p.name}' for p in first.parameters(model, trials))}"
        raise InputError(
            f"no form of the effect '{name}' has these parameters in the model '{model.name}': "
            f"{', '.join(names) or 'none'}",
            file=path,
            column="effects",
            hint=hint,
        )
    return form


class Loaded(NamedTuple):
    """Experiment (trials and their model), and the parameters for its simulation."""

    experiment: Experiment
    applied: Applied


def read_parameters(
    source: parameters_format.Source, own: Sequence[type[Trials]] = ()
) -> tuple[ParameterFile, dict[str, type[Trials]]]:
    """Read a parameter file, and find the experiments that its model can simulate.

    Returns
    -------
    file : ParameterFile
    experiments : dict of str to class
        Experiments that the model describes, by name.

    Raises
    ------
    InputError
        If the source is not a parameter file, or its model describes no experiment.
    """
    known = find_experiments(own)
    file = parameters_format.read(source)
    described = {name: kind for name, kind in known.items() if file.model in kind.models}
    if not described:
        models = dict.fromkeys(model for kind in known.values() for model in kind.models)
        raise InputError(
            f"holds parameters of the model '{file.model}', not of {' or '.join(models)}",
            file=parameters_format.source_path(source),
            column="model",
            hint="give the Python file of an experiment of your own with --experiment",
        )
    return file, described


def load(trials: str | Path | TrialSet, options: Any) -> Loaded:
    """Load trials of any experiment, with the model and the parameters of a parameter file.

    Parameters
    ----------
    trials : path or TrialSet
    options : Options
        Options of a command: ``params`` (a parameter file; None for the values of the robot file, or else the
        start values of the model), ``robot`` (robot for which the parameters are accepted), ``readings``
        (interpretations of the source, which replace those of the parameter file), ``dt`` (integration step
        of a robot with links, s), ``own_effects`` (Python files with effects of the user), and, if the
        command has them, ``own_experiments`` (Python files with experiments of the user), ``chosen`` (values
        that replace those of the file) and ``start_state``.

    Raises
    ------
    InputError
        If a file is invalid, the model does not describe the experiment, the robot differs, or columns are
        missing.
    """
    own_files = getattr(options, "own_experiments", ())
    own = read_experiments(*own_files)
    if not isinstance(trials, TrialSet):
        trials = TrialSet.read(trials, own)
    parameters, chosen = options.params, dict(getattr(options, "chosen", {}))
    given = {
        "readings": dict(options.readings),
        "max_step": options.dt,
        "start_state": getattr(options, "start_state", "auto"),
    }
    if parameters is None:
        experiment = load_experiment(trials, **given)
        return Loaded(experiment, Applied(experiment.model, chosen=chosen))
    path = parameters_format.source_path(parameters)
    file, described = read_parameters(parameters, [*own, type(trials.entries)])
    if trials.experiment not in described:
        raise InputError(
            f"holds trials of the experiment '{trials.experiment}'; parameters of the model "
            f"'{file.model}' describe: {', '.join(described)}",
            file=trials.path,
            column="experiment",
        )
    if options.robot is None:
        _check_robot(trials, file, path)
    experiment = load_experiment(trials, params=(path, file), **given)
    applied = Applied(experiment.model, file, path, chosen, experiment.trials, options.own_effects)
    inputs = [*experiment.inputs, parameters_format.origin(parameters), *own_files, *options.own_effects]
    return Loaded(replace(experiment, model=applied.model, inputs=inputs), applied)


def load_robot(options: Any, file: ParameterFile | None) -> Applied:
    """Load a robot with links, its model and its coefficients, without trials.

    Parameters
    ----------
    options : Options
        ``params``, ``robot``, ``readings``, ``dt``, ``chosen`` and ``own_effects``, as for :func:`load`.
    file : ParameterFile or None
        Parameters of ``options.params``; None for the values of the robot file.

    Raises
    ------
    UsageError
        If neither a parameter file nor a robot is named.
    InputError
        If a file is invalid, or the coefficients give a physically impossible mass.
    """
    path, folder, readings = None, None, dict(options.readings)
    if file is not None:
        path = parameters_format.source_path(options.params)
        name, folder = parameters_format.robot_of(file, path, options.robot)
        readings = {**file.settings.get("readings", {}), **readings}
    elif options.robot is None:
        raise UsageError("name a parameter file (--params) or a robot (--robot)")
    else:
        name = str(options.robot)
    from swimid.swimmer.trials import robot_model

    _, model = robot_model(name, folder, readings=readings, max_step=options.dt)
    applied = Applied(model, file, path, options.chosen, own_effects=options.own_effects)
    try:
        model.check(applied.values())
    except InputError as error:
        place = path or robot_format.locate(name, folder)
        text = f"with these parameters, {error.reason}"
        raise InputError(text, file=place, column=error.column) from error
    return applied


def _check_robot(trials: TrialSet, file: ParameterFile, path: Path) -> None:
    """Refuse the parameters of one robot for the trials of another robot.

    Raises
    ------
    InputError
        If the two robots differ.
    """
    mine = trials.entries.read_robot(trials.path.parent).name
    if file.robot is None or file.robot in (mine, trials.entries.robot):
        return
    try:
        theirs = robot_format.read(file.robot, path.parent).name
    except InputError:
        theirs = Path(file.robot).stem
    if theirs != mine:
        raise InputError(
            f"these are the parameters of the robot '{theirs}'; the trials in {trials.path.name} are of "
            f"'{mine}'",
            file=path,
            column="robot",
        )


def is_possible(model: Model, values: Array) -> bool:
    """Return whether the coefficients give a physically possible mass."""
    try:
        if model.swimmer is not None:
            model.swimmer.check(values)
    except InputError:
        return False
    return True


# ---------------------------------------------------------------- random samples


#: Number of random samples of the coefficients that are drawn at once, and maximum total number of samples.
BLOCK, MAX_DRAWS = 50_000, 5_000_000


def draw_parameters(applied: Applied, count: int, seed: int) -> tuple[list[Array], float]:
    """Draw random parameter vectors from the covariance of the coefficients.

    The normal distribution is truncated at the bounds of each coefficient, and at physically impossible
    masses.

    Returns
    -------
    vectors : list of ndarray
        Parameter vectors of the model.
    inside : float
        Fraction of the samples that were possible. The other samples were replaced.

    Raises
    ------
    NoTrustworthyResult
        If fewer than ``count`` of MAX_DRAWS samples are possible.
    """
    model, centre = applied.model, applied.values()
    names, covariance = applied.uncertain()
    index = [model.index(name) for name in names]
    lower = np.array([model.parameters[k].lower for k in index])
    upper = np.array([model.parameters[k].upper for k in index])
    sd = np.sqrt(np.diag(covariance))
    # use eigenvectors, because the correlation matrix is singular if coefficients share a value
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    root = sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    for made in range(0, MAX_DRAWS, BLOCK):
        moved = centre[index] + rng.standard_normal((BLOCK, len(names))) @ root.T
        for k in np.flatnonzero(((moved >= lower) & (moved <= upper)).all(axis=1)):
            vector = centre.copy()
            vector[index] = moved[k]
            if is_possible(model, vector):
                found.append(vector)
            if len(found) == count:
                return found, count / (made + int(k) + 1)
    raise NoTrustworthyResult(
        "hardly a draw of the coefficients from their covariance is possible",
        hint="they lie at their bounds or have large standard errors; hold them (--set) or add trials",
    )
