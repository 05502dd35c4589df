"""Test rigs with one degree of freedom (falling weight, towing, free decay): ``swimid fit-drag``.

``trials`` reads logs and detects encoders. ``model`` has the model of a rig, and integrates its equation of
motion. ``options`` has the options of the command. ``fit_drag`` is the command, and has the two-point method
of the boxfish paper. It tests held parameters, trials, the measured force of a towed body, and whether the
parameters are physically possible. It also has the quantities that follow from the parameters.
"""
