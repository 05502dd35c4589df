"""Batches of simulations: the equations of one robot, traced with symbols and compiled for vector registers.

``tracing`` runs an engine on symbols and writes its operations as the text of a module. ``kernel`` compiles,
keeps and runs that module, also with the forces and elements of effects.
"""
