"""Robot files, and the built-in robots as YAML.

``file`` reads a robot file by name or path. ``planar`` has the links, joints and elements of a robot in a
plane, ``spatial`` those of a robot in space.
"""
