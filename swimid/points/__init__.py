"""Pose and joint angles of a robot from tracked points.

The module ``points`` computes pose and joint angles. ``point_files`` reads points files, ``bundle`` estimates
states, noise and faults of a film, ``linkage`` has the least squares, and ``point_evidence`` the evidence.
``scale`` describes the scale and the calibration of a camera in YAML files, and ``plane`` maps its picture to
metres.
"""
