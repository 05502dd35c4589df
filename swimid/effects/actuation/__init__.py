"""Effects between the command and what the actuator does."""
