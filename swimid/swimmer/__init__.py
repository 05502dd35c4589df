"""Robots with links, in their plane and in space: ``swimid fit-graybox``.

``planar`` and ``spatial`` each hold a compiled engine, its model, its drive and its elements; both are
built from a ``tree`` of links whose numbers are ``polynomial`` in the coefficients. ``trials`` turns logs
into trials, ``fit_graybox`` is the verb, with ``options``, ``fit_graybox_evidence`` what its answer rests
on; ``front`` searches several objectives (``profiles``, ``stroke_cycles``), ``front_table`` is their table.
"""
