"""Commands ``init`` and ``sample``, which help with the first steps.

``survey`` finds the recordings of a folder. ``drafts`` groups them and makes the text of each file of the
project. ``init`` writes these files. ``sample`` copies the samples of the installed version. ``options`` has
the options of both commands.
"""
