"""The command line: parses, calls one function, prints. Nothing is computed here.

One module per command, named as it is; ``main`` lists them by purpose, ``common`` holds options, output
streams and exit statuses, ``parsing`` values of more than one word; ``doctor_verb`` and ``schema_verb`` do
what no room below is about. Modules here import click and the standard library only; whatever is heavy is
imported when the command runs, so that ``--help`` and completion are instant.
"""
