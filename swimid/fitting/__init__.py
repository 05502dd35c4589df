"""Identification of any model: the model interface, and output error by maximum likelihood.

Interface: ``model`` (parameters, channels, trials, their typical sizes, and parameters that share a value),
``drives`` (beats, strokes, and other inputs of trials), ``hooks`` (effects on a model), ``experiment`` (a
model and its trials). Search: ``output_error`` (the fit), ``problem`` (residuals, derivatives and
Levenberg-Marquardt), ``restarts`` (with profile-likelihood intervals), ``global_search`` (many starts,
several objectives), ``parallel``. Uncertainty: ``noise`` (its model, and tests of residuals), ``covariance``
(with identifiability), ``between_trials`` (random effects, the odd trial). Judging: ``metrics`` (result of a
fit, errors and their limits), ``mistakes`` (of recording). ``fit_common`` makes parameter file, checks and
figures of a fit and fits a model of one's own, ``options`` holds options of several fits.
"""
