"""Identification of any model: the model interface, and output error by maximum likelihood.

The interface is in ``model`` (parameters, channels, trials, their typical sizes, shared parameters),
``drives`` (beats, strokes and other inputs of trials), ``hooks`` (effects on a model) and ``experiment`` (a
model and its trials). ``output_error`` is the fit. It uses ``problem`` (residuals, derivatives,
Levenberg-Marquardt), ``restarts`` (tests of an answer, profile-likelihood intervals), ``global_search`` (many
starts, several objectives) and ``parallel``. ``noise`` has the noise model and tests of residuals,
``covariance`` the covariance and identifiability, ``between_trials`` random effects and the outlier among the
trials. ``metrics`` has the result of a fit and its errors, ``mistakes`` the usual mistakes of recording.
``fit_common`` makes parameter file, checks and figures of a fit, and fits a model of your own. ``options``
has the options of several fits.
"""
