"""Any parameter file on any robot: simulated runs, and measured trials against their simulation.

``catalogue`` joins a trials file and a parameter file: the values of each trial and their covariance.
``simulate`` is one command, with ``cases`` (the runs that are asked for), ``swim_quantities`` and
``animation``. ``compare`` is the other, with ``compare_series`` (each trial, and the file) and
``compare_strokes`` (motion profiles of a robot in space). ``options`` are those of both.
"""
