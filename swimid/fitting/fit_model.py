"""The fit of a model of one's own: any :class:`~swimid.fitting.model.Model`, any trials, in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.files.provenance import Held
from swimid.fitting import fit_common, output_error
from swimid.fitting.model import Model, Trial, chosen
from swimid.notices import recorded
from swimid.progress import Progress, silent
from swimid.results import blocks
from swimid.results import evidence as ev
from swimid.results.fitted import Fitted


def fit_model(
    model: Model,
    trials: Sequence[Trial],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    robot: str = "",
    inputs: Sequence[Path | Held] = (),
    output: str | Path | None = None,
    verb: str = "fit",
    progress: Progress = silent,
) -> Fitted:
    """Estimate the parameters of any model from trials in memory, with all the evidence of a fit.

    A search that converged says nothing of the model: see ``.verdict``, and ``.checks()`` for its residuals.

    Parameters
    ----------
    model : Model
        Simulates a trial from parameter values.
    trials : sequence of Trial
        Those of role ``validate`` are held out: simulated and scored, not fitted.
    fixed : mapping of name to float, optional
        Parameters held at a value, in their units.
    freed : sequence of str
        Parameters estimated that are fixed by default.
    bounds : mapping of name to (lower, upper), optional
        In the place of the model's own, in the parameters' units.
    robot : str
        Whose parameters they are, for the parameter file.
    inputs : sequence of Path or Held
        What the trials were made of, for the provenance: ``log.source`` of each log.
    output : path, optional
        Parameter file to write, its evidence beside it; nothing is written without.
    verb : str
        The command this is the fit of, for the evidence.
    progress : Progress
        Shows the search.

    Returns
    -------
    Fitted
        ``.parameters`` has value, standard error and 95 % interval of each, in its unit; ``.correlation``,
        ``.converged`` and ``.verdict`` say how far to trust them.

    Raises
    ------
    UsageError
        For a parameter that the model does not have, or no trial to fit.
    InputError
        When the output cannot be written.
    NoTrustworthyResult
        When the search does not converge, or nothing can be identified.

    See Also
    --------
    swimid.fitting.output_error.fit : the estimator, with its method.

    References
    ----------
    .. [1] V. Klein, E. A. Morelli, *Aircraft System Identification: Theory and Practice*, AIAA, 2006.
       Output error, coloured residuals.

    Examples
    --------
    A body that coasts from 1 m/s against a quadratic drag:

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
    (0.5, 'good')
    """
    if not any(trial.role == "fit" for trial in trials):
        raise UsageError("there is no trial to fit")
    target = None if output is None else atomic.check_writable(Path(output), inputs=inputs)
    with recorded(repeat=True) as notices:
        parameters = chosen(tuple(model.parameters), fixed=fixed, freed=tuple(freed), bounds=bounds)
        result = output_error.fit(model, trials, parameters=parameters, progress=progress)
        result = output_error.with_held_out(result)
        settings = {
            "fixed": dict(fixed or {}),
            "freed": list(freed),
            "bounds": {name: list(pair) for name, pair in (bounds or {}).items()},
        }
        origin = provenance.collect(inputs, settings=settings)
        file = fit_common.parameter_file(result, robot=robot, provenance=origin)
        checks = fit_common.checks(result, file)
    shared = result.shared
    if shared and all(result.status[label] != "estimated" for label in shared):
        raise NoTrustworthyResult(
            f"none of {', '.join(shared)} can be identified from these trials",
            hint="use more trials, and such as differ more",
        )
    fitted_trials = sum(trial.role == "fit" for trial in trials)
    whose = f"{model.name} of {robot}" if robot else model.name
    evidence = ev.Evidence(
        verb=verb,
        title=f"Fit of {whose}",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        figures=fit_common.figures(result),
        notices=blocks.notices(notices),
        methods=[
            f"{', '.join(shared)} were estimated from {fitted_trials} trial(s) ({result.samples} samples) "
            f"by output-error maximum likelihood with the model {model.name}.",
            fit_common.COVARIANCE,
        ],
        provenance=origin,
    )
    return Fitted.of(file, evidence).saved(target)
