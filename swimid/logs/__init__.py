"""Logs of trials: read, imported from other programs, cleaned, and what they say without a model.

``log`` is the log of one trial, ``trials`` the trials file, ``logged`` the result of all that makes a log;
``plot``, ``figures`` and ``section`` show logs, ``options`` are those of the verbs. Import: ``foreign``
(one module per format), ``mapping``, ``units``, ``guessing`` and ``guess_mapping`` (a mapping drafted),
``import_log``, ``examine``, ``imported`` (its result). Of samples: ``sampling``, ``time_order``,
``plausible``, ``derivative``, ``rotation``. Of tracks: ``track_cleaning``, ``track_speed``, ``course``,
``projection``, ``swimming``. Of strokes: ``beat`` (its frequency), ``rhythm`` (from all channels).
"""
