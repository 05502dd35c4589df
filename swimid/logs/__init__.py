"""Logs of trials: reading, import from other programs, cleaning, and examination without a model.

``log`` is the log of one trial, ``trials`` the file that lists the trials. ``plot`` draws logs. ``options``
holds the options of the commands of this package.

Import: ``foreign`` (readers of file formats, and units), ``mapping`` (a drafted mapping, sample times, and
assignment of a file's columns to those of a log), ``import_log``, ``consistency`` (contradicting columns,
faulty channels).

Samples: ``sampling`` (rate, gaps, repeats, rounding, noise, derivative). Tracks: ``tracks`` (jumps, mean
speed, and the result of commands that write a log). Strokes: ``beat`` (frequency of one channel, and stroke
from all channels). ``kinematics`` has attitudes, quantities of whole cycles, and steady swimming.
"""
