"""Simulation of any parameter file on any robot, and comparison of measured trials with their simulation.

``catalogue`` joins trials and a parameter file: the parameters of each trial and their covariance.
``simulate`` is one command, with ``cases`` (the runs), ``swim_quantities`` and ``animation``. ``compare`` is
the other, with ``compare_series`` (channels of each trial, and the comparison file) and ``compare_strokes``
(motion profiles of a robot in space). ``options`` are those of both commands.
"""
