"""Any parameter file on any robot: simulated runs, and measured trials against their simulation.

``catalogue`` joins a trials file and a parameter file, ``applied`` holds the values of each trial and their
covariance. ``simulate`` is one verb, with ``cases`` (what to run), ``run``, ``swim_quantities``,
``animation`` and ``simulated`` (its result); ``compare`` the other, with ``compare_series``,
``compare_evidence``, ``cycles``, ``compare_strokes`` and ``compare_strokes_evidence``; ``compared`` is its
result, ``comparison_file`` and ``section`` that result's file and its place in a report; ``options`` are
those of both.
"""
