"""Robots with links in space: their engine, the tables of the engine, and the model."""
