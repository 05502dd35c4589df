"""Rigs with one degree of freedom, falling weight, towing and free decay: ``swimid fit-drag``.

``trials`` reads logs and encoders. ``model`` is the model of a rig, and integrates its equation of motion.
``fit_drag`` is the command, with the two-point method of the boxfish paper; ``options`` are its options.
``lack_of_fit`` tests held parameters, differences between trials, and the measured force of a tow.
``derived`` has the quantities that follow from the parameters, and tests whether a body can have the
parameters.
"""
