"""Simulation of robots with identified parameters, and comparison of trials with their simulation.

``catalogue`` combines trials with a parameter file: it gives the parameters of each trial and their
covariance, and draws random parameter vectors. ``simulate`` has the command ``swimid simulate``, and
``cases`` defines the simulations that this command can compute. ``compare`` has the command ``swimid
compare``, and ``compare_series`` has the channels of each trial and the comparison file. ``options`` has the
options of the two commands.
"""
