"""Import of logs of other programs.

The module ``import_log`` is the command, and ``options`` has its options. ``formats`` has the readers of file
formats. Each reader returns a table, whose class is in the module ``table``. ``mapping`` drafts a mapping,
assigns the columns of a file to those of a log, and computes the sample times. ``averaging`` averages
successive rows of a long recording, and computes the statistics of all its rows. ``consistency`` finds
columns that contradict each other, and faulty channels. ``clocks`` finds the offset between the clocks of two
logs.
"""
