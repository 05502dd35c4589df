"""Logs of trials: read, imported from other programs, cleaned, and examined without a model.

``log`` is the log of one trial, ``trials`` the file that lists the trials. ``logged`` is the result of
commands that write a log. ``plot`` draws logs. ``options`` holds the options of the commands of this package.

Import: ``foreign`` (readers of file formats, and a profile for each known program), ``mapping``
(sample times, and assignment of a file's columns to those of a log), ``units``, ``guess_mapping`` (a drafted
mapping), ``import_log``, ``consistency`` (contradicting columns).

Samples: ``sampling`` (rate, gaps, repeats, rounding, noise, derivative), ``rotation``. Tracks: ``tracks``
(jumps, mean speed), ``swimming`` (steady swimming). Strokes: ``beat`` (frequency of one channel), ``rhythm``
(stroke from all channels), ``kinematics`` (quantities of whole cycles and of whole swims, for all commands).
"""
