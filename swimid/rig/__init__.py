"""Rigs with one degree of freedom, falling weight, towing and free decay: ``swimid fit-drag``.

``trials`` turns logs into trials (``encoder``: what a count is worth); ``model`` is a rig as a model,
``equation`` its equation of motion integrated; ``fit_drag`` is the verb, with ``options``.
``trial_effects`` finds what differs from trial to trial, ``two_point`` is the boxfish paper's own method,
``theory`` its estimates from tables, ``derived`` what follows from the parameters.
"""
