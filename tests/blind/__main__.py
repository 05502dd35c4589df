"""``python -m tests.blind``: make blind cases, diagnose them by the command line, score."""

from tests.blind.runner import main

main()
