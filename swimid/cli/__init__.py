"""Command line: it parses the arguments, calls one function and prints the result. It computes nothing.

- ``main`` finds the commands in the ``options.py`` of every package, lists them by purpose, and reads the
  values of their options.
- ``common`` has the shared options, the output streams and the exit statuses.
- ``import_log``, ``schema`` and ``doctor`` (with ``options``) are commands that belong to no other package.

The last three modules are imported when their command runs. The other modules import few libraries, so that
``--help`` is fast.
"""
