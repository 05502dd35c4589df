"""Export of estimated coefficients to simulators: ``swimid export``.

``source`` describes bodies, joints, coefficients and force elements by their numerical values, and has the
functions that formats share. Each format is one module with a title and a function (source, options):
``mjcf``, ``gazebo`` and ``plain`` (JSON). The module ``export`` contains the command, ``options`` its
options.
"""
