"""Motion from accelerations and turn rates: ``swimid track imu``.

``record`` reads a recording and ``faults`` finds and repairs its faults. ``setup`` determines what must be
known before the motion is estimated: sensor errors, rests, mounting and attitude. ``smoother`` integrates the
readings to a path and estimates the errors of this path from observations. ``alone`` applies the smoother to
the inertial unit by itself. ``fusion`` applies it to the unit together with another log of the same trial,
after ``alignment`` of the two logs. ``motion`` computes the motion of the reference point of the body, or the
motion by the method of the long-fin paper. ``track_imu`` is the command with its evidence, and ``options``
contains its options.

Frames
------
``i`` is the frame of the sensor, ``b`` that of the body (x forward, y to port, z up), and ``w`` that of the
world (z up). ``R_wi`` converts components along sensor axes to components along world axes. Rotations are
:class:`scipy.spatial.transform.Rotation`. An accelerometer measures specific force: at rest it shows 1 g
upwards.
"""
