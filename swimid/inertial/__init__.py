"""From accelerations and turn rates to motion.

Frames: ``i`` the sensor, ``b`` the body (x forward, y to port, z up), ``w`` the world (z up). ``R_wi``
turns sensor components into world ones; rotations are :class:`scipy.spatial.transform.Rotation`.
An accelerometer reads specific force: at rest it shows 1 g upwards.
"""
