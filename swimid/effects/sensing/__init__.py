"""Effects between what the robot does and what the log shows of it."""
