"""Robots with links, in their plane (``planar``) and in space (``spatial``): trials, models, gray-box fit."""
