"""Pose and joint angles of a robot from tracked points.

The module ``points`` computes pose and joint angles. ``point_files`` reads points files, ``bundle`` estimates
a film: its states and noise (``film``), faults (``film_faults``), ambiguous states (``film_states``) and the
bias of global quantities (``film_bias``). ``linkage`` has the least squares, and ``point_evidence`` the
checks, tables and figures of a result. ``scale`` describes the scale and the calibration of a camera in YAML
files, and ``plane`` maps the picture of the camera to metres.
"""
