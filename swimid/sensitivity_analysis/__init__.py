"""Which coefficient each output of a robot is most sensitive to: ``swimid sensitivity``.

``outputs`` says what a run comes to, ``indices`` computes Sobol indices and elementary effects over it;
``sensitivity`` is the verb and its result, ``options`` what it can be told, ``evidence`` what the result
rests on, ``file`` and ``section`` its file and its place in a report.
"""
