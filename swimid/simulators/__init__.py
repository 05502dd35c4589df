"""Simulators of the user as models: a file of MuJoCo, or a function in Python.

``model`` has the interface that both share: parameters of the trials file, inputs from the log, and outputs.
``mjcf`` simulates a file of MuJoCo in batches, and ``python`` calls a function of the user. ``repaired``
writes values and effects into the user's file.
"""
