"""Robot files, and the built-in robots as YAML.

``file`` reads a robot file by name or path. ``planar`` defines the links, joints and elements of a robot in a
plane, and ``spatial`` those of a robot in 3-D.
"""
