"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``options`` has the options of the command. ``trials`` reads records on a time grid, at the rate of their
measurements. ``difference`` contains the equation and its free run, ``model`` the same behind the model
interface. ``recursive`` is recursive least squares, ``arx`` the estimation with its uncertainty.
``identified`` chooses working point and orders and computes the errors. ``rwls`` is the command with its
evidence.
"""
