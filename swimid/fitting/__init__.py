"""Identification of any model: the model interface, and output error by maximum likelihood.

The interface of a model is in ``model`` (parameters, channels, trials, hooks for effects, typical scales,
shared parameters) and ``drives`` (inputs of trials: tail beats, strokes, known quantities).

The fit is in ``output_error``, which also searches for a better solution near the estimates. It uses
``problem`` (residuals, derivatives, Levenberg-Marquardt method, threads and processes). ``global_search``
has fits from many starting points, and Pareto fronts.

The statistics are in ``noise`` (noise model, tests of residuals), ``covariance`` (covariance of the
estimates, identifiability), ``between_trials`` (random effects, outlier trials), ``metrics`` (result of a
fit, errors of a simulation) and ``mistakes`` (common recording mistakes). ``fit_common`` reads the logs of
trials, creates the parameter file, checks and figures of a fit, and fits a user-defined model.
"""
