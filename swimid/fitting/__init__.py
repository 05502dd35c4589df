"""Identification of any model: the model interface, and output error by maximum likelihood.

Interface: ``model`` (parameters, channels, trials, their typical sizes, and parameters that share a value),
``drives`` (beats, strokes, and other inputs of trials), ``hooks`` (effects on a model), ``experiment`` (a
model and its trials). Search: ``output_error``, ``problem``, ``levenberg``, ``multistart``, ``restarts``
(with profile-likelihood intervals), ``genetic`` (several objectives), ``parallel``. Uncertainty: ``noise``,
``sandwich`` (covariance), ``identifiability``, ``random_effect``, ``odd_trial``. Judging:
``residual_tests``, ``metrics`` (errors and their limits), ``mistakes`` (of recording). ``fit_result`` holds
the result of a search, ``fit_common`` makes its parameter file, checks and figures, ``fit_model`` fits a
model of one's own, ``options`` holds options of several fits.
"""
