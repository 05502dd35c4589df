"""The catalogue of effects that a model may lack.

Each part of the simulated system has a module with its effects: ``actuation``, ``structure``, ``fluid``,
``environment``, ``sensing``, ``rig``. ``base`` defines an effect, a model with effects, and
functions and base classes that several effects use. ``catalogue`` lists all effects and reads those of a
user's file.
"""
