"""Entry point of ``python -m swimid``."""

from swimid.cli.main import entry

entry()
