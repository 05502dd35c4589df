"""Any parameter file on any robot: simulated runs, and measured trials against their simulation.

``catalogue`` joins a trials file and a parameter file, ``applied`` holds the values of each trial and their
covariance. ``simulate`` is one verb, with ``cases`` (what to run), ``run`` (and its result),
``swim_quantities`` and ``animation``; ``compare`` the other, with its result, ``compare_series`` (each trial),
``compare_strokes`` (motion profiles of a robot in space) and ``compare_evidence``; ``comparison_file`` is the
file of that result; ``options`` are those of both.
"""
