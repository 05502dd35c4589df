"""Motion from accelerations and turn rates: ``swimid track imu``.

``record`` reads a recording, ``faults`` finds what is wrong with it, and ``setup`` contains all that is known
before the motion: sensor, rests, mounting, attitude. ``smoother`` integrates the readings and estimates the
errors of the path with the observations of ``aiding``: for a unit by itself in ``alone``, with another log in
``fusion`` after their ``alignment``. ``motion`` is that path at the reference point of the body. ``paper``
contains the steps of the long-fin paper. ``track_imu`` is the command with its evidence, ``options`` are its
options.

Frames
------
``i`` the sensor, ``b`` the body (x forward, y to port, z up), ``w`` the world (z up). ``R_wi`` turns
components in the sensor into those in the world. Rotations are :class:`scipy.spatial.transform.Rotation`. An
accelerometer measures specific force: at rest it shows 1 g upwards.
"""
