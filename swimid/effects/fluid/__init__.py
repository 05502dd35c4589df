"""Effects of the water on the body and its fins."""
