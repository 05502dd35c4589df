"""Robots with links, in a plane and in space: ``swimid fit-graybox``.

``fit_graybox`` is the command with its evidence, ``options`` its options, ``front`` its search of Pareto
fronts. ``trials`` turns logs into trials. ``model`` simulates a robot: ``tree`` has its links with tables
that are polynomials in the coefficients, ``drive`` the motion of its driven joints, ``steady`` its steady
swimming on a ``limit_cycle``. ``planar`` and ``spatial`` each hold a compiled engine, the assembly of its
tables from a robot file, and the model. ``lanes`` compiles an engine for batches of runs. ``energetics``
computes the powers of a run.
"""
