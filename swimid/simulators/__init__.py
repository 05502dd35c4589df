"""Simulators of the user as models: a file of MuJoCo (``mjcf``), or a function in Python (``python``).

``model`` has the interface that both share: parameters of the trials file, inputs from the log, and outputs.
``effects`` has the forms of effects that a file of MuJoCo can express, and ``repaired`` writes them into the
user's file.
"""
