"""Logs of trials: read, imported from other programs, cleaned, and examined without a model.

``log`` is the log of one trial, ``trials`` the trials file, ``logged`` the result of all that makes a log;
``plot`` and ``figures`` show logs, ``options`` are those of the commands.

Import: ``foreign`` (a reader per file format), ``profiles`` (a profile per known program), ``mapping``,
``clock``, ``units``, ``guess_mapping`` (a drafted mapping),
``import_log``, ``examine``, ``consistency`` (contradicting columns), ``imported`` (the evidence).

Samples: ``sampling``, ``time_order``, ``plausible``, ``derivative``, ``rotation``.
Tracks: ``track_cleaning``, ``track_speed``, ``course``, ``swimming``.
Strokes: ``beat`` (frequency of one channel), ``rhythm`` (of all channels).
"""
