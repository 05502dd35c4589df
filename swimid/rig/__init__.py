"""Test rigs with one degree of freedom (falling weight, towing, free decay): ``swimid fit-drag``.

``trials`` reads logs and detects encoders. ``model`` is the model of a rig, and integrates its equation of
motion. ``fit_drag`` is the command, and has the two-point method of the boxfish paper. ``options`` has the
options of the command. ``lack_of_fit`` tests held parameters, differences between trials, and the measured
force of a towed body. ``derived`` has the quantities that follow from the parameters, and tests whether the
parameters are physically possible.
"""
