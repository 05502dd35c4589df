"""The catalogue of effects: what a model may leave out.

One module for each stage of the chain holds the effects that act there: ``actuation``, ``structure``,
``fluid``, ``environment``, ``sensing``, ``rig``. ``base`` is what an effect is, ``affected`` a model with
effects on it, ``catalogue`` finds them all, ``common`` holds what several of them are made of.
"""
