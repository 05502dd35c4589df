"""Robots with links, in a plane and in 3-D: ``swimid fit-graybox``.

``fit_graybox`` is the command, ``options`` has its options, and ``front`` searches its Pareto fronts.
``trials`` turns logs into trials. ``model`` simulates a robot. ``tree`` holds its links, ``drive`` computes
the motion of its driven joints, and ``steady`` its steady swimming.

``planar`` and ``spatial`` are the two kinds of robot: in a plane and in 3-D. Each has an engine, which is the
compiled equations of motion with their time integration. The engine takes the properties of a robot as arrays
(tables), whose entries are polynomials in the coefficients. The assembly of each kind computes these arrays
from a robot file. ``lanes`` compiles an engine for batches of simulations.
"""
