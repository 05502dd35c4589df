"""From accelerations and turn rates to motion: ``swimid track imu``.

A ``record`` is read, ``faults`` finds what may be wrong with it, and ``setup`` holds all that is known before
the motion: sensor, rests, mounting, a first attitude. ``smoother`` integrates and follows the errors with the
observations of ``aiding``, for a unit by itself (``alone``) or beside another log (``fusion``, with their
``alignment``). ``motion`` is that path at the body's reference point, or by the long-fin paper's steps, and
all else that is estimated. The verb is ``track_imu``, with its evidence and its ``options``.

Frames
------
``i`` the sensor, ``b`` the body (x forward, y to port, z up), ``w`` the world (z up). ``R_wi``
turns sensor components into world ones; rotations are :class:`scipy.spatial.transform.Rotation`.
An accelerometer reads specific force: at rest it shows 1 g upwards.
"""
