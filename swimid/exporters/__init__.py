"""Export of estimated coefficients to simulators: ``swimid export``.

``source`` describes bodies, joints, coefficients and force elements by their numerical values, and has the
functions that XML formats share. ``mjcf`` and ``gazebo`` are XML formats, each with a title and a function
(source, options). The module ``export`` contains the command and the JSON format, ``options`` its options.
"""
