"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``options`` has the options of the command. ``model`` contains the difference equation with its free run
(simulation), adapts it to the interface of all swimid models, and reads trials and records on a time grid, at
the rate of their measurements. ``arx`` is recursive least squares, and the estimation with its uncertainty.
``rwls`` is the command: it chooses working point and orders, computes the prediction errors, and judges them.
"""
