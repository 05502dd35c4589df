"""The command line: parses, calls one function, prints. Nothing is computed here.

- ``builder`` finds the commands in the ``options.py`` of every package and reads the values of their options;
  ``main`` lists them by purpose.
- ``common`` holds shared options, output streams and exit statuses.
- ``import_log``, ``schema`` and ``doctor`` (with ``options``) do what no package below is about.

The last three are imported when their command runs. All others import click and the standard library only,
so that ``--help`` is instant.
"""
