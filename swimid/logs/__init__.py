"""Logs of trials: read, imported from other programs, cleaned, and examined without a model.

``log`` is the log of one trial, ``trials`` the trials file, ``logged`` the result of commands that make a
log, with its figures; ``plot`` draws logs, ``options`` are those of the commands.

Import: ``foreign`` (readers of file formats), ``profiles`` (a profile per known program), ``mapping``,
``clock`` (sample times), ``units``, ``guess_mapping`` (a drafted mapping),
``import_log``, ``examine``, ``consistency`` (contradicting columns).

Samples: ``sampling`` (rate, gaps, repeats, rounding, noise, derivative), ``rotation``.
Tracks: ``tracks`` (jumps, mean speed), ``swimming`` (steady swimming).
Strokes: ``beat`` (frequency of one channel), ``rhythm`` (stroke of all channels), ``kinematics`` (quantities
of whole cycles and swims, for all commands).
"""
