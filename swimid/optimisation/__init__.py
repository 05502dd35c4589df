"""Optimisation with an identified model: maps over gaits, stiffness rules, best gaits.

``performance`` simulates batches of gaits. ``study`` has what the results of all commands share. ``problem``
has the searches. ``performance_map``, ``optimise_stiffness`` and ``optimise_gait`` are the commands, each
with its file and its evidence; ``options`` are their options.
"""
