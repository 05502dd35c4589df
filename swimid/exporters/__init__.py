"""Export of estimated coefficients to simulators: ``swimid export``.

The module ``source`` describes bodies, joints, coefficients and force elements by their numerical values, and
has the functions that the XML formats share. ``mjcf`` and ``gazebo`` write one XML format each. ``export``
has the command and the JSON format, and ``options`` has the options of the command.
"""
