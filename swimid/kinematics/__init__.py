"""Motion of a swimmer in a log, without a model.

The module ``attitude`` converts angles, quaternions and axes. ``jumps`` finds the jumps of a track, and
``speed`` its mean speed. ``frequency`` finds the frequency of one channel, ``stroke`` the stroke from all
channels, and ``course`` compares the course with the heading. ``cycles`` defines quantities over whole
cycles, ``swimming`` measures steady swimming, and ``wave`` the body wave.

``plot`` draws logs. ``logged`` defines the result of commands that write a log. ``options`` has the options
of the command ``plot``.
"""
