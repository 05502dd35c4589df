"""The catalogue of effects that a model may lack.

Each part of the simulated system has a module with its effects: ``actuation``, ``structure``, ``fluid``,
``environment``, ``sensing``, ``rig``. ``base`` defines an effect and a model with effects. ``catalogue``
lists all effects and reads those of a user's file. ``common`` contains functions and base classes that
several effects use.
"""
