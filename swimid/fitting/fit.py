"""``fit``: identification of the model of any experiment, from its trials file or from trials in memory."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.files.provenance import Input
from swimid.fitting import fit_common, output_error
from swimid.fitting.model import Model, Trial, choose_parameters
from swimid.fitting.options import FitOptions
from swimid.logs.experiments import read_experiments
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, automatic, record_warnings, silent
from swimid.options import takes
from swimid.results.parameters import Fitted


@takes(FitOptions)
def fit(
    trials: str | Path | TrialSet,
    *,
    output: Path | None = None,
    options: FitOptions,
    progress: Progress = silent,
) -> Fitted:
    """Identify the model of an experiment that has no command of its own.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file, or the trials that :func:`swimid.load` returns.
    output : path, optional
        Parameter file to write. The evidence file is written beside it.
    progress : Progress
        Progress bar of the search.

    Returns
    -------
    Fitted
        As from :func:`swimid.fit_model`, which also fits trials in memory without an experiment.

    Raises
    ------
    InputError
        If a file is invalid, or the experiment has a command of its own.
    UsageError
        If the model does not have a named parameter, or no trial has the role ``fit``.
    NoTrustworthyResult
        If the search does not converge, or no parameter can be identified.

    Examples
    --------
    A body coasts from 1 m/s against a quadratic drag. Here a class defines the experiment. It can also be
    defined by a file:

    >>> from typing import Literal
    >>> import numpy as np
    >>> import pandas as pd
    >>> import swimid
    >>> from swimid.fitting.fit_common import Experiment, read_trial_log
    >>> from swimid.logs.experiments import TrialEntry
    >>> class CoastingModel(swimid.Model):
    ...     name = "coasting"
    ...     parameters = (swimid.Parameter("drag_per_m", "1/m", 0.0, 10.0, start=1.0, scale=1.0),)
    ...     channels = (swimid.Channel("x_m", "m", "way"),)
    ...
    ...     def simulate(self, values, trial):
    ...         return {"x_m": np.log1p(values[0] * trial.time_s) / values[0]}
    >>> class Coasting(swimid.Trials):
    ...     about = "a body coasts"
    ...     models = ("coasting",)
    ...     experiment: Literal["coasting"]
    ...     trials: list[TrialEntry]
    ...
    ...     def load(self, path, **options):
    ...         logs = [read_trial_log(one, path.parent, required=("x_m",)) for one in self.trials]
    ...         trials = [swimid.Trial(log.path.name, "fit", log.time_s, {"x_m": log["x_m"]}) for log in logs]
    ...         return Experiment.of(self, path, CoastingModel(), trials, [log.source for log in logs])
    >>> t = np.arange(200) / 50
    >>> way = np.log1p(0.5 * t) / 0.5 + 0.002 * np.random.default_rng(1).normal(size=200)
    >>> log = pd.DataFrame({"t_s": t, "x_m": way})
    >>> trials = swimid.load([{"log": log}], experiment=Coasting, robot="boxfish")
    >>> round(fit(trials)["drag_per_m"].value, 2)
    0.5
    """
    if not isinstance(trials, TrialSet):
        trials = TrialSet.read(trials, read_experiments(*options.own_experiments))
    experiment = fit_common.load_experiment(trials, command="fit")
    return fit_model(
        experiment.model,
        experiment.trials,
        fixed=options.fixed,
        freed=options.freed,
        bounds=options.bounds,
        robot=trials.entries.robot,
        inputs=[*experiment.inputs, *options.own_experiments],
        output=output,
        progress=progress,
    )


def fit_model(
    model: Model,
    trials: Sequence[Trial],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    robot: str = "",
    inputs: Sequence[Input] = (),
    output: str | Path | None = None,
    progress: Progress = automatic,
) -> Fitted:
    """Estimate the parameters of any model from trials in memory, with all checks and figures of a fit.

    Convergence does not show that the model is right: look at ``.verdict``, and at the checks of the
    residuals in ``.checks()``. :func:`swimid.fitting.output_error.fit_output_error` describes the method.

    Parameters
    ----------
    model : Model
        Model that simulates a trial from parameter values.
    trials : sequence of Trial
        Trials of the role ``validate`` are held out: they are simulated and scored, not fitted.
    fixed : mapping, optional
        Values of parameters that are not estimated, in the units of the parameters.
    freed : sequence of str
        Names of parameters that are estimated although the model fixes them.
    bounds : mapping, optional
        Bounds (lower, upper) that replace those of the model, in the units of the parameters.
    robot : str
        Name of the robot, for the parameter file.
    inputs : sequence of paths or objects
        Sources of the trials for the provenance: the ``log.source`` of each log.
    output : path, optional
        Parameter file to write, together with its evidence file.
    progress : Progress
        Progress bar of the search.

    Returns
    -------
    Fitted
        ``.parameters`` has the value, standard error and 95 % interval of each parameter, in its unit.
        ``.correlation``, ``.has_converged`` and ``.verdict`` show whether the parameters can be trusted.

    Raises
    ------
    UsageError
        If the model does not have a named parameter, or no trial has the role ``fit``.
    InputError
        If the output cannot be written.
    NoTrustworthyResult
        If the search does not converge, or no parameter can be identified.

    References
    ----------
    .. [1] V. Klein, E. A. Morelli, *Aircraft System Identification: Theory and Practice*, AIAA, 2006.
       Output error and coloured residuals.

    Examples
    --------
    A body coasts from 1 m/s against a quadratic drag:

    >>> import numpy as np
    >>> from swimid import Channel, Model, Parameter, Trial
    >>> class Coasting(Model):
    ...     name = "coasting"
    ...     parameters = (Parameter("drag_per_m", "1/m", lower=0.0, upper=10.0, start=1.0, scale=1.0),)
    ...     channels = (Channel("x_m", "m", "way"),)
    ...
    ...     def simulate(self, values, trial):
    ...         return {"x_m": np.log1p(values[0] * trial.time_s) / values[0]}
    >>> t = np.arange(200) / 50
    >>> way = np.log1p(0.5 * t) / 0.5 + 0.002 * np.random.default_rng(1).normal(size=200)
    >>> fit = fit_model(Coasting(), [Trial("run 1", "fit", time_s=t, measured={"x_m": way})])
    >>> round(fit["drag_per_m"].value, 2), fit.verdict
    (0.5, 'caution')
    """
    if not any(trial.role == "fit" for trial in trials):
        raise UsageError(f"none of the {len(trials)} trials has role: fit: give this role to at least one")
    choices = {"fixed": dict(fixed or {}), "freed": list(freed), "bounds": dict(bounds or {})}
    return _fit_parameters(model, trials, choices, robot, inputs, output, progress)


def _fit_parameters(
    model: Model,
    trials: Sequence[Trial],
    choices: dict[str, Any],
    robot: str,
    inputs: Sequence[Input],
    output: str | Path | None,
    progress: Progress,
) -> Fitted:
    """Estimate the parameters of a model with the choices of the user (see :func:`fit_model`)."""
    target = None if output is None else atomic.check_writable(Path(output), inputs=inputs)
    with record_warnings(repeat=True) as notices:
        parameters = choose_parameters(model.parameters, **choices)
        result = output_error.fit_output_error(model, trials, parameters=parameters, progress=progress)
        result = output_error.complete_fit(result)
        bounds = {name: list(pair) for name, pair in choices["bounds"].items()}
        settings = {**choices, "bounds": bounds}
        origin = provenance.collect(inputs, settings=settings)
        file = fit_common.parameter_file(result, robot=robot, provenance=origin)
        tested = fit_common.assess(result)
    fit_common.insist_identified(result, "use more trials with more different settings, or fix parameters")
    title = f"Fit of {model.name}"
    if robot:
        title += f" of {robot}"
    said = fit_common.describe_method(result, "trial(s)", f"the model {model.name}")
    shown = {"figures": fit_common.figures(result), "methods": [said, fit_common.COVARIANCE]}
    return fit_common.finish("fit", file, tested, notices, target, title=title, **shown)
