"""The catalogue of effects that a model may lack.

Each stage of the simulation has a module with its effects: ``actuation``, ``structure``, ``fluid``,
``environment``, ``sensing``, ``rig``. ``base`` defines an effect and a model with effects, ``catalogue``
lists all effects and reads those of a user, ``common`` holds what several effects share.
"""
