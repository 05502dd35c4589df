"""Sensitivity of the outputs of a robot to its coefficients: ``swimid sensitivity``.

``sensitivity`` is the command and its result; ``indices`` computes Sobol indices and elementary effects.
``options`` are the options of the command, ``evidence`` is the result file and its evidence.
"""
