"""Rigs with one degree of freedom, falling weight, towing and free decay: ``swimid fit-drag``.

``trials`` turns logs into trials and reads encoders; ``model`` is a rig as a model, and integrates its
equation of motion; ``fit_drag`` is the command, with ``options``, and the method of the boxfish paper.
``lack_of_fit`` tests held parameters, starts and frictions of single trials, whether a trial contradicts the
others, and the measured force of a tow. ``derived`` has quantities that follow from the parameters, and
whether a body can have them.
"""
