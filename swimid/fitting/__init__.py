"""Parameter identification of any model: model interface, and output-error fit by maximum likelihood.

The interface of a model is in ``model`` (parameters, channels, trials and their inputs, hooks for effects,
typical scales, shared parameters). ``drives`` has the motions of tail beats and strokes.

The fit is in ``output_error``, which also searches for a better solution near the estimates. It uses
``problem`` (residuals, derivatives, Levenberg-Marquardt method, threads and processes, integration step).
``global_search`` has fits from many starting points, and Pareto fronts.

The statistics are in ``uncertainty`` (noise model, tests of residuals, covariance of the estimates,
identifiability), ``noise`` (autocorrelated noise) and ``intervals`` (errors of the estimates, differences
between trials). ``rivals`` compares a fit with alternative fits by one score. ``mistakes`` has common
recording mistakes. ``fit_common`` reads the logs of trials, computes the errors of a simulation, and creates
the parameter file, checks and figures of a fit. ``fit`` is the command for the model of any experiment, with
its ``options``, and fits a user-defined model.
"""
