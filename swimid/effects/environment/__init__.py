"""Effects of the place the robot swims in."""
