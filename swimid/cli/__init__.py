"""The command line: parses, calls one verb, prints. Nothing is computed here.

Modules of this layer import click and the standard library only; whatever is heavy is
imported when the command runs, so that ``--help`` and completion are instant.
"""
