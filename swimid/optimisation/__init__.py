"""Optimisation of gaits and stiffness with the identified model of a robot.

``study`` simulates batches of gaits, and has the code that all commands share. ``problem`` has the
optimisation problem and its searches. ``performance_map``, ``optimise_stiffness`` and ``optimise_gait`` are
the commands, each with its file format and its evidence. In this order the commands compute a map over a grid
of gaits, a rule for the stiffness of a passive joint, and the best gait within limits. ``options`` has the
options of the commands.
"""
