"""Robots: what is known of one before any fit, and the built-in ones as YAML.

``file`` is the robot file and finds a robot by name or path; ``planar`` holds the links, joints and
elements of a robot in its plane, ``spatial`` those of a robot in space.
"""
