"""Robots with links, in their plane and in space: ``swimid fit-graybox``.

``planar`` and ``spatial`` each hold a compiled engine, its model and its elements; both are a ``model`` on a
``tree`` of links whose numbers are ``polynomial`` in the coefficients, with the ``energetics`` of a run.
``trials`` turns logs into trials, ``fit_graybox`` is the command, with ``options`` and
``fit_graybox_evidence``; ``front`` searches several objectives (``profiles``, ``stroke_cycles``).
"""
