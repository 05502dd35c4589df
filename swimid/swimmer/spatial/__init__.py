"""Robots with links in 3-D: the compiled equations of motion, their input arrays, and the model."""
