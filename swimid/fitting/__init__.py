"""Identification of any model: the model interface, and output error by maximum likelihood.

The interface of a model is in ``model`` (parameters, channels, trials, typical scales, shared parameters),
``drives`` (inputs of trials: tail beats, strokes, known quantities), ``hooks`` (effects on a model) and
``experiment`` (a model and its trials).

The fit is in ``output_error``. It uses ``problem`` (residuals, derivatives, Levenberg-Marquardt method),
``restarts`` (searches for a better solution nearby, profile-likelihood intervals), ``global_search`` (fits
from many starting points, Pareto fronts) and ``parallel`` (threads and processes).

The statistics are in ``noise`` (noise model, tests of residuals), ``covariance`` (covariance of the
estimates, identifiability), ``between_trials`` (random effects, outlier trials), ``metrics`` (result of a
fit, errors of a simulation) and ``mistakes`` (common recording mistakes). ``fit_common`` creates the
parameter file, checks and figures of a fit, and fits a user-defined model. ``options`` has the options that
several fits share.
"""
