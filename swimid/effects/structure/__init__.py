"""Effects of the robot's own mechanics: fins, passive joints, masses."""
