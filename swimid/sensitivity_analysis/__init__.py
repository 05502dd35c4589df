"""Which coefficient each output of a robot is most sensitive to: indices, maps, result."""
