"""Robots with links in a plane: their engine, the tables of the engine, and the model."""
