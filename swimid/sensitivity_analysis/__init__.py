"""Which coefficient each output of a robot is most sensitive to: ``swimid sensitivity``.

``outputs`` says what a run comes to, ``indices`` computes Sobol indices and elementary effects over it
(``threads``); ``sensitivity`` is the verb, ``options`` what it can be told, ``studied`` its result,
``evidence`` what that rests on, ``file`` and ``section`` its file and its place in a report.
"""
