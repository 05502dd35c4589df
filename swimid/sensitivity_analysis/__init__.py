"""Sensitivity of the outputs of a robot to its coefficients: ``swimid sensitivity``.

``sensitivity`` has the command and its result, ``indices`` computes Sobol indices. ``options`` has the
options of the command, ``evidence`` has the result file and its evidence.
"""
