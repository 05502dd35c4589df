"""Optimisation of gaits and stiffness with an identified model: maps, stiffness rules and best gaits.

``study`` simulates batches of gaits, and has the code that all commands share. ``problem`` has the
optimisation problem and its searches. ``performance_map``, ``optimise_stiffness`` and ``optimise_gait`` are
the commands, each with its file format and its evidence. ``options`` has their options.
"""
