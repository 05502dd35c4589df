"""The command line: parses, calls one function, prints. Nothing is computed here.

``verbs`` lists the commands by purpose, ``builder`` makes them of a verb's options, ``main`` puts them
together; a command that is more than its options has a module named as it is. ``common`` holds shared
options, output streams and exit statuses, ``parsing`` values of more than one word, ``table`` the options
as the docs show them; ``doctor_verb`` and ``schema_verb`` do what no room below is about. Modules here
import click and the standard library only; whatever is heavy is imported when the command runs, so that
``--help`` and completion are instant.
"""
