"""The catalogue of effects: what a model may leave out.

One module per effect, in the folder of the stage of the chain at which it acts: ``actuation``,
``structure``, ``fluid``, ``environment``, ``sensing``, ``rig``. ``base`` is what an effect is, ``affected``
a model with effects on it, ``catalogue`` finds them all, ``common`` holds what several of them are made of.
"""
