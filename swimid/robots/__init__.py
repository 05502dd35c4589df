"""Format of robot files, and the robot files of the built-in robots.

``file`` reads a robot file from its name or path. ``planar`` defines the links, joints and hydrodynamic
elements of a robot that moves in a plane, and ``spatial`` those of a robot that moves in 3-D.
"""
