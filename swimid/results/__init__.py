"""Results of commands, and their output on a terminal, as an HTML or Markdown page, and as figures.

- ``result`` has the base class of all results. ``kinds`` lists the results that can be read from a file.
- ``evidence`` has the classes for verdict, checks, tables and figures. ``parameters`` has the parameter file
  and the result of a fit.
- ``terminal`` prints a result, ``page`` creates one page from several results, ``drawing`` draws figures.
- ``report`` (with ``options``) is the command ``swimid report``.
- ``blocks`` creates tables and figures for several packages, ``numbers`` formats numbers and units.
"""
