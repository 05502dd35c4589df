"""Sensitivity of the simulated outputs of a robot to its coefficients: ``swimid sensitivity``.

``sensitivity`` has the command, the format of its result file, its evidence, and the computation of Sobol
indices. ``options`` has the options of the command.
"""
