"""From accelerations and turn rates to motion: ``swimid track imu``.

``record`` and ``sensor`` are what is known, ``faults`` what may be wrong with a recording (one module
each); ``rest`` and ``mounting`` tell rests and how the sensor sits, and ``setup`` holds all that is known
before the motion. ``strapdown`` reckons, ``errorstate`` and ``smoother`` follow the errors with what
``aiding`` observes; they make the path of a unit by itself (``alone``) or beside another log (``fusion``,
with ``clock`` and ``alignment``), and ``plausible`` judges it. ``motion`` is that path at the body's
reference point, ``paper`` the long-fin paper's way. The verb is ``track_imu``: its ``options`` and
``inputs``, the ``run`` with all it estimates, and how that is told (``evidence``, ``checks``, ``figures``).

Frames
------
``i`` the sensor, ``b`` the body (x forward, y to port, z up), ``w`` the world (z up). ``R_wi``
turns sensor components into world ones; rotations are :class:`scipy.spatial.transform.Rotation`.
An accelerometer reads specific force: at rest it shows 1 g upwards.
"""
