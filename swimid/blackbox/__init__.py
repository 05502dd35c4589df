"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``options`` has the options of the command. ``model`` contains the difference equation and its simulation
(free run), and adapts it to the interface of all swimid models. It also reads trials and records on a time
grid. ``arx`` has recursive least squares, and estimates the coefficients with their uncertainty. ``rwls`` is
the command: it chooses working point and orders, computes the prediction errors, and judges them.
"""
