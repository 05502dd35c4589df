"""Results of commands, and their output on a terminal, as an HTML or Markdown page, and as figures.

- ``result`` has the base class of all results, their text for a terminal, and the list of the result formats
that can be read from a file.
- ``evidence`` has the classes for verdict, checks, tables and figures, and the tables and figures of several
  packages. ``parameters`` has the parameter file and the result of a fit.
- ``report`` (with ``options``) is the command ``swimid report``, which creates one page from several results.
- ``drawing`` draws figures, ``numbers`` formats numbers and units.
"""
