"""Which coefficient each output of a robot is most sensitive to: ``swimid sensitivity``.

``sensitivity`` is the command and its result; ``indices`` computes Sobol indices and elementary effects.
``options`` are its options, ``evidence`` is what the result rests on, ``file`` its file.
"""
