"""Command line of swimid. It parses arguments, calls one function and prints the result.

- ``main`` finds the commands in the ``options.py`` of every package, lists them by purpose, and reads the
  values of their options. It also has the options that all commands share, prints results and errors, and
  sets the exit status. It imports few libraries, so that ``--help`` is fast.
- ``commands`` (with ``options``) has the commands that belong to no other package: swimid import, schema and
  doctor.
"""
