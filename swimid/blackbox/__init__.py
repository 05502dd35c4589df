"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``options`` has the options of the command. ``model`` has the difference equation of the models and its
simulation (free run), in the interface that all swimid models share. It also reads logs as records of input
and output on a time grid. ``arx`` estimates the coefficients and their uncertainty by recursive least
squares. ``rwls`` has the command itself. The command chooses the working point and the orders of a model,
computes prediction errors, and checks them.
"""
