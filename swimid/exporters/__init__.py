"""Export of estimated coefficients to simulators: ``swimid export``.

``source`` describes bodies, joints, coefficients and elements as numbers, and has the helpers that formats
share. Each format is one module with a title and a function (source, options): ``mjcf``, ``gazebo`` and
``plain`` (JSON). The command ``export`` lists them, with its ``options``.
"""
