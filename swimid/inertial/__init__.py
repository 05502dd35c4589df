"""Motion of a robot from the readings of an inertial unit: the command ``swimid track imu``.

``record`` reads a recording, and determines sensor errors, rests, mounting and attitude of the sensor before
the motion is estimated. ``faults`` finds and repairs the faults of the recording. ``smoother`` integrates the
readings to a path, estimates the errors of this path from observations, and computes the motion of the
reference point of the body. ``estimate`` applies the smoother to the inertial unit alone, or together with
another log of the same trial after ``alignment`` of the two logs. ``track_imu`` is the command, with the
checks and figures of its result and with the method of Shang et al. (2012). ``options`` contains its options.

Frames
------
``i`` is the frame of the sensor, ``b`` that of the body (x forward, y to port, z up), and ``w`` that of the
world (z up). ``R_wi`` converts components along sensor axes to components along world axes. Rotations are
:class:`scipy.spatial.transform.Rotation`. An accelerometer measures specific force: at rest it shows 1 g
upwards.
"""
