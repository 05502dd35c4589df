"""Batches of simulations: the equations of motion of one robot, compiled for vector registers.

``tracing`` runs an engine (compiled equations of motion) on symbols, and writes its operations as the text of
a module. ``kernel`` compiles, stores and runs that module, also with the forces and elements of effects.
"""
