"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``trials`` gives records on one time grid, at the rate of their measurements. ``difference`` is the equation
and its free run, ``model`` the same behind the model interface. ``arx`` regresses and searches the noise
polynomial, ``recursive`` is recursive least squares. ``identified`` decides on means, chooses orders and
predicts; ``rwls`` is the command with its evidence, ``options`` are its options.
"""
