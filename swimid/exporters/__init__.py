"""Export of estimated coefficients and causes to simulators: ``swimid export``.

The module ``source`` describes the exported robot (bodies, joints, coefficients, force elements) by numerical
values, and has the functions that the XML formats share. ``causes`` applies the effects in a parameter file
to the exported robot. ``filters`` has laws of servos for simulators that lack these laws. ``mjcf`` writes the
XML format of MuJoCo, ``gazebo`` and ``vehicle`` that of Gazebo. ``export`` has the command, the JSON format
and the random samples of the parameters, and ``options`` has the options of the command.
"""
