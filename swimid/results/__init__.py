"""Results of commands, and their renderers: terminal, HTML and Markdown page, figure.

- ``result`` is the base class of all results, ``fitted`` the class of every fit. ``kinds`` lists the results
  that can be read again.
- ``evidence`` holds verdict, checks, tables and figures as data, ``parameters`` the parameter file.
- ``terminal`` prints a result, ``page`` makes a page of several, ``drawing`` draws figures.
- ``report`` (with ``options``) is the command.
- ``blocks`` makes tables and figures that several packages need, ``numbers`` writes numbers and units.
"""
