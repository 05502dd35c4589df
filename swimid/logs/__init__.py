"""Logs of trials, and the files that list them.

The module ``log`` reads and writes the log of one trial. ``units`` has the units of its columns. ``sampling``
estimates the rate, gaps, repeated samples, rounding, noise and derivatives of its channels. ``trials`` reads
the file that lists the trials. ``experiments`` has the base class of experiments and finds all of them.
"""
