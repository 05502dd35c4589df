"""``fit``: identification of the model of any experiment, from its trials file."""

from pathlib import Path

from swimid.fitting.fit_common import fit_model, load_experiment
from swimid.fitting.options import FitOptions
from swimid.logs.experiments import read_experiments
from swimid.logs.trials import TrialSet
from swimid.notices import Progress, silent
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
        Parameter file to write; its evidence goes beside it.
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
    A body coasts from 1 m/s against a quadratic drag. The experiment is a class here, or else a file:

    >>> from typing import Literal
    >>> import numpy as np
    >>> import pandas as pd
    >>> import swimid
    >>> from swimid.fitting.fit_common import Experiment, read_log
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
    ...         logs = [read_log(one, path.parent, required=("x_m",)) for one in self.trials]
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
    experiment = load_experiment(trials, command="fit")
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
