"""Identification of any model: the model interface, and output error by maximum likelihood.

Interface: ``model`` (parameters, channels, trials), ``inputs`` (what is known of a trial beside its samples),
``drives`` (beats and strokes), ``swimmer`` (what models of robots with links have in common), ``body`` (links
of a robot in a plane, and how its tables are changed), ``scales`` (typical sizes of trials), ``hooks`` (what
else acts on a model), ``experiment`` (a model and its trials), ``tied`` (parameters that share a value).
Search: ``output_error``, ``problem``, ``levenberg``, ``multistart``, ``restarts``, ``genetic`` (several
objectives). Uncertainty: ``noise``, ``sandwich`` (covariance), ``identifiability``, ``profile``,
``random_effect``, ``odd_trial``, ``start_states``. Judging: ``residual_tests``, ``metrics``. ``fit_result``
is what a search came to, ``fit_common`` its parameter file, checks and figures, ``fit_model`` the fit of a
model of one's own, ``options`` what several fits can be told.
"""
