"""Discrete-time ARX and ARMAX models from an input and an output column: ``swimid rwls``.

``trials`` gives records on one time grid, ``own_rate`` brings a log to the rate of its measurements,
``difference`` is the equation and its free run, ``model`` the same behind the model interface. ``arx``
regresses, ``armax`` searches the noise polynomial, ``recursive`` is recursive least squares,
``working_point`` decides on means, ``prediction`` predicts and judges. ``identified`` chooses orders and puts
these together; ``rwls`` is the command, with ``options`` and ``evidence``.
"""
