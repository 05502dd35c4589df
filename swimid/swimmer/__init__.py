"""Robots with links, in their plane and in space: ``swimid fit-graybox``.

``trials`` turns logs into trials, ``fit_graybox`` is the command with its evidence, ``options`` its options;
``front`` is its search of several objectives. ``model`` simulates a robot whose links are a ``tree`` with
numbers that are polynomials in the coefficients. ``planar`` and ``spatial`` each hold a compiled engine, the
assembly of its tables from a robot file, and the model. ``lanes`` compiles an engine for several runs
side by side. ``limit_cycle`` finds steady swimming, ``energetics`` the powers and energies of a run.
"""
