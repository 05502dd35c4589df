"""The robot file (``file``), links of a robot in its plane and in space, and the built-in robots."""
