"""Export of estimated coefficients and causes to simulators: ``swimid export``.

The module ``source`` describes bodies, joints, coefficients and force elements by their numerical values, and
has the functions that the XML formats share. ``causes`` applies the effects in a parameter file to them, and
``filters`` has the laws of servos for simulators that lack them. ``mjcf`` and ``gazebo`` write one XML format
each. ``export`` has the command, the JSON format and the random samples, and ``options`` has the options of
the command.
"""
