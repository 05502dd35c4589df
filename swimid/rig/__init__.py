"""Test rigs with one degree of freedom (falling weight, towing, free decay): ``swimid fit-drag``.

``model`` has the model of a rig, and integrates its equation of motion. It also has the known quantities of a
trial, and detects displacements that an encoder measured. ``options`` has the options of the command.
``fit_drag`` has the command itself, the two-point method of the boxfish paper, and the quantities that are
derived from the estimates, such as the terminal speed. It also has the checks of the fit: omitted parameters,
an outlier trial, the sign of a measured force, and estimates that are physically impossible.
"""
