"""Which coefficient each output of a robot is most sensitive to: ``swimid sensitivity``.

``sensitivity`` is the command and its result; ``indices`` computes Sobol indices and elementary effects.
``options`` are its options, ``evidence`` is the file and what it rests on.
"""
