"""Any parameter file on any robot: simulated runs, and measured trials against their simulation.

``catalogue`` joins a trials file and a parameter file, ``applied`` holds the values of each trial and their
covariance. ``simulate`` is one verb, with ``cases`` (what to run), ``run`` (and its result),
``swim_quantities`` and ``animation``; ``compare`` the other, with its result, ``compare_series``,
``compare_evidence``, ``cycles``, ``compare_strokes`` and ``compare_strokes_evidence``; ``comparison_file``
and ``section`` are that result's file and its place in a report; ``options`` are those of both.
"""
