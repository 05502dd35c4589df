"""First steps with swimid: drafts of the files of a project, and samples.

``survey`` finds the recordings of a folder, ``groups`` sorts them by kind, ``drafts`` makes the text of each
file of the project, ``init`` writes them, and ``sample`` copies the samples of the installed version.
"""
