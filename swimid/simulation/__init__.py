"""Simulation of robots with identified parameters, and comparison of trials with their simulation.

``catalogue`` combines trials with a parameter file: it gives the parameters of each trial and their
covariance. ``simulate`` is the command of this name, with ``cases`` (the runs to simulate and their
quantities). ``compare`` is the other command, with ``compare_series`` (channels of
each trial, and the comparison file).
``options`` has the options of both commands.
"""
