"""The command line: parses, calls one function, prints. Nothing is computed here.

``verbs`` lists the commands by purpose, ``builder`` makes them of a verb's options, ``main`` puts them
together, with the group ``track``. ``common`` holds shared options, output streams and exit statuses,
``parsing`` values of more than one word, ``table`` the options as the docs show them; ``doctor`` (with
``options``), ``schema`` and ``import_log`` do what no room below is about, and are imported when their
command runs. All others import click and the standard library only, so that ``--help`` is instant.
"""
