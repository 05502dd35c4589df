"""``python -m validation.blind``: make blind cases, diagnose them by the command line, score."""

from validation.blind.runner import main

main()
