"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``options`` has the options of the command. ``trials`` reads records on a time grid, at the rate of their
measurements. ``difference`` contains the difference equation and its free run (simulation). ``model`` adapts
this model to the interface of all swimid models. ``recursive`` is recursive least squares, ``arx`` the
estimation with its uncertainty. ``identified`` chooses working point and orders and computes the prediction
errors. ``rwls`` is the command with its evidence.
"""
