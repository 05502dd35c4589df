"""The catalogue of effects: what a model may leave out.

One module per effect, in the folder of the stage of the chain at which it acts:
``actuation``, ``structure``, ``fluid``, ``environment``, ``sensing``, ``rig``.
"""
