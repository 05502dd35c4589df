"""Results of commands: their files, and their output as text, as an HTML or Markdown page, and as figures.

- ``result`` has the base class of all results, their text for a terminal, and the list of the result formats
that can be read from a file.
- ``evidence`` has the classes of verdict, checks, tables and figures, and functions for figures that several
  packages use. ``parameters`` has the parameter file and the result of a fit.
- ``report`` (with ``options``) has the command ``swimid report``, which makes one page from several results.
- ``drawing`` draws figures, ``numbers`` formats numbers and units.
"""
