"""Rigs with one degree of freedom, falling weight, towing and free decay: ``swimid fit-drag``.

``trials`` turns logs into trials (``encoder``: what a count is worth); ``model`` is a rig as a model,
``equation`` its equation of motion integrated; ``fit_drag`` is the verb, with ``options``.
``trial_effects`` finds what differs from trial to trial, ``two_point`` is the boxfish paper's own method,
``omitted`` tests the parameters that a fit holds, ``force`` the measured force of a tow; ``theory`` has
estimates from tables, ``derived`` what follows from the parameters.
"""
