"""Robots with links in a plane: the compiled equations of motion, their input arrays, and the model."""
