"""Any parameter file on any robot: simulated runs, and measured trials against their simulation.

``catalogue`` joins a trials file and a parameter file, ``applied`` holds the values of each trial and their
covariance. ``simulate`` is one command, with ``cases`` (the runs), ``run`` (and its result),
``swim_quantities`` and ``animation``. ``compare`` is the other, with ``compare_series`` (each trial),
``compare_strokes`` (motion profiles of a robot in space), ``compare_evidence`` and ``comparison_file``.
``options`` are those of both.
"""
