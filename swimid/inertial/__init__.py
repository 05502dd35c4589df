"""From accelerations and turn rates to motion: ``swimid track imu``.

``record`` and ``sensor`` hold what is known. ``faults`` and ``conventions`` find what may be wrong with a
recording, ``rest`` finds rests, and ``setup`` holds all that is known before the motion. ``strapdown``
integrates, ``errorstate`` and ``smoother`` follow the errors with the observations of ``aiding``. The path is
that of a unit by itself (``alone``) or beside another log (``fusion``, with ``clock`` and ``alignment``);
``plausible`` judges it. ``motion`` is that path at the body's reference point, or by the long-fin paper's
steps. The verb is ``track_imu``: its ``options`` and ``inputs``, the ``run`` with all it estimates, and its
``evidence``.

Frames
------
``i`` the sensor, ``b`` the body (x forward, y to port, z up), ``w`` the world (z up). ``R_wi``
turns sensor components into world ones; rotations are :class:`scipy.spatial.transform.Rotation`.
An accelerometer reads specific force: at rest it shows 1 g upwards.
"""
